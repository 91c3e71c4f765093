"""Expectations about what passengers feel: jerk, and the vibration dose of ISO 2631-1."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.scenario.expression import Array, Expression
from hev_can_emu.scenario.monitor import Block, Head, Monitor, first_true
from hev_can_emu.scenario.verdict import Outcome
from hev_can_emu.scenario.weighting import weigh, weighting_filter

DOSE_UNIT = "m/s^1.75"


class Jerk(Monitor):
    """The magnitude of an acceleration's mean slope over a sliding span stays below a limit.

    Args:
        head: see there.
        value: an acceleration, or (``order`` 2) a speed, whose second difference is taken.
        order: see ``value``.
        gain: from the value's unit to SI.
        limit: m/s^3.
        ticks: length of the span.
        tick_ns: length of a tick.
    """

    def __init__(
        self,
        head: Head,
        value: Expression,
        order: int,
        gain: float,
        limit: float,
        ticks: int,
        tick_ns: int,
    ) -> None:
        super().__init__(head, "m/s^3")
        self._value = value
        self._order = order
        self._gain = gain
        self._limit = limit
        self._ticks = ticks
        self._span_s = ticks * tick_ns * 1e-9
        self._kept = np.empty(0)
        self._worst = -1.0
        self._worst_ns = 0

    def watch(self, block: Block) -> None:
        """Fail at the first tick with too steep a slope."""
        t_ns, rows, last = block
        n = self._ticks
        values = np.concatenate([self._kept, self._value.values(rows) * self._gain])
        before = self._order * n
        self._kept = values[-before:].copy()
        slope = values
        for _ in range(self._order):
            slope = (slope[n:] - slope[:-n]) / self._span_s
        steep = np.abs(slope)
        steep = np.where(np.isnan(steep), -1.0, steep)
        times = t_ns[len(t_ns) - len(steep) :]
        bad = first_true(steep > self._limit)
        if steep.size:
            place = int(steep[: None if bad is None else bad + 1].argmax())
            if steep[place] > self._worst:
                self._worst, self._worst_ns = float(steep[place]), int(times[place])
        if self._worst >= 0.0:
            self.margin = self._limit - self._worst
        told = f"at most {self._worst:.4g} m/s^3, at {self._worst_ns * 1e-9:.3f} s"
        if bad is not None:
            told = f"{self._worst:.4g} m/s^3; {self._see(rows[len(rows) - len(steep) + bad])}"
            self._decide(Outcome.FAIL, times[bad], told)
        elif last and self._worst < 0.0:
            told = "no two values available so far apart"
            self._decide(Outcome.INCONCLUSIVE, t_ns[-1], told)
        elif last:
            self._decide(Outcome.PASS, t_ns[-1], told)


class VibrationDose(Monitor):
    """The fourth-power dose of a weighted acceleration, (integral of a^4 dt)^(1/4), stays below a limit.

    Args:
        head: see there.
        value: an acceleration.
        gain: from its unit to SI.
        limit: m/s^1.75.
        weighting: one of weighting.WEIGHTINGS.
        tick_ns: length of a tick.
    """

    def __init__(
        self, head: Head, value: Expression, gain: float, limit: float, weighting: str, tick_ns: int
    ) -> None:
        super().__init__(head, DOSE_UNIT)
        self._value = value
        self._gain = gain
        self._limit = limit
        self._tick_s = tick_ns * 1e-9
        self._filter = weighting_filter(weighting, self._tick_s)
        self._memory = np.zeros((len(self._filter), 2))
        self._sum = 0.0
        self._known = False

    def watch(self, block: Block) -> None:
        """Fail at the tick at which the dose is used up."""
        t_ns, rows, last = block
        values: Array = self._value.values(rows) * self._gain
        self._known = self._known or bool((~np.isnan(values)).any())
        values = np.where(np.isnan(values), 0.0, values)
        weigh(self._filter, self._memory, values)
        # Carried on as one sum, so that the blocks' ends do not show in its last bits.
        sums = np.cumsum(np.concatenate([[self._sum], values**4 * self._tick_s]))[1:]
        self._sum = float(sums[-1])
        dose = sums**0.25
        bad = first_true(dose > self._limit)
        self.margin = self._limit - float(dose[-1 if bad is None else bad])
        if bad is not None:
            self._decide(Outcome.FAIL, t_ns[bad], f"{dose[bad]:.4g} {DOSE_UNIT}")
        elif last and not self._known:
            self.margin = math.inf
            told = "a signal was not available all the while"
            self._decide(Outcome.INCONCLUSIVE, t_ns[-1], told)
        elif last:
            self._decide(Outcome.PASS, t_ns[-1], f"{dose[-1]:.4g} {DOSE_UNIT}")
