"""Counter and CRC of protected messages, sending and receiving, as one table read by two kernels.

AUTOSAR E2E profiles 1, 2, 5, 11 and 22 (Specification of SW-C End-to-End Communication Protection
Library) and a custom profile differ only in the columns below: the CRC runs over the data-ID bytes
before the data, the data without the CRC's own bytes, and the data-ID bytes after it.
docs/protection.md tells what each profile does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hev_can_emu.jit import kernel
from hev_can_emu.messages.crc import crc_table
from hev_can_emu.messages.protection_spec import DATA_ID_MODES, DATA_ID_POSITIONS, ProtectionSpec

OK = 0  #: in sequence
FIRST = 1  #: intact, and nothing seen before to compare the counter with
CRC_WRONG = 2  #: CRC or data-ID nibble wrong, or a counter beyond its range
COUNTER_REPEATED = 3  #: intact, counter as before: a frozen or repeating sender
COUNTER_JUMP = 4  #: intact, more frames lost than allowed
LENGTH_WRONG = 5  #: number of data bytes differs from the database (never decoded)

CODE_NAMES = ("ok", "first", "crc wrong", "counter repeated", "counter jump", "length wrong")

OFF = 0  #: nothing is checked
OBSERVE = 1  #: checked and told; the data is used all the same
ENFORCE = 2  #: only OK and FIRST frames are used

MODE_NAMES = ("off", "observe", "enforce")

NEVER = -1  #: counter state of a receiver that has seen no frame

# Columns of Protection.layout, one row per message.
P_WIDTH = 0  # CRC bits; 0: no CRC
P_INIT = 1
P_XOR = 2
P_REFLECTED = 3
P_BIG_ENDIAN = 4
P_CRC_BYTE = 5
P_COUNTER_BIT = 6
P_COUNTER_BITS = 7
P_MODULUS = 8
P_MAX_DELTA = 9
P_ID = 10
P_MODE = 11  # index into DATA_ID_MODES
P_POSITION = 12  # index into DATA_ID_POSITIONS
P_FROM_LIST = 13  # 1: the data ID byte comes from the list, chosen by the counter
P_NIBBLE_BIT = 14  # -1: no nibble in the frame
P_ON = 15  # 1: protected
P_COUNTER_BIG_ENDIAN = 16
P_FIRST = 17  # first byte that the CRC covers
P_END = 18  # byte after the last; -1: the message's end
P_OWN_AS_ZERO = 19  # 1: the CRC's own bytes count as zero, else they are left out
P_COLUMNS = 20

_ALTERNATING = DATA_ID_MODES.index("alternating")
_LOW = DATA_ID_MODES.index("low")
_NIBBLE = DATA_ID_MODES.index("nibble")
_PREFIX = DATA_ID_POSITIONS.index("prefix")
_SUFFIX = DATA_ID_POSITIONS.index("suffix")


class Protection(NamedTuple):
    """The protection of all messages of a database.

    ``layout``: int64 (messages, P_COLUMNS); ``data_ids``: int64 (messages, 16), the data ID lists;
    ``tables``: uint16 (messages, 256), the CRC remainders: a quarter of the cache that int64 would take.
    """

    layout: np.ndarray
    data_ids: np.ndarray
    tables: np.ndarray


def build_protection(specs: Sequence[ProtectionSpec | None]) -> Protection:
    """Return the table for messages with these declarations (None: unprotected), in message order."""
    count = len(specs)
    layout = np.zeros((count, P_COLUMNS), dtype=np.int64)
    data_ids = np.zeros((count, 16), dtype=np.int64)
    tables = np.zeros((count, 256), dtype=np.uint16)
    for row, spec in enumerate(specs):
        if spec is None:
            continue
        crc = spec.effective_crc
        layout[row] = [
            crc.width,
            crc.init,
            crc.xor,
            crc.reflected,
            crc.big_endian,
            spec.crc_bit // 8,
            spec.counter_bit,
            spec.counter_bits,
            spec.counter_modulus,
            spec.max_delta_counter,
            spec.data_id,
            DATA_ID_MODES.index(spec.data_id_mode),
            _position(spec),
            spec.profile in ("P02", "P22")
            or (spec.profile == "custom" and bool(spec.data_id_list)),
            spec.nibble_bit if spec.sends_nibble else -1,
            1,
            spec.is_counter_big_endian,
            crc.first_byte,
            crc.last_byte + 1 if crc.last_byte >= 0 else -1,
            crc.own_as_zero,
        ]
        if spec.data_id_list:
            data_ids[row] = spec.data_id_list
        if crc.width:
            tables[row] = crc_table(crc.width, crc.polynomial, crc.reflected)
    return Protection(layout, data_ids, tables)


def _position(spec: ProtectionSpec) -> Any:
    if spec.profile in ("P01", "P11"):
        return _PREFIX
    if spec.profile == "custom":
        return DATA_ID_POSITIONS.index(spec.data_id_position)
    return _SUFFIX


@kernel
def read_bits(data: np.ndarray, first: int, count: int, big_endian: int) -> Any:
    """Return ``count`` bits from bit ``first`` (``8 * byte + bit``) upward as an integer.

    Above a byte's bit 7 comes bit 0 of the next byte, of the previous one where ``big_endian``.
    """
    value: Any = 0
    bit: Any = first
    for n in range(count):
        value |= ((np.int64(data[bit >> 3]) >> (bit & 7)) & 1) << n
        bit += -15 if big_endian != 0 and bit & 7 == 7 else 1
    return value


@kernel
def write_bits(data: np.ndarray, first: int, count: int, big_endian: int, value: int) -> None:
    """Write the low ``count`` bits of ``value`` as :func:`read_bits` reads them, leaving all others."""
    if (first & 7) + count <= 8:
        field = ((1 << count) - 1) << (first & 7)
        kept: Any = np.int64(data[first >> 3]) & (255 - field)
        data[first >> 3] = kept | ((value << (first & 7)) & field)
        return
    bit: Any = first
    for n in range(count):
        mask = 1 << (bit & 7)
        byte: Any = np.int64(data[bit >> 3]) & (255 - mask)
        if (value >> n) & 1 != 0:
            byte |= mask
        data[bit >> 3] = byte
        bit += -15 if big_endian != 0 and bit & 7 == 7 else 1


@kernel
def _compute_crc(
    layout: np.ndarray,
    data_ids: np.ndarray,
    tables: np.ndarray,
    message: int,
    data: np.ndarray,
    base: int,
    length: int,
    counter: int,
) -> Any:
    """Return the CRC of ``data[base : base + length]``.

    One loop without calls or views: references that a compiled function counts cost more than the CRC.
    """
    ids: Any = 2
    first_id: Any = layout[message, P_ID] & 0xFF
    second_id: Any = layout[message, P_ID] >> 8
    mode = layout[message, P_MODE]
    if layout[message, P_FROM_LIST] != 0:
        ids, first_id = 1, data_ids[message, counter & 15]
    elif mode == _ALTERNATING:
        ids = 1
        if counter & 1 != 0:
            first_id = second_id
    elif mode == _LOW:
        ids = 1
    elif mode == _NIBBLE:
        second_id = 0
    position = layout[message, P_POSITION]
    before = ids if position == _PREFIX else 0
    after = ids if position == _SUFFIX else 0
    width = layout[message, P_WIDTH]
    reflected = layout[message, P_REFLECTED]
    shift = width - 8
    mask = (1 << width) - 1
    own = layout[message, P_CRC_BYTE]
    own_end = own + (width >> 3)
    first = layout[message, P_FIRST]
    end = length if layout[message, P_END] < 0 else layout[message, P_END]
    crc: Any = layout[message, P_INIT]
    as_zero = layout[message, P_OWN_AS_ZERO] != 0
    for n in range(first - before, end + after):
        if n < first:
            byte: Any = first_id if n == first - before else second_id
        elif n >= end:
            byte = first_id if n == end else second_id
        elif n < own or n >= own_end:
            byte = np.int64(data[base + n])
        elif as_zero:
            byte = 0
        else:
            continue
        if reflected != 0:
            crc = (crc >> 8) ^ np.int64(tables[message, (crc ^ byte) & 0xFF])
        else:
            crc = ((crc << 8) & mask) ^ np.int64(tables[message, ((crc >> shift) ^ byte) & 0xFF])
    return crc ^ layout[message, P_XOR]


@kernel
def protect(
    protection: Protection, message: int, data: np.ndarray, length: int, counter: int
) -> None:
    """Write ``counter`` (modulo its range), data-ID nibble and CRC into ``data[:length]``.

    Does nothing to an unprotected message.  ``data``: uint8, at least ``length`` long.
    """
    protect_at(
        protection.layout, protection.data_ids, protection.tables, message, data, 0, length, counter
    )


@kernel
def protect_at(
    layout: np.ndarray,
    data_ids: np.ndarray,
    tables: np.ndarray,
    message: int,
    data: np.ndarray,
    base: int,
    length: int,
    counter: int,
) -> None:
    """Do what :func:`protect` does to ``data[base : base + length]``, from the arrays themselves."""
    if layout[message, P_ON] == 0:
        return
    counter = counter % layout[message, P_MODULUS]
    bit = layout[message, P_COUNTER_BIT]
    bits = layout[message, P_COUNTER_BITS]
    big_endian = layout[message, P_COUNTER_BIG_ENDIAN]
    write_bits(data, 8 * base + bit, bits, big_endian, counter)
    if layout[message, P_NIBBLE_BIT] >= 0:
        nibble = (layout[message, P_ID] >> 8) & 0xF
        write_bits(data, 8 * base + layout[message, P_NIBBLE_BIT], 4, 0, nibble)
    width = layout[message, P_WIDTH]
    if width == 0:
        return
    crc = _compute_crc(layout, data_ids, tables, message, data, base, length, counter)
    own = base + layout[message, P_CRC_BYTE]
    if width == 8:
        data[own] = crc
    elif layout[message, P_BIG_ENDIAN] != 0:
        data[own] = crc >> 8
        data[own + 1] = crc & 0xFF
    else:
        data[own] = crc & 0xFF
        data[own + 1] = crc >> 8


@kernel
def check(
    protection: Protection, message: int, data: np.ndarray, length: int, counter_state: np.ndarray
) -> Any:
    """Return the code of a received message and advance ``counter_state``.

    ``counter_state``: int64 (1,), the last counter taken, :data:`NEVER` before the first frame.  An
    unprotected message is always OK.
    """
    layout = protection.layout
    if layout[message, P_ON] == 0:
        return OK
    bits = layout[message, P_COUNTER_BITS]
    big_endian = layout[message, P_COUNTER_BIG_ENDIAN]
    counter = read_bits(data, layout[message, P_COUNTER_BIT], bits, big_endian)
    modulus = layout[message, P_MODULUS]
    if counter >= modulus:
        return CRC_WRONG
    if layout[message, P_NIBBLE_BIT] >= 0 and (
        read_bits(data, layout[message, P_NIBBLE_BIT], 4, 0) != (layout[message, P_ID] >> 8) & 0xF
    ):
        return CRC_WRONG
    width = layout[message, P_WIDTH]
    if width != 0:
        own = layout[message, P_CRC_BYTE]
        received: Any = np.int64(data[own])
        if width == 16:
            second: Any = np.int64(data[own + 1])
            if layout[message, P_BIG_ENDIAN] != 0:
                received = (received << 8) | second
            else:
                received = received | (second << 8)
        if received != _compute_crc(
            layout, protection.data_ids, protection.tables, message, data, 0, length, counter
        ):
            return CRC_WRONG
    last = counter_state[0]
    counter_state[0] = counter
    if last == NEVER:
        return FIRST
    if bits == 0:
        return OK
    step = (counter - last) % modulus
    if step == 0:
        return COUNTER_REPEATED
    if step > layout[message, P_MAX_DELTA]:
        return COUNTER_JUMP
    return OK


@kernel
def is_accepted(code: int, mode: int) -> bool:
    """Whether a frame with this code may be used under protection mode OFF, OBSERVE or ENFORCE."""
    if code == LENGTH_WRONG:
        return False
    return mode != ENFORCE or code <= FIRST
