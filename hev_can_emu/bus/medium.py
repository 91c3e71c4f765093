"""A wire that buses share: what one port sends, the others receive once the wire has carried it.

Time comes from one clock for all; whoever looks at the medium lets the wire catch up with it.  How
often that is changes nothing but how soon what was carried is handed over.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Protocol

from hev_can_emu.bus.port import RECORD
from hev_can_emu.bus.wire import Wire
from hev_can_emu.bus.wire_parts import Sent, Timing, WireEvent
from hev_can_emu.messages.frame import EXTENDED, SENT

Identifier = tuple[int, bool]  #: and whether it is extended


class Receiver(Protocol):
    """What a port does with frames that the wire has carried."""

    def __call__(self, record: bytes, t_ns: int) -> None:
        """Take one frame, as RECORD bytes, carried whole at ``t_ns`` of the medium's clock."""


class Port:
    """One participant of a medium: a node, or a program that plays several.

    Args:
        medium: what it takes part in.
        name: of its node, for people.
        receive: takes what the others send.
    """

    def __init__(self, medium: Medium, name: str, receive: Receiver) -> None:
        self.receive = receive
        self.hears_itself = False  #: then its own frames come back, marked SENT, once carried
        self._medium = medium
        self._own = medium.wire.add_node(name)
        self.nodes = {self._own}
        self._senders: dict[Identifier, int] = {}

    def play(self, senders: Mapping[Identifier, str]) -> None:
        """Be several control units, each with its mailboxes: ``senders`` names each frame's."""
        wire = self._medium.wire
        numbers = {
            name: wire.add_node(name, mailboxes=True) for name in dict.fromkeys(senders.values())
        }
        self.nodes |= set(numbers.values())
        self._senders = {identifier: numbers[name] for identifier, name in senders.items()}
        self.hears_itself = True

    def send(self, raw: bytes) -> None:
        """Submit frames, given as consecutive RECORD bytes, now."""
        batches: dict[int, list[bytes]] = {}
        for start in range(0, len(raw), RECORD.size):
            record = raw[start : start + RECORD.size]
            _, can_id, flags, _, _, _ = RECORD.unpack(record)
            node = self._senders.get((can_id, bool(flags & EXTENDED)), self._own)
            batches.setdefault(node, []).append(record)
        now = self._medium.now_ns()
        for node, records in batches.items():
            self._medium.wire.submit(node, now, b"".join(records))

    def leave(self) -> None:
        """Take part no more."""
        for node in self.nodes:
            self._medium.wire.remove_node(node)
        self._medium.ports.remove(self)


class Medium:
    """A wire, its clock and its ports.

    Args:
        timing: bit rates.
        now_ns: the clock, ns.

    Attributes:
        wire: decides who sends when.
        ports: who takes part.
        listeners: are told when a node's error state changes.
    """

    def __init__(self, timing: Timing, now_ns: Callable[[], int]) -> None:
        self.wire = Wire(timing)
        self.now_ns = now_ns
        self.ports: list[Port] = []
        self.listeners: list[Callable[[WireEvent], None]] = []
        self._begin_ns = now_ns()
        self._timer: asyncio.TimerHandle | None = None
        self._pumping = False

    def join(self, name: str, receive: Receiver) -> Port:
        """Return a new port."""
        port = Port(self, name, receive)
        self.ports.append(port)
        return port

    def pump(self) -> None:
        """Let the wire catch up with the clock, and hand over what it has carried."""
        if self._pumping:  # a receiver may look at the medium itself
            return
        self._pumping = True
        try:
            for sent in self.wire.advance(self.now_ns()):
                self._hand_over(sent)
            for event in self.wire.take_events():
                for tell in self.listeners:
                    tell(event)
        finally:
            self._pumping = False

    def _hand_over(self, sent: Sent) -> None:
        wire = self.wire
        for port in list(self.ports):
            own = sent.node in port.nodes
            if own and not port.hears_itself:
                continue
            if not own and not any(
                wire.is_on(node) and wire.name(node) != sent.missed_by for node in port.nodes
            ):
                continue
            t_ns, can_id, flags, length, channel, data = RECORD.unpack(sent.record)
            flags = flags & ~SENT | (SENT if own else 0)
            port.receive(RECORD.pack(t_ns, can_id, flags, length, channel, data), sent.t_ns)

    def pump_in_time(self) -> None:
        """Pump, and again by the running loop's timer when the wire has carried the next frame."""
        self.pump()
        due = self.wire.next_ns
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if due is not None:
            wait = max(due - self.now_ns(), 0) * 1e-9
            self._timer = asyncio.get_running_loop().call_later(wait, self.pump_in_time)

    def stop(self) -> None:
        """Forget the timer."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def describe(self) -> str:
        """Return what it carried and how busy it was, in one line."""
        return self.wire.statistics.describe(self.now_ns() - self._begin_ns)
