"""One client's connection to the embedded server: handshake, hold, then frames both ways."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from typing import Protocol

from hev_can_emu.bus import socketcand_protocol as protocol

KERNEL_BUFFER_BYTES = 1 << 18
"""The kernel's own buffer of a client, bounded lest it hide for minutes that nobody reads."""
HOLD_S = 0.03
"""Frames wait this long after a client's rawmode.  python-can compares one whole ``recv`` with
``< ok >``: a frame that arrives in the same segment ends its connection."""

_QUICKACK = getattr(socket, "TCP_QUICKACK", None)  # Linux only


class Hub(Protocol):
    """What a connection tells the server."""

    @property
    def client_buffer(self) -> int:
        """Bytes that a client may leave unread."""

    def attach(self, client: Client) -> None:
        """Know ``client`` from its connection on."""

    def join(self, client: Client) -> None:
        """Let ``client`` receive from now on."""

    def detach(self, client: Client) -> None:
        """Forget ``client``, whose connection has ended."""

    def expel(self, client: Client, reason: str) -> None:
        """Send nothing more to ``client``, whose connection is being closed for ``reason``."""

    def relay(self, sender: Client, frames: list[protocol.Send]) -> None:
        """Carry what ``sender`` sent to every other node."""

    def refuse(self, client: Client, reason: str, *, tell: bool) -> None:
        """Count, and tell, a frame or command that cannot be served."""

    def keep_pace(
        self, client: Client, element: protocol.Lockstep | protocol.Done
    ) -> protocol.Refusal | protocol.ProtocolError | None:
        """Let time wait for ``client``, or go on as it allows; returns what is wrong with that."""


class Client(asyncio.Protocol):
    """One connection: handshake, hold, then frames both ways."""

    def __init__(self, hub: Hub) -> None:
        self.name = "client"
        self._hub = hub
        self._parser = protocol.Parser()
        self._opened = False
        self._raw = False
        self._held: list[bytes] | None = None  # frames kept back after rawmode
        self._held_bytes = 0
        self._release_timer: asyncio.TimerHandle | None = None
        self._told: set[str] = set()  # reasons of refusals, each told once

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet; called by the loop."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._socket = transport.get_extra_info("socket")
        peer = transport.get_extra_info("peername")
        self.name = f"client {peer[0]}:{peer[1]}" if peer else "client"
        with contextlib.suppress(OSError):  # the peer may be gone already
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL_BUFFER_BYTES)
        self._acknowledge_now()
        self._hub.attach(self)
        transport.write(protocol.HI)

    def data_received(self, data: bytes) -> None:
        """Obey commands and relay frames; called by the loop."""
        self._acknowledge_now()
        elements, error = self._parser.feed(data)
        frames: list[protocol.Send] = []
        for element in elements:
            if isinstance(element, protocol.Send) and self._raw:
                frames.append(element)
            else:
                self._relay(frames)
                frames = []
                error = self._obey(element) or error
        self._relay(frames)
        if error is not None:
            self._hub.expel(self, str(error))
            self._transport.write(f"< error {error} >".encode("ascii", "replace"))
            self._transport.close()

    def _relay(self, frames: list[protocol.Send]) -> None:
        if frames:
            self._release()
            self._hub.relay(self, frames)

    def connection_lost(self, error: Exception | None) -> None:
        """Leave; called by the loop."""
        if self._release_timer is not None:
            self._release_timer.cancel()
        self._hub.detach(self)

    def deliver(self, text: bytes) -> None:
        """Send frames, or keep them while holding; drops this client if it does not read."""
        if self._held is not None:
            self._held.append(text)
            self._held_bytes += len(text)
            unread = self._held_bytes
        else:
            self._transport.write(text)
            unread = self._transport.get_write_buffer_size()
        if unread > self._hub.client_buffer:
            self._hub.expel(self, f"it does not read ({unread} bytes waiting)")
            self._transport.abort()

    def finish(self) -> None:
        """Close, having sent what is held and buffered."""
        self._release()
        self._transport.close()

    def abort(self) -> None:
        """Close at once."""
        self._transport.abort()

    def _obey(self, element: protocol.Element) -> protocol.ProtocolError | None:
        """Carry out one command; returns what is wrong with it at this point."""
        if isinstance(element, protocol.Lockstep | protocol.Done) and self._raw:
            self._release()
            answer = self._hub.keep_pace(self, element)
            if not isinstance(answer, protocol.Refusal):
                return answer
            element = answer
        if isinstance(element, protocol.Refusal):
            first = element.reason not in self._told
            self._told.add(element.reason)
            self._hub.refuse(self, element.reason, tell=first)
            if first:
                self._transport.write(f"< error {element.reason} >".encode())
        elif isinstance(element, protocol.Echo):
            self._transport.write(protocol.ECHO)
        elif isinstance(element, protocol.Open) and not self._opened:
            self._opened = True
            self._transport.write(protocol.OK)
        elif isinstance(element, protocol.RawMode) and self._opened and not self._raw:
            self._raw = True
            self._held = []
            self._transport.write(protocol.OK)
            self._hub.join(self)
            self._release_timer = asyncio.get_running_loop().call_later(HOLD_S, self._release)
        else:
            command = type(element).__name__.lower()
            return protocol.ProtocolError(f"expected open, then rawmode, got '{command}'")
        return None

    def _release(self) -> None:
        """End the hold: a client that sends, or has had time, has read its last ``< ok >``."""
        if self._release_timer is not None:
            self._release_timer.cancel()
            self._release_timer = None
        if self._held is not None:
            text = b"".join(self._held)
            self._held = None
            if text:
                self._transport.write(text)

    def _acknowledge_now(self) -> None:
        # Linux falls back to delayed acknowledgements by itself, so it is asked anew on every read:
        # a client with Nagle's algorithm on would otherwise wait up to 40 ms for its next segment.
        if _QUICKACK is not None:
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.IPPROTO_TCP, _QUICKACK, 1)
