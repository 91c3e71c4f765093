"""A database as the tables that the codec's kernels read: where each signal lies, its range, its codes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hev_can_emu.messages.columns import (
    F_COLUMNS,
    M_COLUMNS,
    M_GUARD_COUNT,
    M_GUARDS,
    S_BIT,
    S_BYTE,
    S_COLUMNS,
    S_EXTRA,
    S_EXTRA_COUNT,
    S_HAS_NA,
    S_INITIAL,
    S_KIND,
    S_LENGTH,
    S_MISSING,
    S_NA,
    S_ORDER,
    S_PARENT,
    S_PROTECTED,
    S_RANGE_COUNT,
    S_RANGES,
    S_STEP,
)
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.definitions import SignalDef
from hev_can_emu.messages.frame import BRS, EXTENDED, FD
from hev_can_emu.messages.quick import build_quick, word_order
from hev_can_emu.messages.raw import (
    FLOAT16,
    FLOAT32,
    FLOAT64,
    SIGNED,
    UNSIGNED,
    float_pattern,
)

#: cantools lets a value pass its limits by this part of the factor.
_TOLERANCE = 1e-6


class Codec(NamedTuple):
    """The tables of a database.

    ``keys``: int64, sorted identifiers (bit 29 set: extended), ``key_messages``: int64, their messages;
    ``messages``: int64 (messages, M_COLUMNS); ``signals``: int64 (signals, S_COLUMNS);
    ``scaling``: float64 (signals, F_COLUMNS); ``lists``: int64, ranges and labelled values; ``ranges`` and
    ``places``: what :mod:`hev_can_emu.messages.quick` reads, and its scratch row.
    """

    keys: np.ndarray
    key_messages: np.ndarray
    messages: np.ndarray
    signals: np.ndarray
    scaling: np.ndarray
    lists: np.ndarray
    ranges: np.ndarray
    places: np.ndarray


def build_codec(database: Database) -> Codec:
    """Return the tables of a database."""
    messages = np.zeros((len(database.messages), M_COLUMNS), dtype=np.int64)
    signals = np.zeros((len(database.signals), S_COLUMNS), dtype=np.int64)
    scaling = np.zeros((len(database.signals), F_COLUMNS), dtype=np.float64)
    lists: list[int] = [0]  # never empty, so that its type is known
    keys: list[tuple[int, int]] = []
    first = 0
    for message in database.messages:
        flags = EXTENDED * message.extended | FD * message.fd | BRS * message.brs
        messages[message.index] = [
            message.can_id,
            flags,
            message.length,
            message.wire_length,
            first,
            len(message.signals),
            word_order(message),
            0,
            0,
        ]
        keys.append((message.can_id | int(message.extended) << 29, message.index))
        by_name = {signal.name: signal for signal in message.signals}
        protected = message.protection.bits() if message.protection else frozenset[int]()
        for signal in message.signals:
            _fill_signal(signal, by_name, signals[signal.index], scaling[signal.index], lists)
            signals[signal.index, S_PROTECTED] = not protected.isdisjoint(signal.bits())
        guards = [s.index for s in message.signals if signals[s.index, S_PROTECTED] != 0]
        messages[message.index, M_GUARDS] = len(lists)
        messages[message.index, M_GUARD_COUNT] = len(guards)
        lists += guards
        order = sorted(message.signals, key=lambda signal: _depth(signal, by_name))
        for place, signal in enumerate(order):
            signals[first + place, S_ORDER] = signal.index
        first += len(message.signals)
    keys.sort()
    ranges, places = build_quick(signals, scaling)
    return Codec(
        keys=np.array([key for key, _ in keys], dtype=np.int64),
        key_messages=np.array([index for _, index in keys], dtype=np.int64),
        messages=messages,
        signals=signals,
        scaling=scaling,
        lists=np.array(lists, dtype=np.int64),
        ranges=ranges,
        places=places,
    )


def _depth(signal: SignalDef, by_name: dict[str, SignalDef]) -> int:
    depth = 0
    while signal.multiplexer is not None and depth <= len(by_name):
        signal = by_name[signal.multiplexer]
        depth += 1
    return depth


def signal_kind(signal: SignalDef) -> int:
    """Return UNSIGNED, SIGNED, FLOAT16, FLOAT32 or FLOAT64."""
    if signal.is_float:
        return {16: FLOAT16, 32: FLOAT32, 64: FLOAT64}[signal.length]
    return SIGNED if signal.signed else UNSIGNED


def _fill_signal(
    signal: SignalDef,
    by_name: dict[str, SignalDef],
    row: np.ndarray,
    scale_row: np.ndarray,
    lists: list[int],
) -> None:
    if signal.little_endian:
        lowest, step = signal.start, 1
    else:
        # DBC's big-endian start is the most significant bit; walk down to the least.
        last = 8 * (signal.start // 8) + 7 - signal.start % 8 + signal.length - 1
        lowest, step = 8 * (last // 8) + 7 - last % 8, -1
    row[S_BYTE], row[S_BIT], row[S_STEP] = lowest // 8, lowest % 8, step
    row[S_LENGTH] = signal.length
    row[S_KIND] = kind = signal_kind(signal)
    low, high = raw_limits(signal)
    scale_row[:] = [float(signal.scale), float(signal.offset), low, high]
    row[S_HAS_NA] = signal.not_available is not None
    row[S_NA] = _int64(_pattern(signal.not_available or 0, kind, signal.length))
    row[S_INITIAL] = _int64(_pattern(_initial(signal), kind, signal.length))
    if signal.not_available is not None:
        row[S_MISSING] = row[S_NA]
    elif signal.is_float and not signal.constant:
        row[S_MISSING] = _int64(_pattern(math.nan, kind, signal.length))
    else:
        row[S_MISSING] = row[S_INITIAL]
    row[S_PARENT] = by_name[signal.multiplexer].index if signal.multiplexer else -1
    row[S_RANGES], row[S_RANGE_COUNT] = len(lists), len(signal.multiplexer_ranges)
    for start, end in signal.multiplexer_ranges:
        lists += [start, end]
    row[S_EXTRA] = len(lists)
    if not signal.is_float:
        lists += [
            raw
            for raw in signal.labels
            if not low <= raw <= high
            and signal.raw_range[0] <= raw <= signal.raw_range[1]
            and abs(raw) < 1 << 53
            and raw != signal.not_available
        ]
    row[S_EXTRA_COUNT] = len(lists) - row[S_EXTRA]


def raw_limits(signal: SignalDef) -> tuple[float, float]:
    """Return the smallest and largest raw value to send: the declared range, as far as it can be encoded.

    The not-available value at either end of an integer's range is left out; one inside is stepped over
    when encoding.
    """
    low, high = -math.inf, math.inf
    ends: list[float] = []
    for limit, sign in ((signal.minimum, -1), (signal.maximum, 1)):
        if limit is None:
            ends.append(sign * math.inf * (1 if signal.scale > 0 else -1))
        else:
            tolerated = limit + sign * abs(signal.scale) * _TOLERANCE
            ends.append((tolerated - signal.offset) / signal.scale)
    if min(ends) <= max(ends) and not (
        signal.minimum is not None
        and signal.maximum is not None
        and signal.minimum > signal.maximum
    ):
        low, high = min(ends), max(ends)
    if signal.is_float:
        return low, high
    smallest, largest = signal.raw_range
    if signal.not_available == largest:
        largest -= 1
    elif signal.not_available == smallest:
        smallest += 1
    low = max(float(np.rint(low)), float(smallest))
    high = min(float(np.rint(high)), _float_below(largest))
    if low > high:  # a declared range that no raw value meets binds nothing
        return float(smallest), _float_below(largest)
    return low, high


def _float_below(value: int) -> float:
    """Return the largest double that does not exceed an integer."""
    nearest = float(value)
    return nearest if int(nearest) <= value else math.nextafter(nearest, -math.inf)


def _initial(signal: SignalDef) -> float:
    raw = 0 if signal.initial is None else signal.initial
    if signal.is_float:
        return raw
    return max(signal.raw_range[0], min(signal.raw_range[1], int(raw)))


def _pattern(raw: float, kind: int, length: int) -> int:
    if kind in (SIGNED, UNSIGNED):
        return int(raw) & ((1 << length) - 1)
    return int(float_pattern(float(raw), kind))


def _int64(pattern: int) -> int:
    return pattern - (1 << 64) if pattern >= 1 << 63 else pattern
