"""Expectations at run time: each watches its window and decides once.

A monitor is asked at every tick of its window, both ends included.  What is not available (NaN)
satisfies no condition; a ``never`` whose signals were never all available is inconclusive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hev_can_emu.scenario.expression import Expression
from hev_can_emu.scenario.signals import Signal
from hev_can_emu.scenario.stimuli import Instant
from hev_can_emu.scenario.verdict import Outcome, Verdict

NEVER = 1 << 62  #: later than any scenario lasts


class Monitor:
    """Base: the decision and its record.  ``opened``, ``open_ns`` and ``close_ns`` are set by the player."""

    kind = ""

    def __init__(self, expression: Expression, name: str, window: str, where: str) -> None:
        self.expression = expression
        self.name = name
        self.where = where
        self.opened = False
        self.open_ns = 0
        self.close_ns = NEVER
        self.outcome: Outcome | None = None
        self.margin = math.inf
        self._window = window
        self._margin_unit = expression.unit.name if expression.unit is not None else ""
        self._instant_ns: int | None = None
        self._observed = ""

    def check(self, now: Instant) -> None:
        """Look at the present values; called at every tick of the window."""
        raise NotImplementedError

    def close(self, now: Instant) -> None:
        """Decide at the window's last tick, after :meth:`check`."""
        raise NotImplementedError

    def abandon(self, reason: str) -> None:
        """Decide that nothing can be said, unless something was."""
        if self.outcome is None:
            self.outcome, self._observed = Outcome.INCONCLUSIVE, reason
            self.margin = math.inf

    def verdict(self) -> Verdict:
        """Return the record; what is undecided so far reads as inconclusive, and stays undecided."""
        undecided = self.outcome is None
        return Verdict(
            "expectation",
            self.name,
            self.outcome or Outcome.INCONCLUSIVE,
            self._instant_ns,
            f"{self._says()} {self._window}".strip(),
            "the scenario has not come to an end" if undecided else self._observed,
            self.margin if math.isfinite(self.margin) else None,
            self._margin_unit if math.isfinite(self.margin) else "",
            self.where,
            (self.open_ns, self.close_ns if self.close_ns < NEVER else None)
            if self.opened
            else (None, None),
            self.expression.reads,
        )

    def _says(self) -> str:
        return f"{self.kind}: {self.expression.text}"

    def _keep_time_left(self, now: Instant) -> None:
        if self.close_ns < NEVER:
            self.margin, self._margin_unit = (self.close_ns - now.t_ns) * 1e-9, "s"

    def _decide(self, outcome: Outcome, now: Instant, observed: str = "") -> None:
        self.outcome = outcome
        self._instant_ns = now.t_ns
        self._observed = observed or self.expression.observe(now.item)


class Always(Monitor):
    """The condition holds (``sign`` 1) or fails to hold (-1, never) at every tick of the window."""

    def __init__(
        self, expression: Expression, name: str, window: str, where: str, *, never: bool
    ) -> None:
        super().__init__(expression, name, window, where)
        self.kind = "never" if never else "always"
        self._wanted = not never
        self._sign = -1.0 if never else 1.0
        self._available = False
        self._nearest: tuple[int, tuple[float, ...]] | None = None

    def check(self, now: Instant) -> None:
        """Fail at the first tick that contradicts; keep the smallest margin."""
        _, item, seen, t, since_step = now
        expression = self.expression
        margin = 0.0
        if expression.margin is not None:
            margin = expression.margin(item, seen, t, since_step)
            if self._sign * margin < self.margin:
                self.margin = self._sign * margin
                values = tuple([item(signal.index) for signal in expression.signals])
                self._nearest = (now.t_ns, values)
        # The margin's sign tells whether the comparison holds, except on the border and for NaN.
        if margin > 0.0 or margin < 0.0:
            holds = margin > 0.0
        else:
            holds = expression.function(item, seen, t, since_step)
        if holds is not self._wanted:
            self._decide(Outcome.FAIL, now)
        elif not self._available:
            values = tuple([item(signal.index) for signal in expression.signals])
            self._available = all(value == value for value in values)

    def close(self, now: Instant) -> None:
        """Pass, telling the nearest miss."""
        if not self._available:
            self._decide(Outcome.INCONCLUSIVE, now, "a signal was not available all the while")
        elif self._nearest is None:
            self._decide(Outcome.PASS, now)
        else:
            t_ns, values = self._nearest
            told = [
                f"{signal.name} = {signal.say(value)}"
                for signal, value in zip(self.expression.signals, values, strict=True)
            ]
            self._decide(Outcome.PASS, now, f"nearest at {t_ns * 1e-9:.3f} s: {', '.join(told)}")


