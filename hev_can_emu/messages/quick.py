"""The usual case, many signals at a time: integer signals of messages of up to 8 bytes.

Vector instructions (of :mod:`.word_vectors`, or loops without a branch that the compiler turns into such):
values to bit patterns, patterns into the message's 64-bit word, and back.  Whatever is out of the ordinary (a
value out of range, one that would become the not-available pattern) is counted only: encoding then goes
the long way, :func:`hev_can_emu.messages.codec.encode_signals`, for that message.

Rounding: adding 1.5 * 2**52 to a number below 2**51 rounds it to the nearest integer, ties to even, and
leaves that integer in the low bits of the sum, in two's complement.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hev_can_emu.jit import BOUNDS_CHECKED, JIT_DISABLED, before_compiling, inlined_kernel, kernel
from hev_can_emu.messages.columns import (
    F_HIGH,
    F_LOW,
    F_OFFSET,
    F_SCALE,
    S_BIT,
    S_BYTE,
    S_HAS_NA,
    S_KIND,
    S_LENGTH,
    S_MISSING,
    S_NA,
    S_STEP,
)
from hev_can_emu.messages.definitions import MessageDef
from hev_can_emu.messages.raw import SIGNED

# Rows of ranges (float64, flat), one place per signal in each.
Q_SCALE, Q_OFFSET, Q_LOW, Q_HIGH = range(4)
Q_MISSING = 4  # what a receiver reads where NaN was sent
Q_ZERO = 5  # subtracted from a pattern that was made a number, see quick_values
Q_ROWS = 6

# Rows of places (uint64, flat).
B_MASK = 0
B_NA = 1  # pattern; one that no value has where there is none
B_MISSING = 2  # pattern that NaN is sent as
B_SHIFT = 3  # to the signal's place in the word
B_BIG = 4  # all ones: the word is read big-endian
B_PATTERN = 5  # scratch: the patterns just made, at their places
B_SIGN = 6  # the sign's bit, 0 for none
B_ROWS = 7

NOT_QUICK, LITTLE, BIG, MIXED = range(4)  #: how a message's word is put together

_LONGEST = 51
ROUNDER = 6755399441055744.0  # 1.5 * 2**52
HIGH_BITS = 0x4330000000000000  # of the float64 2**52, whose low bits count in ones
_ALL = (1 << 64) - 1


def word_order(message: MessageDef) -> int:
    """Return how the kernels below put a message together; NOT_QUICK where they cannot."""
    if message.length > 8 or any(
        signal.multiplexer is not None or signal.is_float or signal.length > _LONGEST
        for signal in message.signals
    ):
        return NOT_QUICK
    little = {signal.little_endian for signal in message.signals}
    return MIXED if len(little) > 1 else BIG if little == {False} else LITTLE


def build_quick(signals: np.ndarray, scaling: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ``ranges`` and ``places``, row after row, from the codec's other tables."""
    count = signals.shape[0]
    ranges = np.zeros((Q_ROWS, count))
    places = np.zeros((B_ROWS, count), dtype=np.uint64)
    for row, column in ((Q_SCALE, F_SCALE), (Q_OFFSET, F_OFFSET), (Q_LOW, F_LOW), (Q_HIGH, F_HIGH)):
        ranges[row] = scaling[:, column]
    for s in range(count):
        length = int(signals[s, S_LENGTH])
        mask = (1 << length) - 1
        has_na = signals[s, S_HAS_NA] != 0
        missing = int(signals[s, S_MISSING]) & mask
        negative = signals[s, S_KIND] == SIGNED and missing >> (length - 1) == 1
        raw = missing - (1 << length) if negative else missing
        ranges[Q_MISSING, s] = (
            np.nan if has_na else raw * scaling[s, F_SCALE] + scaling[s, F_OFFSET]
        )
        byte, bit = int(signals[s, S_BYTE]), int(signals[s, S_BIT])
        big = signals[s, S_STEP] < 0
        places[B_MASK, s] = mask
        places[B_NA, s] = int(signals[s, S_NA]) & mask if has_na else _ALL
        places[B_MISSING, s] = missing
        if byte < 8:
            places[B_SHIFT, s] = 8 * (7 - byte if big else byte) + bit
        places[B_BIG, s] = _ALL if big else 0
        sign = 1 << (length - 1) if signals[s, S_KIND] == SIGNED and length <= _LONGEST else 0
        places[B_SIGN, s] = sign
        ranges[Q_ZERO, s] = 2.0**52 + sign
    return ranges.ravel(), places.ravel()


