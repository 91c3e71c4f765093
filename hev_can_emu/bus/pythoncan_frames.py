"""Frames to and from python-can's messages, and the error numbers in its exceptions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hev_can_emu.bus.socketcand_protocol import UNFIT
from hev_can_emu.messages.frame import BRS, ERROR, EXTENDED, FD, REMOTE

if TYPE_CHECKING:
    import can


def unfit(interface: str, flags: int) -> str:
    """Return why ``interface`` cannot carry a frame with ``flags``, or ''.

    python-can's socketcand would send such a frame as rubbish, for which a server may close.
    """
    return UNFIT if interface == "socketcand" and flags & (FD | REMOTE | ERROR) else ""


def to_message(make: type[can.Message], can_id: int, flags: int, data: bytes) -> can.Message:
    """Return a frame as ``make``, python-can's Message."""
    return make(
        arbitration_id=can_id,
        is_extended_id=bool(flags & EXTENDED),
        is_remote_frame=bool(flags & REMOTE),
        is_error_frame=bool(flags & ERROR),
        is_fd=bool(flags & FD),
        bitrate_switch=bool(flags & BRS),
        dlc=len(data),
        data=None if flags & REMOTE else data,
    )


def flags_of(message: can.Message) -> int:
    """Return our flags of a python-can message."""
    return (
        (EXTENDED if message.is_extended_id else 0)
        | (REMOTE if message.is_remote_frame else 0)
        | (ERROR if message.is_error_frame else 0)
        | (FD if message.is_fd else 0)
        | (BRS if message.bitrate_switch else 0)
    )


def error_number(error: BaseException) -> int | None:
    """Return the errno of an OSError or of python-can's wrapper around one."""
    if isinstance(error, OSError):
        return error.errno
    code = getattr(error, "error_code", None)
    return code if isinstance(code, int) else None
