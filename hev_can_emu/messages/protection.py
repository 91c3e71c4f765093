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

from hev_can_emu.jit import inlined_kernel, kernel, small_kernel, uncompiled
from hev_can_emu.messages import word_protection as words
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
    ``tables``: uint16 (messages, 256), the CRC remainders: a quarter of the cache that int64 would take;
    ``words``: int64 (messages, word_protection.G_COLUMNS), for messages that are one 64-bit word, and
    ``remainders``: uint16, what bytes add to their CRCs.
    """

    layout: np.ndarray
    data_ids: np.ndarray
    tables: np.ndarray
    words: np.ndarray
    remainders: np.ndarray


def build_protection(
    specs: Sequence[ProtectionSpec | None], lengths: Sequence[int] | None = None
) -> Protection:
    """Return the table for messages with these declarations (None: unprotected), in message order.

    ``lengths``: of the messages, in bytes; those of up to 8 are then treated as words, which is faster.
    """
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
    rows = np.zeros((count, words.G_COLUMNS), dtype=np.int64)
    remainders = words.Remainders()
    for row, (spec, length) in enumerate(zip(specs, lengths or [], strict=lengths is not None)):
        if spec is not None and length <= 8:
            rows[row] = _word_row(spec, length, remainders, layout, data_ids, tables, row)
    return Protection(layout, data_ids, tables, rows, remainders.flat())


def _word_row(
    spec: ProtectionSpec,
    length: int,
    remainders: words.Remainders,
    layout: np.ndarray,
    data_ids: np.ndarray,
    tables: np.ndarray,
    message: int,
) -> np.ndarray:
    """Return a message's row for :mod:`.word_protection`, zeros where it is not possible."""
    row = np.zeros(words.G_COLUMNS, dtype=np.int64)
    crc, bits = spec.effective_crc, spec.counter_bits
    if not words.is_one_field(spec.counter_bit, bits, spec.is_counter_big_endian):
        return row
    own = range(spec.crc_bit // 8, spec.crc_bit // 8 + crc.width // 8)
    end = crc.last_byte + 1 if crc.last_byte >= 0 else length
    covered = [n for n in range(crc.first_byte, end) if crc.own_as_zero or n not in own]
    chosen_by_counter = layout[message, P_FROM_LIST] != 0
    ids = 1 if chosen_by_counter or layout[message, P_MODE] in (_ALTERNATING, _LOW) else 2
    counter_mask, crc_mask = (1 << bits) - 1, (1 << crc.width) - 1
    nibble_mask = 0xF << spec.nibble_bit if spec.sends_nibble else 0
    taken = counter_mask << spec.counter_bit | nibble_mask
    row[words.G_ON] = 1
    row[words.G_COUNTER_SHIFT], row[words.G_COUNTER_MASK] = spec.counter_bit, counter_mask
    row[words.G_MODULUS], row[words.G_MAX_DELTA] = spec.counter_modulus, spec.max_delta_counter
    if spec.sends_nibble:
        row[words.G_NIBBLE] = _signed((spec.data_id >> 8 & 0xF) << spec.nibble_bit)
        row[words.G_NIBBLE_MASK] = _signed(nibble_mask)
    if crc.width:
        taken |= crc_mask << 8 * own.start
        row[words.G_CRC_SHIFT], row[words.G_CRC_MASK] = 8 * own.start, crc_mask
        row[words.G_SWAP] = crc.width == 16 and crc.big_endian
        begin = remainders.begin(crc.width, crc.polynomial, crc.reflected)
        after = ids if layout[message, P_POSITION] == _SUFFIX else 0
        row[words.G_OFFSETS : words.G_OFFSETS + 8] = words.offsets_of(covered, after, begin)
        zeros = np.zeros(8, dtype=np.uint8)
        differing = 16 if chosen_by_counter else 2 if layout[message, P_MODE] == _ALTERNATING else 1
        with uncompiled():
            starts = [
                _compute_crc(layout, data_ids, tables, message, zeros, 0, length, counter)
                for counter in range(differing)
            ]
        row[words.G_STARTS : words.G_STARTS + 16] = starts * (16 // differing)
    row[words.G_KEEP] = _signed(~taken & (1 << 64) - 1)
    return row


def _signed(word: int) -> int:
    """Return the int64 of a 64-bit pattern."""
    return word - (1 << 64) if word >> 63 else word


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
    return _in_sequence(counter, bits, modulus, layout[message, P_MAX_DELTA], counter_state)


@small_kernel
def _in_sequence(
    counter: int, bits: int, modulus: int, max_delta: int, counter_state: np.ndarray
) -> Any:
    """Return the code of an intact message from its counter, and advance ``counter_state``."""
    last = counter_state[0]
    counter_state[0] = counter
    if last == NEVER:
        return FIRST
    if bits == 0:
        return OK
    step = (counter - last) % modulus
    if step == 0:
        return COUNTER_REPEATED
    if step > max_delta:
        return COUNTER_JUMP
    return OK


@inlined_kernel
def check_word(protection: Protection, message: int, word: Any, counter_state: np.ndarray) -> Any:
    """Do what :func:`check` does to a message that is a word (uint64), with a row in ``protection.words``."""
    counter = words.word_counter(protection.words, protection.remainders, message, word)
    if counter < 0:
        return CRC_WRONG
    row = protection.words[message]
    return _in_sequence(
        counter, row[words.G_COUNTER_MASK], row[words.G_MODULUS], row[words.G_MAX_DELTA],
        counter_state,
    )  # fmt: skip


@kernel
def is_accepted(code: int, mode: int) -> bool:
    """Whether a frame with this code may be used under protection mode OFF, OBSERVE or ENFORCE."""
    if code == LENGTH_WRONG:
        return False
    return mode != ENFORCE or code <= FIRST
