"""candump's log format, exactly as can-utils writes it (``candump -L``), formatted as a matrix.

::

    (1436509052.249713) vcan0 123#1122            standard data frame
    (1436509052.249713) vcan0 12345678#1122       extended
    (1436509052.249713) vcan0 123#R4              remote, of length 4
    (1436509052.249713) vcan0 123##11122          CAN FD; the digit holds the flags (1: BRS)
    (1436509052.249713) vcan0 20000004#0000...    error frame

No direction follows: readers other than python-can's refuse its trailing ``R`` or ``T``.

One compiled loop writes the text, eight characters at a time, into a buffer that has room for the longest
lines.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel, small_kernel
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
        self._file = io.FileIO(path, "w", opener=_as_it_is)  # unbuffered
        self._text = np.empty(_CHUNK * _longest(channel), dtype=np.uint8)
        # What is called for the first time may take long: before the clock starts, not in it.
        native(write_lines, make_frames(0), epoch_ns, _words(channel), self._text)

    def begin(self) -> None:
        """Empty the file: to let go of a large one takes as long as a short run's start; raises OSError."""
        if os.fstat(self._file.fileno()).st_size > 0:
            self._file.truncate()

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


def _as_it_is(path: str, flags: int) -> int:
    """Open a file as :class:`io.FileIO` asks for it, but leave what is in it."""
    return os.open(path, flags & ~os.O_TRUNC, 0o666)


def format_candump(frames: np.ndarray, epoch_ns: int = 0, channel: str = "vcan0") -> bytes:
    """Return ``frames``, shape (n,), as candump lines; times are cut to microseconds."""
    text = np.empty(len(frames) * _longest(channel), dtype=np.uint8)
    return b"".join(bytes(piece) for piece in _pieces(frames, epoch_ns, channel, text))


def _longest(channel: str) -> int:
    """Return how many bytes a line takes at most; ``channel``: of channel 0."""
    return _LONGEST + max(len(_name(channel)), len(_name("can65535")))


def _name(channel: str) -> bytes:
    return f") {channel} ".encode()


def _words(channel: str) -> Text:
    """Return what follows the time in lines of a channel, as :func:`write_lines` takes it."""
    name = _name(channel)
    return np.frombuffer(name + bytes(-len(name) % 8), dtype=np.uint8)


def _pieces(frames: np.ndarray, epoch_ns: int, channel: str, text: Text) -> Iterator[memoryview]:
    """Yield the lines, made in ``text``, valid until the next: one piece per run of equal channels."""
    edges = np.flatnonzero(np.diff(frames["channel"])) + 1
    for run in np.split(frames, edges):
        if len(run):
            number = run["channel"][0]
            name = _words(f"can{number}" if number else channel)
            size = native(write_lines, run, epoch_ns, name, text)
            yield text[:size].data


