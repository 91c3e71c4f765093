"""From the text of a DBC file to the records of :mod:`hev_can_emu.messages.definitions`.

cantools parses; here its failures become errors with file and line, what it lets pass is refused, and
the attributes that tell when and how a message is sent are resolved through the file's own definitions.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Collection
from typing import Any

import cantools.database.can

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.messages.dbc_attributes import (
    MOST,
    attribute,
    integer_attribute,
    is_invalid,
    is_not_available,
    read_protection,
    read_send_type,
)
from hev_can_emu.messages.dbc_text import FORMAT, DbcText, check_sizes, translate
from hev_can_emu.messages.definitions import MessageDef, SendType, SignalDef

_MS = 1_000_000
#: cantools logs what it merely doubts; what matters is refused below with its own words.
_LOGGER = logging.getLogger("cantools")


def _parse(source: DbcText) -> Any:
    check_sizes(source)
    # Not strict: what it would refuse is looked at message by message, in _read_message.
    database = cantools.database.can.Database(strict=False)
    level = _LOGGER.level
    _LOGGER.setLevel(logging.CRITICAL)
    try:
        database.add_dbc_string(source.text)
    except Exception as error:  # whatever the parser raises means a bad file
        raise translate(source, error) from error
    finally:
        _LOGGER.setLevel(level)
    return database


def read_messages(
    source: DbcText, leave_out: Collection[str] = (), defects: list[InputError] | None = None
) -> tuple[tuple[str, ...], tuple[MessageDef, ...]]:
    """Return the nodes and messages of a DBC text.

    Args:
        source: the text.
        leave_out: names of messages that are not read, whatever is wrong with them.
        defects: takes what is wrong with single messages, which are then left out; without it the first
            defect raises.

    Raises:
        InputError: the text is no DBC, or a message of it cannot be used.
    """
    if not re.search(r"^\s*(VERSION|NS_|BS_|BU_|BO_)\b", source.text, re.MULTILINE):
        first = source.text.strip().splitlines()[0][:60]
        raise InputError(source.where(1), FORMAT, f"'{first}'")
    database = _parse(source)
    definitions = database.dbc.attribute_definitions if database.dbc else {}
    names = [entry.name for entry in database.messages]
    for name in leave_out:
        if name not in names:
            hint = did_you_mean(name, names)
            raise InputError(str(source.path), "the message to leave out", f"no '{name}'", hint)
    messages: list[MessageDef] = []
    first_signal = 0
    ids: dict[tuple[int, bool], str] = {}
    for entry in database.messages:
        if entry.name == "VECTOR__INDEPENDENT_SIG_MSG" or entry.name in leave_out:
            continue
        try:
            _check_unique(source, entry, ids)
            message = _read_message(source, entry, len(messages), first_signal, definitions)
        except InputError as error:
            if defects is None:
                raise
            defects.append(error)
            continue
        ids[entry.frame_id, entry.is_extended_frame] = entry.name
        first_signal += len(message.signals)
        messages.append(message)
    return tuple(node.name for node in database.nodes), tuple(messages)


def _check_unique(source: DbcText, entry: Any, ids: dict[tuple[int, bool], str]) -> None:
    other = ids.get((entry.frame_id, entry.is_extended_frame))
    if other is not None:
        raise source.error(
            "identifiers that occur once",
            f"0x{entry.frame_id:X} for both '{other}' and '{entry.name}'",
            message=entry.name,
        )
    if entry.name in ids.values():
        raise source.error(
            "message names that occur once", f"'{entry.name}' twice", message=entry.name
        )


def _read_message(
    source: DbcText, entry: Any, index: int, first_signal: int, definitions: Any
) -> MessageDef:
    if not 0 <= entry.length <= 64:
        raise source.error("a message of 0 to 64 bytes", f"{entry.length}", message=entry.name)
    signals = tuple(
        _read_signal(source, entry, signal, first_signal + n, index)
        for n, signal in enumerate(entry.signals)
    )
    try:
        entry.refresh(strict=True)
    except Exception as error:  # whatever it raises means a bad layout
        raise translate(source, error) from error
    seen: set[str] = set()
    for signal in signals:
        if signal.name in seen:
            raise source.error(
                f"signal names that occur once in {entry.name}",
                f"'{signal.name}' twice",
                message=entry.name,
                signal=signal.name,
            )
        seen.add(signal.name)

    def number(name: str, lowest: int = 0) -> int | None:
        try:
            return integer_attribute(entry, name, definitions, lowest)
        except ValueError as error:
            raise source.error(
                f"{name} of {entry.name}: {lowest} to {MOST}", str(error), message=entry.name
            ) from error

    try:
        protection = read_protection(entry, definitions)
        if protection is not None:
            protection.check_length(entry.length)
    except ValueError as error:
        expected, _, got = str(error).removeprefix("expected ").rpartition(", got ")
        raise source.error(
            f"{expected or 'valid protection attributes'} (protection of {entry.name})",
            got,
            message=entry.name,
        ) from error
    cycle = number("GenMsgCycleTime") or 0
    start_delay = attribute(entry, "GenMsgStartDelayTime", {})
    send_type = read_send_type(entry, definitions)
    if send_type is SendType.NONE and cycle > 0:
        send_type = SendType.CYCLIC
    bit_rate_switch = attribute(entry, "CANFD_BRS", definitions)
    return MessageDef(
        index=index,
        name=entry.name,
        can_id=entry.frame_id,
        extended=entry.is_extended_frame,
        fd=entry.is_fd,
        brs=entry.is_fd and str(bit_rate_switch) in ("1", "True"),
        length=entry.length,
        sender=entry.senders[0] if entry.senders else "",
        receivers=tuple(sorted(entry.receivers)),
        signals=signals,
        send_type=send_type,
        cycle_time_ns=cycle * _MS,
        fast_cycle_time_ns=(number("GenMsgCycleTimeFast") or 0) * _MS,
        repetitions=number("GenMsgNrOfRepetition") or 0,
        delay_ns=(number("GenMsgDelayTime") or 0) * _MS,
        start_delay_ns=None if start_delay is None else (number("GenMsgStartDelayTime") or 0) * _MS,
        protection=protection,
        comment=entry.comment or "",
    )


def _read_signal(
    source: DbcText, entry: Any, signal: Any, index: int, message_index: int
) -> SignalDef:
    def fail(expected: str, got: str) -> InputError:
        return source.error(
            f"{expected} ({entry.name}.{signal.name})", got, message=entry.name, signal=signal.name
        )

    if not math.isfinite(signal.scale) or signal.scale == 0:
        raise fail("a finite factor other than 0", f"{signal.scale}")
    if not math.isfinite(signal.offset):
        raise fail("a finite offset", f"{signal.offset}")
    if signal.length > 64:
        raise fail("a signal of 1 to 64 bits", f"{signal.length}")
    if signal.conversion.is_float and signal.length not in (16, 32, 64):
        raise fail("a floating-point signal of 16, 32 or 64 bits", f"{signal.length}")
    labels = {int(raw): str(label) for raw, label in (signal.choices or {}).items()}
    return SignalDef(
        index=index,
        message_index=message_index,
        name=signal.name,
        message=entry.name,
        start=signal.start,
        length=signal.length,
        little_endian=signal.byte_order == "little_endian",
        signed=signal.is_signed,
        is_float=signal.conversion.is_float,
        scale=signal.scale,
        offset=signal.offset,
        minimum=signal.minimum,
        maximum=signal.maximum,
        unit=signal.unit or "",
        labels=labels,
        not_available=_not_available(signal, labels),
        initial=signal.raw_initial,
        is_multiplexer=signal.is_multiplexer,
        multiplexer=signal.multiplexer_signal,
        multiplexer_ranges=_ranges(signal.multiplexer_ids or ()),
        receivers=tuple(signal.receivers),
        comment=signal.comment or "",
    )


def _not_available(signal: Any, labels: dict[int, str]) -> int | None:
    """Return the raw value labelled as not available, the all-ones one where several are."""
    if signal.conversion.is_float:
        return None
    length = signal.length
    lowest, highest = (
        (-(1 << (length - 1)), (1 << (length - 1)) - 1)
        if signal.is_signed
        else (0, (1 << length) - 1)
    )
    all_ones = -1 if signal.is_signed else highest
    if is_not_available(labels.get(all_ones, "")) or is_invalid(labels.get(all_ones, "")):
        return all_ones
    found = [
        raw for raw, label in labels.items() if is_not_available(label) and lowest <= raw <= highest
    ]
    return max(found) if found else None


def _ranges(ids: Any) -> tuple[tuple[int, int], ...]:
    """Join multiplexer ids into inclusive ranges."""
    ranges: list[tuple[int, int]] = []
    for value in sorted(ids):
        if ranges and value == ranges[-1][1] + 1:
            ranges[-1] = (ranges[-1][0], value)
        else:
            ranges.append((value, value))
    return tuple(ranges)
