"""The expectations of a run: opens and closes their windows, hands them what was seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import numpy as np

from hev_can_emu.messages.frame import EXTENDED
from hev_can_emu.scenario.monitor import NEVER, Block, Frames, Monitor
from hev_can_emu.scenario.program import Instant, Watch
from hev_can_emu.scenario.script import ROWS, Script

#: Resolves an instant to run time, None while it is not known.
Resolve = Callable[[Instant], int | None]


class Worker(Protocol):
    """A second thread that does what it is given in order; both raise what failed there."""

    def do(self, work: Callable[[], object]) -> None:
        """Give work."""

    def wait(self) -> None:
        """Wait until all that was given is done."""


class Watcher:
    """Watches all windows of a program.

    Args:
        watches: the expectations.
        script: where the rows are.
        resolve: tells when an instant is.

    Attributes:
        worker: where expectations look at what is handed over; None: at once, by the one who hands it over.
            To be changed only where nothing waits there.
    """

    def __init__(self, watches: Sequence[Watch], script: Script, resolve: Resolve) -> None:
        self._monitors = [watch.make() for watch in watches]
        self.worker: Worker | None = None
        self.hears = any(watch.hears for watch in watches)
        self._script = script
        self._resolve = resolve
        self._undecided = list(zip(watches, self._monitors, strict=True))
        self._frames: list[np.ndarray] = []

    @property
    def monitors(self) -> Sequence[Monitor]:
        """All of them, when they have looked at all that was handed over."""
        if self.worker is not None:
            self.worker.wait()
        return self._monitors

    @property
    def busy(self) -> bool:
        """Whether anything is undecided; with a worker, by what it has come to so far."""
        return bool(self._undecided)

    def hear(self, frames: np.ndarray) -> None:
        """Keep frames (FRAME records, copied) for the expectations that listen."""
        if self.hears and len(frames):
            self._frames.append(frames[["t_ns", "id", "flags"]].copy())

    def watch(self) -> None:
        """Hand over the rows noted and the frames heard since the last call."""
        script = self._script
        count = int(script.control[ROWS])
        script.control[ROWS] = 0
        if count == 0:
            return
        t_ns, rows = script.rows_ns[:count], script.rows[:count]
        # What is known of windows by now, whenever it is looked at.
        pairs = self._undecided
        windows = [(self._resolve(watch.opens), self._resolve(watch.closes)) for watch, _ in pairs]
        heard = self._heard()
        if self.worker is None:
            self._look(Block(t_ns, rows, last=False), pairs, windows, heard)
        else:
            block = Block(t_ns.copy(), rows.copy(), last=False)
            self.worker.do(partial(self._look, block, pairs, windows, heard))

    def _look(
        self,
        noted: Block,
        pairs: Sequence[tuple[Watch, Monitor]],
        windows: Sequence[tuple[int | None, int | None]],
        heard: Frames | None,
    ) -> None:
        """Let expectations look at rows; ``windows``: when they open and close, None: not known yet."""
        t_ns, rows, _ = noted
        count = len(t_ns)
        for (watch, monitor), (opens, closes) in zip(pairs, windows, strict=True):
            if monitor.outcome is not None:  # decided since this was handed over
                continue
            if not monitor.opened:
                if opens is None or opens > t_ns[-1]:
                    continue
                monitor.opened, monitor.open_ns = True, opens
            if monitor.close_ns == NEVER and closes is not None:
                monitor.close_ns = closes
            first = int(np.searchsorted(t_ns, monitor.open_ns))
            stop = int(np.searchsorted(t_ns, monitor.close_ns)) + 1
            last = stop <= count
            if first >= min(stop, count):
                continue
            if heard is not None and watch.hears:
                monitor.hear(heard)
            monitor.watch(Block(t_ns[first:stop], rows[first:stop], last))
        self._undecided = [pair for pair in self._undecided if pair[1].outcome is None]

    def _heard(self) -> Frames | None:
        if not self._frames:
            return None
        whole = np.concatenate(self._frames)
        self._frames.clear()
        return Frames(whole["t_ns"], whole["id"], (whole["flags"] & EXTENDED) != 0)
