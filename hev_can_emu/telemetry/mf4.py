"""ASAM MDF 4 bus logging (``.mf4``), written as the run goes.

asammdf lays out an empty file: channel groups, sources and names as ASAM's bus logging has them
(``CAN_DataFrame``, ``CAN_ErrorFrame``, ``CAN_RemoteFrame``; source type and bus type CAN).  It writes
measurements only as a whole, which a killed process would lose; so records are appended here: each
batch as a data block behind the others, chained by data lists, and the number of records put in last.
The file is whole after each batch.

asammdf is an optional dependency (extra ``mf4``), imported when such a file is opened: it takes up to
a second.
"""

from __future__ import annotations

import os
import struct
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError
from hev_can_emu.messages.frame import BRS, ERROR, EXTENDED, FD, REMOTE, SENT

_NAMES = ("CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame")
_SIZES = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64])  # bytes per DLC

# Links in blocks of an MDF 4 file: behind a header of 24 bytes, 8 bytes each.
_GROUP_DATA = 24 + 2 * 8  # of a DG block: its data
_GROUP_CYCLES = 24 + 6 * 8 + 8  # of a CG block: number of records, behind links and record id
_LIST_NEXT = 24  # of a DL block: the next one
_LIST = struct.Struct("<4sIQQQQB3xIQ")  # DL: id, 0, length, links, next, data, flags, count, offset
_DATA = struct.Struct("<4sIQQ")  # DT: id, 0, length, links


def _layout(name: str) -> np.dtype[np.void]:
    fields: list[Any] = [("BusChannel", "u1"), ("ID", "<u4"), ("IDE", "u1"), ("DLC", "u1")]
    fields += [("DataLength", "u1")]
    if name != "CAN_RemoteFrame":
        fields += [("DataBytes", "u1", (64,))]
    fields += [("Dir", "u1")]
    if name != "CAN_RemoteFrame":
        fields += [("EDL", "u1"), ("BRS", "u1"), ("ESI", "u1")]
    return np.dtype([(f"{name}.{field[0]}", *field[1:]) for field in fields])


class _Group(NamedTuple):
    """Where a channel group's blocks are: byte offsets in the file."""

    name: str
    record: np.dtype[np.void]  # time, then the frame
    data_group: int
    channel_group: int


class Mf4File:
    """A ``.mf4`` file.

    Args:
        path: of the new file.
        epoch_ns: Unix time, in ns, at the frames' time zero: the file's start.
        channel: not told by this format, which numbers channels.

    Raises:
        InputError: asammdf is not installed.
    """

    def __init__(self, path: Path, epoch_ns: int, channel: str) -> None:
        template, self._groups = _template(path, epoch_ns)
        self._file: BinaryIO = path.open("w+b", buffering=0)
        self._put(0, template)
        self._end = len(template)
        self._cycles = dict.fromkeys(_NAMES, 0)
        self._links = {group.name: group.data_group + _GROUP_DATA for group in self._groups}

    def write(self, frames: npt.NDArray[np.void]) -> None:
        """Append frames; raises OSError."""
        flags = frames["flags"]
        error = (flags & ERROR) != 0
        remote = ((flags & REMOTE) != 0) & ~error
        for group, chosen in zip(self._groups, (~error & ~remote, error, remote), strict=True):
            if chosen.any():
                self._append(group, _records(group, frames[chosen]))

    def flush(self) -> None:
        """Do nothing: the file is unbuffered, and whole after each write."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _append(self, group: _Group, records: npt.NDArray[np.void]) -> None:
        """Write a data block and its list behind all, then link it, then count it."""
        content = records.tobytes()
        data_at = self._end
        list_at = data_at + -(-(_DATA.size + len(content)) // 8) * 8
        before = self._cycles[group.name] * group.record.itemsize
        self._put(data_at, _DATA.pack(b"##DT", 0, _DATA.size + len(content), 0) + content)
        chained = _LIST.pack(b"##DL", 0, _LIST.size, 2, 0, data_at, 0, 1, before)
        self._put(list_at, chained)
        self._end = list_at + _LIST.size
        self._put(self._links[group.name], struct.pack("<Q", list_at))
        self._links[group.name] = list_at + _LIST_NEXT
        self._cycles[group.name] += len(records)
        count = struct.pack("<Q", self._cycles[group.name])
        self._put(group.channel_group + _GROUP_CYCLES, count)

    def _put(self, at: int, content: bytes) -> None:
        self._file.seek(at)
        view = memoryview(content)
        while view:
            view = view[self._file.write(view) or 0 :]


def _records(group: _Group, frames: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """Return frames as a channel group's records."""
    records = np.zeros(len(frames), dtype=group.record)
    flags, length = frames["flags"], frames["length"]
    name = group.name
    records["time"] = frames["t_ns"] * 1e-9
    records[f"{name}.BusChannel"] = frames["channel"]
    records[f"{name}.ID"] = frames["id"]
    records[f"{name}.IDE"] = (flags & EXTENDED) != 0
    records[f"{name}.Dir"] = (flags & SENT) != 0
    if name == "CAN_RemoteFrame":
        records[f"{name}.DLC"] = np.minimum(length, 8)
        return records
    records[f"{name}.DLC"] = np.searchsorted(_SIZES, length)
    records[f"{name}.DataLength"] = length
    records[f"{name}.DataBytes"] = frames["data"]
    records[f"{name}.EDL"] = (flags & FD) != 0
    records[f"{name}.BRS"] = (flags & BRS) != 0
    return records


def _template(path: Path, epoch_ns: int) -> tuple[bytes, list[_Group]]:
    """Return a file without records, and where its groups are."""
    try:
        from asammdf import MDF, Signal
        from asammdf.blocks.v4_blocks import SourceInformation
        from asammdf.blocks.v4_constants import BUS_TYPE_CAN, SOURCE_BUS
    except ImportError as error:
        raise InputError(
            f"--record {path}", "the package asammdf", "none installed", HINT
        ) from error
    start = datetime.fromtimestamp(epoch_ns // 1_000_000_000, UTC)
    made = MDF(version="4.10")
    made.header.start_time = start + timedelta(microseconds=epoch_ns % 1_000_000_000 // 1000)
    for name in _NAMES:
        made.append(
            Signal(
                name=name,
                samples=np.array([], dtype=_layout(name)),
                timestamps=np.array([], dtype="<f8"),
                source=SourceInformation(source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN),
            )
        )
    import tempfile  # what a recording need not import

    with tempfile.TemporaryDirectory() as folder:
        saved = made.save(os.path.join(folder, "empty.mf4"), compression=0)
        made.close()
        content = Path(saved).read_bytes()
        read: Any = MDF(saved)
        groups = [
            _Group(
                name,
                np.dtype([("time", "<f8"), *_layout(name).descr]),
                int(group.data_group.address),
                int(group.channel_group.address),
            )
            for name, group in zip(_NAMES, read.groups, strict=True)
        ]
        for group, found in zip(groups, read.groups, strict=True):
            if found.channel_group.samples_byte_nr != group.record.itemsize:
                raise AssertionError(f"asammdf lays {group.name} out in another way")
        read.close()
    return content + bytes(-len(content) % 8), groups


HINT = "pip install 'hev-can-emu[mf4]'"
