"""The network as a scenario sees it: names, senders, units, labels, and each signal's index."""

from __future__ import annotations

import math
from collections.abc import Iterable

import msgspec

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.messages.definitions import MessageDef, SignalDef
from hev_can_emu.scenario.place import Place
from hev_can_emu.units import Unit, parse_quantity, unit

NOT_AVAILABLE = (
    "not available"  #: the word by which a scenario sends a signal's not-available value
)


class Signal(msgspec.Struct, frozen=True, kw_only=True):
    """One signal in physical values of its own unit.

    Attributes:
        index: position in the vector over all signals.
        labels: value table, label to physical value; NaN is the not-available value.
        initial: physical value before anything is set; NaN where the database gives none.
        minimum, maximum: the database's range; infinite where it gives none.
        protected: it is the message's CRC or counter, which the protection writes.
    """

    name: str
    message: str
    sender: str
    index: int
    unit: str
    labels: dict[str, float]
    initial: float
    minimum: float
    maximum: float
    protected: bool = False

    def known_unit(self, place: Place) -> Unit:
        """Return the unit; raises InputError at ``place`` where the database's text names none."""
        return unit(self.unit, f"{place}: unit of {self.message}.{self.name}")

    def say(self, value: float) -> str:
        """Return ``value`` as a person reads it: label, or number with unit."""
        if math.isnan(value):
            return NOT_AVAILABLE
        for label, labelled in self.labels.items():
            if labelled == value:
                return label
        return f"{value:.6g} {self.unit}".strip()

    def parse(self, value: float | str | bool, place: Place) -> float:
        """Return the physical value that a scenario writes for this signal, NaN for not available.

        Raises:
            InputError: unknown label, wrong unit, out of range.
        """
        number = self._number(value, place)
        if not math.isnan(number) and not self.minimum <= number <= self.maximum:
            span = f"{self.minimum:g} to {self.maximum:g} {self.unit}".strip()
            got = f"{value}" if isinstance(value, str) else f"{value} {self.unit}".strip()
            raise place.refuse(span, got, f"the range of {self.message}.{self.name}")
        return number

    def _number(self, value: float | str | bool, place: Place) -> float:
        wanted = f"a number in {self.unit}" if self.unit else "a number"
        if self.labels:
            wanted += " or a label"
        if isinstance(value, bool):
            raise place.refuse(wanted, str(value).lower(), self._choices())
        if not isinstance(value, str):
            return float(value)
        if value in self.labels:
            return self.labels[value]
        if value == NOT_AVAILABLE:
            return math.nan
        try:
            quantity = parse_quantity(value, str(place))
        except InputError as error:
            if value[:1].isdigit() or value[:1] in "+-.":
                raise
            raise place.refuse(wanted, f"'{value}'", self._choices(value)) from error
        if not quantity.unit:
            return float(value)
        own = self.known_unit(place)
        if quantity.dimension != own.dimension:
            hint = f"{self.message}.{self.name} is in {self.unit}" if self.unit else "write no unit"
            raise place.refuse(wanted, f"'{value}'", hint)
        # 0.1 + 0.2 style residues of the way through SI are not the author's.
        return float(f"{own.from_si(quantity.si_value):.12g}")

    def _choices(self, value: str = "") -> str:
        near = did_you_mean(value, self.labels) if value else ""
        if near or not self.labels:
            return near
        return "labels: " + ", ".join(self.labels)


class Signals:
    """All signals by name."""

    def __init__(self, messages: Iterable[MessageDef]) -> None:
        self.messages: dict[str, str] = {}  #: message name to sender
        self._qualified: dict[str, Signal] = {}
        self._by_name: dict[str, list[Signal]] = {}
        self._first: dict[str, int] = {}
        self.identifiers: dict[str, tuple[int, bool]] = {}  #: message to CAN identifier, extended
        for message in messages:
            self.identifiers[message.name] = (message.can_id, message.extended)
            if message.signals:
                self._first[message.name] = message.signals[0].index
            self.messages[message.name] = message.sender
            for definition in message.signals:
                signal = _signal(definition, message)
                self._qualified[definition.qualified_name] = signal
                self._by_name.setdefault(definition.name, []).append(signal)

    def names(self) -> list[str]:
        """Return every name by which a signal can be found."""
        return [*self._by_name, *self._qualified]

    def find(self, name: str) -> Signal | None:
        """Return the signal called ``name`` (``Signal`` or ``Message.Signal``), None if none is."""
        if name in self._qualified:
            return self._qualified[name]
        found = self._by_name.get(name, [])
        return found[0] if len(found) == 1 else None

    def require(self, name: str, place: Place) -> Signal:
        """Return the signal called ``name``.

        Raises:
            InputError: no such signal, or more than one.
        """
        signal = self.find(name)
        if signal is None:
            raise place.refuse(*self.complain(name))
        return signal

    def complain(self, name: str, others: Iterable[str] = ()) -> tuple[str, str, str]:
        """Return expected, got and hint for a name that :meth:`find` does not find."""
        several = self._by_name.get(name, [])
        if several:
            choices = " or ".join(f"'{each.message}.{each.name}'" for each in several)
            return "one signal", f"'{name}' of {len(several)} messages", f"write {choices}"
        known = self._qualified if "." in name else [*self._by_name, *others]
        return "a signal", f"'{name}'", did_you_mean(name, known)

    def first_signal(self, message: str) -> int:
        """Return the index of a message's first signal, -1 where it has none."""
        return self._first.get(message, -1)

    def require_message(self, name: str, place: Place) -> str:
        """Return ``name`` if a message is called so; raises InputError."""
        if name not in self.messages:
            raise place.refuse("a message", f"'{name}'", did_you_mean(name, self.messages))
        return name


def _signal(definition: SignalDef, message: MessageDef) -> Signal:
    def physical(raw: float) -> float:
        if definition.not_available is not None and raw == definition.not_available:
            return math.nan
        return float(raw * definition.scale + definition.offset)

    low, high = definition.minimum, definition.maximum
    spec = message.protection
    bits = definition.bits()
    bounded = low is not None and high is not None and low < high
    return Signal(
        name=definition.name,
        message=definition.message,
        sender=message.sender,
        index=definition.index,
        unit=definition.unit,
        labels={label: physical(raw) for raw, label in definition.labels.items()},
        initial=math.nan if definition.initial is None else physical(definition.initial),
        minimum=float(low) if bounded and low is not None else -math.inf,
        maximum=float(high) if bounded and high is not None else math.inf,
        protected=spec is not None and (spec.crc_bit in bits or spec.counter_bit in bits),
    )
