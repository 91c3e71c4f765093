"""A scenario file's shape, version 1; what its texts mean is found out in :mod:`.program`.

Every quantity may be a bare number (the signal's own unit), a text with a unit (``20 km/h``), or,
for signals with a value table, a label.  Times always carry a unit.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

Text = Annotated[str, msgspec.Meta(min_length=1)]
Value = (
    int | float | str | bool
)  #: bool only so that it can be refused with a better word than "number"
Names = tuple[Text, ...]

DEFAULT_PLAYS = ("HCU", "VEH")  #: the controller under test, and driver and road


class _Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    pass


class Ramp(_Record, frozen=True):
    """A straight line from ``start`` (default: the present value) to ``to`` in the time ``over``."""

    to: Value
    over: Value
    start: Value | None = msgspec.field(default=None, name="from")


class Sine(_Record, frozen=True):
    """``offset + amplitude * sin(2 pi frequency t + phase)``; offset defaults to the present value."""

    amplitude: Value
    frequency: Value
    offset: Value | None = None
    phase: Value = 0.0


class Step(_Record, frozen=True):
    """One step: exactly one of ``at``, ``when``, ``after`` says when, the others what to do then."""

    name: str = ""
    at: Value | None = None
    when: Text | None = None
    after: Value | None = None
    timeout: Value | None = None
    held: Value | None = None
    on_timeout: Literal["stop", "continue"] = "stop"
    set: dict[str, Value] = {}
    ramp: dict[str, Ramp] = {}
    follow: dict[str, Text] = {}
    sine: dict[str, Sine] = {}
    hold: Names = ()
    release: Names = ()
    silence: Names = ()
    resume: Names = ()


class Settles(_Record, frozen=True):
    """``value`` comes within ``band`` of ``to`` and stays there."""

    value: Text
    to: Value
    band: Value


class Equals(_Record, frozen=True):
    """``value`` is within ``tolerance`` of ``to``."""

    value: Text
    to: Value
    tolerance: Value = 0.0


class Sequence(_Record, frozen=True):
    """``value`` takes the values ``of`` in this order; ``exactly`` allows no other between."""

    value: Text
    of: Annotated[tuple[Value, ...], msgspec.Meta(min_length=1)]
    exactly: bool = False


class Expectation(_Record, frozen=True):
    """Exactly one of always, never, becomes, settles, equals, sequence, and the window."""

    name: str = ""
    always: Text | None = None
    never: Text | None = None
    becomes: Text | None = None
    settles: Settles | None = None
    equals: Equals | None = None
    sequence: Sequence | None = None
    at: Value | None = None
    start: Value | None = msgspec.field(default=None, name="from")
    to: Value | None = None
    length: Value | None = msgspec.field(default=None, name="for")
    within: Value | None = None
    hold: Value | None = None


class Scenario(_Record, frozen=True):
    """One scenario file."""

    version: Literal[1]
    name: Text
    duration: Value
    description: str = ""
    vehicle: Text | None = None
    model: Text | None = None
    bus: Text | None = None
    seed: int | None = None
    start: Literal["ready", "off"] | None = None
    nodes: dict[str, Literal["emulated", "external", "silent"]] = {}
    plays: Names = DEFAULT_PLAYS
    parameters: dict[str, Value] = {}
    steps: tuple[Step, ...] = ()
    expectations: tuple[Expectation, ...] = ()
