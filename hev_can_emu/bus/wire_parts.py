"""What the wire is made of: bit rates, nodes, frames that wait, are on it, or have left it."""

from __future__ import annotations

from typing import NamedTuple

from hev_can_emu.bus.disturbance import ActiveDisturbance, Flood
from hev_can_emu.bus.error_counters import BUS_OFF, ErrorCounters


class Timing(NamedTuple):
    """Bit rates, in bit/s: ``bitrate`` of arbitration, ``data_bitrate`` of frames that switch it."""

    bitrate: int = 500_000
    data_bitrate: int = 2_000_000

    def bits_ns(self, nominal: int, fast: int = 0) -> int:
        """Return how long so many bits of either rate take, ns."""
        return nominal * 1_000_000_000 // self.bitrate + fast * 1_000_000_000 // self.data_bitrate


class Sent(NamedTuple):
    """A frame that left the wire whole at ``t_ns``.

    ``node``: its sender; ``record``: its RECORD bytes, stamped then; ``missed_by``: name of the one node
    that, passive, found fault with it.
    """

    t_ns: int
    node: int
    record: bytes
    missed_by: str = ""


class WireEvent(NamedTuple):
    """A node changed its error state at ``t_ns``."""

    t_ns: int
    node: str
    state: str
    transmit_errors: int
    receive_errors: int

    def describe(self) -> str:
        """Return it in words."""
        errors = f"{self.transmit_errors} transmit, {self.receive_errors} receive errors"
        return f"{self.node} is {self.state} ({errors})"


class Pending(NamedTuple):
    """A frame that waits; ordered by arbitration, then by submission."""

    priority: int
    order: int
    submitted_ns: int
    duration_ns: int
    record: bytes


class Node:
    """A controller on the wire.

    Attributes:
        number: by which others name it.
        name: for people and disturbances.
        mailboxes: whether a newer frame overwrites a pending one of its identifier.
        errors: its error counters.
        queue: heap of what is to be sent.
        newest: when the newest frame was submitted, by priority.
        ready_ns: sends nothing before.
        sequences_left: of recessive bits, while it is off the bus, until it recovers.
        recessive_ns: how long the present sequence has been.
        held_off_ns: does not try to recover before.
        present: whether it has not been removed.
        sent: frames that it has sent whole.
    """

    def __init__(self, number: int, name: str, mailboxes: bool) -> None:
        self.number = number
        self.name = name
        self.mailboxes = mailboxes
        self.errors = ErrorCounters()
        self.queue: list[Pending] = []
        self.newest: dict[int, int] = {}
        self.ready_ns = 0
        self.sequences_left = 0
        self.recessive_ns = 0
        self.held_off_ns = 0
        self.present = True
        self.sent = 0

    @property
    def takes_part(self) -> bool:
        """Whether it is there and not off the bus."""
        return self.present and self.errors.state != BUS_OFF


class Transmission(NamedTuple):
    """What is on the wire: see Sent and ActiveDisturbance."""

    node: Node
    frame: Pending
    start_ns: int
    end_ns: int
    error: ActiveDisturbance | None
    acknowledged: bool
    missed_by: str


class Flooding:
    """A flood, and when its next frame is due."""

    def __init__(self, node: Node, what: Flood, frame: Pending) -> None:
        self.node = node
        self.what = what
        self.frame = frame
        self.due_ns = what.start_ns

    @property
    def waits(self) -> bool:
        """Whether its next frame comes at ``due_ns``: it has none pending, and is not over."""
        over = self.what.end_ns is not None and self.due_ns >= self.what.end_ns
        return self.node.takes_part and not self.node.queue and not over
