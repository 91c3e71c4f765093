"""Opening a python-can bus, and saying in one line why it cannot be opened.

Everything here blocks: it runs in a worker thread.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import socket
import traceback
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    import can

CONNECT_S = 3.0  #: how long a socketcand server may take to answer


class Target(NamedTuple):
    """What to open: python-can's interface, channel ('' for none) and options; the user's words."""

    interface: str
    channel: str
    options: dict[str, Any]
    spec: str


def open_target(target: Target, notices: Callable[[str], None]) -> can.BusABC:
    """Return ``target`` as an open python-can bus.

    ``notices`` gets what python-can has to say meanwhile.  Raises InputError, whatever python-can or
    the driver below it raised.
    """
    import can  # takes 0.2 s and more: only when a bus is opened by it

    with _LogAsNotices(notices):
        return _open_quietly(target, can.Bus)


def _open_quietly(target: Target, make: Callable[..., can.BusABC]) -> can.BusABC:
    options = target.options
    try:
        if target.interface == "socketcand":
            # python-can itself would spin for 10 s before it gave up.
            address = (options["host"], options["port"])
            socket.create_connection(address, timeout=CONNECT_S).close()
        bus = make(interface=target.interface, channel=target.channel or None, **options)
    except Exception as error:
        # Not only CanError: drivers raise OSError, ImportError, NameError, ValueError ...
        # A half-built bus hangs on the traceback: let it go, and complain, while that is kept off the
        # terminal.
        traceback.clear_frames(error.__traceback__)
        raise _cannot_open(target, error) from error
    if target.interface == "udp_multicast" and options.get("hop_limit") == 0:
        _pin_to_loopback(bus, target.channel)
    return bus


def _cannot_open(target: Target, error: Exception) -> InputError:
    """Return what a person needs to know of ``error``."""
    where = f"--bus {target.spec}"
    text = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    got = f"{type(error).__name__}: {text.rstrip('.')}"
    if target.interface == "socketcan":
        number = error.errno if isinstance(error, OSError) else None
        if number in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT) or not hasattr(socket, "AF_CAN"):
            hint = (
                "leave --bus out for the embedded bus, which needs none; or, as root, "
                f"modprobe vcan && ip link add dev {target.channel} type vcan"
            )
            return InputError(where, "a kernel with SocketCAN", "one without", hint)
        if number in (errno.ENODEV, errno.ENXIO):
            hint = f"ip link add dev {target.channel} type vcan && ip link set {target.channel} mtu 72 up"
            return InputError(
                where, "an existing CAN device", f"no device '{target.channel}'", hint
            )
        if number == errno.ENETDOWN:
            hint = f"ip link set {target.channel} up"
            return InputError(where, "a CAN device that is up", f"'{target.channel}' down", hint)
    if target.interface == "udp_multicast":
        hint = (
            "it needs the extra python-can[multicast], a multicast address "
            "such as 239.74.163.2, and a route: ip route add 239.0.0.0/8 dev lo"
        )
        return InputError(where, "a multicast group that can be joined", got, hint)
    if target.interface == "socketcand":
        hint = "start it first: hev-can-emu run, or socketcand"
        return InputError(where, "a socketcand server that answers", got, hint)
    hint = "are its driver and python-can's extra for it installed, and the channel right?"
    return InputError(where, "a python-can bus that opens", got, hint)


class _LogAsNotices(logging.Handler):
    """While entered, python-can's warnings become notices, not lines on the terminal."""

    def __init__(self, notices: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._tell = notices

    def emit(self, record: logging.LogRecord) -> None:
        self._tell(f"python-can: {record.getMessage()}")

    def __enter__(self) -> None:
        logging.getLogger("can").addHandler(self)

    def __exit__(self, *_: object) -> None:
        logging.getLogger("can").removeHandler(self)


def _pin_to_loopback(bus: can.BusABC, group: str) -> None:
    """Send multicast over ``lo`` alone, and hear it there; IPv6 keeps its hop limit of 0 only."""
    with (
        contextlib.suppress(OSError),
        socket.socket(fileno=os.dup(bus.fileno())) as shared,
    ):
        local = socket.inet_aton("127.0.0.1")
        address = socket.inet_aton(group)
        shared.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, address + local)
        shared.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, local)
        shared.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
