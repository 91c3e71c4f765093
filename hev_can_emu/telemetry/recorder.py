"""Recording of bus frames to files that other tools open, off the tick and without loss.

The tick hands over copies; one thread formats and writes them a few times a second.  When the
thread falls behind by more than ``BACKLOG_FRAMES``, as it can in virtual time, the caller waits for it:
a recording has no gaps.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, Self

import numpy as np

from hev_can_emu.errors import InputError, StateError, did_you_mean
from hev_can_emu.telemetry.candump import CandumpWriter
from hev_can_emu.telemetry.vector import AscFile, BlfFile

FLUSH_S = 0.5  #: the file is complete up to this long ago, even if the process is killed
WAKE_FRAMES = 4096  #: a backlog of this many frames wakes the thread before its time
BACKLOG_FRAMES = 1 << 18  #: frames (20 MB) waiting at most
CHANNEL = "vcan0"


class FrameFile(Protocol):
    """One file format; used from the recorder's thread alone, but for its construction."""

    def write(self, frames: np.ndarray) -> None:
        """Append frames; raises OSError."""

    def flush(self) -> None:
        """Hand everything to the operating system, readable as it stands; raises OSError."""

    def close(self) -> None:
        """Complete and close the file; raises OSError."""


Maker = Callable[[Path, int, str], FrameFile]

FORMATS: dict[str, Maker] = {".log": CandumpWriter, ".blf": BlfFile, ".asc": AscFile}
"""File ending to format: called with path, Unix time at time zero in ns, and channel name."""


class RecorderCounters(NamedTuple):
    """``written``: frames handed over.  ``waited``: how often the caller had to wait for the disk."""

    written: int
    waited: int


def open_recorder(path: str | Path, *, epoch_ns: int = 0, channel: str = CHANNEL) -> Recorder:
    """Return a recorder into a new file whose format follows from its ending.

    Args:
        path: ``.log`` (candump), ``.blf`` or ``.asc`` (Vector).
        epoch_ns: Unix time, in ns, at which the frames' time is zero.
        channel: name of channel 0 in formats that name channels.

    Raises InputError if the ending is unknown or the file cannot be created.
    """
    path = check_path(path)
    try:
        return Recorder(path, FORMATS[path.suffix.lower()](path, epoch_ns, channel))
    except OSError as error:
        raise InputError(f"--record {path}", "a writable file", f"{error.strerror}") from error


def check_path(path: str | Path) -> Path:
    """Return the path if a recording could go there; raises InputError.  Touches nothing."""
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in FORMATS:
        known = ", ".join(FORMATS)
        got = f"'{path.suffix}'" if path.suffix else "none"
        hint = did_you_mean(ending, FORMATS) if ending else ""
        raise InputError(f"--record {path}", f"a file ending of {known}", got, hint)
    if not path.parent.is_dir():
        hint = f"mkdir -p '{path.parent}'"
        raise InputError(f"--record {path}", "an existing folder", f"'{path.parent}'", hint)
    return path


class Recorder:
    """Frames in, a file out.  Made by :func:`open_recorder`; close it, or use it by ``with``."""

    def __init__(self, path: Path, file: FrameFile) -> None:
        self.path = path
        self._file = file
        self._batches: deque[np.ndarray] = deque()
        self._backlog = 0
        self._wake_at = min(WAKE_FRAMES, BACKLOG_FRAMES)
        self._written = 0
        self._waited = 0
        self._failure: Exception | None = None
        self._closing = False
        self._work = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=f"record {path.name}", daemon=True)
        self._thread.start()

    def write(self, frames: np.ndarray, count: int) -> None:
        """Record ``frames[:count]`` (copied).  Returns in microseconds unless far behind.

        Frames with the flag SENT are marked as transmitted where the format can tell.  Raises
        InputError once the file can no longer be written (disk full); StateError when closed.
        """
        if self._failure is not None:
            raise self._failed() from self._failure
        if count <= 0:
            return
        batch = frames[:count].copy()
        with self._work:
            if self._closing:
                raise StateError(f"the recorder of {self.path} is closed")
            if self._backlog >= BACKLOG_FRAMES:
                self._waited += 1
                self._work.wait_for(lambda: self._backlog < BACKLOG_FRAMES)
            self._batches.append(batch)
            self._backlog += count
            self._written += count
            if self._backlog >= self._wake_at:
                self._work.notify_all()

    @property
    def counters(self) -> RecorderCounters:
        """What was handed over so far."""
        return RecorderCounters(self._written, self._waited)

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
        try:
            while True:
                with self._work:
                    self._work.wait_for(
                        lambda: self._closing or self._backlog >= self._wake_at, FLUSH_S
                    )
                    closing = self._closing
                    batches = self._take()
                if batches:
                    self._file.write(np.concatenate(batches) if len(batches) > 1 else batches[0])
                    self._file.flush()
                if closing:
                    return self._file.close()
        except Exception as error:  # noqa: BLE001 - told by the next write, or by close
            self._failure = error
            with contextlib.suppress(OSError):
                self._file.close()
        finally:
            with self._work:  # nobody may wait for a thread that has ended
                self._take()

    def _take(self) -> list[np.ndarray]:
        batches = list(self._batches)
        self._batches.clear()
        self._backlog = 0
        self._work.notify_all()
        return batches
