"""Faults by name: what can be injected, with which parameters, and what each does.

A fault is a frozen record; :func:`parse` makes one from a mapping such as
``{"fault": "drop", "message": "HCU_EM2Request", "frames": 5}``, and :data:`CATALOGUE` lists all kinds.
What a fault's names mean in a network is found out when it is injected
(:mod:`hev_can_emu.ecu.fault_rows`).

Numbers without a unit are SI (times in s, shares from 0 to 1), but for values of a signal, which are in the
signal's own unit; texts carry a unit (``20 ms``, ``-5 degC``) or are a label of the signal.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, get_args

import msgspec
from msgspec import inspect

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.units import parse_quantity


def _meta(description: str, unit: str = "", **limits: Any) -> msgspec.Meta:
    return msgspec.Meta(description=description, extra={"unit": unit}, **limits)


Text = Annotated[str, msgspec.Meta(min_length=1)]
Name = Annotated[Text, _meta("name of a message of the network")]
Signal = Annotated[Text, _meta("name of a signal, qualified where two messages have it")]
Value = int | float | str
Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Resume = Annotated[
    Literal["running", "stopped"],
    _meta("the sender's counter afterwards: as if nothing had been (running), or where it stopped"),
]
Machine = Annotated[Literal["engine", "em1", "em2"], _meta("which machine")]
EMachine = Annotated[Literal["em1", "em2"], _meta("which machine")]
Actuator = Annotated[
    Literal["engine", "em1", "em2", "clutch", "shift", "brake", "contactors"],
    _meta("which actuator"),
]


def seconds(value: Value, where: str) -> float:
    """Return a time in s from a number or a text with its unit; raises InputError outside 0 to 1 day."""
    time = parse_quantity(value, where, "s").si_value if isinstance(value, str) else float(value)
    if not 0.0 <= time <= 86400.0:
        raise InputError(where, "a time from 0 s to 86400 s", f"'{value}'")
    return time


def tag(name: str) -> str:
    """Return a kind's name from that of its class: ``CounterWrong`` is ``counter_wrong``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


class _Fault(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="fault",
    tag=tag,
):
    name: Annotated[
        str, _meta("by which it is cleared and told; the kind and target if left out")
    ] = ""
    after: Annotated[Value, _meta("from injection to the first effect", "s")] = 0.0
    duration: Annotated[Value | None, _meta("how long it acts; until cleared if left out", "s")] = (
        None
    )
    seed: Annotated[
        Annotated[int, msgspec.Meta(ge=0, le=(1 << 62) - 1)] | None,
        _meta("of its random numbers; from the run's seed and the name if left out"),
    ] = None

    def __post_init__(self) -> None:
        seconds(self.after, "after")
        if self.duration is not None and seconds(self.duration, "duration") == 0.0:
            raise InputError("duration", "a time above 0 s", f"'{self.duration}'")
        self._check()

    def _check(self) -> None:
        """Raise InputError for values that no network could make sense of."""

    @property
    def kind(self) -> str:
        """The kind's name."""
        return tag(type(self).__name__)

    @property
    def label(self) -> str:
        """The fault's name, or one made from kind and target."""
        return self.name or f"{self.kind} {self.target}".strip()

    @property
    def target(self) -> str:
        """What it acts on."""
        return str(getattr(self, _TARGETS.get(self.kind, ""), ""))


class _Frames(_Fault, frozen=True, kw_only=True):
    message: Name
    frames: Annotated[
        Annotated[int, msgspec.Meta(ge=0, le=1_000_000_000)],
        _meta("how many frames are hit before it ends by itself; 0 for no limit"),
    ] = 0
    chance: Annotated[Share, _meta("share of the frames that are hit")] = 1.0


class _Counting(_Frames, frozen=True, kw_only=True):
    resume: Resume = "running"


class CounterWrong(_Counting, frozen=True, kw_only=True):
    """The counter runs backwards; the CRC fits it."""


