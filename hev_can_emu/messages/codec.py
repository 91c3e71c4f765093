"""Physical values to frame bytes and back, by kernels over tables built from a database.

The bytes equal those of cantools for every value it encodes, with two deliberate differences: a number never
becomes the not-available value (NaN does), and values out of range saturate, counted, instead of failing.

Vectors of values are float64 over all signals of the database; NaN means not available.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hev_can_emu.jit import inlined_kernel, kernel
from hev_can_emu.messages.codec_tables import Codec, build_codec
from hev_can_emu.messages.columns import (
    F_HIGH,
    F_LOW,
    F_OFFSET,
    F_SCALE,
    M_COUNT,
    M_FIRST,
    M_LENGTH,
    M_QUICK,
    M_WIRE_LENGTH,
    S_BIT,
    S_BYTE,
    S_EXTRA,
    S_EXTRA_COUNT,
    S_HAS_NA,
    S_KIND,
    S_LENGTH,
    S_MISSING,
    S_NA,
    S_ORDER,
    S_PARENT,
    S_RANGE_COUNT,
    S_RANGES,
    S_STEP,
)
from hev_can_emu.messages.quick import quick_values, quick_word
from hev_can_emu.messages.raw import (
    FLOAT16,
    FLOAT64,
    SIGNED,
    UNSIGNED,
    float_pattern,
    float_value,
    get_bits,
    put_bits,
    signed_value,
)

__all__ = [
    "Codec",
    "build_codec",
    "decode",
    "decode_signals",
    "encode",
    "encode_signals",
    "find_message",
    "is_active",
    "physical_value",
    "to_pattern",
    "to_physical",
]


@kernel
def find_message(codec: Codec, can_id: Any, extended: Any) -> Any:
    """Return the index of the message with this identifier, or -1."""
    key = np.int64(can_id)
    if extended != 0:
        key |= 1 << 29
    low = 0
    high = codec.keys.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if codec.keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    if low < codec.keys.shape[0] and codec.keys[low] == key:
        return codec.key_messages[low]
    return -1


@kernel
def is_active(signals: np.ndarray, lists: np.ndarray, s: int, data: np.ndarray) -> bool:
    """Whether the multiplexers in ``data`` select signal ``s``, up to the outermost one."""
    parent = signals[s, S_PARENT]
    while parent >= 0:
        row = signals[parent]
        bits = get_bits(data, row[S_BYTE], row[S_BIT], row[S_STEP], row[S_LENGTH])
        if row[S_KIND] == SIGNED:
            selector = signed_value(bits, row[S_LENGTH])
        else:
            selector = np.int64(bits)
        start = signals[s, S_RANGES]
        found = False
        for n in range(signals[s, S_RANGE_COUNT]):
            if lists[start + 2 * n] <= selector <= lists[start + 2 * n + 1]:
                found = True
        if not found:
            return False
        s = parent
        parent = signals[s, S_PARENT]
    return True


@kernel
def physical_value(
    bits: Any, kind: int, length: int, has_na: int, na: int, scale: float, offset: float
) -> Any:
    """Return the physical value of a bit pattern (uint64); NaN: not available."""
    if kind == UNSIGNED:
        raw = np.float64(bits)
    elif kind == SIGNED:
        raw = np.float64(signed_value(bits, length))
    else:
        raw = float_value(bits, kind)
    if has_na != 0 and np.int64(bits) == na:
        return np.nan
    return raw * scale + offset


@kernel
def to_physical(signals: np.ndarray, scaling: np.ndarray, s: int, bits: Any) -> Any:
    """Return the physical value of a bit pattern (uint64) of signal ``s``; NaN: not available."""
    return physical_value(
        bits,
        signals[s, S_KIND],
        signals[s, S_LENGTH],
        signals[s, S_HAS_NA],
        signals[s, S_NA],
        scaling[s, F_SCALE],
        scaling[s, F_OFFSET],
    )


@kernel
def to_pattern(
    signals: np.ndarray, scaling: np.ndarray, lists: np.ndarray, s: int, value: float
) -> Any:
    """Return the bit pattern (uint64) that is sent for a physical value, and 1 where it saturated."""
    kind = signals[s, S_KIND]
    if np.isnan(value):
        return np.uint64(signals[s, S_MISSING]), 0
    low = scaling[s, F_LOW]
    high = scaling[s, F_HIGH]
    raw = (value - scaling[s, F_OFFSET]) / scaling[s, F_SCALE]
    if kind >= FLOAT16:
        return _limited_float_pattern(raw, low, high, kind)
    length = signals[s, S_LENGTH]
    raw = np.rint(raw)
    saturated = 0
    if raw < low or raw > high:
        start = signals[s, S_EXTRA]
        for n in range(signals[s, S_EXTRA_COUNT]):
            if lists[start + n] == raw:
                return _integer_pattern(raw, kind, length), 0
        raw = low if raw < low else high
        saturated = 1
    bits = _integer_pattern(raw, kind, length)
    if signals[s, S_HAS_NA] != 0 and np.int64(bits) == signals[s, S_NA]:
        raw = raw - 1.0 if raw > low else raw + 1.0
        saturated = 1
        bits = _integer_pattern(raw, kind, length)
    return bits, saturated


@kernel
def _limited_float_pattern(raw: float, low: float, high: float, kind: int) -> Any:
    saturated = 0
    if raw < low:
        raw = low
        saturated = 1
    elif raw > high:
        raw = high
        saturated = 1
    if kind != FLOAT64 and not np.isinf(raw):
        # From half a step above the largest number on, rounding would give infinity.
        overflow = 65520.0 if kind == FLOAT16 else 3.4028235677973366e38
        if abs(raw) >= overflow:
            largest = 65504.0 if kind == FLOAT16 else 3.4028234663852886e38
            raw = largest if raw > 0.0 else -largest
            saturated = 1
    return float_pattern(raw, kind), saturated


@kernel
def _integer_pattern(raw: float, kind: int, length: int) -> Any:
    if kind == SIGNED:
        bits = np.uint64(np.int64(raw))
    else:
        bits = np.uint64(raw)
    return (bits << np.uint64(64 - length)) >> np.uint64(64 - length)


# The two loops below hand only scalars to what they call for every signal: a compiled function that takes
# several arrays counts references atomically, which costs ten times the conversion itself.


@kernel
def decode_signals(
    signals: np.ndarray,
    scaling: np.ndarray,
    lists: np.ndarray,
    first: int,
    count: int,
    data: np.ndarray,
    values: np.ndarray,
) -> None:
    """Write the physical values of ``count`` signals from ``first`` on; see :func:`decode`."""
    for s in range(first, first + count):
        if signals[s, S_PARENT] >= 0 and not is_active(signals, lists, s, data):
            continue
        length = signals[s, S_LENGTH]
        bits = get_bits(data, signals[s, S_BYTE], signals[s, S_BIT], signals[s, S_STEP], length)
        values[s] = physical_value(
            bits,
            signals[s, S_KIND],
            length,
            signals[s, S_HAS_NA],
            signals[s, S_NA],
            scaling[s, F_SCALE],
            scaling[s, F_OFFSET],
        )


@kernel
def encode_signals(
    signals: np.ndarray,
    scaling: np.ndarray,
    lists: np.ndarray,
    first: int,
    count: int,
    values: np.ndarray,
    data: np.ndarray,
    on_bus_values: np.ndarray,
) -> int:
    """Write ``count`` signals from ``first`` on into ``data``, which is all zero; see :func:`encode`."""
    saturations = 0
    for place in range(first, first + count):
        s = signals[place, S_ORDER]
        if signals[s, S_PARENT] >= 0 and not is_active(signals, lists, s, data):
            continue
        kind = signals[s, S_KIND]
        length = signals[s, S_LENGTH]
        scale = scaling[s, F_SCALE]
        offset = scaling[s, F_OFFSET]
        raw = np.rint((values[s] - offset) / scale)
        usual = False
        bits = np.uint64(0)
        # NaN fails the comparison too.
        if kind < FLOAT16 and scaling[s, F_LOW] <= raw <= scaling[s, F_HIGH]:
            bits = _integer_pattern(raw, kind, length)
            usual = signals[s, S_HAS_NA] == 0 or np.int64(bits) != signals[s, S_NA]
        if usual:
            on_bus_values[s] = raw * scale + offset
        else:
            bits, saturated = to_pattern(signals, scaling, lists, s, values[s])
            saturations += saturated
            on_bus_values[s] = to_physical(signals, scaling, s, bits)
        put_bits(data, signals[s, S_BYTE], signals[s, S_BIT], signals[s, S_STEP], length, bits)
    return saturations


@kernel
def decode(codec: Codec, message: int, data: np.ndarray, values: np.ndarray) -> None:
    """Write the physical values of a message's signals into the vector of all signals.

    ``data``: uint8, at least the message's length; ``values``: float64 (signals).  Of a multiplexed
    message only the selected signals are written.
    """
    row = codec.messages[message]
    if row[M_QUICK] != 0:
        word: Any = np.uint64(0)
        for n in range(row[M_LENGTH]):
            word |= np.uint64(data[n]) << np.uint64(8 * n)
        quick_values(
            codec.ranges, 0, codec.places, 0, codec.signals.shape[0], row[M_FIRST], row[M_COUNT],
            word, values, 0,
        )  # fmt: skip
        return
    decode_signals(
        codec.signals, codec.scaling, codec.lists, row[M_FIRST], row[M_COUNT], data, values
    )


@inlined_kernel
def encode(
    codec: Codec,
    message: int,
    values: np.ndarray,
    data: np.ndarray,
    on_bus_values: np.ndarray,
) -> int:
    """Write a message's bytes, and into ``on_bus_values`` what a receiver will read from them.

    ``values``, ``on_bus_values``: float64 (signals), may be the same array; ``data``: uint8, at least the
    message's length on the bus; unused bits become 0.  NaN becomes the not-available value, without one
    the initial value (NaN in floating-point signals).  Signals that a multiplexer does not select are
    left out.

    Returns:
        the number of values that were out of range and saturated.
    """
    row = codec.messages[message]
    if row[M_QUICK] != 0:
        word, unusual = quick_word(
            codec.ranges, codec.places, codec.signals.shape[0], row[M_FIRST], row[M_COUNT], values
        )  # fmt: skip
        if unusual == 0:
            quick_values(
                codec.ranges, 0, codec.places, 0, codec.signals.shape[0], row[M_FIRST],
                row[M_COUNT], word, on_bus_values, 0,
            )  # fmt: skip
            for n in range(row[M_WIRE_LENGTH]):
                data[n] = np.uint8(word & np.uint64(255))
                word >>= np.uint64(8)
            return 0
    for n in range(row[M_WIRE_LENGTH]):
        data[n] = 0
    return encode_signals(
        codec.signals,
        codec.scaling,
        codec.lists,
        row[M_FIRST],
        row[M_COUNT],
        values,
        data,
        on_bus_values,
    )