@kernel
def write_lines(frames: np.ndarray, epoch_ns: int, name: Text, text: Text) -> int:
    """Write frames as lines into ``text``, uint8, long enough; return how many bytes that took.

    ``name``: what follows the time, uint8, filled up with zeros to whole words of eight.
    """
    at: Any = 0
    before: Any = np.int64(-1)
    seconds: Any = np.int64(-1)
    # The time as three words, of which the last ends with what the name then overwrites.
    first: Any = np.int64(0)
    middle: Any = np.int64(0)
    second: Any = np.int64(0)
    last: Any = np.int64(0)
    length_of_name: Any = 0
    for n in range(name.shape[0]):
        length_of_name += 1 if name[n] != 0 else 0
    for i in range(frames.shape[0]):
        flags = np.int64(frames[i]["flags"])
        error = flags & ERROR != 0
        remote = flags & REMOTE != 0 and not error
        fd = flags & FD != 0 and not error and not remote
        length: Any = np.int64(frames[i]["length"])
        microseconds = (np.int64(frames[i]["t_ns"]) + epoch_ns) // 1000
        if microseconds != before:
            before = microseconds
            if microseconds // 1_000_000 != seconds:
                seconds = microseconds // 1_000_000
                rest = seconds % 10_000_000_000
                # "(", seven digits; three digits, the point
                eight = _decimal(rest // 1000 % 10_000_000)
                first = (eight & ~255) | 40
                middle = (_decimal(rest % 1000 * 100_000) & 0xFF_FFFF) | 46 << 24
            digits_of = _decimal(microseconds % 1_000_000 * 100)
            second = middle | (digits_of & 0xFFFF_FFFF) << 32
            last = digits_of >> 32
        _put(text, at, first)
        _put(text, at + 8, second)
        _put(text, at + 16, last)
        at += _TIME
        for n in range(0, name.shape[0], 8):
            _put(text, at + n, _taken(name, n))
        at += length_of_name

        identifier: Any = np.int64(frames[i]["id"]) & 0x1FFF_FFFF
        if error:
            identifier = (_BUS_ERROR if identifier == 0 else identifier) | _ERROR_FLAG
        if error or flags & EXTENDED != 0:
            _put(text, at, _hexadecimal(identifier))
            at += 8
        else:
            _put(text, at, _hexadecimal(identifier << 20))
            at += 3
        text[at] = 35  # '#'
        at += 1
        if remote:
            text[at] = 82  # 'R'
            at += 1
            if length > 0:
                text[at] = 48 + min(length, 8)
                at += 1
            length = 0
        elif fd:
            text[at] = 35
            text[at + 1] = 49 if flags & BRS != 0 else 48
            at += 2
        elif error:
            length = _ERROR_LENGTH
        length = min(length, _MOST_DATA)
        data = frames[i]["data"]
        for n in range(0, length, 4):
            word: Any = np.int64(0)
            for k in range(4):
                word = word << 8 | np.int64(data[np.uint64(n + k)])
            _put(text, at + 2 * n, _hexadecimal(np.int64(0) if error else word))
        at += 2 * length
        text[at] = 10
        at += 1
    return int(at)


@small_kernel
def _put(text: Text, at: int, word: Any) -> None:
    """Write eight characters, the lowest byte first: one store, once it is compiled."""
    for n in range(8):
        text[np.uint64(at + n)] = (word >> (8 * n)) & 255


@small_kernel
def _taken(text: Text, at: int) -> Any:
    """Return eight characters as :func:`_put` writes them."""
    word: Any = np.int64(0)
    for n in range(8):
        word |= np.int64(text[np.uint64(at + n)]) << (8 * n)
    return word


@small_kernel
def _hexadecimal(value: Any) -> Any:
    """Return eight hexadecimal digits of 32 bits as characters, the highest in the lowest byte.

    All digits at a time: halves change places until each byte has one, then 48 is added, or 55 beyond 9.
    """
    word: Any = (value >> 16 & 0xFFFF) | (value & 0xFFFF) << 32
    word = (word >> 8 & 0xFF_0000_00FF) | (word & 0xFF_0000_00FF) << 16
    word = (word >> 4 & 0xF_000F_000F_000F) | (word & 0xF_000F_000F_000F) << 8
    beyond = (word + 0x0606_0606_0606_0606) >> 4 & 0x0101_0101_0101_0101
    return word + 0x3030_3030_3030_3030 + beyond * 7


@small_kernel
def _decimal(value: Any) -> Any:
    """Return eight decimal digits as characters, the highest in the lowest byte.

    The value is split into halves of four digits, quarters of two, and digits, all at a time: a
    division is a multiplication with 2**n / divisor, exact for numbers this small.
    """
    word: Any = value // 10_000 | value % 10_000 << 32
    quotient = (word * 10_486 >> 20) & 0x7F_0000_007F
    word = quotient | (word - quotient * 100) << 16
    quotient = (word * 103 >> 10) & 0xF_000F_000F_000F
    word = quotient | (word - quotient * 10) << 8
    return word + 0x3030_3030_3030_3030