@kernel
def _make_patterns(
    scale: np.ndarray,
    offset: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    received: np.ndarray,
    mask: np.ndarray,
    forbidden: np.ndarray,
    instead: np.ndarray,
    shift: np.ndarray,
    given: np.ndarray,
    patterns: np.ndarray,
    seen: np.ndarray,
) -> Any:
    unusual: Any = np.int64(0)
    for n in range(given.shape[0]):
        value = given[n]
        shifted = (value - offset[n]) / scale[n] + ROUNDER
        raw = shifted - ROUNDER
        pattern = np.float64(shifted).view(np.uint64) & mask[n]
        unusual += np.int64(raw < low[n]) + np.int64(raw > high[n])
        unusual += np.int64(pattern == forbidden[n])
        # Both are read whichever is taken: a branch would keep the loop from being turned into vectors.
        other, other_value = instead[n], received[n]
        usual_value = raw * scale[n] + offset[n]
        missing = value != value  # NaN
        pattern = other if missing else pattern
        patterns[n] = pattern << shift[n]
        seen[n] = other_value if missing else usual_value
    return unusual


@kernel
def quick_patterns(
    ranges: np.ndarray,
    at_ranges: int,
    places: np.ndarray,
    at_places: int,
    stride: int,
    first: int,
    count: int,
    values: np.ndarray,
    at_values: int,
    on_bus_values: np.ndarray,
    at_on_bus: int,
) -> Any:
    """Make the patterns of ``count`` signals from ``first`` on; return how many are out of the ordinary.

    Each array may be part of a longer one, from its ``at_...`` on; ``stride`` is the number of signals.
    ``values``, ``on_bus_values``: float64 (signals), see :func:`hev_can_emu.messages.codec.encode`.
    """
    # Slices, so that all indices below are plain counts: else nothing is turned into vectors.
    at = at_ranges + first
    scale = ranges[at : at + count]
    offset = ranges[at + Q_OFFSET * stride : at + Q_OFFSET * stride + count]
    low = ranges[at + Q_LOW * stride : at + Q_LOW * stride + count]
    high = ranges[at + Q_HIGH * stride : at + Q_HIGH * stride + count]
    received = ranges[at + Q_MISSING * stride : at + Q_MISSING * stride + count]
    at = at_places + first
    mask = places[at : at + count]
    forbidden = places[at + B_NA * stride : at + B_NA * stride + count]
    instead = places[at + B_MISSING * stride : at + B_MISSING * stride + count]
    shift = places[at + B_SHIFT * stride : at + B_SHIFT * stride + count]
    patterns = places[at + B_PATTERN * stride : at + B_PATTERN * stride + count]
    given = values[at_values + first : at_values + first + count]
    seen = on_bus_values[at_on_bus + first : at_on_bus + first + count]
    return _make_patterns(
        scale, offset, low, high, received, mask, forbidden, instead, shift, given, patterns, seen
    )


def quick_word(
    ranges: np.ndarray, places: np.ndarray, stride: int, first: int, count: int, values: np.ndarray
) -> Any:
    """Return a message's 64-bit word, little-endian, and how many values are out of the ordinary.

    For one message at a time.  For the arrays see :func:`quick_patterns`; they start with signal 0.
    """
    step = np.uint64(stride)
    at = np.uint64(first)
    word: Any = np.uint64(0)
    big_word: Any = np.uint64(0)
    unusual: Any = np.int64(0)
    for n in range(count):
        i = at + np.uint64(n)
        value = values[i]
        offset = ranges[i + np.uint64(Q_OFFSET) * step]
        shifted = (value - offset) / ranges[i] + ROUNDER
        raw = shifted - ROUNDER
        pattern = np.float64(shifted).view(np.uint64) & places[i]
        outside = raw < ranges[i + np.uint64(Q_LOW) * step]
        outside |= raw > ranges[i + np.uint64(Q_HIGH) * step]
        unusual += np.int64(outside or pattern == places[i + np.uint64(B_NA) * step])
        if value != value:  # NaN
            pattern = places[i + np.uint64(B_MISSING) * step]
        placed = pattern << places[i + np.uint64(B_SHIFT) * step]
        big = places[i + np.uint64(B_BIG) * step]
        big_word |= placed & big
        word |= placed & ~big
    return word | swap_bytes(big_word), unusual