class CounterFrozen(_Counting, frozen=True, kw_only=True):
    """The counter stays at its value in the first frame hit; the CRC fits it."""


class CounterRandom(_Counting, frozen=True, kw_only=True):
    """The counter takes any value of its range; the CRC fits it."""


class CounterOffset(_Counting, frozen=True, kw_only=True):
    """The counter is ahead by a constant; the CRC fits it."""

    offset: Annotated[
        Annotated[int, msgspec.Meta(ge=-255, le=255)], _meta("added to the counter")
    ] = 2


class CrcWrong(_Frames, frozen=True, kw_only=True):
    """All bits of the CRC are inverted."""


class CrcFrozen(_Frames, frozen=True, kw_only=True):
    """The CRC stays at its value in the first frame hit."""


class CrcRandom(_Frames, frozen=True, kw_only=True):
    """The CRC is any number."""


class CrcOffset(_Frames, frozen=True, kw_only=True):
    """A constant is added to the CRC."""

    offset: Annotated[Annotated[int, msgspec.Meta(ge=1, le=65535)], _meta("added to the CRC")] = 1


class WrongLength(_Frames, frozen=True, kw_only=True):
    """The frame has another number of data bytes; bytes added are zero."""

    length: Annotated[Annotated[int, msgspec.Meta(ge=0, le=64)], _meta("data bytes")] = 7


class Drop(_Counting, frozen=True, kw_only=True):
    """The frame never arrives."""


class Delay(_Frames, frozen=True, kw_only=True):
    """The frame arrives later; the order is kept."""

    delay: Annotated[Value, _meta("how much later, in whole milliseconds", "s")] = 0.02

    def _check(self) -> None:
        _milliseconds(self.delay, "delay")


class Jitter(_Frames, frozen=True, kw_only=True):
    """Each frame arrives later by another random time; the order is kept."""

    jitter: Annotated[Value, _meta("at most so much later, in whole milliseconds", "s")] = 0.02

    def _check(self) -> None:
        _milliseconds(self.jitter, "jitter")


class Duplicate(_Frames, frozen=True, kw_only=True):
    """The frame arrives several times at once."""

    copies: Annotated[Annotated[int, msgspec.Meta(ge=1, le=8)], _meta("how many more")] = 1


class Reorder(_Frames, frozen=True, kw_only=True):
    """Each frame hit changes places with the message's next one."""


class SilentNode(_Fault, frozen=True, kw_only=True):
    """None of the node's frames arrives; the node works all the same."""

    node: Annotated[Text, _meta("name of a node")]
    resume: Resume = "running"


class BabblingNode(_Fault, frozen=True, kw_only=True):
    """Somebody sends random data without end, at the highest priority unless told otherwise."""

    id: Annotated[Annotated[int, msgspec.Meta(ge=0, le=0x1FFFFFFF)], _meta("identifier")] = 0
    extended: Annotated[bool, _meta("29-bit identifier")] = False
    rate: Annotated[Value, _meta("frames a second, in whole frames per millisecond", "1/s")] = (
        4000.0
    )
    length: Annotated[Annotated[int, msgspec.Meta(ge=0, le=8)], _meta("data bytes")] = 8

    def _check(self) -> None:
        rate = self.rate
        number = (
            parse_quantity(rate, "rate", "Hz").si_value if isinstance(rate, str) else float(rate)
        )
        if not 1000.0 <= number <= 20000.0:
            raise InputError("rate", "1000 to 20000 frames a second", f"'{rate}'")
        if self.id > 0x7FF and not self.extended:
            raise InputError("id", "0 to 0x7FF, or extended: true", hex(self.id))


class _Valued(_Fault, frozen=True, kw_only=True):
    signal: Signal
    frames: Annotated[
        Annotated[int, msgspec.Meta(ge=0, le=1_000_000_000)],
        _meta("how many frames are hit before it ends by itself; 0 for no limit"),
    ] = 0
    chance: Annotated[Share, _meta("share of the frames that are hit")] = 1.0


