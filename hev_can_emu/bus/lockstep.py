"""The embedded server in lockstep: virtual time goes on when every partner allows it.

A partner is a client that said ``< lockstep NAME >``.  It hears ``< now T >``, sends its frames, and says
``< done T' >``: until then it has nothing more to send.  Time goes on to the least of what the partners
allow.  Frames of partners are put on the bus together, at the instant at which time stands, ordered
by the partners' names: however their messages race through the sockets, the run is the same.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from hev_can_emu.bus import socketcand_protocol as protocol
from hev_can_emu.bus.socketcand import DEFAULT_HOST, DEFAULT_PORT, SocketcandBus
from hev_can_emu.bus.socketcand_client import Client
from hev_can_emu.errors import BusError

PATIENCE_S = 10.0  #: how long a partner may take to say done
JOIN_S = 60.0  #: how long partners may take to join


class _Partner:
    def __init__(self, name: str, client: Client) -> None:
        self.name = name
        self.client = client
        self.until_ns = 0
        self.frames: list[protocol.Send] = []


class LockstepBus(SocketcandBus):
    """The server, whose clock is the car's own.

    Args:
        now_ns: the car's time.
        host, port: where to listen; port 0 takes any free one.
        epoch_ns: added to the car's time in the frames that clients see.
        partners: how many clients time waits for.
        patience_s: how long a partner may take to say done, in wall time.
        join_s: how long all may take to join.
        beacon: announce the server on this machine's loopback.
    """

    def __init__(
        self,
        now_ns: Callable[[], int],
        host: str = DEFAULT_HOST,
        port: int = DEFAULT_PORT,
        *,
        epoch_ns: int = 0,
        partners: int = 1,
        patience_s: float = PATIENCE_S,
        join_s: float = JOIN_S,
        beacon: bool = True,
    ) -> None:
        super().__init__(now_ns, host, port, epoch_ns=epoch_ns, beacon=beacon)
        self._wanted = partners
        self._patience_s = patience_s
        self._join_s = join_s
        self._partners: dict[str, _Partner] = {}
        self._gone: str | None = None
        self._changed = asyncio.Event()

    def describe(self) -> str:
        """Return the address, and how many partners keep time."""
        count = f"{self._wanted} partner{'s' if self._wanted != 1 else ''}"
        return f"{super().describe()}, in lockstep with {count}"

    async def agree(self) -> int:
        """Wait until every partner allows time to go on; return until when, ns.

        What they sent is received then.

        Raises:
            BusError: one has not joined, has not said done in time, or has left.
        """
        now = self._now_ns()
        limit_s = self._patience_s if len(self._partners) == self._wanted else self._join_s
        try:
            async with asyncio.timeout(limit_s):
                while self._gone is None and not self._agreed(now):
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            raise BusError(self._complaint(now, limit_s)) from None
        if self._gone is not None:
            raise BusError(f"partner '{self._gone}' left at {now * 1e-9:.3f} s")
        for partner in self._by_name():
            frames, partner.frames = partner.frames, []
            if frames:
                super().relay(partner.client, frames)
        return min(partner.until_ns for partner in self._partners.values())

    def tell(self) -> None:
        """Tell the partners that waited for this instant, or an earlier one, that it is here."""
        now = self._now_ns()
        self._write_outbox()
        for partner in self._by_name():
            if partner.until_ns <= now:
                partner.client.deliver(protocol.format_now(now))

    def relay(self, sender: Client, frames: list[protocol.Send]) -> None:
        """Keep a partner's frames until time may go on; carry all others at once."""
        for partner in self._partners.values():
            if partner.client is sender:
                partner.frames += frames
                return
        super().relay(sender, frames)

    def keep_pace(
        self, client: Client, element: protocol.Lockstep | protocol.Done
    ) -> protocol.Refusal | protocol.ProtocolError | None:
        """Take a partner in, or note how far it lets time go."""
        partner = next((each for each in self._partners.values() if each.client is client), None)
        if isinstance(element, protocol.Lockstep):
            if partner is not None:
                return protocol.ProtocolError("expected lockstep once")
            if element.name in self._partners:
                return protocol.ProtocolError(f"expected a name of its own, got '{element.name}'")
            if len(self._partners) == self._wanted:
                count = f"{self._wanted}-of-{self._wanted}"
                return protocol.Refusal(f"lockstep-refused:{count}-partners-are-there")
            self._partners[element.name] = _Partner(element.name, client)
            self._notices.append(f"{client.name} keeps time as '{element.name}'")
            client.deliver(protocol.format_now(self._now_ns()))
        elif partner is None:
            return protocol.ProtocolError("expected lockstep before done")
        elif element.until_ns <= self._now_ns():
            now = self._now_ns()
            return protocol.ProtocolError(f"expected done beyond {now}, got {element.until_ns}")
        else:
            partner.until_ns = element.until_ns
        self._changed.set()
        return None

    def detach(self, client: Client) -> None:
        """Forget a client; a partner's leaving ends the run."""
        super().detach(client)
        for partner in self._partners.values():
            if partner.client is client and self._gone is None:
                self._gone = partner.name
                self._changed.set()

    def _send(self, raw: bytes, count: int) -> None:
        self._sent += count
        text, unfit = protocol.format_frames(raw, epoch_ns=self._epoch_ns)
        if unfit:
            self._tell_unfit(unfit)
        for client in list(self._joined):
            client.deliver(text)

    def _agreed(self, now: int) -> bool:
        there = self._partners.values()
        return len(there) == self._wanted and all(each.until_ns > now for each in there)

    def _by_name(self) -> list[_Partner]:
        return [self._partners[name] for name in sorted(self._partners)]

    def _complaint(self, now: int, limit_s: float) -> str:
        if len(self._partners) < self._wanted:
            return f"{len(self._partners)} of {self._wanted} partners joined within {limit_s:g} s"
        slow = [each.name for each in self._by_name() if each.until_ns <= now]
        names = ", ".join(f"'{name}'" for name in slow)
        return f"partner {names} has not said done for {limit_s:g} s at {now * 1e-9:.3f} s"
