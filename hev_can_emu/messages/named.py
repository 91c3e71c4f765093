"""Encoding and decoding with names and values, for scripts and tests; the tick uses the kernels."""

from __future__ import annotations

import itertools
import math
import operator
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hev_can_emu.errors import did_you_mean
from hev_can_emu.jit import kernel
from hev_can_emu.messages.codec import (
    F_COLUMNS,
    S_COLUMNS,
    S_ORDER,
    S_PARENT,
    Codec,
    build_codec,
    decode_signals,
    encode_signals,
    is_active,
    to_pattern,
)
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.definitions import MessageDef, SignalDef

Value = float | str | None
"""A physical value, a label of the value table, or None for not available."""


# A call of a compiled function from Python costs by the number of its arrays.  So all that a message needs
# lies in one int64 array: [signals, bytes, start of scaling, lists, values, data] and then these tables.
_HEADER = 6


@kernel
def _encode(block: np.ndarray) -> int:
    count = block[0]
    signals = block[_HEADER : block[2]].reshape((count, S_COLUMNS))
    scaling = block[block[2] : block[3]].view(np.float64).reshape((count, F_COLUMNS))
    lists = block[block[3] : block[4]]
    values = block[block[4] : block[5]].view(np.float64)
    data = block[block[5] :].view(np.uint8)
    for n in range(block[1]):
        data[n] = 0
    return encode_signals(signals, scaling, lists, 0, count, values, data, values)


@kernel
def _decode(block: np.ndarray) -> None:
    count = block[0]
    signals = block[_HEADER : block[2]].reshape((count, S_COLUMNS))
    scaling = block[block[2] : block[3]].view(np.float64).reshape((count, F_COLUMNS))
    lists = block[block[3] : block[4]]
    values = block[block[4] : block[5]].view(np.float64)
    data = block[block[5] :].view(np.uint8)
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
        words = (message.length + 7) // 8
        sizes = [_HEADER, signals.size, self.count * F_COLUMNS, codec.lists.size, self.count, words]
        ends = np.cumsum(sizes)
        self.memory = bytearray(8 * int(ends[-1]))
        self.block = np.frombuffer(self.memory, dtype=np.int64)
        self.block[:_HEADER] = [self.count, message.length, *ends[1:5]]
        self.block[_HEADER : ends[1]] = signals.ravel()
        self.block[ends[1] : ends[2]] = codec.scaling[first:last].ravel().view(np.int64)
        self.block[ends[2] : ends[3]] = codec.lists
        self.values_at = 8 * int(ends[3])
        self.view = self.block[ends[3] : ends[4]].view(np.float64)
        self.view[:] = np.nan
        start = 8 * int(ends[4])
        self.buffer = memoryview(self.memory)[start : start + message.length]
        self.data = np.frombuffer(self.buffer, dtype=np.uint8)
        self.data_slice = slice(start, start + message.length)
        self.collect = _collector(self.names)
        self.pick: Callable[[Any], Any] = (
            operator.itemgetter(*self.names)
            if self.count > 1
            else lambda given: tuple(given[name] for name in self.names)
        )
        layout = struct.Struct(f"{self.count}d")
        self.pack, self.unpack = layout.pack_into, layout.unpack_from
        self.multiplexed = any(signal.multiplexer for signal in message.signals)
        self.active = np.zeros(self.count, dtype=np.uint8)
        self.wide = tuple(signal for signal in message.signals if _is_wide(signal))
        self.labels = tuple(
            (signal.name, _labels_by_value(signal)) for signal in message.signals if signal.labels
        )


def _collector(names: tuple[str, ...]) -> Callable[..., dict[str, float]]:
    """Return a function from values to ``{name: value}``: a dict display, thrice as fast as dict(zip())."""
    arguments = [f"v{n}" for n in range(len(names))]
    pairs = ", ".join(f"{name!r}: {v}" for name, v in zip(names, arguments, strict=True))
    made: Callable[..., dict[str, float]] = eval(f"lambda {', '.join(arguments)}: {{{pairs}}}")
    return made


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
        self._by_id = {(face.message.can_id, face.message.extended): face for face in faces}
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
            if len(values) != face.count:
                raise KeyError
            face.pack(face.memory, face.values_at, *face.pick(values))
        except (KeyError, struct.error, OverflowError):
            face.view[:] = _numbers(face, values)
        self.saturations += _encode(face.block)
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
        face = self._by_id.get((can_id, extended))
        if face is None:
            raise ValueError(f"unknown identifier 0x{can_id:X}")
        buffer = face.buffer
        if len(data) != len(buffer):
            name = face.message.name
            raise ValueError(f"{name} has {len(buffer)} bytes, got {len(data)}")
        face.memory[face.data_slice] = data
        _decode(face.block)
        found: dict[str, Any]
        if face.multiplexed:
            signals, _, lists = self._tables
            _select(signals, lists, face.first, face.count, face.data, face.active)
            pairs = zip(face.names, face.view.tolist(), strict=True)
            found = dict(itertools.compress(pairs, face.active.tolist()))
        else:
            found = face.collect(*face.unpack(face.memory, face.values_at))
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
