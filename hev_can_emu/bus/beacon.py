"""The UDP beacon by which ``can.detect_available_configs`` finds a socketcand server.

Sent to this machine's own loopback address only: finding a server must not need, or touch, the
network.  A beacon that nobody hears is no error.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from xml.sax.saxutils import quoteattr

BEACON_PORT = 42_000
BEACON_PERIOD_S = 2.0  #: socketcand's own is 3 s, and python-can listens for 3.1 s: leave it room


def beacon_text(host: str, port: int, channel: str) -> bytes:
    """Return the beacon's datagram for a server at ``host``:``port``."""
    return (
        f'<CANBeacon name="hev-can-emu" type="SocketCAN" description="hev-can-emu">'
        f"<URL>can://{host}:{port}</URL><Bus name={quoteattr(channel)}/></CANBeacon>"
    ).encode()


async def send_beacons(host: str, port: int, channel: str, beacon_port: int) -> None:
    """Send beacons until cancelled."""
    datagram = beacon_text(host, port, channel)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setblocking(False)
        while True:
            # Nobody listening is told as "connection refused" on the next send.
            with contextlib.suppress(OSError):
                sender.sendto(datagram, ("127.0.0.1", beacon_port))
            await asyncio.sleep(BEACON_PERIOD_S)
