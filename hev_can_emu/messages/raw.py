"""Bits of a frame to raw values and back: any byte order, 1 to 64 bits, IEEE 754 of 16, 32 and 64 bits.

A bit pattern is a uint64.  Mixed signed and unsigned arithmetic turns into floating point in Numba, so
every constant beside a pattern is a uint64 too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hev_can_emu.jit import kernel

UNSIGNED = 0
SIGNED = 1
FLOAT16 = 2
FLOAT32 = 3
FLOAT64 = 4


@kernel
def get_bits(data: np.ndarray, byte: int, bit: int, step: int, length: int) -> Any:
    """Return ``length`` bits upward from ``bit`` of ``byte``; ``step`` leads to the byte of higher bits."""
    pattern = np.uint64(data[byte]) >> np.uint64(bit)
    have = 8 - bit
    while have < length:
        byte += step
        pattern |= np.uint64(data[byte]) << np.uint64(have)
        have += 8
    unused = np.uint64(64 - length)
    return (pattern << unused) >> unused


@kernel
def put_bits(data: np.ndarray, byte: int, bit: int, step: int, length: int, pattern: Any) -> None:
    """Set ``length`` bits, all zero before, to ``pattern``, which has no bits beyond them."""
    data[byte] |= np.uint8((pattern << np.uint64(bit)) & np.uint64(255))
    have = 8 - bit
    while have < length:
        byte += step
        data[byte] |= np.uint8((pattern >> np.uint64(have)) & np.uint64(255))
        have += 8


@kernel
def signed_value(pattern: Any, length: int) -> Any:
    """Return the two's complement value (int64) of a pattern."""
    shift = 64 - length
    return np.int64(pattern << np.uint64(shift)) >> np.int64(shift)


@kernel
def float_value(pattern: Any, kind: int) -> Any:
    """Return the number that an IEEE 754 pattern stands for, as float64."""
    if kind == FLOAT64:
        return np.uint64(pattern).view(np.float64)
    if kind == FLOAT32:
        return np.float64(np.uint32(pattern).view(np.float32))
    half = np.int64(pattern)
    exponent = (half >> 10) & 0x1F
    fraction = np.float64(half & 0x3FF)
    sign = -1.0 if half >> 15 != 0 else 1.0
    if exponent == 0x1F:
        return np.nan if fraction != 0.0 else sign * np.inf
    if exponent == 0:
        return sign * fraction * 2.0**-24
    return sign * (1024.0 + fraction) * 2.0 ** np.float64(exponent - 25)


@kernel
def float_pattern(value: float, kind: int) -> Any:
    """Return the IEEE 754 pattern nearest to a number, ties to even; too large ones become infinite."""
    if kind == FLOAT64:
        return np.uint64(np.float64(value).view(np.uint64))
    if kind == FLOAT32:
        return np.uint64(np.float32(value).view(np.uint32))
    bits = np.uint64(np.float64(value).view(np.uint64))
    sign = np.int64(bits >> np.uint64(63)) << 15
    magnitude = abs(value)
    if np.isnan(value):
        return np.uint64(0x7E00)
    if magnitude >= 65520.0:
        return np.uint64(sign | 0x7C00)
    if magnitude < 2.0**-14:
        # Subnormal: a multiple of 2^-24, exact after scaling.
        return np.uint64(sign | np.int64(np.rint(magnitude * 2.0**24)))
    exponent = (np.int64(bits >> np.uint64(52)) & 0x7FF) - 1023
    fraction = np.int64(np.rint((magnitude * 2.0 ** np.float64(-exponent) - 1.0) * 1024.0))
    # A fraction rounded up to 1024 carries into the exponent by itself.
    return np.uint64(sign | (((exponent + 15) << 10) + fraction))