class SignalStuck(_Valued, frozen=True, kw_only=True):
    """The signal keeps one value; counter and CRC are right."""

    value: Annotated[
        Value | None, _meta("which; that of the first frame hit if left out", "the signal's")
    ] = None


class SignalOffset(_Valued, frozen=True, kw_only=True):
    """A constant is added to the signal; counter and CRC are right."""

    offset: Annotated[Value, _meta("added", "the signal's")]


class SignalNoise(_Valued, frozen=True, kw_only=True):
    """Normally distributed noise is added to the signal; counter and CRC are right."""

    deviation: Annotated[Value, _meta("standard deviation", "the signal's")]


class SignalDrift(_Valued, frozen=True, kw_only=True):
    """What is added to the signal grows with time; counter and CRC are right."""

    rate: Annotated[Value, _meta("growth per second", "the signal's")]


class SignalNotAvailable(_Valued, frozen=True, kw_only=True):
    """The signal is sent as not available; counter and CRC are right."""


class ActuatorStuck(_Fault, frozen=True, kw_only=True):
    """The actuator stays where it is whatever its unit commands."""

    actuator: Actuator
    value: Annotated[
        Value | None,
        _meta("where; where it is at the first effect if left out", "N m, N, or 0 and 1"),
    ] = None


class ActuatorSlow(_Fault, frozen=True, kw_only=True):
    """The actuator follows its command with a lag of first order."""

    actuator: Actuator
    time_constant: Annotated[Value, _meta("of the lag", "s")] = 0.5

    def _check(self) -> None:
        if seconds(self.time_constant, "time_constant") == 0.0:
            raise InputError("time_constant", "a time above 0 s", f"'{self.time_constant}'")


class SensorFailure(_Fault, frozen=True, kw_only=True):
    """A unit's measured value is lost, or stays; every signal that carries it follows."""

    sensor: Annotated[Text, _meta("status port, such as em2_speed")]
    mode: Annotated[
        Literal["lost", "stuck"], _meta("not available, or the last value for ever")
    ] = "lost"


class MachineDerated(_Fault, frozen=True, kw_only=True):
    """The machine gives a share of its torque only."""

    machine: Machine
    share: Annotated[Share, _meta("of the torque otherwise available")] = 0.5


class MachineTripped(_Fault, frozen=True, kw_only=True):
    """The machine protects itself: fuel cut, or the inverter's pulses blocked."""

    machine: Machine


class MachineShortCircuit(_Fault, frozen=True, kw_only=True):
    """The inverter short-circuits its machine, which brakes."""

    machine: EMachine


class ClutchLeak(_Fault, frozen=True, kw_only=True):
    """The clutch's cylinder leaks: a share of its capacity is missing."""

    share: Annotated[Share, _meta("of the capacity that is lost")] = 0.5


class ValveStuck(_Fault, frozen=True, kw_only=True):
    """A hydraulic valve stays at one opening."""

    valve: Annotated[Literal["clutch", "g1", "g2"], _meta("which valve")]
    opening: Annotated[Share, _meta("0 drains, 1 is fully open to pressure")] = 0.0


class BusErrors(_Fault, frozen=True, kw_only=True):
    """Frames are destroyed on the wire: error counters rise, and the frames are sent again."""

    node: Annotated[str, _meta("whose frames; anybody's if left out")] = ""
    receiver: Annotated[
        str, _meta("the node that finds fault with them; their sender itself if left out")
    ] = ""
    id: Annotated[
        Annotated[int, msgspec.Meta(ge=0, le=0x1FFFFFFF)] | None,
        _meta("of frames with this identifier only"),
    ] = None
    extended: Annotated[bool, _meta("29-bit identifier")] = False
    frames: Annotated[
        Annotated[int, msgspec.Meta(ge=0, le=1_000_000_000)],
        _meta("how many tries to send are destroyed before it ends by itself; 0 for no limit"),
    ] = 0
    chance: Annotated[Share, _meta("share of the tries that are destroyed")] = 1.0