class Becomes(Monitor):
    """The condition holds at some tick of the window; the margin is the time left."""

    kind = "becomes"

    def check(self, now: Instant) -> None:
        """Pass at the first tick at which the condition holds."""
        _, item, seen, t, since_step = now
        if self.expression.function(item, seen, t, since_step):
            self._keep_time_left(now)
            self._decide(Outcome.PASS, now)

    def close(self, now: Instant) -> None:
        """Fail: it has not come; the margin is the comparison's, where it is one."""
        if self.expression.margin is not None:
            margin = self.expression.margin(now.item, now.seen, now.t_s, now.since_step_s)
            self.margin = margin if math.isfinite(margin) else math.inf
        self._decide(Outcome.FAIL, now)


class _Target(Monitor):
    """Base of the monitors that compare a value with a target."""

    def __init__(
        self,
        expression: Expression,
        name: str,
        window: str,
        where: str,
        *,
        target: float,
        band: float,
    ) -> None:
        super().__init__(expression, name, window, where)
        self._target = target
        self._band = band

    def _left(self, now: Instant) -> float:
        """Return the distance to the band's edge, negative outside, NaN where not available."""
        value = self.expression.function(now.item, now.seen, now.t_s, now.since_step_s)
        return self._band - abs(float(value) - self._target)

    def _says(self) -> str:
        unit = f" {self._unit}" if self._unit else ""
        return f"{self.kind}: {self.expression.text} = {self._target:g} ± {self._band:g}{unit}"

    @property
    def _unit(self) -> str:
        return self.expression.unit.name if self.expression.unit is not None else ""


class Equals(_Target):
    """The value is within the band at one instant."""

    kind = "equals"

    def check(self, now: Instant) -> None:
        """Decide at once."""
        left = self._left(now)
        self.margin = left if math.isfinite(left) else math.inf
        # A tolerance of zero allows for the last bits of a scaled value.
        rounding = 1e-9 * max(abs(self._target), self._band)
        self._decide(Outcome.PASS if left >= -rounding else Outcome.FAIL, now)

    def close(self, now: Instant) -> None:
        """Decide, where no tick fell on the instant itself."""
        self.check(now)


class Settles(_Target):
    """The value is within the band from the deadline at the latest until the window's end."""

    kind = "settles"

    def __init__(
        self,
        expression: Expression,
        name: str,
        window: str,
        where: str,
        *,
        target: float,
        band: float,
        hold_ns: int,
    ) -> None:
        super().__init__(expression, name, window, where, target=target, band=band)
        self._hold_ns = hold_ns
        self._since_ns: int | None = None

    def check(self, now: Instant) -> None:
        """Note since when the value is in the band; fail where it is not after the deadline."""
        left = self._left(now)
        if left >= 0.0:
            if self._since_ns is None:
                self._since_ns = now.t_ns
        else:
            self._since_ns = None
        if self._since_ns is None and now.t_ns >= self.close_ns - self._hold_ns:
            self.margin = left if math.isfinite(left) else math.inf
            self._decide(Outcome.FAIL, now)

    def close(self, now: Instant) -> None:
        """Pass; the margin is the time between settling and the deadline."""
        if self._since_ns is None:
            self._decide(Outcome.FAIL, now)
            return
        deadline_ns = self.close_ns - self._hold_ns
        self.margin, self._margin_unit = (deadline_ns - self._since_ns) * 1e-9, "s"
        told = f"settled at {self._since_ns * 1e-9:.3f} s; {self.expression.observe(now.item)}"
        self._decide(Outcome.PASS, now, told)


class InSequence(Monitor):
    """The value takes the wanted values one after the other."""

    kind = "sequence"

    def __init__(
        self,
        expression: Expression,
        name: str,
        window: str,
        where: str,
        *,
        wanted: Sequence[float],
        exactly: bool,
        signal: Signal | None,
    ) -> None:
        super().__init__(expression, name, window, where)
        self._wanted = tuple(wanted)
        self._exactly = exactly
        self._signal = signal
        self._reached = 0
        self._last = math.nan
        self._met: list[float] = []

    def check(self, now: Instant) -> None:
        """Compare each new value with the next wanted one."""
        _, item, seen, t, since_step = now
        value = float(self.expression.function(item, seen, t, since_step))
        if value == self._last or value != value:
            return
        self._last = value
        self._met.append(value)
        if self._reached < len(self._wanted) and value == self._wanted[self._reached]:
            self._reached += 1
            if self._reached == len(self._wanted) and not self._exactly:
                self._keep_time_left(now)
                self._decide(Outcome.PASS, now, self._chain(self._met))
        elif self._exactly:
            self._decide(Outcome.FAIL, now, self._chain(self._met))

    def close(self, now: Instant) -> None:
        """Pass where all have come."""
        complete = self._reached == len(self._wanted)
        met = self._chain(self._met) or "no value"
        self._decide(Outcome.PASS if complete else Outcome.FAIL, now, met)

    def _chain(self, values: Sequence[float]) -> str:
        shown = [self._signal.say(v) if self._signal else f"{v:g}" for v in values[-20:]]
        return ("... > " if len(values) > 20 else "") + " > ".join(shown)

    def _says(self) -> str:
        how = "exactly " if self._exactly else ""
        return f"{self.kind}: {self.expression.text} {how}{self._chain(self._wanted)}"
