"""Many messages encoded by one call, for whoever sends a set of them at once: scripts, peers, benchmarks.

The tick does the same inside its own one call (:func:`hev_can_emu.messages.transfer.transmit`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.messages.codec import build_codec, encode_signals
from hev_can_emu.messages.columns import (
    F_COLUMNS,
    M_COUNT,
    M_FIRST,
    M_FLAGS,
    M_ID,
    M_LENGTH,
    M_QUICK,
    M_WIRE_LENGTH,
    S_COLUMNS,
)
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.frame import FRAME, SENT
from hev_can_emu.messages.protection import P_COLUMNS, build_protection, protect_at
from hev_can_emu.messages.python_entry import entry
from hev_can_emu.messages.quick import join, quick_patterns

# A call from Python costs by the number of its arrays, so all lies in one int64 array: this header of places
# and counts, then what it points at.
(
    H_SIGNALS, H_MESSAGES, H_LISTS, H_ROWS, H_PROTECT,
    H_AT_TABLE, H_AT_SCALING, H_AT_LISTS, H_AT_RANGES, H_AT_PLACES, H_AT_ROWS, H_AT_COUNTERS, H_AT_LAYOUT,
    H_AT_IDS, H_AT_CRC, H_AT_VALUES, H_AT_ON_BUS, H_AT_FRAMES, H_SIZE,
) = range(19)  # fmt: skip

# Columns of a row: a message of the set, in the order of the database.
W_FIRST, W_COUNT, W_QUICK, W_LENGTH, W_INDEX, W_RUN, W_COLUMNS = range(7)

_WORDS = FRAME.itemsize // 8
_DATA_WORD = FRAME.fields["data"][1] // 8  # type: ignore[index]


@kernel
def _encode_set(block: np.ndarray) -> Any:
    numbers = block.view(np.float64)
    words = block.view(np.uint64)
    stride = block[H_SIGNALS]
    at_ranges, at_places = block[H_AT_RANGES], block[H_AT_PLACES]
    at_values, at_on_bus = block[H_AT_VALUES], block[H_AT_ON_BUS]
    row = block[H_AT_ROWS]
    frame = block[H_AT_FRAMES] + _DATA_WORD
    saturated: Any = np.int64(0)
    unusual: Any = np.int64(0)
    for i in range(block[H_ROWS]):
        first, count = block[row + W_FIRST], block[row + W_COUNT]
        run, order = block[row + W_RUN], block[row + W_QUICK]
        if run > 0:
            unusual = quick_patterns(
                numbers, at_ranges, words, at_places, stride, first, run, numbers, at_values,
                numbers, at_on_bus,
            )  # fmt: skip
        if order == 0 or (unusual != 0 and _is_unusual(block, numbers, words, first, count)):
            saturated += _encode_slowly(block, i)
        else:
            words[frame] = join(words, at_places, stride, first, count, order)
        row += W_COLUMNS
        frame += _WORDS
    if block[H_PROTECT] != 0:
        _protect_all(block)
    return saturated


@kernel
def _is_unusual(
    block: np.ndarray, numbers: np.ndarray, words: np.ndarray, first: int, count: int
) -> bool:
    """Whether one message of a run has a value that is out of the ordinary."""
    found = quick_patterns(
        numbers, block[H_AT_RANGES], words, block[H_AT_PLACES], block[H_SIGNALS], first, count,
        numbers, block[H_AT_VALUES], numbers, block[H_AT_ON_BUS],
    )  # fmt: skip
    return bool(found != 0)


@kernel
def _encode_slowly(block: np.ndarray, i: int) -> Any:
    n = block[H_SIGNALS]
    table = block[block[H_AT_TABLE] : block[H_AT_SCALING]].reshape((n, S_COLUMNS))
    scaling = block[block[H_AT_SCALING] : block[H_AT_LISTS]].view(np.float64)
    lists = block[block[H_AT_LISTS] : block[H_AT_RANGES]]
    values = block[block[H_AT_VALUES] : block[H_AT_ON_BUS]].view(np.float64)
    on_bus = block[block[H_AT_ON_BUS] : block[H_AT_FRAMES]].view(np.float64)
    row = block[block[H_AT_ROWS] + W_COLUMNS * i : block[H_AT_ROWS] + W_COLUMNS * (i + 1)]
    at = block[H_AT_FRAMES] + _WORDS * i + _DATA_WORD
    words = block[at : at + 8]
    words[:] = 0
    return encode_signals(
        table, scaling.reshape((n, F_COLUMNS)), lists, row[W_FIRST], row[W_COUNT], values,
        words.view(np.uint8), on_bus,
    )  # fmt: skip


@kernel
def _protect_all(block: np.ndarray) -> None:
    messages = block[H_MESSAGES]
    layout = block[block[H_AT_LAYOUT] : block[H_AT_IDS]].reshape((messages, P_COLUMNS))
    data_ids = block[block[H_AT_IDS] : block[H_AT_CRC]].reshape((messages, 16))
    tables = block[block[H_AT_CRC] : block[H_AT_VALUES]].reshape((messages, 256))
    data = block[block[H_AT_FRAMES] :].view(np.uint8)
    for i in range(block[H_ROWS]):
        row = block[H_AT_ROWS] + W_COLUMNS * i
        at = block[H_AT_COUNTERS] + i
        start = 8 * (_WORDS * i + _DATA_WORD)
        protect_at(
            layout, data_ids, tables, block[row + W_INDEX], data, start, block[row + W_LENGTH],
            block[at],
        )  # fmt: skip
        block[at] += 1


class TransmitSet:
    """Encodes some messages of a database, or all, by one call of ``encode()``.

    Args:
        database: the network.
        names: the messages; all of them where left out.
        protected: whether counters and CRCs are written, too; the counters advance with each call.

    Raises:
        InputError: an unknown message.

    Attributes:
        encode: encodes ``values`` into ``frames``; returns how many values were out of range and saturated.
        values: float64 (signals of the database), physical values to encode; NaN is not available.  To be
            changed in place.
        on_bus: float64 (signals), what a receiver reads from the frames (without counters and CRCs).
        frames: FRAME records in the order of the database, rewritten by each call.
    """

    def __init__(
        self, database: Database, names: Iterable[str] | None = None, protected: bool = False
    ) -> None:
        wanted = {
            database.message(name).index
            for name in ([m.name for m in database.messages] if names is None else names)
        }
        codec = build_codec(database)
        protection = build_protection([message.protection for message in database.messages])
        rows = _rows(codec.messages, sorted(wanted))
        count, signals = len(rows), codec.signals.shape[0]
        parts: list[npt.NDArray[Any]] = [
            codec.signals, codec.scaling, codec.lists, codec.ranges, codec.places, rows,
            np.zeros(count, dtype=np.int64), protection.layout, protection.data_ids,
            protection.tables.astype(np.int64),
            np.full(signals, np.nan), np.full(signals, np.nan), np.zeros(count * _WORDS, dtype=np.int64),
        ]  # fmt: skip
        starts = np.cumsum([H_SIZE, *(part.size for part in parts)])
        self._block = np.zeros(int(starts[-1]), dtype=np.int64)
        self._block[:H_AT_TABLE] = [
            signals, len(database.messages), codec.lists.size, count, int(protected),
        ]  # fmt: skip
        self._block[H_AT_TABLE:H_SIZE] = starts[:-1]
        for start, part in zip(starts, parts, strict=False):
            self._block[start : start + part.size] = np.ravel(part).view(np.int64)
        at_values, at_on_bus, at_frames = (int(start) for start in starts[-4:-1])
        self.values: npt.NDArray[np.float64] = self._block[at_values:at_on_bus].view(np.float64)
        self.on_bus: npt.NDArray[np.float64] = self._block[at_on_bus:at_frames].view(np.float64)
        self.frames: npt.NDArray[np.void] = self._block[at_frames:].view(FRAME)
        for frame, row in zip(self.frames, rows, strict=True):
            message = codec.messages[row[W_INDEX]]
            frame["id"] = message[M_ID]
            frame["flags"] = message[M_FLAGS] | SENT
            frame["length"] = message[M_WIRE_LENGTH]
        self.encode: Callable[[], int] = functools.partial(
            entry(_encode_set, self._block), self._block
        )
        self._block[starts[6] : starts[7]] = 0  # the counters, which the first call advanced
        self.on_bus[:] = np.nan


def _rows(messages: npt.NDArray[np.int64], wanted: list[int]) -> npt.NDArray[np.int64]:
    """Return the rows of a set; a run of quick messages that follow each other is begun by its first."""
    rows = np.zeros((len(wanted), W_COLUMNS), dtype=np.int64)
    start = end = -1
    for i, index in enumerate(wanted):
        message = messages[index]
        first, count = message[M_FIRST], message[M_COUNT]
        rows[i] = [first, count, message[M_QUICK], message[M_LENGTH], index, 0]
        if message[M_QUICK]:
            if first != end or start < 0:
                start = i
            rows[start, W_RUN] += count
            end = first + count
        else:
            start = end = -1
    return rows
