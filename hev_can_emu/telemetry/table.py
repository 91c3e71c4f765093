"""Frames as a table of decoded signals: a row per instant, a column per signal.

A cell is filled where a frame carried the signal at that instant, and empty where none did; NaN in a
filled cell is the signal's "not available".  So nothing is lost: rows turn back into frames, and a
forward fill gives what a receiver has at hand.  The plant's truth, where it is sampled, has columns of
its own, named ``truth.NAME``, in SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.messages.codec import Codec, decode, encode, find_message, is_active
from hev_can_emu.messages.columns import (
    M_COUNT,
    M_FIRST,
    M_FLAGS,
    M_ID,
    M_LENGTH,
    M_WIRE_LENGTH,
    S_PARENT,
)
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.frame import ERROR, EXTENDED, REMOTE, make_frames
from hev_can_emu.messages.protection import Protection, build_protection, protect

TRUTH = "truth."  #: how names of the plant's quantities begin
TIME = "time_s"  #: the first column: seconds since the run's start


class Network(NamedTuple):
    """What a table needs to know: the messages, and names and units of the plant's quantities."""

    database: Database
    codec: Codec
    truth: Sequence[str] = ()
    truth_units: Sequence[str] = ()


class Column(NamedTuple):
    """A column: its name, and its unit as the network gives it (empty: none)."""

    name: str
    unit: str


class Rows(NamedTuple):
    """Part of a table.

    ``t_ns``: int64 (rows); ``values``: float64 (rows, columns); ``filled``: bool (rows, columns).
    """

    t_ns: npt.NDArray[np.int64]
    values: npt.NDArray[np.float64]
    filled: npt.NDArray[np.bool_]

    def part(self, start: int, stop: int) -> Rows:
        """Return some of the rows (views)."""
        return Rows(self.t_ns[start:stop], self.values[start:stop], self.filled[start:stop])


def columns_of(network: Network) -> list[Column]:
    """Return the columns behind the time: all signals, then all quantities of the plant."""
    signals = [Column(signal.qualified_name, signal.unit) for signal in network.database.signals]
    units = network.truth_units or [""] * len(network.truth)
    pairs = zip(network.truth, units, strict=True)
    return signals + [Column(TRUTH + name, unit) for name, unit in pairs]


@kernel
def _fill(
    codec: Codec,
    frames: npt.NDArray[np.void],
    values: npt.NDArray[np.float64],
    filled: npt.NDArray[np.uint8],
    t_ns: npt.NDArray[np.int64],
    decoded: npt.NDArray[np.float64],
) -> Any:
    """Decode frames into rows; return how many rows.  A message seen twice begins a new row."""
    row = -1
    for i in range(frames.shape[0]):
        flags = np.int64(frames[i]["flags"])
        if flags & (REMOTE | ERROR) != 0:
            continue
        message = find_message(codec, frames[i]["id"], flags & EXTENDED)
        if message < 0 or frames[i]["length"] != codec.messages[message, M_WIRE_LENGTH]:
            continue
        first = codec.messages[message, M_FIRST]
        count = codec.messages[message, M_COUNT]
        if count == 0:
            continue
        if row < 0 or frames[i]["t_ns"] != t_ns[row] or filled[row, first] != 0:
            row += 1
            t_ns[row] = frames[i]["t_ns"]
        data = frames[i]["data"]
        decode(codec, message, data, decoded)
        for signal in range(first, first + count):
            if codec.signals[signal, S_PARENT] < 0 or is_active(
                codec.signals, codec.lists, signal, data
            ):
                values[row, signal] = decoded[signal]
                filled[row, signal] = 1
    return row + 1


def rows_of(network: Network, frames: npt.NDArray[np.void]) -> Rows:
    """Return frames, in order of time, as rows.

    Frames of unknown messages, with another length than theirs, remote and error frames have no place in
    a table.
    """
    width = len(network.database.signals) + len(network.truth)
    values = np.full((len(frames), width), np.nan)
    filled = np.zeros((len(frames), width), dtype=np.uint8)
    t_ns = np.zeros(len(frames), dtype=np.int64)
    decoded = np.full(len(network.database.signals), np.nan)
    count = int(_fill(network.codec, frames, values, filled, t_ns, decoded))
    return Rows(t_ns[:count], values[:count], filled[:count].astype(np.bool_))


