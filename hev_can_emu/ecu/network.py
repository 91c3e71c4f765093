"""The network as the bindings complete it: a DBC's messages with the protection, the send type and the
constant signals that a file beside it declares.

What follows (:func:`hev_can_emu.ecu.bindings.resolve`, the codec, the schedule) reads the result as if the
DBC had said it all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgspec

from hev_can_emu.ecu.bindings_file import Bindings, MessageBinding
from hev_can_emu.ecu.network_file import ProtectionBinding, Sending
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.messages.database import Database, MessageDef, ProtectionSpec, SendType, SignalDef
from hev_can_emu.messages.protection_spec import CrcSpec
from hev_can_emu.units import parse_quantity

Steps = tuple[str | int, ...]
Locate = Callable[[Steps], str]

_SEND_TYPES = {
    "cyclic": SendType.CYCLIC,
    "on_change": SendType.ON_CHANGE,
    "cyclic_and_change": SendType.CYCLIC_AND_CHANGE,
    "cyclic_if_active": SendType.CYCLIC_IF_ACTIVE,
    "event": SendType.EVENT,
    "never": SendType.NONE,
}
_CUSTOM_ONLY = (
    "crc_width", "polynomial", "init", "xor", "reflected", "big_endian", "first_byte", "last_byte",
    "own_as_zero", "counter_length", "counter_max", "data_id_position",
)  # fmt: skip


def complete(bindings: Bindings, database: Database, locate: Locate) -> Database:
    """Return the database with what the bindings say of its messages.

    Args:
        bindings: the file's content.
        database: the network as the DBC has it.
        locate: gives a place in the bindings file from the keys that lead to it.

    Raises:
        InputError: an unknown signal or label, a protection that does not fit, a time that is none.
    """
    known = {message.name: message for message in database.messages}
    messages = list(database.messages)
    for name, binding in bindings.messages.items():
        if name not in known:
            continue  # told by resolve(), which looks at every name
        message, steps = known[name], ("messages", name)
        if binding.protection is not None:
            spec = _protection(binding.protection, message, locate, (*steps, "protection"))
            message = msgspec.structs.replace(message, protection=spec)
        if binding.sending is not None:
            message = _send(binding.sending, message, locate, (*steps, "sending"))
        if binding.constant:
            message = _fix(binding, message, locate, (*steps, "constant"))
        messages[message.index] = message
    return Database(path=database.path, nodes=database.nodes, messages=tuple(messages))


def _signal(message: MessageDef, name: str, locate: Locate, steps: Steps) -> SignalDef:
    signals = {signal.name: signal for signal in message.signals}
    if name not in signals:
        hint = did_you_mean(name, signals)
        raise InputError(locate(steps), f"a signal of {message.name}", f"'{name}'", hint)
    return signals[name]


def _lowest_bit(signal: SignalDef) -> int:
    """Return the place of a signal's least significant bit, ``8 * byte + bit``."""
    if signal.little_endian:
        return signal.start
    last = 8 * (signal.start // 8) + 7 - signal.start % 8 + signal.length - 1
    return 8 * (last // 8) + 7 - last % 8


def _protection(
    asked: ProtectionBinding, message: MessageDef, locate: Locate, steps: Steps
) -> ProtectionSpec | None:
    if asked.profile == "none":
        return None
    if asked.profile != "custom":
        for name in _CUSTOM_ONLY:
            if getattr(asked, name) != getattr(ProtectionBinding(profile="custom"), name):
                where = locate((*steps, name))
                raise InputError(where, "the profile custom beside it", f"'{asked.profile}'")
    fields: dict[str, Any] = {}
    width: int | None = asked.crc_width
    length = asked.counter_length
    high_first, counter_high_first = asked.big_endian or False, False
    if asked.crc:
        crc = _only_once(asked, "crc", ("crc_bit", "crc_width"), message, locate, steps)
        bits = crc.bits()
        if crc.length not in (8, 16) or min(bits) % 8 or max(bits) - min(bits) + 1 != crc.length:
            got = f"{crc.length} bits from bit {min(bits)}"
            raise InputError(locate((*steps, "crc")), "a CRC of one or two whole bytes", got)
        fields["crc_offset"], width = min(bits), crc.length
        high_first = not crc.little_endian if asked.big_endian is None else asked.big_endian
    elif asked.crc_bit is not None:
        fields["crc_offset"] = asked.crc_bit
    if asked.counter:
        counter = _only_once(
            asked, "counter", ("counter_bit", "counter_length"), message, locate, steps
        )
        fields["counter_offset"], length = _lowest_bit(counter), counter.length
        counter_high_first = not counter.little_endian
    elif asked.counter_bit is not None:
        fields["counter_offset"] = asked.counter_bit
    if asked.data_id_nibble:
        nibble = _only_once(
            asked, "data_id_nibble", ("data_id_nibble_bit",), message, locate, steps
        )
        if nibble.length != 4:
            where = locate((*steps, "data_id_nibble"))
            raise InputError(where, "a signal of 4 bits", f"{nibble.length}")
        fields["nibble_offset"] = _lowest_bit(nibble)
    elif asked.data_id_nibble_bit is not None:
        fields["nibble_offset"] = asked.data_id_nibble_bit
    if asked.profile == "custom":
        width = 8 if width is None else width
        if asked.polynomial is None and width:
            raise InputError(locate(steps), "a 'polynomial' of the CRC", "none")
        fields |= {
            "counter_length": 4 if length is None else length,
            "counter_max": -1 if asked.counter_max is None else asked.counter_max,
            "counter_big_endian": counter_high_first,
            "data_id_position": asked.data_id_position,
        }
    try:
        if asked.profile == "custom":
            fields["crc"] = CrcSpec(
                width=width or 0,
                polynomial=asked.polynomial or 0,
                init=asked.init,
                xor=asked.xor,
                reflected=asked.reflected,
                big_endian=high_first,
                first_byte=asked.first_byte,
                last_byte=-1 if asked.last_byte is None else asked.last_byte,
                own_as_zero=asked.own_as_zero,
            )
        spec = ProtectionSpec(
            profile=asked.profile,
            data_id=asked.data_id,
            data_id_mode=asked.data_id_mode,
            data_id_list=asked.data_id_list,
            max_delta_counter=asked.max_delta_counter,
            **fields,
        )
        spec.check_length(message.length)
        if asked.crc and width != spec.effective_crc.width:
            raise ValueError(
                f"expected a CRC of {spec.effective_crc.width} bits for {asked.profile}, got {width}"
            )
        if asked.counter and length != spec.counter_bits:
            raise ValueError(
                f"expected a counter of {spec.counter_bits} bits for {asked.profile}, got {length}"
            )
    except ValueError as error:
        expected, _, got = str(error).removeprefix("expected ").rpartition(", got ")
        raise InputError(locate(steps), f"{expected} in {message.name}", got) from error
    return spec


def _only_once(
    asked: ProtectionBinding,
    key: str,
    others: tuple[str, ...],
    message: MessageDef,
    locate: Locate,
    steps: Steps,
) -> SignalDef:
    """Return the signal that ``key`` names; refuse that its place is said a second time."""
    for other in others:
        if getattr(asked, other) is not None:
            where = locate((*steps, other))
            raise InputError(where, f"either '{key}' or '{other}'", "both")
    return _signal(message, getattr(asked, key), locate, (*steps, key))


def _time_ns(text: str, locate: Locate, steps: Steps) -> int:
    where = locate(steps)
    seconds = parse_quantity(text, where, "s").si_value
    if not 0.0 <= seconds <= 3600.0:
        raise InputError(where, "0 s to 3600 s", f"'{text}'")
    return round(seconds * 1e9)


def _send(asked: Sending, message: MessageDef, locate: Locate, steps: Steps) -> MessageDef:
    changes: dict[str, Any] = {}
    for key, field in (
        ("period", "cycle_time_ns"),
        ("fast_period", "fast_cycle_time_ns"),
        ("delay", "delay_ns"),
        ("phase", "start_delay_ns"),
    ):
        text = getattr(asked, key)
        if text:
            changes[field] = _time_ns(text, locate, (*steps, key))
    if asked.repetitions is not None:
        if not 0 <= asked.repetitions <= 1000:
            where = locate((*steps, "repetitions"))
            raise InputError(where, "0 to 1000", f"{asked.repetitions}")
        changes["repetitions"] = asked.repetitions
    if asked.type is not None:
        changes["send_type"] = _SEND_TYPES[asked.type]
    elif message.send_type is SendType.NONE and changes.get("cycle_time_ns"):
        changes["send_type"] = SendType.CYCLIC
    done = msgspec.structs.replace(message, **changes)
    cyclic = (SendType.CYCLIC, SendType.CYCLIC_AND_CHANGE, SendType.CYCLIC_IF_ACTIVE)
    if done.send_type in cyclic and done.cycle_time_ns <= 0:
        raise InputError(locate(steps), "a 'period' of a cyclic message", "none")
    if done.send_type is SendType.EVENT and done.repetitions and not done.fast_cycle_time_ns:
        raise InputError(locate(steps), "a 'fast_period' between the repetitions", "none")
    return done


def _fix(binding: MessageBinding, message: MessageDef, locate: Locate, steps: Steps) -> MessageDef:
    """Give the constant signals the value that a signal without value is sent with."""
    signals = list(message.signals)
    for name, value in binding.constant.items():
        place = (*steps, name)
        signal = _signal(message, name, locate, place)
        if name in binding.status:
            raise InputError(locate(place), "a signal without port", f"'{name}', which has one")
        if message.protection and not message.protection.bits().isdisjoint(signal.bits()):
            got = f"'{name}', which the protection of {message.name} writes"
            raise InputError(locate(place), "a signal that carries a value", got)
        raw = _raw_value(signal, value, locate, place)
        position = signal.index - message.signals[0].index
        signals[position] = msgspec.structs.replace(
            signal, initial=raw, not_available=None, constant=True
        )
    return msgspec.structs.replace(message, signals=tuple(signals))


def _raw_value(signal: SignalDef, value: float | str, locate: Locate, steps: Steps) -> float:
    if isinstance(value, str):
        for raw, label in signal.labels.items():
            if label == value:
                return raw
        hint = did_you_mean(value, signal.labels.values())
        raise InputError(locate(steps), f"a label of {signal.name} or a number", f"'{value}'", hint)
    exact = (value - signal.offset) / signal.scale
    if signal.is_float:
        return exact
    nearest = round(exact) if math.isfinite(exact) else 0
    low, high = signal.raw_range
    if not math.isclose(exact, nearest, abs_tol=1e-6) or not low <= nearest <= high:
        ends = sorted(raw * signal.scale + signal.offset for raw in (low, high))
        expected = f"a value that {signal.name} can take, {ends[0]:g} to {ends[1]:g}"
        raise InputError(locate(steps), expected, f"{value:g}", f"its step is {signal.scale:g}")
    return nearest
