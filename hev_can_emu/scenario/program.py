"""A scenario ready to play: what the compilers make of a file, and the player plays."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hev_can_emu.scenario import expectations, stimuli
from hev_can_emu.scenario.expression import Expression
from hev_can_emu.scenario.signals import Signal


class Instant(NamedTuple):
    """A time in the scenario: ``offset_ns`` after the start, or after the step with that number."""

    step: int | None
    offset_ns: int


class Ramp(NamedTuple):
    """Line from ``start`` (NaN: the present value) to ``end``."""

    start: float
    end: float
    length_ns: int


class Sine(NamedTuple):
    """Sine around ``offset`` (NaN: the present value); ``omega`` in rad/s, ``phase`` in rad."""

    offset: float
    amplitude: float
    omega: float
    phase: float


class Follow(NamedTuple):
    """``gain * expression + offset`` at every tick."""

    expression: Expression
    gain: float
    offset: float


class Set(NamedTuple):
    """A constant; NaN sends "not available"."""

    value: float


class Hold(NamedTuple):
    """The present value from now on."""


class Release(NamedTuple):
    """The initial value."""


Action = Set | Ramp | Sine | Follow | Hold | Release


class Step(NamedTuple):
    """One step, ready to play; exactly one of ``at_ns``, ``after_ns`` and ``when`` is given."""

    name: str
    at_ns: int | None
    after_ns: int | None
    when: Expression | None
    timeout_ns: int
    held_ns: int
    stop_on_timeout: bool
    actions: tuple[tuple[Signal, Action], ...]
    messages: tuple[stimuli.SendMessage, ...]
    where: str


class Watch(NamedTuple):
    """One expectation: ``make`` gives a fresh monitor for the window."""

    opens: Instant
    closes: Instant
    make: Callable[[], expectations.Monitor]


class Program(NamedTuple):
    """A scenario, ready to play."""

    name: str
    duration_ns: int
    steps: tuple[Step, ...]
    watches: tuple[Watch, ...]
