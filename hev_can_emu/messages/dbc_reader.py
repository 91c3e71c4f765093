"""From the text of a DBC file to the records of :mod:`hev_can_emu.messages.definitions`.

cantools parses; here its failures become errors with file and line, what it lets pass is refused, and
the attributes that tell when and how a message is sent are resolved through the file's own definitions.
"""

from __future__ import annotations

import logging
import math
import re
from pathlib import Path
from typing import Any

import cantools.database.can
import msgspec

from hev_can_emu.errors import InputError
from hev_can_emu.messages.dbc_attributes import (
    attribute,
    integer_attribute,
    is_invalid,
    is_not_available,
    read_protection,
    read_send_type,
)
from hev_can_emu.messages.definitions import MessageDef, SendType, SignalDef

_MS = 1_000_000
_FORMAT = "a DBC file (text that begins with VERSION, NS_, BU_ or BO_)"
#: cantools logs what it merely doubts; what matters is refused below with its own words.
_LOGGER = logging.getLogger("cantools")


class DbcText(msgspec.Struct, frozen=True):
    """A DBC file's path and text, and where in it something stands."""

    path: Path
    text: str

    @classmethod
    def read(cls, path: Path) -> DbcText:
        """Read the file (UTF-8, else Windows-1252); raises InputError where it is no text."""
        try:
            content = path.read_bytes()
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(str(path), "a readable DBC file", reason.lower()) from error
        if b"\0" in content:
            line = content[: content.index(b"\0")].count(b"\n") + 1
            raise InputError(f"{path}:{line}", _FORMAT, "binary data (a zero byte)")
        for encoding in ("utf-8-sig", "cp1252"):
            try:
                text = content.decode(encoding)
            except UnicodeDecodeError:
                continue
            if not text.strip():
                raise InputError(str(path), _FORMAT, "an empty file")
            return cls(path, text)
        raise InputError(str(path), _FORMAT, "bytes that are neither UTF-8 nor Windows-1252")

    def line_of(self, message: str = "", signal: str = "") -> int:
        """Return the line that defines a message, or a signal of it; 0 where it is not found."""
        inside = not message
        for number, line in enumerate(self.text.splitlines(), start=1):
            words = line.replace(":", " ").split()
            if len(words) > 2 and words[0] == "BO_":
                inside = not message or words[2] == message
                if inside and not signal:
                    return number
            elif inside and signal and len(words) > 1 and words[0] == "SG_" and words[1] == signal:
                return number
        return 0

    def line_with(self, word: str) -> int:
        """Return the first line that holds ``word``, preferring those that use it; else 0."""
        lines = self.text.splitlines()
        pattern = re.compile(rf"(?<!\w){re.escape(word)}(?!\w)")
        hits = [number for number, line in enumerate(lines, start=1) if pattern.search(line)]
        return hits[0] if hits and word else 0

    def where(self, line: int = 0) -> str:
        """Return ``path:line``, or the path alone for line 0."""
        return f"{self.path}:{line}" if line else str(self.path)

    def error(
        self, expected: str, got: str, hint: str = "", message: str = "", signal: str = ""
    ) -> InputError:
        """Return an InputError at the line of a message or signal."""
        return InputError(self.where(self.line_of(message, signal)), expected, got, hint)


def _parse(source: DbcText) -> Any:
    database = cantools.database.can.Database(strict=True)
    level = _LOGGER.level
    _LOGGER.setLevel(logging.CRITICAL)
    try:
        database.add_dbc_string(source.text)
    except Exception as error:  # whatever the parser raises means a bad file
        raise _translate(source, error) from error
    finally:
        _LOGGER.setLevel(level)
    return database


