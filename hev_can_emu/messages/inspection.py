"""What is wrong, or merely odd, in a DBC file: everything at once, each with its line."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

from hev_can_emu.errors import InputError
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.dbc_reader import read_messages
from hev_can_emu.messages.dbc_text import DbcText
from hev_can_emu.messages.definitions import MessageDef, SendType, SignalDef

_CYCLIC = (SendType.CYCLIC, SendType.CYCLIC_AND_CHANGE, SendType.CYCLIC_IF_ACTIVE)


class Finding(NamedTuple):
    """One line for people: where, and what is found there."""

    where: str
    text: str


class Inspection(NamedTuple):
    """What was found in a file.

    ``database``: the messages that can be used; ``defects``: why others cannot, overlapping signals among
    them; ``unencodable``: values that a signal declares and its bits cannot hold.
    """

    database: Database
    defects: list[InputError]
    unencodable: list[Finding]


def inspect(path: Path, leave_out: Collection[str] = ()) -> Inspection:
    """Read what can be read of a DBC file and tell of the rest.

    Raises:
        InputError: the file as a whole cannot be read.
    """
    source = DbcText.read(path)
    defects: list[InputError] = []
    nodes, messages = read_messages(source, leave_out, defects)
    database = Database(path=path, nodes=nodes, messages=messages)
    found = [
        Finding(source.where(source.line_of(signal.message, signal.name)), text)
        for signal in database.signals
        for text in _unencodable(signal)
    ]
    return Inspection(database, defects, found)


def _unencodable(signal: SignalDef) -> Iterator[str]:
    if signal.is_float:
        return
    name, unit = signal.qualified_name, f" {signal.unit}" if signal.unit else ""
    ends = sorted(raw * signal.scale + signal.offset for raw in signal.raw_range)
    slack = 1e-6 * abs(signal.scale)
    if signal.minimum is not None and signal.minimum < ends[0] - slack:
        yield f"{name} declares {signal.minimum:g}{unit}, its bits reach down to {ends[0]:g}{unit}"
    if signal.maximum is not None and signal.maximum > ends[1] + slack:
        yield f"{name} declares {signal.maximum:g}{unit}, its bits reach up to {ends[1]:g}{unit}"
    if signal.minimum is not None and signal.maximum is not None:
        if signal.minimum > signal.maximum:
            yield f"{name} declares a range from {signal.minimum:g} down to {signal.maximum:g}"
        elif signal.minimum > ends[1] or signal.maximum < ends[0]:
            yield f"{name}: no value of its bits lies in the range that it declares"
    low, high = signal.raw_range
    for raw, label in signal.labels.items():
        if not low <= raw <= high:
            yield f"{name}: the label '{label}' belongs to {raw}, its bits hold {low} to {high}"
    if signal.initial is not None and not low <= signal.initial <= high:
        yield f"{name} starts with {signal.initial:g}, its bits hold {low} to {high}"


def without_cycle_time(database: Database) -> list[MessageDef]:
    """Return the messages that nothing tells when to send: no cycle time, no event either."""
    return [
        message
        for message in database.messages
        if message.cycle_time_ns <= 0
        and (message.send_type in _CYCLIC or message.send_type is SendType.NONE)
    ]
