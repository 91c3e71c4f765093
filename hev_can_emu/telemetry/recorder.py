"""Recording of bus frames to files that other tools open, off the tick and without loss.

The tick hands over copies; one thread formats and writes them a few times a second.  When the
thread falls behind by more than ``BACKLOG_FRAMES``, as it can in virtual time, the caller waits for it:
a recording has no gaps.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, cast

import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError, StateError, did_you_mean
from hev_can_emu.messages.frame_copy import join_frames, lasting_frames

if TYPE_CHECKING:
    from hev_can_emu.telemetry.table import Network
    from hev_can_emu.telemetry.table_file import RowFile

FLUSH_S = 0.5  #: the file is complete up to this long ago, even if the process is killed
PARQUET_FLUSH_S = 2.0  #: the same for Parquet, whose parts are costly
WAKE_FRAMES = 4096  #: a backlog of this many frames wakes the thread before its time
BACKLOG_FRAMES = 1 << 18  #: frames (20 MB) waiting at most
CHANNEL = "vcan0"


class FrameFile(Protocol):
    """One file format; used from the recorder's thread alone, but for its construction.

    Where it has a method ``begin``, that is called first.
    """

    def write(self, frames: np.ndarray) -> None:
        """Append frames; raises OSError."""

    def flush(self) -> None:
        """Hand everything to the operating system, readable as it stands; raises OSError."""

    def close(self) -> None:
        """Complete and close the file; raises OSError."""


Maker = Callable[[Path, int, str], FrameFile]


def _in(module: str, name: str) -> Callable[..., Any]:
    """Return what makes files of a class, whose module is imported with the first of them."""

    def make(*arguments: Any) -> Any:
        found = importlib.import_module(f"{__package__}.{module}")
        return getattr(found, name)(*arguments)

    return make


FORMATS: dict[str, Maker] = {
    ".log": _in("candump", "CandumpWriter"),
    ".blf": _in("vector", "BlfFile"),
    ".asc": _in("vector", "AscFile"),
    ".mf4": _in("mf4", "Mf4File"),
}
"""File ending to format: called with path, Unix time at time zero in ns, and channel name."""

TABLES: dict[str, tuple[Callable[[Path, Network], RowFile], float]] = {
    ".csv": (_in("csv_table", "CsvFile"), FLUSH_S),
    ".parquet": (_in("parquet_table", "ParquetFile"), PARQUET_FLUSH_S),
}
"""The same for decoded signals: called with path and network; and how often they are flushed, s."""

ENDINGS = (*FORMATS, *TABLES)


class TruthSamples(NamedTuple):
    """The plant at some instants: int64 (n,) and float64 (n, quantities)."""

    t_ns: npt.NDArray[np.int64]
    values: npt.NDArray[np.float64]


class RecorderCounters(NamedTuple):
    """What became of the frames.

    ``written``: frames handed over.  ``waited``: how often the caller had to wait for the disk.
    ``flushed``: frames that a killed process would leave behind (in tables all but the last instant's).
    """

    written: int
    waited: int
    flushed: int


def open_recorder(
    path: str | Path,
    *,
    epoch_ns: int = 0,
    channel: str = CHANNEL,
    network: Network | None = None,
) -> Recorder:
    """Return a recorder into a new file whose format follows from its ending.

    Args:
        path: ``.log`` (candump), ``.blf`` or ``.asc`` (Vector), ``.mf4`` (ASAM); decoded signals:
            ``.csv``, ``.parquet``.
        epoch_ns: Unix time, in ns, at which the frames' time is zero; tables count from zero.
        channel: name of channel 0 in formats that name channels.
        network: what the frames mean; needed for decoded signals.

    Raises InputError if the ending is unknown or the file cannot be created.
    """
    path = check_path(path)
    ending = path.suffix.lower()
    try:
        if ending in FORMATS:
            return Recorder(path, FORMATS[ending](path, epoch_ns, channel))
        if network is None:
            raise ValueError(f"{path}: decoded signals need a network")
        from hev_can_emu.telemetry.table_file import TableFile

        make, flush_s = TABLES[ending]
        return Recorder(path, TableFile(make(path, network), network, flush_s))
    except OSError as error:
        raise InputError(f"--record {path}", "a writable file", f"{error.strerror}") from error


def check_path(path: str | Path) -> Path:
    """Return the path if a recording could go there; raises InputError.  Touches nothing."""
    path = Path(path)
    check_ending(path.suffix, f"--record {path}")
    if not path.parent.is_dir():
        hint = f"mkdir -p '{path.parent}'"
        raise InputError(f"--record {path}", "an existing folder", f"'{path.parent}'", hint)
    return path


def check_ending(ending: str, where: str = "--record") -> None:
    """Raise InputError where no format has this file ending."""
    if ending.lower() not in ENDINGS:
        known = ", ".join(ENDINGS)
        got = f"'{ending}'" if ending else "none"
        hint = did_you_mean(ending, ENDINGS) if ending else ""
        raise InputError(where, f"a file ending of {known}", got, hint)


class Recorder:
    """Frames in, a file out.  Made by :func:`open_recorder`; close it, or use it by ``with``."""

    def __init__(self, path: Path, file: FrameFile) -> None:
        self.path = path
        self._file = file
        self._begin: Callable[[], None] = getattr(file, "begin", lambda: None)
        self._truth = getattr(file, "write_truth", None)
        self._flush_s: float = getattr(file, "flush_s", FLUSH_S)
        self._batches: deque[np.ndarray | TruthSamples] = deque()
        self._backlog = 0
        self._wake_at = min(WAKE_FRAMES, BACKLOG_FRAMES)
        self._written = 0
        self._waited = 0
        self._flushed = 0
        self._failure: Exception | None = None
        self._closing = False
        self._work = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"record {path.name}", daemon=True)
        self._thread.start()

    def write(self, frames: np.ndarray, count: int) -> None:
        """Record ``frames[:count]`` (copied unless they last).  Returns in microseconds unless far behind.

        Frames with the flag SENT are marked as transmitted where the format can tell.  Raises
        InputError once the file can no longer be written (disk full); StateError when closed.
        """
        if count > 0:
            self._put(lasting_frames(frames[:count]), count)
        elif self._failure is not None:
            raise self._failed() from self._failure

    @property
    def takes_truth(self) -> bool:
        """Whether the format has a place for the plant's truth."""
        return self._truth is not None

    def write_truth(self, t_ns: int, truth: npt.NDArray[np.float64]) -> None:
        """Record one sample of the plant's truth (copied) where the format has a place for it."""
        if self._truth is not None:
            stamp = np.array([t_ns], dtype=np.int64)
            self._put(TruthSamples(stamp, truth[np.newaxis].copy()), 1)

    def _put(self, batch: np.ndarray | TruthSamples, count: int) -> None:
        if self._failure is not None:
            raise self._failed() from self._failure
        with self._work:
            if self._closing:
                raise StateError(f"the recorder of {self.path} is closed")
            if self._backlog >= BACKLOG_FRAMES:
                self._waited += 1
                self._work.wait_for(lambda: self._backlog < BACKLOG_FRAMES)
            self._batches.append(batch)
            self._backlog += count
            if not isinstance(batch, TruthSamples):
                self._written += count
            if self._backlog >= self._wake_at:
                self._work.notify_all()

    @property
    def counters(self) -> RecorderCounters:
        """What was handed over so far."""
        return RecorderCounters(self._written, self._waited, self._flushed)

    def close(self) -> None:
        """Write what is left and complete the file; raises InputError if that failed.  Idempotent."""
        with self._work:
            self._closing = True
            self._work.notify_all()
        self._thread.join()
        if self._failure is not None:
            raise self._failed() from self._failure

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _failed(self) -> InputError:
        assert self._failure is not None
        reason = getattr(self._failure, "strerror", None) or repr(self._failure)
        return InputError(f"--record {self.path}", "a file that can be written", reason)

    def _run(self) -> None:
        """Write until closed: the recorder's thread."""
        flushed_s, unflushed, put = 0.0, False, 0
        try:
            self._begin()
            while True:
                with self._work:
                    self._work.wait_for(
                        lambda: self._closing or self._backlog >= self._wake_at, FLUSH_S
                    )
                    closing = self._closing
                    batches = self._take()
                for batch in _joined(batches):
                    unflushed = True
                    if isinstance(batch, TruthSamples):
                        assert self._truth is not None
                        self._truth(*batch)
                    else:
                        self._file.write(batch)
                        put += len(batch)
                if closing:
                    return self._file.close()
                if unflushed and time.monotonic() - flushed_s >= 0.9 * self._flush_s:
                    self._file.flush()
                    flushed_s, unflushed = time.monotonic(), False
                    self._flushed = put
        except Exception as error:  # noqa: BLE001 - told by the next write, or by close
            self._failure = error
            with contextlib.suppress(OSError):
                self._file.close()
        finally:
            with self._work:  # nobody may wait for a thread that has ended
                self._take()

    def _take(self) -> list[np.ndarray | TruthSamples]:
        batches = list(self._batches)
        self._batches.clear()
        self._backlog = 0
        self._work.notify_all()
        return batches


def _joined(batches: list[np.ndarray | TruthSamples]) -> Iterator[np.ndarray | TruthSamples]:
    """Yield the batches in order, runs of frames as one where they are short."""
    for is_truth, run in itertools.groupby(batches, lambda batch: isinstance(batch, TruthSamples)):
        parts = list(run)
        if is_truth or len(parts) == 1 or all(len(part) > WAKE_FRAMES for part in parts):
            yield from parts
        else:
            yield join_frames(cast(list[np.ndarray], parts))