class BusOff(_Fault, frozen=True, kw_only=True):
    """The node is off the bus; cleared, it recovers after 128 times 11 recessive bits."""

    node: Annotated[Text, _meta("name of a node")]


class BusFlood(_Fault, frozen=True, kw_only=True):
    """Somebody else's frame takes a share of the bus, at the highest priority unless told otherwise."""

    id: Annotated[Annotated[int, msgspec.Meta(ge=0, le=0x1FFFFFFF)], _meta("identifier")] = 0
    extended: Annotated[bool, _meta("29-bit identifier")] = False
    length: Annotated[Annotated[int, msgspec.Meta(ge=0, le=8)], _meta("data bytes")] = 8
    load: Annotated[
        Annotated[float, msgspec.Meta(gt=0.0, le=1.0)], _meta("share of the bus's time")
    ] = 1.0

    def _check(self) -> None:
        if self.id > 0x7FF and not self.extended:
            raise InputError("id", "0 to 0x7FF, or extended: true", hex(self.id))


BUS_FAULTS = (BusErrors, BusOff, BusFlood)  #: kinds that need a bus with bit times

Fault = (
    CounterWrong | CounterFrozen | CounterRandom | CounterOffset
    | CrcWrong | CrcFrozen | CrcRandom | CrcOffset | WrongLength
    | Drop | Delay | Jitter | Duplicate | Reorder | SilentNode | BabblingNode
    | SignalStuck | SignalOffset | SignalNoise | SignalDrift | SignalNotAvailable
    | ActuatorStuck | ActuatorSlow | SensorFailure
    | MachineDerated | MachineTripped | MachineShortCircuit | ClutchLeak | ValveStuck
    | BusErrors | BusOff | BusFlood
)  # fmt: skip
"""Any fault that can be injected."""


class Parameter(NamedTuple):
    """One parameter of a kind; ``default`` as it stands in a file, empty where there is none."""

    name: str
    unit: str
    meaning: str
    default: str
    required: bool


class Kind(NamedTuple):
    """One entry of the catalogue."""

    name: str
    does: str
    parameters: tuple[Parameter, ...]
    spec: type[msgspec.Struct]


_TARGETS: dict[str, str] = {}
_TARGET_FIELDS = ("message", "signal", "node", "actuator", "sensor", "machine", "valve")
COMMON = ("name", "after", "duration", "seed")  #: parameters that every kind has


def _entry(spec: type[msgspec.Struct]) -> Kind:
    info = inspect.type_info(spec)
    assert isinstance(info, inspect.StructType)
    parameters = []
    for field in info.fields:
        meta = field.type
        default = "" if field.default is msgspec.NODEFAULT else field.default
        extra = meta.extra if isinstance(meta, inspect.Metadata) else None
        schema = (meta.extra_json_schema or {}) if isinstance(meta, inspect.Metadata) else {}
        parameters.append(
            Parameter(
                field.name,
                (extra or {}).get("unit", ""),
                schema.get("description", ""),
                "" if default is None else str(default),
                field.required,
            )
        )
    return Kind(tag(spec.__name__), " ".join((spec.__doc__ or "").split()), tuple(parameters), spec)


class _Catalogue(Mapping[str, Kind]):
    """Entries made when they are asked for: looking at all specifications takes a while."""

    def __init__(self, specs: Sequence[type[msgspec.Struct]]) -> None:
        self.specs = {tag(spec.__name__): spec for spec in specs}
        self._made: dict[str, Kind] = {}

    def __getitem__(self, name: str) -> Kind:
        if name not in self._made:
            self._made[name] = _entry(self.specs[name])
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.specs)

    def __len__(self) -> int:
        return len(self.specs)

    def __contains__(self, name: object) -> bool:
        return name in self.specs


