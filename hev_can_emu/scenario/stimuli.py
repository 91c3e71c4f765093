"""What a step does to a signal: the shapes that a stimulus takes over time."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from hev_can_emu.scenario.evaluation import Item
from hev_can_emu.scenario.expression import Expression


class SetSignal(NamedTuple):
    """From now on the signal with index ``signal`` has ``value``; NaN sends "not available"."""

    signal: int
    value: float


class SendMessage(NamedTuple):
    """From now on ``message`` is sent (``enabled``) or not."""

    message: str
    enabled: bool


Stimulus = SetSignal | SendMessage


class Instant(NamedTuple):
    """What a shape may read: the vectors' ``item`` methods and the time."""

    t_ns: int
    item: Item
    seen: Item
    t_s: float
    since_step_s: float


class Shape(Protocol):
    """A running stimulus; :meth:`value` is asked once per tick until :attr:`done`."""

    done: bool

    def value(self, now: Instant) -> float:
        """Return the signal's value now; NaN keeps the one before."""


class Line:
    """A straight line from ``start`` at ``begin_ns`` to ``end`` after ``length_ns``, exact at both ends."""

    def __init__(self, start: float, end: float, begin_ns: int, length_ns: int) -> None:
        self._start = start
        self._end = end
        self._begin = begin_ns
        self._length = length_ns
        self.done = False

    def value(self, now: Instant) -> float:
        """Return the point on the line."""
        elapsed = now.t_ns - self._begin
        if elapsed >= self._length:
            self.done = True
            return self._end
        return self._start + (self._end - self._start) * (elapsed / self._length)


class Wave:
    """A sine that begins at its phase."""

    done = False

    def __init__(
        self, offset: float, amplitude: float, omega: float, phase: float, begin_ns: int
    ) -> None:
        self._offset = offset
        self._amplitude = amplitude
        self._omega = omega
        self._phase = phase
        self._begin = begin_ns

    def value(self, now: Instant) -> float:
        """Return the sine's value; ``omega`` in rad/s, ``phase`` in rad."""
        elapsed = (now.t_ns - self._begin) * 1e-9
        return self._offset + self._amplitude * math.sin(self._omega * elapsed + self._phase)


class Follower:
    """An expression, taken anew at every tick: ``gain * expression + offset``."""

    done = False

    def __init__(self, expression: Expression, gain: float, offset: float) -> None:
        self._function = expression.function
        self._gain = gain
        self._offset = offset

    def value(self, now: Instant) -> float:
        """Return the expression's value in the signal's unit; NaN where it has none now."""
        _, item, seen, t, since_step = now
        value: float = self._function(item, seen, t, since_step) * self._gain + self._offset
        return value if math.isfinite(value) else math.nan