def _translate(source: DbcText, error: Exception) -> InputError:
    text = " ".join(str(error).split())
    if match := re.search(r"Invalid syntax at line (\d+), column (\d+)", text):
        line = int(match[1])
        lines = source.text.splitlines()
        content = lines[line - 1] if 0 < line <= len(lines) else ""
        got = f"'{content.strip()[:60]}'" if content.strip() else "the end of the file"
        return InputError(source.where(line), f"DBC syntax (column {match[2]})", got)
    if match := re.search(r"signals (\S+) and (\S+) are overlapping in message (\S+)\.$", text):
        first, second, message = match.groups()
        if first == second:
            expected, got = f"signal names that occur once in {message}", f"'{first}' twice"
            return source.error(expected, got, message=message, signal=first)
        return source.error(
            f"signals of {message} that do not overlap",
            f"'{first}' and '{second}' on the same bits",
            message=message,
            signal=first,
        )
    if match := re.search(r"signal (\S+) does not fit in message (\S+)\.$", text):
        signal, message = match.groups()
        return source.error(
            f"a signal inside {message}",
            f"'{signal}' beyond its last bit",
            message=message,
            signal=signal,
        )
    if match := re.search(
        r"signal (\S+) length (\S+) is not greater than 0 in message (\S+)", text
    ):
        signal, length, message = match.groups()
        message = message.rstrip(".")
        return source.error(
            "a signal of at least one bit", f"{length}", message=message, signal=signal
        )
    if match := re.search(
        r"frame id (0x[0-9a-f]+) is more than (\d+) bits in message (\S+)\.", text
    ):
        return source.error(f"an identifier of {match[2]} bits", match[1], message=match[3])
    if isinstance(error, KeyError):
        name = str(error.args[0]) if error.args else ""
        return InputError(
            source.where(source.line_with(name)), "a name that the file defines", f"'{name}'"
        )
    if match := re.search(r"unused (VAL_|SIG_VALTYPE_) entries in DBC: \S+ (\d+) (\S+)", text):
        pattern = rf"{match[1]}\s+{match[2]}\s+{re.escape(match[3])}\b"
        found = re.search(pattern, source.text)
        line = source.text[: found.start()].count("\n") + 1 if found else 0
        return InputError(
            source.where(line),
            f"a signal of message {match[2]} that {match[1]} belongs to",
            f"'{match[3]}', which that message lacks",
        )
    return InputError(str(source.path), "a valid DBC file", text or type(error).__name__)


def read_messages(source: DbcText) -> tuple[tuple[str, ...], tuple[MessageDef, ...]]:
    """Return the nodes and messages of a DBC text; raises InputError."""
    if not re.search(r"^\s*(VERSION|NS_|BS_|BU_|BO_)\b", source.text, re.MULTILINE):
        first = source.text.strip().splitlines()[0][:60]
        raise InputError(source.where(1), _FORMAT, f"'{first}'")
    database = _parse(source)
    definitions = database.dbc.attribute_definitions if database.dbc else {}
    messages: list[MessageDef] = []
    first_signal = 0
    names: dict[str, str] = {}
    ids: dict[tuple[int, bool], str] = {}
    for entry in database.messages:
        if entry.name == "VECTOR__INDEPENDENT_SIG_MSG":
            continue
        key = (entry.frame_id, entry.is_extended_frame)
        if key in ids:
            raise source.error(
                "identifiers that occur once",
                f"0x{entry.frame_id:X} for both '{ids[key]}' and '{entry.name}'",
                message=entry.name,
            )
        if entry.name in names:
            raise source.error(
                "message names that occur once", f"'{entry.name}' twice", message=entry.name
            )
        ids[key] = entry.name
        names[entry.name] = entry.name
        message = _read_message(source, entry, len(messages), first_signal, definitions)
        first_signal += len(message.signals)
        messages.append(message)
    return tuple(node.name for node in database.nodes), tuple(messages)


def _read_message(
    source: DbcText, entry: Any, index: int, first_signal: int, definitions: Any
) -> MessageDef:
    if not 0 <= entry.length <= 64:
        raise source.error("a message of 0 to 64 bytes", f"{entry.length}", message=entry.name)
    signals = tuple(
        _read_signal(source, entry, signal, first_signal + n, index)
        for n, signal in enumerate(entry.signals)
    )
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
                f"{name} of {entry.name}: {lowest} or more", str(error), message=entry.name
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
