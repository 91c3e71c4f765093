"""candump's log format, exactly as can-utils writes it (``candump -L``), formatted as a matrix.

::

    (1436509052.249713) vcan0 123#1122            standard data frame
    (1436509052.249713) vcan0 12345678#1122       extended
    (1436509052.249713) vcan0 123#R4              remote, of length 4
    (1436509052.249713) vcan0 123##11122          CAN FD; the digit holds the flags (1: BRS)
    (1436509052.249713) vcan0 20000004#0000...    error frame

No direction follows: readers other than python-can's refuse its trailing ``R`` or ``T``.

One compiled loop writes the text, byte by byte, into a buffer that has room for the longest lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.messages.frame import BRS, ERROR, EXTENDED, FD, REMOTE, make_frames
from hev_can_emu.native import native

Text = npt.NDArray[np.uint8]

_ERROR_FLAG = 0x2000_0000
_BUS_ERROR = 0x80  # error class of frames that name none
_ERROR_LENGTH = 8
_MOST_DATA = 64
_TIME = 18  # bytes: a bracket, ten digits, point, six digits
_LONGEST = _TIME + 8 + 3 + 2 * _MOST_DATA + 1  #: bytes of a line, without the channel's name
_CHUNK = 16_384  #: frames formatted at a time: bounds memory


class CandumpWriter:
    """A ``.log`` file.

    Args:
        path: of the new file.
        epoch_ns: Unix time, in ns, at the frames' time zero.
        channel: name of channel 0; channel n of others is ``can<n>``.
    """

    def __init__(self, path: Path, epoch_ns: int, channel: str) -> None:
        self._epoch_ns = epoch_ns
        self._channel = channel
        self._file = path.open("wb", buffering=0)
        self._text = np.empty(_CHUNK * _longest(channel), dtype=np.uint8)
        # What is called for the first time may take long: before the clock starts, not in it.
        name = np.frombuffer(_name(channel), dtype=np.uint8)
        native(write_lines, make_frames(0), epoch_ns, name, self._text)

    def write(self, frames: np.ndarray) -> None:
        """Append frames; raises OSError."""
        for start in range(0, len(frames), _CHUNK):
            chunk = frames[start : start + _CHUNK]
            for view in _pieces(chunk, self._epoch_ns, self._channel, self._text):
                while view:
                    view = view[self._file.write(view) or 0 :]

    def flush(self) -> None:
        """Do nothing: the file is unbuffered."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def format_candump(frames: np.ndarray, epoch_ns: int = 0, channel: str = "vcan0") -> bytes:
    """Return ``frames``, shape (n,), as candump lines; times are cut to microseconds."""
    text = np.empty(len(frames) * _longest(channel), dtype=np.uint8)
    return b"".join(bytes(piece) for piece in _pieces(frames, epoch_ns, channel, text))


def _longest(channel: str) -> int:
    """Return how many bytes a line takes at most; ``channel``: of channel 0."""
    return _LONGEST + max(len(_name(channel)), len(_name("can65535")))


def _name(channel: str) -> bytes:
    return f") {channel} ".encode()


def _pieces(frames: np.ndarray, epoch_ns: int, channel: str, text: Text) -> Iterator[memoryview]:
    """Yield the lines, made in ``text``, valid until the next: one piece per run of equal channels."""
    edges = np.flatnonzero(np.diff(frames["channel"])) + 1
    for run in np.split(frames, edges):
        if len(run):
            number = run["channel"][0]
            name = np.frombuffer(_name(f"can{number}" if number else channel), dtype=np.uint8)
            size = native(write_lines, run, epoch_ns, name, text)
            yield text[:size].data


@kernel
def write_lines(frames: np.ndarray, epoch_ns: int, name: Text, text: Text) -> int:
    """Write frames as lines into ``text``, uint8, long enough; return how many bytes that took.

    ``name``: what follows the time, uint8.
    """
    at: Any = 0
    line: Any = 0  # where the line before began
    before: Any = np.int64(-1)
    for i in range(frames.shape[0]):
        flags = np.int64(frames[i]["flags"])
        error = flags & ERROR != 0
        remote = flags & REMOTE != 0 and not error
        fd = flags & FD != 0 and not error and not remote
        length: Any = np.int64(frames[i]["length"])
        microseconds = (np.int64(frames[i]["t_ns"]) + epoch_ns) // 1000
        if microseconds == before:
            for n in range(_TIME):
                text[at + n] = text[line + n]
        else:
            _write_time(microseconds, text, at)
            before = microseconds
        line = at
        at += _TIME
        for n in range(name.shape[0]):
            text[at + n] = name[n]
        at += name.shape[0]

        identifier: Any = np.int64(frames[i]["id"]) & 0x1FFF_FFFF
        digits = 3
        if error:
            identifier = (_BUS_ERROR if identifier == 0 else identifier) | _ERROR_FLAG
        if error or flags & EXTENDED != 0:
            digits = 8
        for n in range(digits):
            text[at + n] = _hexadecimal((identifier >> (4 * (digits - 1 - n))) & 15)
        at += digits
        text[at] = 35  # '#'
        at += 1
        if remote:
            text[at] = 82  # 'R'
            at += 1
            if length > 0:
                text[at] = _hexadecimal(min(length, 8))
                at += 1
            length = 0
        elif fd:
            text[at] = 35
            text[at + 1] = _hexadecimal(1 if flags & BRS != 0 else 0)
            at += 2
        elif error:
            length = _ERROR_LENGTH
        data = frames[i]["data"]
        for n in range(min(length, _MOST_DATA)):
            byte = np.int64(0) if error else np.int64(data[n])
            text[at] = _hexadecimal(byte >> 4)
            text[at + 1] = _hexadecimal(byte & 15)
            at += 2
        text[at] = 10
        at += 1
    return int(at)


@kernel
def _hexadecimal(digit: Any) -> Any:
    """Return the character of a hexadecimal digit, without a branch."""
    return 48 + digit + 7 * ((digit + 6) >> 4)


@kernel
def _write_time(microseconds: Any, text: Text, at: int) -> None:
    """Write ``(1436509052.249713`` at ``at``."""
    text[at] = 40
    text[at + 11] = 46
    rest: Any = microseconds % 1_000_000
    for n in range(6):
        text[at + 17 - n] = 48 + rest % 10
        rest //= 10
    rest = microseconds // 1_000_000
    for n in range(10):
        text[at + 10 - n] = 48 + rest % 10
        rest //= 10
