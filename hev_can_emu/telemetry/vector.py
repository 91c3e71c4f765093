"""Vector's log formats, BLF and ASC, through python-can's writers.

python-can is imported when such a file is opened, not before: it takes a fifth of a second.
"""

from __future__ import annotations

import struct
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from hev_can_emu.messages.frame import BRS, ERROR, EXTENDED, FD, REMOTE, SENT

_RECORD = struct.Struct("=qIBBH64s")  # one frame of FRAME: t_ns, id, flags, length, channel, data


class _VectorFile:
    """What both formats share: frames become python-can messages, one by one."""

    def __init__(self, writer: Any, epoch_ns: int) -> None:
        self._writer = writer
        self._epoch_ns = epoch_ns

    def write(self, frames: np.ndarray) -> None:
        """Append frames; raises OSError."""
        import can

        make, put, epoch_ns = can.Message, self._writer.on_message_received, self._epoch_ns
        for t_ns, can_id, flags, length, channel, data in _RECORD.iter_unpack(frames.tobytes()):
            remote = bool(flags & REMOTE)
            message = make(
                timestamp=(epoch_ns + t_ns) / 1e9,
                arbitration_id=can_id,
                is_extended_id=bool(flags & EXTENDED),
                is_remote_frame=remote,
                is_error_frame=bool(flags & ERROR),
                is_fd=bool(flags & FD),
                bitrate_switch=bool(flags & BRS),
                is_rx=not flags & SENT,
                channel=channel,
                dlc=length,
                data=None if remote else data[:length],
            )
            put(message)

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._writer.file.flush()

    def close(self) -> None:
        """Complete and close the file."""
        self._writer.stop()


class BlfFile(_VectorFile):
    """A ``.blf`` file; times are UTC and have 1 ns steps, of which python-can keeps about 200."""

    def __init__(self, path: Path, epoch_ns: int, channel: str) -> None:
        from can import BLFWriter

        super().__init__(BLFWriter(path), epoch_ns)

    def flush(self) -> None:
        """Write the open container and a header that counts it.

        BLFWriter does both only when it stops: a killed process would leave a file without its last
        128 KiB and without start time.
        """
        writer = self._writer
        writer._flush()
        end = writer.file.tell()
        writer.file.seek(0)
        writer._write_header(end)
        writer.file.seek(end)
        super().flush()


class AscFile(_VectorFile):
    """A ``.asc`` file; its dates are local time, as CANoe reads them."""

    def __init__(self, path: Path, epoch_ns: int, channel: str) -> None:
        from can import ASCWriter

        class Writer(ASCWriter):
            """Writes the date's milliseconds with leading zeros: .005 as .5 shifts all times."""

            def _format_header_datetime(self, dt: datetime) -> str:
                return dt.strftime(f"%a %b %d %H:%M:%S.{dt.microsecond // 1000:03d} %Y")

        super().__init__(Writer(path), epoch_ns)
