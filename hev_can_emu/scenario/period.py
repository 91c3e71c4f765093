"""Expectation about a message's period and jitter, from the frames themselves."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.scenario.monitor import Block, Frames, Head, Monitor
from hev_can_emu.scenario.verdict import Outcome


class Period(Monitor):
    """Every interval between two frames of a message keeps a period; none is missing at the window's ends.

    Args:
        head: see there.
        identifier, extended: the message's frames.
        period_ns: the wanted interval.
        jitter_ns: by how much an interval may differ from it.
    """

    def __init__(
        self, head: Head, identifier: int, extended: bool, period_ns: int, jitter_ns: int
    ) -> None:
        super().__init__(head, "s")
        self._identifier = identifier
        self._extended = extended
        self._period_ns = period_ns
        self._jitter_ns = jitter_ns
        self._last_ns: int | None = None
        self._count = 0
        self._sum_ns = 0
        self._shortest = self._longest = 0
        self._bad: tuple[int, str] | None = None  #: when, what
        self._worst_ns = 0
        self._silent = False

    def hear(self, frames: Frames) -> None:
        """Measure the intervals."""
        mine = (
            (frames.identifiers == self._identifier)
            & (frames.extended == self._extended)
            & (frames.t_ns >= self.open_ns)
            & (frames.t_ns <= self.close_ns)
        )
        times = frames.t_ns[mine]
        if not times.size or self._bad is not None:
            return
        if self._last_ns is None:
            self._check_silence(int(times[0]), self.open_ns)
            gaps = np.diff(times)
        else:
            gaps = np.diff(times, prepend=self._last_ns)
        self._last_ns = int(times[-1])
        if not gaps.size:
            return
        away = np.abs(gaps - self._period_ns)
        late = np.flatnonzero(away > self._jitter_ns)
        if late.size and self._bad is None:
            place = int(late[0])
            at = int(times[len(times) - len(gaps) + place])
            self._bad = at, f"an interval of {gaps[place] * 1e-6:.6g} ms"
            gaps, away = gaps[: place + 1], away[: place + 1]
        low, high = int(gaps.min()), int(gaps.max())
        self._shortest = min(self._shortest, low) if self._count else low
        self._longest = max(self._longest, high)
        self._count += len(gaps)
        self._sum_ns += int(gaps.sum())
        self._worst_ns = max(self._worst_ns, int(away.max()))

    def _check_silence(self, t_ns: int, since_ns: int) -> None:
        """Note that nothing came for longer than the period allows."""
        longest = self._period_ns + self._jitter_ns
        if t_ns - since_ns > longest and self._bad is None:
            # How long it lasts is not known: there is no margin.
            self._bad = since_ns + longest, f"no frame for more than {longest * 1e-6:.6g} ms"
            self._silent = True

    def watch(self, block: Block) -> None:
        """Fail where an interval was wrong, or where none has ended for too long."""
        now = int(block.t_ns[-1])
        since = self.open_ns if self._last_ns is None else self._last_ns
        self._check_silence(min(now, self.close_ns), since)
        spare_s = (self._jitter_ns - self._worst_ns) * 1e-9
        self.margin = math.inf if self._silent else spare_s
        if self._bad is not None:
            self._decide(Outcome.FAIL, *self._bad)
        elif block.last and self._count == 0:
            self.margin = math.inf
            self._decide(Outcome.INCONCLUSIVE, now, "fewer than two frames in the window")
        elif block.last:
            mean = self._sum_ns / self._count * 1e-6
            spread = f"{self._shortest * 1e-6:.6g} to {self._longest * 1e-6:.6g} ms"
            told = f"{self._count} intervals, mean {mean:.6g} ms, {spread}"
            self._decide(Outcome.PASS, now, told)
