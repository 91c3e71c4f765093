"""The embedded bus: a socketcand-protocol server that any python-can program on the machine joins.

It needs no kernel CAN, no root and no plug-in.  Every client, and the emulator itself, is a node:
what one sends, all others receive, in order and without loss; nobody hears itself.

A client that does not read is dropped once its buffer is full: a bus must not wait for one node.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import socket
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from hev_can_emu.bus import socketcand_protocol as protocol
from hev_can_emu.bus.beacon import BEACON_PORT, send_beacons
from hev_can_emu.bus.port import RECORD, Bus, make_medium
from hev_can_emu.bus.socketcand_client import Client
from hev_can_emu.bus.wire_parts import Timing
from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.bus.medium import Port, Receiver

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 29_536
CHANNEL = "vcan0"  #: the name told to clients; any name is accepted, all mean the same bus
CLIENT_BUFFER_BYTES = 1 << 20
"""What a client may leave unread, about 16,000 frames, before it is dropped."""
CLOSE_S = 1.0  #: on closing, clients get this long to take what is still buffered


class SocketcandBus(Bus):
    """The server, and the emulator's own node on it.

    Args:
        now_ns: the clock that stamps received frames.
        host, port: where to listen; port 0 takes any free one, told by :attr:`port`.
        epoch_ns: added to the clock's time in the frames that clients see.
        beacon: announce the server on this machine's loopback.
        beacon_port: where listeners for beacons listen.
        client_buffer: bytes that a client may leave unread.
        timing: bit rates, for a bus that takes its time as CAN does; None for delivery at once.
    """

    def __init__(
        self,
        now_ns: Callable[[], int],
        host: str = DEFAULT_HOST,
        port: int = DEFAULT_PORT,
        *,
        epoch_ns: int = 0,
        beacon: bool = True,
        beacon_port: int = BEACON_PORT,
        client_buffer: int = CLIENT_BUFFER_BYTES,
        timing: Timing | None = None,
    ) -> None:
        super().__init__(now_ns)
        self.host = host
        self.port = port
        self.client_buffer = client_buffer
        self._epoch_ns = epoch_ns
        self._beacon_port = beacon_port if beacon else 0
        self._clients: list[Client] = []
        self._joined: list[Client] = []  # those past the handshake
        self._server: asyncio.Server | None = None
        self._beacon: asyncio.Task[None] | None = None
        self._all_gone = asyncio.Event()
        self._outbox: list[tuple[bytes, str]] = []  # RECORD bytes and their time stamp
        self._unfit_told = False
        self.medium = make_medium(timing, time.monotonic_ns)
        self._port: Port | None = None
        self._client_ports: dict[Client, Port] = {}

    def describe(self) -> str:
        """Return the address."""
        return f"embedded socketcand server on {self.host}:{self.port}"

    def join_hint(self) -> str:
        """Return python-can's logger command for this server."""
        return (
            f"python -m can.logger -i socketcand -c {CHANNEL} "
            f"--bus-kwargs host={self._reachable_host()} port={self.port}"
        )

    @property
    def client_count(self) -> int:
        """How many clients have joined."""
        return len(self._joined)

    def _reachable_host(self) -> str:
        return DEFAULT_HOST if self.host in ("0.0.0.0", "localhost") else self.host

    async def _open(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            # IPv4 only: python-can's client knows no other.
            self._server = await loop.create_server(
                lambda: Client(self), self.host, self.port, family=socket.AF_INET
            )
        except OSError as error:
            raise self._cannot_listen(error) from error
        self.port = self._server.sockets[0].getsockname()[1]
        if self.medium is not None:
            self._port = self._join(self.medium, "emulator")
        if not _is_loopback(self.host):
            self._notices.append(
                f"{self.describe()} is open to the network, not to this machine only"
            )
        if self._beacon_port:
            self._beacon = loop.create_task(
                send_beacons(self._reachable_host(), self.port, CHANNEL, self._beacon_port),
                name="socketcand-beacon",
            )

    def _cannot_listen(self, error: OSError) -> InputError:
        where = f"--bus socketcand:{self.host}:{self.port}"
        if error.errno == errno.EADDRINUSE:
            return InputError(
                where,
                "a free TCP port",
                f"port {self.port} in use",
                "end the program that uses it, or choose another: --bus socketcand:"
                f"{self.host}:{self.port + 1 if self.port < 65_535 else 0}"
                f" (or --bus socketcand:{self.host}:0 for any free port)",
            )
        if error.errno == errno.EACCES:
            return InputError(
                where, "a port open to users", f"{error.strerror}", "use one above 1023"
            )
        return InputError(
            where,
            "an address of this machine",
            f"'{self.host}' ({error.strerror})",
            "e.g. 127.0.0.1",
        )

    async def _close(self) -> None:
        if self._beacon is not None:
            self._beacon.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._beacon
            self._beacon = None
        if self._server is not None:
            self._server.close()
            self._server = None
        self._write_outbox()
        if self.medium is not None:
            self.medium.stop()
        for client in list(self._clients):
            client.finish()
        if self._clients:
            self._all_gone.clear()
            try:
                async with asyncio.timeout(CLOSE_S):
                    await self._all_gone.wait()
            except TimeoutError:
                for client in list(self._clients):
                    client.abort()

    def _send(self, raw: bytes, count: int) -> None:
        if self._port is not None and self.medium is not None:
            self._put_on_wire(raw, count)
            return
        # Sockets are written once the caller's turn on the loop is over, all its frames at once.
        if not self._outbox:
            asyncio.get_running_loop().call_soon(self._write_outbox)
        self._outbox.append((raw, self._stamp()))
        self._sent += count

    def _put_on_wire(self, raw: bytes, count: int) -> None:
        assert self._port is not None
        assert self.medium is not None
        fit, unfit = protocol.sort_out(raw)
        self._sent += count
        if unfit:
            self._tell_unfit(unfit)
        self._port.send(fit)
        self.medium.pump_in_time()

    def _hand_to(self, client: Client) -> Receiver:
        """Return what writes frames that the wire has carried to ``client``."""

        def write(record: bytes, t_ns: int) -> None:
            assert self.medium is not None
            stamp_ns = self._epoch_ns + t_ns + self._now_ns() - self.medium.now_ns()
            text, _ = protocol.format_frames(record, protocol.format_stamp(stamp_ns))
            client.deliver(text)

        return write

    def _write_outbox(self) -> None:
        """Write what was sent since the last turn of the loop: once to each client."""
        texts = []
        for raw, stamp in self._outbox:
            text, unfit = protocol.format_frames(raw, stamp)
            texts.append(text)
            if unfit:
                self._tell_unfit(unfit)
        self._outbox.clear()
        if joined := b"".join(texts):
            for client in list(self._joined):
                client.deliver(joined)

    def _tell_unfit(self, count: int) -> None:
        self._sent -= count
        self._errors += count
        if not self._unfit_told:
            self._unfit_told = True
            self._notices.append(protocol.UNFIT)

    def _stamp(self) -> str:
        return protocol.format_stamp(self._epoch_ns + self._now_ns())

    # -- called by clients ----------------------------------------------------------------------

    def attach(self, client: Client) -> None:
        """Know ``client`` from its connection on."""
        self._clients.append(client)

    def join(self, client: Client) -> None:
        """Let ``client`` receive from now on."""
        self._write_outbox()
        self._joined.append(client)
        if self.medium is not None:
            self._client_ports[client] = self.medium.join(client.name, self._hand_to(client))
        self._notices.append(f"{client.name} joined")

    def detach(self, client: Client) -> None:
        """Forget ``client``, whose connection has ended."""
        self._clients.remove(client)
        if client in self._joined:
            self._part(client)
            self._notices.append(f"{client.name} left")
        if not self._clients:
            self._all_gone.set()

    def expel(self, client: Client, reason: str) -> None:
        """Send nothing more to ``client``, whose connection is being closed for ``reason``."""
        self._errors += 1
        if client in self._joined:
            self._part(client)
        self._notices.append(f"{client.name} disconnected: {reason}")

    def _part(self, client: Client) -> None:
        """Let ``client`` receive and send no more."""
        self._joined.remove(client)
        if client in self._client_ports:
            self._client_ports.pop(client).leave()

    def relay(self, sender: Client, frames: list[protocol.Send]) -> None:
        """Carry what ``sender`` sent to every other node."""
        if self.medium is not None:
            if sender in self._client_ports:
                records = [RECORD.pack(0, i, f, len(d), 0, d) for i, f, d in frames]
                self._client_ports[sender].send(b"".join(records))
                self.medium.pump_in_time()
            return
        self._write_outbox()  # one order of frames for all
        for can_id, flags, data in frames:
            self._accept(can_id, flags, data)
        if len(self._joined) > 1:
            stamp = self._stamp()
            text = "".join([protocol.format_frame(*frame, stamp) for frame in frames]).encode()
            for client in list(self._joined):
                if client is not sender:
                    client.deliver(text)

    def refuse(self, client: Client, reason: str, *, tell: bool) -> None:
        """Count, and tell, a frame or command that cannot be served."""
        self._errors += 1
        if tell:
            self._notices.append(f"{client.name}: {reason.replace('-', ' ')}")

    def keep_pace(
        self, client: Client, element: protocol.Lockstep | protocol.Done
    ) -> protocol.Refusal | protocol.ProtocolError | None:
        """Refuse: this server's time waits for nobody."""
        return protocol.Refusal("lockstep-refused:this-server-keeps-wall-time")


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
