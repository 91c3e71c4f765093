"""Expectations about how a value goes to a target: settles, equals, overshoot, rise time, monotone."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.scenario.expression import Array, Expression
from hev_can_emu.scenario.monitor import Block, Head, Monitor, first_true
from hev_can_emu.scenario.verdict import Outcome


class Equals(Monitor):
    """The value is within the band at one instant."""

    def __init__(self, head: Head, value: Expression, target: float, band: float) -> None:
        super().__init__(head, value.unit_name)
        self._value = value
        self._target = target
        self._band = band

    def watch(self, block: Block) -> None:
        """Decide at once."""
        left = self._band - abs(self._value.value(block.rows[0]) - self._target)
        self.margin = left if math.isfinite(left) else math.inf
        # A tolerance of zero allows for the last bits of a scaled value.
        rounding = 1e-9 * max(abs(self._target), self._band)
        outcome = Outcome.PASS if left >= -rounding else Outcome.FAIL
        self._decide(outcome, block.t_ns[0], self._see(block.rows[0]))


class Settles(Monitor):
    """The value is within the band from the deadline at the latest until the window's end."""

    def __init__(
        self, head: Head, value: Expression, target: float, band: float, hold_ns: int
    ) -> None:
        super().__init__(head, value.unit_name)
        self._value = value
        self._target = target
        self._band = band
        self._hold_ns = hold_ns
        self._since_ns: int | None = None

    def watch(self, block: Block) -> None:
        """Note since when the value is in the band; fail where it is not after the deadline."""
        t_ns, rows, last = block
        left = self._band - np.abs(self._value.values(rows) - self._target)
        outside = np.flatnonzero(~(left >= 0.0))
        deadline_ns = self.close_ns - self._hold_ns
        late = outside[t_ns[outside] >= deadline_ns]
        if late.size:
            margin = float(left[late[0]])
            self.margin = margin if math.isfinite(margin) else math.inf
            self._decide(Outcome.FAIL, t_ns[late[0]], self._see(rows[late[0]]))
            return
        if outside.size:
            after = int(outside[-1]) + 1
            self._since_ns = int(t_ns[after]) if after < len(t_ns) else None
        elif self._since_ns is None:
            self._since_ns = int(t_ns[0])
        if last and self._since_ns is not None:
            self.margin, self._margin_unit = (deadline_ns - self._since_ns) * 1e-9, "s"
            told = f"settled at {self._since_ns * 1e-9:.3f} s; {self._see(rows[-1])}"
            self._decide(Outcome.PASS, t_ns[-1], told)


class _Step(Monitor):
    """Base: the value goes from what it is at the window's opening to a target."""

    def __init__(self, head: Head, value: Expression, target: float, margin_unit: str) -> None:
        super().__init__(head, margin_unit)
        self._value = value
        self._target = target
        self._start = math.nan

    def _begin(self, values: Array) -> None:
        """Take the first available value as the start."""
        if math.isnan(self._start):
            known = first_true(~np.isnan(values))
            if known is not None:
                self._start = float(values[known])

    def _never_there(self, block: Block) -> bool:
        """Decide at the window's end where the value was never available."""
        if not block.last or not math.isnan(self._start):
            return False
        told = "a signal was not available all the while"
        self._decide(Outcome.INCONCLUSIVE, block.t_ns[-1], told)
        return True


class Overshoot(_Step):
    """The value goes beyond its target by no more than a limit.

    Args:
        head, value, target: see there.
        limit: in the value's unit, or, where ``share``, a part of the way from start to target.
        share: whether it is.
    """

    def __init__(
        self, head: Head, value: Expression, target: float, limit: float, share: bool
    ) -> None:
        super().__init__(head, value, target, value.unit_name)
        self._limit = limit
        self._share = share
        self._worst = 0.0
        self._worst_ns = 0

    def watch(self, block: Block) -> None:
        """Fail at the first tick beyond the limit."""
        values = self._value.values(block.rows)
        self._begin(values)
        if self._never_there(block) or math.isnan(self._start):
            return
        way = self._target - self._start
        beyond = (values - self._target) * (1.0 if way >= 0.0 else -1.0)
        if way == 0.0:
            beyond = np.abs(beyond)
        limit = self._limit * abs(way) if self._share else self._limit
        bad = first_true(beyond > limit)
        known = np.where(np.isnan(beyond), -np.inf, beyond)[: None if bad is None else bad + 1]
        place = int(known.argmax())
        if known[place] > self._worst:
            self._worst, self._worst_ns = float(known[place]), int(block.t_ns[place])
        self.margin = limit - self._worst
        if bad is not None:
            self._decide(Outcome.FAIL, block.t_ns[bad], self._told(way))
        elif block.last:
            self._decide(Outcome.PASS, block.t_ns[-1], self._told(way))

    def _told(self, way: float) -> str:
        if self._worst == 0.0:
            return "no overshoot"
        part = f" ({self._worst / abs(way):.2%})" if way else ""
        unit = self._value.unit_name
        return f"{self._worst:.4g} {unit}".strip() + f"{part} at {self._worst_ns * 1e-9:.3f} s"