def truth_rows(
    network: Network, t_ns: npt.NDArray[np.int64], truth: npt.NDArray[np.float64]
) -> Rows:
    """Return samples of the plant's truth, shape (rows, quantities), as rows."""
    signals = len(network.database.signals)
    values = np.full((len(t_ns), signals + len(network.truth)), np.nan)
    values[:, signals:] = truth
    filled = np.zeros(values.shape, dtype=np.bool_)
    filled[:, signals:] = True
    return Rows(t_ns, values, filled)


def merge(parts: Sequence[Rows]) -> Rows:
    """Return all in order of time, rows of the same instant as one where they do not collide."""
    t_ns = np.concatenate([part.t_ns for part in parts])
    order = np.argsort(t_ns, kind="stable")
    t_ns = t_ns[order]
    values = np.concatenate([part.values for part in parts])[order]
    filled = np.concatenate([part.filled for part in parts])[order]
    keep = np.ones(len(t_ns), dtype=np.bool_)
    for row in (np.flatnonzero(np.diff(t_ns) == 0) + 1).tolist():
        before = row - 1
        if not (filled[before] & filled[row]).any():
            values[row] = np.where(filled[before], values[before], values[row])
            filled[row] |= filled[before]
            keep[before] = False
    return Rows(t_ns[keep], values[keep], filled[keep])


@kernel
def _encode_rows(
    codec: Codec,
    protection: Protection,
    missing: npt.NDArray[np.uint8],
    values: npt.NDArray[np.float64],
    filled: npt.NDArray[np.bool_],
    t_ns: npt.NDArray[np.int64],
    counters: npt.NDArray[np.int64],
    frames: npt.NDArray[np.void],
    ignored: npt.NDArray[np.float64],
) -> Any:
    """Encode every message of which a row has a signal; return how many frames that made.

    ``ignored`` is scratch, as long as a row.
    """
    made = 0
    for row in range(values.shape[0]):
        for message in range(codec.messages.shape[0]):
            first = codec.messages[message, M_FIRST]
            there = False
            for signal in range(first, first + codec.messages[message, M_COUNT]):
                there = there or filled[row, signal]
            if not there:
                continue
            data = frames[made]["data"]
            encode(codec, message, values[row], data, ignored)
            if missing[message] != 0:
                length = codec.messages[message, M_LENGTH]
                protect(protection, message, data, length, counters[message])
                counters[message] += 1
            frames[made]["t_ns"] = t_ns[row]
            frames[made]["id"] = codec.messages[message, M_ID]
            frames[made]["flags"] = codec.messages[message, M_FLAGS]
            frames[made]["length"] = codec.messages[message, M_WIRE_LENGTH]
            made += 1
    return made


class RowEncoder:
    """Turns rows back into frames.

    Counter and CRC are the table's where the network has signals for them; otherwise counters run
    from 0 and CRCs are computed.
    """

    def __init__(self, network: Network) -> None:
        database = network.database
        self._codec = network.codec
        self._protection = build_protection([m.protection for m in database.messages])
        self._missing = np.zeros(len(database.messages), dtype=np.uint8)
        for message in database.messages:
            if message.protection is not None:
                covered: set[int] = set()
                covered.update(*(signal.bits() for signal in message.signals))
                self._missing[message.index] = not message.protection.bits() <= covered
        self._counters = np.zeros(len(database.messages), dtype=np.int64)

    def frames(self, rows: Rows) -> npt.NDArray[np.void]:
        """Return the frames of ``rows``, messages of one instant by their order in the database."""
        frames = make_frames(max(len(rows.t_ns) * len(self._missing), 1))
        count = _encode_rows(
            self._codec, self._protection, self._missing, rows.values, rows.filled, rows.t_ns,
            self._counters, frames, np.empty(rows.values.shape[1]),
        )  # fmt: skip
        return frames[: int(count)].copy()
