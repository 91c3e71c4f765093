"""Counter and CRC of messages of up to 8 bytes, in the 64-bit word that the message is.

A CRC is linear over GF(2): what a byte adds to it depends on the byte and on how many follow, not on the
others.  So eight look-ups that do not wait for each other, and a start value for what is fixed (initial
value, data ID, final exclusive or), give what :mod:`.protection` computes byte after byte.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hev_can_emu.jit import inlined_kernel, small_kernel
from hev_can_emu.messages.crc import crc_table

# Columns of the rows, one row per message; all zero: not this way.
G_ON = 0
G_KEEP = 1  # bits of the word that protection leaves alone
G_NIBBLE = 2  # the data ID's nibble, at its place
G_COUNTER_SHIFT = 3
G_COUNTER_MASK = 4
G_MODULUS = 5
G_MAX_DELTA = 6
G_CRC_SHIFT = 7
G_CRC_MASK = 8  # 0: no CRC
G_SWAP = 9  # 1: the CRC's high byte comes first
G_NIBBLE_MASK = 10
G_OFFSETS = 16  # of each byte: where its remainders begin
G_STARTS = 24  # CRC of a message of zeros, by the counter's low four bits
G_COLUMNS = 40

_FOLLOWING = 10  # bytes that may follow one: seven of data, two of the data ID


class Remainders:
    """What bytes add to a CRC, a table of 256 per polynomial and number of bytes that follow."""

    def __init__(self) -> None:
        self.tables = [np.zeros(256, dtype=np.int64)]  # of bytes that the CRC does not cover
        self._begin: dict[tuple[int, int, bool], int] = {}

    def begin(self, width: int, polynomial: int, reflected: bool) -> int:
        """Return the number of a polynomial's first table, for no byte that follows."""
        key = width, polynomial, reflected
        if key not in self._begin:
            self._begin[key] = len(self.tables)
            table = crc_table(width, polynomial, reflected)
            added = table
            for _ in range(_FOLLOWING):
                self.tables.append(added)
                if reflected:
                    added = (added >> 8) ^ table[added & 0xFF]
                else:
                    added = ((added << 8) & ((1 << width) - 1)) ^ table[added >> (width - 8)]
        return self._begin[key]

    def flat(self) -> np.ndarray:
        """Return all tables, uint16."""
        return np.concatenate(self.tables).astype(np.uint16)


def is_one_field(first: int, count: int, big_endian: bool) -> bool:
    """Return whether bits lie side by side in the little-endian word."""
    return first + count <= 64 and ((first & 7) + count <= 8 or not big_endian)


def offsets_of(covered: Sequence[int], after: int, begin: int) -> list[int]:
    """Return where each byte's remainders begin.

    Args:
        covered: the bytes that the CRC covers, in their order.
        after: bytes of the data ID that follow them.
        begin: see :meth:`Remainders.begin`.
    """
    offsets = [0] * 8
    for place, byte in enumerate(covered):
        offsets[byte] = 256 * (begin + len(covered) - 1 - place + after)
    return offsets


@small_kernel
def word_crc(
    rows: np.ndarray, remainders: np.ndarray, message: int, word: Any, counter: int
) -> Any:
    """Return the CRC of a message whose CRC's own bytes are zero in ``word`` (uint64)."""
    crc: Any = rows[message, G_STARTS + (counter & 15)]
    for n in range(8):
        byte = np.int64((word >> np.uint64(8 * n)) & np.uint64(255))
        crc ^= np.int64(remainders[rows[message, G_OFFSETS + n] + byte])
    if rows[message, G_SWAP] != 0:
        crc = ((crc & 0xFF) << 8) | (crc >> 8)
    return crc


@inlined_kernel
def protect_word(
    rows: np.ndarray, remainders: np.ndarray, message: int, word: Any, counter: int
) -> Any:
    """Return ``word`` (uint64) with counter (modulo its range), data-ID nibble and CRC in their places."""
    counter = counter % rows[message, G_MODULUS]
    field = (counter & rows[message, G_COUNTER_MASK]) << rows[message, G_COUNTER_SHIFT]
    word = (word & np.uint64(rows[message, G_KEEP])) | np.uint64(field | rows[message, G_NIBBLE])
    crc = word_crc(rows, remainders, message, word, counter)
    return word | (np.uint64(crc) << np.uint64(rows[message, G_CRC_SHIFT]))


@inlined_kernel
def word_counter(rows: np.ndarray, remainders: np.ndarray, message: int, word: Any) -> Any:
    """Return the counter of a received word (uint64); -1 where counter, nibble or CRC is wrong."""
    counter = (
        np.int64(word >> np.uint64(rows[message, G_COUNTER_SHIFT]))
        & (rows[message, G_COUNTER_MASK])
    )
    if counter >= rows[message, G_MODULUS]:
        return np.int64(-1)
    nibble = np.int64(word & np.uint64(rows[message, G_NIBBLE_MASK]))
    if nibble != rows[message, G_NIBBLE]:
        return np.int64(-1)
    mask, shift = np.uint64(rows[message, G_CRC_MASK]), np.uint64(rows[message, G_CRC_SHIFT])
    received = np.int64((word >> shift) & mask)
    if mask != 0 and received != word_crc(
        rows, remainders, message, word & ~(mask << shift), counter
    ):
        return np.int64(-1)
    return counter