@kernel
def join(
    places: np.ndarray, at_places: int, stride: int, first: int, count: int, order: int
) -> Any:
    """Return the 64-bit word, little-endian, of a message whose patterns were just made."""
    start = np.uint64(at_places + B_PATTERN * stride + first)
    word: Any = np.uint64(0)
    if order == MIXED:
        bigs = np.uint64(at_places + B_BIG * stride + first)
        little: Any = np.uint64(0)
        for n in range(count):
            placed = places[start + np.uint64(n)]
            word |= placed & places[bigs + np.uint64(n)]
            little |= placed & ~places[bigs + np.uint64(n)]
        return little | swap_bytes(word)
    for n in range(count):
        word |= places[start + np.uint64(n)]
    return swap_bytes(word) if order == BIG else word


def quick_values(
    ranges: np.ndarray,
    at_ranges: int,
    places: np.ndarray,
    at_places: int,
    stride: int,
    first: int,
    count: int,
    word: Any,
    values: np.ndarray,
    at_values: int,
) -> Any:
    """Write the physical values of a message's signals from its 64-bit word, little-endian.

    A pattern with its sign bit turned over, put into the low bits of 2**52, is a float64 that exceeds
    the raw value by 2**52 and the sign bit's weight.

    Returns:
        How many signals lie outside their declared range.  Not-available values are no such case;
        labelled ones count.
    """
    step = np.uint64(stride)
    numbers = np.uint64(at_ranges + first)
    masks = np.uint64(at_places + first)
    taken = np.uint64(at_values + first)
    swapped = swap_bytes(word)
    beyond: Any = np.int64(0)
    for n in range(count):
        i = np.uint64(n)
        number, mask = numbers + i, masks + i
        big = places[mask + np.uint64(B_BIG) * step]
        source = (swapped & big) | (word & ~big)
        pattern = (source >> places[mask + np.uint64(B_SHIFT) * step]) & places[mask]
        lifted = (pattern ^ places[mask + np.uint64(B_SIGN) * step]) | np.uint64(HIGH_BITS)
        raw = np.uint64(lifted).view(np.float64) - ranges[number + np.uint64(Q_ZERO) * step]
        value = raw * ranges[number] + ranges[number + np.uint64(Q_OFFSET) * step]
        missing = pattern == places[mask + np.uint64(B_NA) * step]
        values[taken + i] = np.nan if missing else value
        outside = raw < ranges[number + np.uint64(Q_LOW) * step]
        outside |= raw > ranges[number + np.uint64(Q_HIGH) * step]
        beyond += np.int64(outside and not missing)
    return beyond


@kernel
def swap_bytes(word: Any) -> Any:
    """Return a uint64 with its bytes in the other order."""
    odd = np.uint64(0x00FF00FF00FF00FF)
    word = ((word & odd) << np.uint64(8)) | ((word >> np.uint64(8)) & odd)
    pairs = np.uint64(0x0000FFFF0000FFFF)
    word = ((word & pairs) << np.uint64(16)) | ((word >> np.uint64(16)) & pairs)
    return (word << np.uint64(32)) | (word >> np.uint64(32))


def show_signals(
    source: np.ndarray, target: np.ndarray, seen_ns: np.ndarray, first: int, count: int, t_ns: int
) -> None:
    """Copy the values of ``count`` signals from ``first`` on, and note the time at which they were seen."""
    for s in range(first, first + count):
        target[s] = source[s]
        seen_ns[s] = t_ns


def reached(times: np.ndarray, start: int, t_ns: int) -> Any:
    """Return, as bits, which of eight times from ``start`` on are not after ``t_ns``."""
    bits: Any = np.int64(0)
    for n in range(8):
        if times[start + n] <= t_ns:
            bits |= 1 << n
    return bits


def lowest(bits: int) -> Any:
    """Return the number of the lowest bit that is set; one is."""
    n: Any = np.int64(0)
    while (bits >> n) & 1 == 0:
        n += 1
    return n


def _compile_vectors() -> None:
    import hev_can_emu.messages.word_vectors  # noqa: F401


if BOUNDS_CHECKED:
    quick_word, quick_values = inlined_kernel(quick_word), inlined_kernel(quick_values)
    show_signals, reached = inlined_kernel(show_signals), inlined_kernel(reached)
    lowest = inlined_kernel(lowest)
elif not JIT_DISABLED:
    before_compiling(_compile_vectors)
