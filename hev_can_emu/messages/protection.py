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
from hev_can_emu.messages.crc import crc_table, crc_update
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
    ``tables``: int64 (messages, 256), the CRC remainders.
    """

    layout: np.ndarray
    data_ids: np.ndarray
    tables: np.ndarray


def build_protection(specs: Sequence[ProtectionSpec | None]) -> Protection:
    """Return the table for messages with these declarations (None: unprotected), in message order."""
    count = len(specs)
    layout = np.zeros((count, P_COLUMNS), dtype=np.int64)
    data_ids = np.zeros((count, 16), dtype=np.int64)
    tables = np.zeros((count, 256), dtype=np.int64)
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
    bit: Any = first
    for n in range(count):
        mask = 1 << (bit & 7)
        byte: Any = np.int64(data[bit >> 3]) & (255 - mask)
        if (value >> n) & 1 != 0:
            byte |= mask
        data[bit >> 3] = byte
        bit += -15 if big_endian != 0 and bit & 7 == 7 else 1


@kernel
def _add_data_id(
    protection: Protection, message: int, width: int, reflected: int, crc: Any, counter: int
) -> Any:
    layout = protection.layout[message]
    table = protection.tables[message]
    if layout[P_FROM_LIST] != 0:
        return crc_update(table, width, reflected, crc, protection.data_ids[message, counter & 15])
    low = layout[P_ID] & 0xFF
    high = layout[P_ID] >> 8
    mode = layout[P_MODE]
    if mode == _ALTERNATING:
        return crc_update(table, width, reflected, crc, low if counter & 1 == 0 else high)
    crc = crc_update(table, width, reflected, crc, low)
    if mode == _LOW:
        return crc
    return crc_update(table, width, reflected, crc, 0 if mode == _NIBBLE else high)


@kernel
def _compute_crc(
    protection: Protection, message: int, data: np.ndarray, length: int, counter: int
) -> Any:
    layout = protection.layout[message]
    table = protection.tables[message]
    width = layout[P_WIDTH]
    reflected = layout[P_REFLECTED]
    crc = layout[P_INIT]
    if layout[P_POSITION] == _PREFIX:
        crc = _add_data_id(protection, message, width, reflected, crc, counter)
    own = layout[P_CRC_BYTE]
    own_end = own + (width >> 3)
    end = length if layout[P_END] < 0 else layout[P_END]
    for n in range(layout[P_FIRST], end):
        if n < own or n >= own_end:
            crc = crc_update(table, width, reflected, crc, np.int64(data[n]))
        elif layout[P_OWN_AS_ZERO] != 0:
            crc = crc_update(table, width, reflected, crc, 0)
    if layout[P_POSITION] == _SUFFIX:
        crc = _add_data_id(protection, message, width, reflected, crc, counter)
    return crc ^ layout[P_XOR]


@kernel
def protect(
    protection: Protection, message: int, data: np.ndarray, length: int, counter: int
) -> None:
    """Write ``counter`` (modulo its range), data-ID nibble and CRC into ``data[:length]``.

    Does nothing to an unprotected message.  ``data``: uint8, at least ``length`` long.
    """
    layout = protection.layout[message]
    if layout[P_ON] == 0:
        return
    counter = counter % layout[P_MODULUS]
    big_endian = layout[P_COUNTER_BIG_ENDIAN]
    write_bits(data, layout[P_COUNTER_BIT], layout[P_COUNTER_BITS], big_endian, counter)
    if layout[P_NIBBLE_BIT] >= 0:
        write_bits(data, layout[P_NIBBLE_BIT], 4, 0, (layout[P_ID] >> 8) & 0xF)
    width = layout[P_WIDTH]
    if width == 0:
        return
    crc = _compute_crc(protection, message, data, length, counter)
    own = layout[P_CRC_BYTE]
    if width == 8:
        data[own] = crc
    elif layout[P_BIG_ENDIAN] != 0:
        data[own] = crc >> 8
        data[own + 1] = crc & 0xFF
    else:
        data[own] = crc & 0xFF
        data[own + 1] = crc >> 8


@kernel
def _read_crc(layout: np.ndarray, data: np.ndarray) -> Any:
    own = layout[P_CRC_BYTE]
    received: Any = np.int64(data[own])
    if layout[P_WIDTH] == 8:
        return received
    second: Any = np.int64(data[own + 1])
    if layout[P_BIG_ENDIAN] != 0:
        return (received << 8) | second
    return received | (second << 8)


@kernel
def check(
    protection: Protection, message: int, data: np.ndarray, length: int, counter_state: np.ndarray
) -> Any:
    """Return the code of a received message and advance ``counter_state``.

    ``counter_state``: int64 (1,), the last counter taken, :data:`NEVER` before the first frame.  An
    unprotected message is always OK.
    """
    layout = protection.layout[message]
    if layout[P_ON] == 0:
        return OK
    big_endian = layout[P_COUNTER_BIG_ENDIAN]
    counter = read_bits(data, layout[P_COUNTER_BIT], layout[P_COUNTER_BITS], big_endian)
    modulus = layout[P_MODULUS]
    if counter >= modulus:
        return CRC_WRONG
    if layout[P_NIBBLE_BIT] >= 0 and (
        read_bits(data, layout[P_NIBBLE_BIT], 4, 0) != (layout[P_ID] >> 8) & 0xF
    ):
        return CRC_WRONG
    width = layout[P_WIDTH]
    if width != 0 and _read_crc(layout, data) != _compute_crc(
        protection, message, data, length, counter
    ):
        return CRC_WRONG
    last = counter_state[0]
    counter_state[0] = counter
    if last == NEVER:
        return FIRST
    if layout[P_COUNTER_BITS] == 0:
        return OK
    step = (counter - last) % modulus
    if step == 0:
        return COUNTER_REPEATED
    if step > layout[P_MAX_DELTA]:
        return COUNTER_JUMP
    return OK


@kernel
def is_accepted(code: int, mode: int) -> bool:
    """Whether a frame with this code may be used under protection mode OFF, OBSERVE or ENFORCE."""
    if code == LENGTH_WRONG:
        return False
    return mode != ENFORCE or code <= FIRST
