"""A scenario file's shape, version 1; what its texts mean is found out in :mod:`.compiler`.

Every quantity may be a bare number (the signal's own unit), a text with a unit (``20 km/h``), or,
for signals with a value table, a label.  Times always carry a unit.

Annotations are evaluated where they stand: msgspec takes three times as long to evaluate each as a text.
"""

from typing import Annotated, Any, Literal

import msgspec

from hev_can_emu.scenario.expectation_schema import Expectation, Names, Record, Text, Value

DEFAULT_PLAYS = ("HCU", "VEH")  #: the controller under test, and driver and road
MAX_TIMES = 10_000  #: rounds of one loop


class Ramp(Record, frozen=True):
    """A straight line from ``from`` (default: the present value) to ``to`` in the time ``over``."""

    to: Value
    over: Value
    start: Value | None = msgspec.field(default=None, name="from")


class Sine(Record, frozen=True):
    """``offset + amplitude * sin(2 pi frequency t + phase)``; offset defaults to the present value."""

    amplitude: Value
    frequency: Value
    offset: Value | None = None
    phase: Value = 0.0


class Chirp(Record, frozen=True):
    """A sine whose frequency sweeps from ``from`` to ``to`` in the time ``over``, then ``offset``."""

    amplitude: Value
    start: Value = msgspec.field(name="from")
    to: Value
    over: Value
    offset: Value | None = None
    sweep: Literal["linear", "logarithmic"] = "linear"


class Train(Record, frozen=True):
    """A train of steps: each of ``values`` lasts ``every``, all come ``times`` times; the last stays."""

    values: Annotated[tuple[Value, ...], msgspec.Meta(min_length=1)]
    every: Value
    times: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 1


class Profile(Record, frozen=True):
    """A column of a CSV file over its column of times; the last value stays."""

    file: Text
    column: Text
    time: Text = "time"
    between: Literal["line", "hold"] = "line"


class RawFrame(Record, frozen=True):
    """A frame as it stands, sent once: ``data`` are hexadecimal bytes."""

    id: Annotated[int, msgspec.Meta(ge=0, le=0x1FFFFFFF)]
    data: str = ""
    extended: bool = False
    fd: bool = False


class Repeat(Record, frozen=True):
    """A loop: ``steps`` so many ``times``, or for each of the values of a name in ``for``."""

    steps: "tuple[Step, ...]"
    times: Annotated[int, msgspec.Meta(ge=1, le=MAX_TIMES)] | None = None
    each: dict[str, Annotated[tuple[Value, ...], msgspec.Meta(min_length=1)]] = msgspec.field(
        default_factory=dict, name="for"
    )


class Step(Record, frozen=True):
    """One step: one of ``at``, ``when``, ``after`` says when, the others what to do then; or a loop."""

    name: str = ""
    at: Value | None = None
    when: Text | None = None
    after: Value | None = None
    timeout: Value | None = None
    held: Value | None = None
    on_timeout: Literal["stop", "continue"] = "stop"
    set: dict[str, Value] = msgspec.field(default_factory=dict)
    ramp: dict[str, Ramp] = msgspec.field(default_factory=dict)
    follow: dict[str, Text] = msgspec.field(default_factory=dict)
    sine: dict[str, Sine] = msgspec.field(default_factory=dict)
    chirp: dict[str, Chirp] = msgspec.field(default_factory=dict)
    train: dict[str, Train] = msgspec.field(default_factory=dict)
    profile: dict[str, Profile] = msgspec.field(default_factory=dict)
    hold: Names = ()
    release: Names = ()
    silence: Names = ()
    resume: Names = ()
    send: tuple[RawFrame, ...] = ()
    inject: tuple[dict[str, Any], ...] = ()
    clear: Names = ()
    repeat: Repeat | None = None


class Scenario(Record, frozen=True):
    """One scenario file."""

    version: Literal[1]
    name: Text
    duration: Value
    description: str = ""
    vehicle: Text | None = None
    model: Text | None = None
    bus: Text | None = None
    seed: Annotated[int, msgspec.Meta(ge=0)] | None = None
    start: Literal["ready", "off"] | None = None
    nodes: dict[str, Literal["emulated", "external", "silent"]] = msgspec.field(
        default_factory=dict
    )
    plays: Names = DEFAULT_PLAYS
    parameters: dict[str, Value] = msgspec.field(default_factory=dict)
    matrix: dict[str, Annotated[tuple[Value, ...], msgspec.Meta(min_length=1)]] = msgspec.field(
        default_factory=dict
    )
    setup: tuple[Step, ...] = ()
    steps: tuple[Step, ...] = ()
    teardown: tuple[Step, ...] = ()
    expectations: tuple[Expectation, ...] = ()
