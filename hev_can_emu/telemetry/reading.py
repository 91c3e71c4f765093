"""Recordings read back, of every format that a recorder writes, by file ending.

Frames come through python-can's readers (imported here, when a file is read), tables of decoded
signals are encoded anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError
from hev_can_emu.messages.frame import BRS, ERROR, EXTENDED, FD, FRAME, REMOTE, SENT
from hev_can_emu.telemetry.csv_table import read_csv
from hev_can_emu.telemetry.mf4 import HINT
from hev_can_emu.telemetry.parquet_table import read_parquet
from hev_can_emu.telemetry.recorder import FORMATS, check_ending
from hev_can_emu.telemetry.table import Network, RowEncoder

_BATCH = 4096
_UNIX_NS = (
    100_000_000 * 1_000_000_000
)  #: times beyond this (1973) are dates, not times since a start
_TABLES = {".csv": read_csv, ".parquet": read_parquet}


def read_recording(path: str | Path, network: Network) -> npt.NDArray[np.void]:
    """Return all frames of a recording, FRAME records in order of time.

    Times are those since the run's start where the file has such; where it has dates, its first
    frame is at 0.

    Args:
        path: the file; its ending tells the format.
        network: what decoded signals mean; frames are taken whether it knows them or not.

    Raises:
        InputError: no such file, an unknown ending, content that cannot be read, no frame at all.
    """
    path = Path(path)
    ending = path.suffix.lower()
    check_ending(path.suffix, str(path))
    if not path.exists():
        raise InputError(str(path), "a recording", "no such file")
    try:
        parts = list(_parts(path, ending, network))
    except OSError as error:
        raise InputError(str(path), "a file that can be read", f"{error.strerror}") from error
    frames = np.concatenate(parts) if parts else np.zeros(0, dtype=FRAME)
    if not len(frames):
        raise InputError(str(path), "frames", "none")
    frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    if frames["t_ns"][0] > _UNIX_NS:
        frames["t_ns"] -= frames["t_ns"][0]
    return frames


def _parts(path: Path, ending: str, network: Network) -> Iterator[npt.NDArray[np.void]]:
    if ending in FORMATS:
        yield from _messages(path)
    else:
        encoder = RowEncoder(network)
        for rows in _TABLES[ending](path, network):
            yield encoder.frames(rows)


def _messages(path: Path) -> Iterator[npt.NDArray[np.void]]:
    """Yield the frames of a log in batches, through python-can."""
    import can

    readers: dict[str, tuple[str, Callable[[Any], Iterable[Any]]]] = {
        ".log": ("r", can.CanutilsLogReader),
        ".blf": ("rb", can.BLFReader),
        ".asc": ("r", can.ASCReader),
        ".mf4": ("rb", can.MF4Reader),
    }
    mode, make = readers[path.suffix.lower()]
    read = 0
    try:
        # Opened here: readers that meet something broken leave their file open.
        with path.open(mode) as file:
            batch: list[tuple[Any, ...]] = []
            for record in _records(make(file)):
                batch.append(record)
                read += 1
                if len(batch) == _BATCH:
                    yield np.array(batch, dtype=FRAME)
                    batch = []
            if batch:
                yield np.array(batch, dtype=FRAME)
    except NotImplementedError as error:
        raise InputError(str(path), "the package asammdf", "none installed", HINT) from error
    except OSError:
        raise
    except Exception as error:
        # Readers meet a broken file with whatever their parsing happens to raise.
        told = str(error).splitlines()[0] if str(error) else type(error).__name__
        where = f"{path}: after {read} frames" if read else str(path)
        raise InputError(where, f"a {path.suffix} recording", told) from error


def _records(messages: Iterable[Any]) -> Iterator[tuple[Any, ...]]:
    zeros = bytes(64)
    for message in messages:
        flags = (
            EXTENDED * message.is_extended_id
            | FD * message.is_fd
            | BRS * message.bitrate_switch
            | REMOTE * message.is_remote_frame
            | ERROR * message.is_error_frame
            | SENT * (not message.is_rx)
        )
        data = bytes(message.data or b"")
        yield (
            round(message.timestamp * 1e6) * 1000,  # writers cut: a tick is not to come a ns early
            message.arbitration_id,
            flags,
            message.dlc if message.is_remote_frame else len(data),
            message.channel if isinstance(message.channel, int) else 0,
            np.frombuffer(data + zeros[len(data) :], dtype=np.uint8),
        )
