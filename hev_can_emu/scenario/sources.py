"""What a scenario can look at and play: the network, the plant's truth, events."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from hev_can_emu.errors import did_you_mean
from hev_can_emu.scenario.columns import EVENT, Column
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.units import Unit


class Truth(NamedTuple):
    """A quantity of the plant: its place in the truth vector, and its SI unit (None: a plain number)."""

    place: int
    unit: Unit | None


class EventKind(NamedTuple):
    """A kind of event.

    Attributes:
        code: the kind in the event's record.
        names: what an event of the kind can concern, by name.
        by_value: the name stands in the record's value, not in its index.
    """

    code: int
    names: Mapping[str, int]
    by_value: bool = False


def no_profile(file: str, place: Place) -> str:
    """Refuse a profile: a scenario that is no file has none beside it."""
    raise place.refuse("a scenario in a file", f"'{file}'", "profiles are looked for beside it")


def no_fault(mapping: Mapping[str, object], place: Place) -> tuple[str, object]:
    """Refuse a fault: nothing is there that could have one."""
    raise place.refuse("no fault", f"'{mapping.get('fault', '')}'")


class Sources(NamedTuple):
    """Everything by name.

    Attributes:
        signals: the network.
        truths: the plant's truth.
        events: kinds of events.
        profile: returns the text of a CSV file named in the scenario; may raise InputError at the place.
        fault: returns name and content of a fault as it is written; may raise InputError at the place.
    """

    signals: Signals
    truths: Mapping[str, Truth] = {}
    events: Mapping[str, EventKind] = {}
    profile: Callable[[str, Place], str] = no_profile
    fault: Callable[[Mapping[str, object], Place], tuple[str, object]] = no_fault

    def truth(self, name: str, text: str, place: Place) -> Truth:
        """Return the quantity ``name``; raises InputError for an unknown one."""
        if name not in self.truths:
            got = f"'truth.{name}' in '{text}'"
            raise place.refuse(
                "a quantity of the plant's truth", got, did_you_mean(name, self.truths)
            )
        return self.truths[name]

    def event(self, kind: str, what: str | None, text: str, place: Place) -> Column:
        """Return the column of an event; raises InputError for an unknown kind or name."""
        if kind not in self.events:
            hint = did_you_mean(kind, self.events) or "known: " + ", ".join(self.events)
            raise place.refuse("a kind of event", f"'{kind}' in '{text}'", hint)
        found = self.events[kind]
        if what is None:
            return Column(EVENT, -1, found.code)
        if what not in found.names:
            hint = did_you_mean(what, found.names) or "known: " + ", ".join(found.names)
            raise place.refuse(f"what '{kind}' can concern", f"'{what}' in '{text}'", hint)
        number = found.names[what]
        if found.by_value:
            return Column(EVENT, -1, found.code, float(number))
        return Column(EVENT, number, found.code)
