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


@kernel
def _encode(
    signals: np.ndarray,
    scaling: np.ndarray,
    lists: np.ndarray,
    first: int,
    count: int,
    values: np.ndarray,
    data: np.ndarray,
) -> int:
    for n in range(data.shape[0]):
        data[n] = 0
    return encode_signals(signals, scaling, lists, first, count, values, data, values)


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

    def __init__(self, message: MessageDef, codec: Codec, values: np.ndarray) -> None:
        self.message = message
        self.names = tuple(signal.name for signal in message.signals)
        self.count = len(self.names)
        self.first = message.signals[0].index if message.signals else 0
        self.values = values
        self.view = values[self.first : self.first + self.count]
        self.buffer = bytearray(message.length)
        self.data = np.frombuffer(self.buffer, dtype=np.uint8)
        self.pick: Callable[[Any], Any] = (
            operator.itemgetter(*self.names)
            if self.count > 1
            else lambda given: tuple(given[name] for name in self.names)
        )
        self.pack: Callable[..., None] = struct.Struct(f"{self.count}d").pack_into
        self.multiplexed = any(signal.multiplexer for signal in message.signals)
        self.active = np.zeros(self.count, dtype=np.uint8)
        self.wide = tuple(signal for signal in message.signals if _is_wide(signal))
        self.labels = tuple(
            (signal.name, _labels_by_value(signal)) for signal in message.signals if signal.labels
        )


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
        values = np.full(max(len(database.signals), 1), np.nan)
        faces = [_Face(message, self.codec, values) for message in database.messages]
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
            face.pack(face.view, 0, *face.pick(values))
        except (KeyError, struct.error, OverflowError):
            face.view[:] = _numbers(face, values)
        signals, scaling, lists = self._tables
        self.saturations += _encode(
            signals, scaling, lists, face.first, face.count, face.values, face.data
        )
        for signal in face.wide:
            value = values.get(signal.name)
            if (
                isinstance(value, int)
                and is_active(signals, lists, signal.index, face.data)
                and _put_exactly(face.buffer, signal, value)
            ):
                # It only seemed out of range in float64.
                number = _number(signal, value)
                self.saturations -= to_pattern(signals, scaling, lists, signal.index, number)[1]
        return bytes(face.buffer)

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
        buffer[:] = data
        signals, scaling, lists = self._tables
        decode_signals(signals, scaling, lists, face.first, face.count, face.data, face.values)
        found: dict[str, Any]
        if face.multiplexed:
            _select(signals, lists, face.first, face.count, face.data, face.active)
            pairs = zip(face.names, face.view.tolist(), strict=True)
            found = dict(itertools.compress(pairs, face.active.tolist()))
        else:
            found = dict(zip(face.names, face.view.tolist(), strict=True))
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


def _put_exactly(buffer: bytearray, signal: SignalDef, value: int) -> bool:
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
