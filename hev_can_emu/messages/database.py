"""The network: every message and signal of a DBC file, with look-ups by name and identifier."""

from __future__ import annotations

import functools
from collections.abc import Collection, Mapping
from pathlib import Path

import msgspec

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.messages.dbc_text import DbcText
from hev_can_emu.messages.definitions import MessageDef, SendType, SignalDef
from hev_can_emu.messages.protection_spec import ProtectionSpec

__all__ = [
    "Database",
    "MessageDef",
    "ProtectionSpec",
    "SendType",
    "SignalDef",
    "load_database",
    "with_protection",
]


class Database(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """All messages of one network, in the file's order; signals are numbered over all of them.

    The signals of a message have consecutive numbers, so ``values[first : first + n]`` is a message.
    """

    path: Path
    nodes: tuple[str, ...]
    messages: tuple[MessageDef, ...]

    @functools.cached_property
    def signals(self) -> tuple[SignalDef, ...]:
        """Every signal; ``signals[i].index == i``."""
        return tuple(signal for message in self.messages for signal in message.signals)

    @functools.cached_property
    def _by_name(self) -> dict[str, MessageDef]:
        return {message.name: message for message in self.messages}

    @functools.cached_property
    def _by_id(self) -> dict[tuple[int, bool], MessageDef]:
        return {(message.can_id, message.extended): message for message in self.messages}

    @functools.cached_property
    def _by_signal(self) -> dict[str, tuple[SignalDef, ...]]:
        found: dict[str, tuple[SignalDef, ...]] = {}
        for signal in self.signals:
            found[signal.qualified_name] = (signal,)
        for signal in self.signals:
            found[signal.name] = (*found.get(signal.name, ()), signal)
        return found

    def message(self, name: str) -> MessageDef:
        """Return the message of this name; raises InputError."""
        if name not in self._by_name:
            hint = did_you_mean(name, self._by_name)
            raise InputError(str(self.path), "a message of the database", f"'{name}'", hint)
        return self._by_name[name]

    def message_of_id(self, can_id: int, extended: bool = False) -> MessageDef | None:
        """Return the message with this identifier, or None."""
        return self._by_id.get((can_id, extended))

    def signal(self, name: str) -> SignalDef:
        """Return the signal ``Signal`` or ``Message.Signal``.

        Raises:
            InputError: where it is unknown, or occurs in several messages and is not qualified.
        """
        found = self._by_signal.get(name)
        if found is None:
            message, dot, short = name.partition(".")
            if dot and message in self._by_name:
                known = [signal.name for signal in self._by_name[message].signals]
                expected, got, hint = (
                    f"a signal of {message}",
                    f"'{short}'",
                    did_you_mean(short, known),
                )
            else:
                expected, got, hint = (
                    "a signal of the database",
                    f"'{name}'",
                    did_you_mean(name, self._by_signal),
                )
            raise InputError(str(self.path), expected, got, hint)
        if len(found) > 1:
            where = " or ".join(f"'{signal.qualified_name}'" for signal in found)
            raise InputError(
                str(self.path), "a signal name that is unique", f"'{name}'", f"write {where}"
            )
        return found[0]

    def signal_index(self, message: str, signal: str) -> int:
        """Return the place of ``message.signal`` in a vector over all signals; raises InputError."""
        self.message(message)
        return self.signal(f"{message}.{signal}").index


def load_database(path: Path, leave_out: Collection[str] = ()) -> Database:
    """Read a DBC file, without the messages named in ``leave_out``.

    Raises:
        InputError: where the file is missing, no text, no DBC, or describes a network that cannot be encoded
            (overlapping signals, equal identifiers or names, a factor of zero); with the line where known.
    """
    # Only here: the parser behind it takes longer to import than anything else in this package.
    from hev_can_emu.messages.dbc_reader import read_messages

    text = DbcText.read(Path(path))
    nodes, messages = read_messages(text, leave_out)
    return Database(path=Path(path), nodes=nodes, messages=messages)


def with_protection(
    database: Database, specs: Mapping[str, ProtectionSpec | None], where: str = ""
) -> Database:
    """Return the database with the protection of the named messages replaced.

    Raises:
        InputError: where a message is unknown or too short; ``where`` names the declaring file.
    """
    messages = list(database.messages)
    for name, spec in specs.items():
        message = database.message(name)
        if spec is not None:
            try:
                spec.check_length(message.length)
            except ValueError as error:
                raise InputError(
                    f"{where or database.path}: {name}", "a protection that fits", str(error)
                ) from error
        messages[message.index] = msgspec.structs.replace(message, protection=spec)
    return Database(path=database.path, nodes=database.nodes, messages=tuple(messages))