class RiseTime(_Step):
    """From one share of the way to the target to another the value takes no longer than a limit.

    Crossings are found on straight lines between ticks.
    """

    def __init__(
        self,
        head: Head,
        value: Expression,
        target: float,
        limit_ns: int,
        shares: tuple[float, float],
    ) -> None:
        super().__init__(head, value, target, "s")
        self._limit_s = limit_ns * 1e-9
        self._shares = shares
        self._crossed: list[float] = []
        self._before: tuple[float, float] | None = None

    def watch(self, block: Block) -> None:
        """Decide at the second crossing."""
        values = self._value.values(block.rows)
        self._begin(values)
        if self._never_there(block) or math.isnan(self._start):
            return
        way = self._target - self._start
        known = np.flatnonzero(~np.isnan(values))
        t_s: Array = np.asarray(block.t_ns[known] * 1e-9, dtype=np.float64)
        done: Array = np.ones(len(known))
        if way:
            done = np.asarray((values[known] - self._start) / way, dtype=np.float64)
        while len(self._crossed) < 2:
            share = self._shares[len(self._crossed)]
            place = first_true((done >= share) & (t_s >= (self._crossed or [0.0])[-1]))
            if place is None:
                break
            self._crossed.append(self._crossing(t_s, done, place, share))
        if len(known):
            self._before = float(t_s[-1]), float(done[-1])
        if len(self._crossed) == 2:
            rise = self._crossed[1] - self._crossed[0]
            self.margin = self._limit_s - rise
            outcome = Outcome.PASS if rise <= self._limit_s else Outcome.FAIL
            told = f"{rise:.4g} s, from {self._crossed[0]:.3f} s to {self._crossed[1]:.3f} s"
            self._decide(outcome, round(self._crossed[1] * 1e9), told)
        elif block.last:
            told = f"has not come so far: {self._see(block.rows[-1])}"
            self._decide(Outcome.FAIL, block.t_ns[-1], told)

    def _crossing(self, t_s: Array, done: Array, place: int, share: float) -> float:
        before = (float(t_s[place - 1]), float(done[place - 1])) if place else self._before
        if before is None or done[place] == before[1]:
            return float(t_s[place])
        part = (share - before[1]) / (done[place] - before[1])
        return float(before[0] + max(part, 0.0) * (float(t_s[place]) - before[0]))


class Monotone(Monitor):
    """The value goes one way, back by no more than a tolerance from the farthest point reached."""

    def __init__(self, head: Head, value: Expression, sign: float, tolerance: float) -> None:
        super().__init__(head, value.unit_name)
        self._value = value
        self._sign = sign
        self._tolerance = tolerance
        self._farthest = -math.inf
        self._worst = 0.0
        self._worst_ns: int | None = None

    def watch(self, block: Block) -> None:
        """Fail at the first tick too far back."""
        t_ns, rows, last = block
        values = self._sign * self._value.values(rows)
        known = np.where(np.isnan(values), -np.inf, values)
        farthest = np.maximum(np.maximum.accumulate(known), self._farthest)
        back = np.zeros(len(values))
        np.subtract(farthest, known, out=back, where=~np.isnan(values))
        self._farthest = float(farthest[-1])
        bad = first_true(back > self._tolerance)
        place = int(back[: None if bad is None else bad + 1].argmax())
        if back[place] > self._worst:
            self._worst, self._worst_ns = float(back[place]), int(t_ns[place])
        self.margin = self._tolerance - self._worst
        told = "never back"
        if self._worst_ns is not None:
            unit = self._value.unit_name
            told = (
                f"back by {self._worst:.4g} {unit}".rstrip() + f" at {self._worst_ns * 1e-9:.3f} s"
            )
        if bad is not None:
            self._decide(Outcome.FAIL, t_ns[bad], f"{told}; {self._see(rows[bad])}")
        elif last and math.isinf(self._farthest):
            self.margin = math.inf
            told = "a signal was not available all the while"
            self._decide(Outcome.INCONCLUSIVE, t_ns[-1], told)
        elif last:
            self._decide(Outcome.PASS, t_ns[-1], told)
