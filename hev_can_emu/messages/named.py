"""Encoding and decoding with names and values, for scripts and tests; the tick uses the kernels."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hev_can_emu.errors import did_you_mean
from hev_can_emu.jit import kernel
from hev_can_emu.messages.codec import (
    Codec,
    build_codec,
    decode_signals,
    encode_signals,
    is_active,
    to_pattern,
)
from hev_can_emu.messages.columns import F_COLUMNS, M_QUICK, S_COLUMNS, S_ORDER, S_PARENT
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.definitions import MessageDef, SignalDef
from hev_can_emu.messages.python_entry import entry
from hev_can_emu.messages.quick import join, quick_patterns, quick_values

Value = float | str | None
"""A physical value, a label of the value table, or None for not available."""


# A call from Python costs by the number of its arrays.  So all that a message needs lies in one int64 array:
# this header of counts and places, then what it points at.
(
    H_COUNT, H_ORDER, H_BYTES, H_AT_TABLE, H_AT_SCALING, H_AT_LISTS, H_AT_RANGES, H_AT_PLACES, H_AT_VALUES,
    H_AT_ON_BUS, H_AT_DATA, H_SIZE,
) = range(12)  # fmt: skip


@kernel
def _encode(block: np.ndarray) -> int:
    count, order = block[H_COUNT], block[H_ORDER]
    numbers, words = block.view(np.float64), block.view(np.uint64)
    if order != 0:
        unusual = quick_patterns(
            numbers, block[H_AT_RANGES], words, block[H_AT_PLACES], count, 0, count, numbers,
            block[H_AT_VALUES], numbers, block[H_AT_ON_BUS],
        )  # fmt: skip
        if unusual == 0:
            words[block[H_AT_DATA]] = join(words, block[H_AT_PLACES], count, 0, count, order)
            return 0
    signals = block[block[H_AT_TABLE] : block[H_AT_SCALING]].reshape((count, S_COLUMNS))
    scaling = numbers[block[H_AT_SCALING] : block[H_AT_LISTS]].reshape((count, F_COLUMNS))
    lists = block[block[H_AT_LISTS] : block[H_AT_RANGES]]
    values = numbers[block[H_AT_VALUES] : block[H_AT_ON_BUS]]
    on_bus = numbers[block[H_AT_ON_BUS] : block[H_AT_DATA]]
    block[block[H_AT_DATA] :] = 0
    data = block[block[H_AT_DATA] :].view(np.uint8)
    return encode_signals(signals, scaling, lists, 0, count, values, data, on_bus)


@kernel
def _decode(block: np.ndarray) -> None:
    count = block[H_COUNT]
    numbers, words = block.view(np.float64), block.view(np.uint64)
    if block[H_ORDER] != 0:
        quick_values(
            numbers, block[H_AT_RANGES], words, block[H_AT_PLACES], count, 0, count,
            words[block[H_AT_DATA]], numbers, block[H_AT_VALUES],
        )  # fmt: skip
        return
    signals = block[block[H_AT_TABLE] : block[H_AT_SCALING]].reshape((count, S_COLUMNS))
    scaling = numbers[block[H_AT_SCALING] : block[H_AT_LISTS]].reshape((count, F_COLUMNS))
    lists = block[block[H_AT_LISTS] : block[H_AT_RANGES]]
    data = block[block[H_AT_DATA] :].view(np.uint8)
    values = numbers[block[H_AT_VALUES] : block[H_AT_ON_BUS]]
    decode_signals(signals, scaling, lists, 0, count, data, values)


@kernel
def _select(
    signals: np.ndarray,
    lists: np.ndarray,
    first: int,
    count: int,
    data: np.ndarray,
    active: np.ndarray,
) -> None:
    for n in range(count):
        active[n] = is_active(signals, lists, first + n, data)


class _Face:
    """One message's buffers and names, prepared so that a call does nothing twice."""

    def __init__(self, message: MessageDef, codec: Codec) -> None:
        self.message = message
        self.names = tuple(signal.name for signal in message.signals)
        self.count = len(self.names)
        self.first = message.signals[0].index if message.signals else 0
        first, last = self.first, self.first + self.count
        signals = codec.signals[first:last].copy()
        signals[:, S_ORDER] -= first
        signals[:, S_PARENT] -= np.where(signals[:, S_PARENT] >= 0, first, 0)
        every = codec.signals.shape[0]
        parts = [
            signals,
            codec.scaling[first:last],
            codec.lists,
            codec.ranges.reshape(-1, every)[:, first:last],
            codec.places.reshape(-1, every)[:, first:last],
            np.full(self.count, np.nan),
            np.full(self.count, np.nan),
            np.zeros((message.length + 7) // 8 or 1, dtype=np.int64),
        ]
        starts = np.cumsum([H_SIZE, *(part.size for part in parts)])
        self.memory = bytearray(8 * int(starts[-1]))
        self.block = np.frombuffer(self.memory, dtype=np.int64)
        order = codec.messages[message.index, M_QUICK]
        self.block[:H_SIZE] = [self.count, order, message.length, *starts[:-1]]
        for start, part in zip(starts, parts, strict=False):
            self.block[start : start + part.size] = np.ravel(part).view(np.int64)
        self.values_at = 8 * int(starts[5])
        self.view = self.block[starts[5] : starts[6]].view(np.float64)
        start = 8 * int(starts[7])
        self.buffer = memoryview(self.memory)[start : start + message.length]
        self.data = np.frombuffer(self.buffer, dtype=np.uint8)
        layout = struct.Struct(f"{self.count}d")
        self.pack, self.unpack = layout.pack_into, layout.unpack_from
        run_encode, run_decode = entry(_encode, self.block), entry(_decode, self.block)
        self.view[:] = np.nan
        self.run_encode, self.run_decode = run_encode, run_decode
        self.encode, self.decode = _written_out(self)
        self.multiplexed = any(signal.multiplexer for signal in message.signals)
        self.active = np.zeros(self.count, dtype=np.uint8)
        self.wide = tuple(signal for signal in message.signals if _is_wide(signal))
        self.plain = not self.multiplexed and not self.wide
        self.labels = tuple(
            (signal.name, _labels_by_value(signal)) for signal in message.signals if signal.labels
        )


def _written_out(
    face: _Face,
) -> tuple[Callable[[Mapping[str, Any]], int], Callable[[Any], dict[str, Any]]]:
    """Return functions that encode and decode one message, all its names written out in their source.

    That takes half the time of loops over the names.  ``encode`` puts values into the face's buffer and
    returns how many saturated; it raises KeyError, struct.error or OverflowError where each value has to be
    looked at.  ``decode`` raises ValueError for a wrong number of bytes.
    """
    names = [repr(name) for name in face.names]
    numbers = [f"v{n}" for n in range(face.count)]
    given = "".join(f", values[{name}]" for name in names)
    pairs = ", ".join(f"{name}: {v}" for name, v in zip(names, numbers, strict=True))
    unpacked = f"{', '.join(numbers)}, = unpack(memory, {face.values_at})" if numbers else "pass"
    source = f"""
def encode(values):
    if len(values) != {face.count}:
        raise KeyError
    pack(memory, {face.values_at}{given})
    return run_encode(block)

def decode(data):
    buffer[every] = data
    run_decode(block)
    {unpacked}
    return {{{pairs}}}
"""
    scope: dict[str, Any] = {
        "memory": face.memory, "block": face.block, "pack": face.pack, "unpack": face.unpack,
        "run_encode": face.run_encode, "run_decode": face.run_decode,
        "buffer": face.buffer, "every": slice(None),
    }  # fmt: skip
    exec(source, scope)
    return scope["encode"], scope["decode"]


def _is_wide(signal: SignalDef) -> bool:
    """Whether float64 cannot hold every physical value of an integer signal."""
    if signal.is_float:
        return False
    low, high = (raw * signal.scale + signal.offset for raw in signal.raw_range)
    return signal.length > 53 or max(abs(low), abs(high)) > 1 << 53


def _labels_by_value(signal: SignalDef) -> dict[float, str]:
    return {
        float(raw * signal.scale + signal.offset): label for raw, label in signal.labels.items()
    }


class NamedCodec:
    """Encodes and decodes messages of a database by name.

    Not for several threads at once: each message has one buffer.
    """

    def __init__(self, database: Database) -> None:
        self.database = database
        self.codec = build_codec(database)
        self.saturations = 0
        faces = [_Face(message, self.codec) for message in database.messages]
        self._by_name = {face.message.name: face for face in faces}
        self._standard = {f.message.can_id: f for f in faces if not f.message.extended}
        self._extended = {f.message.can_id: f for f in faces if f.message.extended}
        self._tables = (self.codec.signals, self.codec.scaling, self.codec.lists)

    def encode_message(self, name: str, values: Mapping[str, Value]) -> bytes:
        """Return the bytes of a message.

        Signals that are left out, None or NaN are sent as not available (see
        :func:`hev_can_emu.messages.codec.encode`); values out of range saturate and are counted in
        ``saturations``.

        Raises:
            ValueError: for an unknown message, signal or label.
        """
        face = self._by_name.get(name)
        if face is None:
            raise ValueError(
                f"unknown message '{name}' {did_you_mean(name, self._by_name)}".strip()
            )
        try:
            self.saturations += face.encode(values)
        except (KeyError, struct.error, OverflowError):
            face.view[:] = _numbers(face, values)
            self.saturations += face.run_encode(face.block)
        for signal in face.wide:
            value = values.get(signal.name)
            signals, scaling, lists = self._tables
            if (
                isinstance(value, int)
                and is_active(signals, lists, signal.index, face.data)
                and _put_exactly(face.buffer, signal, value)
            ):
                # It only seemed out of range in float64.
                number = _number(signal, value)
                self.saturations -= to_pattern(signals, scaling, lists, signal.index, number)[1]
        return face.buffer.tobytes()

    def decode_message(
        self, can_id: int, data: bytes, extended: bool = False, labels: bool = False
    ) -> dict[str, Any]:
        """Return the physical values in a frame; NaN for not available.

        With ``labels`` values of the value table come as their label.  Of a multiplexed message only the
        selected signals are returned.

        Raises:
            ValueError: for an unknown identifier, or another number of bytes than the message has.
        """
        face = (self._extended if extended else self._standard).get(can_id)
        if face is None:
            raise ValueError(f"unknown identifier 0x{can_id:X}")
        try:
            found = face.decode(data)
        except ValueError:
            name, length = face.message.name, face.message.length
            raise ValueError(f"{name} has {length} bytes, got {len(data)}") from None
        if face.plain and not labels:
            return found
        if face.multiplexed:
            signals, _, lists = self._tables
            _select(signals, lists, face.first, face.count, face.data, face.active)
            found = dict(itertools.compress(found.items(), face.active.tolist()))
        for signal in face.wide:
            if signal.name in found and not math.isnan(found[signal.name]):
                found[signal.name] = _get_exactly(data, signal) * signal.scale + signal.offset
        if labels:
            for name, by_value in face.labels:
                if name in found:
                    found[name] = _label(face.message, name, by_value, found[name])
        return found


def _label(message: MessageDef, name: str, by_value: dict[float, str], value: float) -> Any:
    if math.isnan(value):
        signal = next(signal for signal in message.signals if signal.name == name)
        return value if signal.not_available is None else signal.labels[signal.not_available]
    return by_value.get(value, value)


def _numbers(face: _Face, values: Mapping[str, Value]) -> list[float]:
    """Return a number for every signal of a message; the slow path, which also finds mistakes."""
    for name in values:
        if name not in face.names:
            hint = did_you_mean(name, face.names)
            raise ValueError(f"unknown signal '{name}' of {face.message.name} {hint}".strip())
    return [_number(signal, values.get(signal.name)) for signal in face.message.signals]


def _number(signal: SignalDef, value: Value) -> float:
    if value is None:
        return math.nan
    if not isinstance(value, str):
        try:
            return float(value)
        except OverflowError:
            return math.copysign(math.inf, value)
    for raw, label in signal.labels.items():
        if label == value:
            missing = raw == signal.not_available
            return math.nan if missing else float(raw * signal.scale + signal.offset)
    hint = did_you_mean(value, signal.labels.values())
    raise ValueError(f"unknown label '{value}' of {signal.qualified_name} {hint}".strip())


def _raw_position(signal: SignalDef, length: int) -> tuple[str, int]:
    """Return the byte order in which a message is one integer, and the signal's lowest bit in it."""
    if signal.little_endian:
        return "little", signal.start
    last = 8 * (signal.start // 8) + 7 - signal.start % 8 + signal.length - 1
    return "big", 8 * length - 1 - last


def _get_exactly(data: bytes, signal: SignalDef) -> int:
    order, shift = _raw_position(signal, len(data))
    whole = int.from_bytes(data, "little" if order == "little" else "big")
    raw = whole >> shift & ((1 << signal.length) - 1)
    if signal.signed and raw >> (signal.length - 1):
        raw -= 1 << signal.length
    return raw


def _put_exactly(buffer: memoryview, signal: SignalDef, value: int) -> bool:
    """Overwrite an integer signal by exact arithmetic, where float64 may have lost its low bits.

    Returns False, and leaves the saturated value, where the value is out of range.
    """
    shifted = value - signal.offset
    quotient, remainder = divmod(shifted, signal.scale)
    raw = round(shifted / signal.scale if remainder else quotient)
    smallest, largest = signal.raw_range
    inside = (signal.minimum is None or value >= signal.minimum) and (
        signal.maximum is None or value <= signal.maximum
    )
    if not inside or not smallest <= raw <= largest or raw == signal.not_available:
        return False
    order, shift = _raw_position(signal, len(buffer))
    side: Any = order
    mask = (1 << signal.length) - 1
    whole = int.from_bytes(buffer, side) & ~(mask << shift) | (raw & mask) << shift
    buffer[:] = whole.to_bytes(len(buffer), side)
    return True
