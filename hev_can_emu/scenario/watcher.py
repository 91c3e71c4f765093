"""The expectations of a run: opens and closes their windows, hands them what was seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hev_can_emu.messages.frame import EXTENDED
from hev_can_emu.scenario.monitor import NEVER, Block, Frames, Monitor
from hev_can_emu.scenario.program import Instant, Watch
from hev_can_emu.scenario.script import ROWS, Script

#: Resolves an instant to run time, None while it is not known.
Resolve = Callable[[Instant], int | None]


class Watcher:
    """Watches all windows of a program.

    Args:
        watches: the expectations.
        script: where the rows are.
        resolve: tells when an instant is.
    """

    def __init__(self, watches: Sequence[Watch], script: Script, resolve: Resolve) -> None:
        self.monitors = [watch.make() for watch in watches]
        self.hears = any(watch.hears for watch in watches)
        self._script = script
        self._resolve = resolve
        self._waiting = list(zip(watches, self.monitors, strict=True))
        self._open: list[tuple[Watch, Monitor]] = []
        self._frames: list[np.ndarray] = []

    @property
    def busy(self) -> bool:
        """Whether anything is undecided."""
        return bool(self._waiting or self._open)

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
        self._open_windows(int(t_ns[-1]))
        heard = self._heard()
        for watch, monitor in self._open:
            if monitor.close_ns == NEVER:
                closes = self._resolve(watch.closes)
                monitor.close_ns = NEVER if closes is None else closes
            first = int(np.searchsorted(t_ns, monitor.open_ns))
            stop = int(np.searchsorted(t_ns, monitor.close_ns)) + 1
            last = stop <= count
            if first >= min(stop, count):
                continue
            if heard is not None and watch.hears:
                monitor.hear(heard)
            monitor.watch(Block(t_ns[first:stop], rows[first:stop], last))
        self._open = [pair for pair in self._open if pair[1].outcome is None]

    def _open_windows(self, now_ns: int) -> None:
        waiting = []
        for watch, monitor in self._waiting:
            opens = self._resolve(watch.opens)
            if opens is None or opens > now_ns:
                waiting.append((watch, monitor))
            else:
                monitor.opened, monitor.open_ns = True, opens
                self._open.append((watch, monitor))
        self._waiting = waiting

    def _heard(self) -> Frames | None:
        if not self._frames:
            return None
        whole = np.concatenate(self._frames)
        self._frames.clear()
        return Frames(whole["t_ns"], whole["id"], (whole["flags"] & EXTENDED) != 0)
