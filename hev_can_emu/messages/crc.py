"""Cyclic redundancy checks of 8 and 16 bits by table, one byte at a time."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from hev_can_emu.jit import kernel


@functools.cache
def crc_table(width: int, polynomial: int, reflected: bool = False) -> np.ndarray:
    """Return the 256 remainders, int64, of a CRC of ``width`` bits (8 or 16).

    ``polynomial`` is written most significant bit first without its leading one, whether or not
    the bits enter reflected (Ross Williams, "A Painless Guide to CRC Error Detection Algorithms").
    """
    mask = (1 << width) - 1
    top = 1 << (width - 1)
    mirrored = int(f"{polynomial:0{width}b}"[::-1], 2)
    table = np.zeros(256, dtype=np.int64)
    for byte in range(256):
        if reflected:
            remainder = byte
            for _ in range(8):
                remainder = (remainder >> 1) ^ (mirrored if remainder & 1 else 0)
        else:
            remainder = byte << (width - 8)
            for _ in range(8):
                remainder = ((remainder << 1) ^ (polynomial if remainder & top else 0)) & mask
        table[byte] = remainder
    return table


@kernel
def crc_update(table: np.ndarray, width: int, reflected: int, crc: Any, byte: Any) -> Any:
    """Return the remainder after one more byte; ``table`` from :func:`crc_table`."""
    if reflected != 0:
        return (crc >> 8) ^ table[(crc ^ byte) & 0xFF]
    mask = (1 << width) - 1
    return ((crc << 8) & mask) ^ table[((crc >> (width - 8)) ^ byte) & 0xFF]