CATALOGUE = _Catalogue(get_args(Fault))
"""Every kind of fault, by name."""
_TARGETS.update(
    {
        name: field
        for name, spec in CATALOGUE.specs.items()
        for field in _TARGET_FIELDS
        if field in spec.__struct_fields__
    }
)

_WORDS = {"float": "a number", "int": "a whole number", "str": "text", "bool": "true or false"}


def parse(mapping: Mapping[str, Any], where: str = "fault") -> Fault:
    """Return the fault that a mapping describes; ``fault`` names the kind.

    Raises:
        InputError: no such kind or parameter, or a value that cannot be used; on one line.
    """
    if not isinstance(mapping, Mapping) or "fault" not in mapping:
        raise InputError(where, "a mapping with the key 'fault'", _describe(mapping))
    kind = mapping["fault"]
    if not isinstance(kind, str) or kind not in CATALOGUE:
        hint = did_you_mean(str(kind), CATALOGUE) or f"known: {', '.join(CATALOGUE)}"
        raise InputError(f"{where}.fault", "a kind of fault", _describe(kind), hint)
    known = [parameter.name for parameter in CATALOGUE[kind].parameters]
    for key in mapping:
        if key != "fault" and key not in known:
            hint = did_you_mean(str(key), known) or f"known: {', '.join(known)}"
            raise InputError(where, f"a parameter of {kind}", f"'{key}'", hint)
    try:
        found: Fault = msgspec.convert(dict(mapping), Fault)
    except msgspec.ValidationError as error:
        raise _complaint(error, mapping, where, kind) from error
    return found


def _complaint(
    error: msgspec.ValidationError, mapping: Mapping[str, Any], where: str, kind: str
) -> InputError:
    cause = error.__cause__
    if isinstance(cause, InputError):
        return InputError(f"{where}.{cause.where}", cause.expected, cause.got, cause.hint)
    text, _, path = str(error).partition(" - at `$.")
    key = path.rstrip("`")
    missing = re.fullmatch(r"Object missing required field `(.*)`", text)
    if missing:
        return InputError(where, f"the parameter '{missing[1]}' of {kind}", "none")
    got = _describe(mapping.get(key))
    choices = _choices(kind, key)
    if text.startswith("Invalid enum") and choices:
        hint = did_you_mean(str(mapping.get(key)), choices)
        return InputError(f"{where}.{key}", f"one of {', '.join(choices)}", got, hint)
    wanted = re.fullmatch(r"Expected `([^`]*)`(.*?)(, got `[^`]*`)?", text)
    if wanted:
        kinds = [part for part in wanted[1].split(" | ") if part != "null"]
        if "float" in kinds and "int" in kinds:
            kinds.remove("int")
        words = " or ".join(_WORDS.get(part, part) for part in kinds)
        return InputError(f"{where}.{key}", words + wanted[2], got)
    return InputError(f"{where}.{key}", "a usable value", got, text)


def _choices(kind: str, key: str) -> list[str]:
    info = inspect.type_info(CATALOGUE[kind].spec)
    assert isinstance(info, inspect.StructType)
    for field in info.fields:
        found = field.type
        while isinstance(found, inspect.Metadata):
            found = found.type
        if field.name == key and isinstance(found, inspect.LiteralType):
            return [str(value) for value in found.values]
    return []


def _describe(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, str):
        line = " ".join(value.split())
        return f"'{line}'" if len(line) <= 60 else f"'{line[:57]}...'"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return f"only {', '.join(repr(str(key)) for key in value)}" if value else "an empty mapping"
    if isinstance(value, list):
        return "a list"
    return str(value)


def _milliseconds(value: Value, where: str) -> float:
    time = seconds(value, where)
    if not 1e-3 <= time <= 10.0:
        raise InputError(where, "1 ms to 10 s", f"'{value}'")
    return time
