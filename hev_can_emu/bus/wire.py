"""The wire: which frame is on it when, decided as CAN does, one frame after the other.

Pure and deterministic: time is passed in, nothing waits.  Nodes submit frames; at the start of each frame
the least identifier among all that is pending wins (ISO 11898-1:2015, 10.4.2.2); it takes its bits' time,
stuff bits included, and the intermission; what is destroyed costs its sender and the others error counts
(12.1.4) and is sent again.  Simplified: an error flag and its echo are always 12 bits, and of two frames
with the same identifier that start together the one submitted first is sent first.
"""

from __future__ import annotations

import heapq
import struct
from collections import deque

import numpy as np

from hev_can_emu.bus.bits import INTERMISSION, bits_of, priority
from hev_can_emu.bus.disturbance import ActiveDisturbance, Disturbance, Flood
from hev_can_emu.bus.error_counters import BUS_OFF, PASSIVE, RECOVERY_SEQUENCES, ErrorCounters
from hev_can_emu.bus.port import RECORD
from hev_can_emu.bus.wire_parts import (
    Flooding,
    Node,
    Pending,
    Sent,
    Timing,
    Transmission,
    WireEvent,
)
from hev_can_emu.bus.wire_statistics import WireStatistics
from hev_can_emu.messages.frame import EXTENDED, FRAME, make_frames

QUEUE_FRAMES = 1024  #: frames that a node without mailboxes may have pending; more are dropped
ERROR_FRAME = 12 + 8  #: bits: error flag and its echo, delimiter
LONE_ERROR_FRAME = 6 + 8  #: bits: where no other node echoes the flag
SUSPEND = 8  #: bits that a passive sender waits longer than the others
SEQUENCE = 11  #: recessive bits that count towards recovery from bus-off
FOREVER = 1 << 62
_STAMP = struct.Struct("=q")  # the first field of RECORD


class Wire:
    """One bus of some nodes.

    Args:
        timing: bit rates.
    """

    def __init__(self, timing: Timing) -> None:
        bits_of(make_frames(1))  # compiled now, not when the first frame is due
        self.timing = timing
        self.statistics = WireStatistics()
        self._nodes: dict[int, Node] = {}
        self._numbers = 0
        self._arrivals: deque[tuple[int, Node, Pending]] = deque()
        self._order = 0
        self._latest_ns = 0  # of submissions: they are taken in order
        self._free_ns = 0  # the wire is idle from here on
        self._current: Transmission | None = None
        self._events: list[WireEvent] = []
        self._disturbances: list[ActiveDisturbance] = []
        self._floods: list[Flooding] = []
        self._holds: list[tuple[int, str, int]] = []

    # -- nodes ----------------------------------------------------------------------------------

    def add_node(self, name: str, *, mailboxes: bool = False) -> int:
        """Return the number of a new node.

        With ``mailboxes`` it holds one batch of frames per identifier: a frame still pending when a later
        one of its identifier is submitted is overwritten, as in a control unit.  Without, frames
        queue.
        """
        number = self._numbers
        self._numbers += 1
        self._nodes[number] = Node(number, name, mailboxes)
        return number

    def remove_node(self, node: int) -> None:
        """Take a node off the wire, with what it has pending."""
        gone = self._nodes.pop(node)
        gone.present = False
        gone.queue.clear()
        self._floods = [flood for flood in self._floods if flood.node is not gone]

    @property
    def names_off(self) -> set[str]:
        """Names of the nodes that are off the bus."""
        return {node.name for node in self._nodes.values() if not node.takes_part}

    def name(self, node: int) -> str:
        """Return a node's name."""
        return self._nodes[node].name

    def errors(self, node: int) -> ErrorCounters:
        """Return a node's error counters."""
        return self._nodes[node].errors

    def is_on(self, node: int) -> bool:
        """Return whether a node takes part, that is, is not off the bus."""
        return self._nodes[node].errors.state != BUS_OFF

    def hold_off(self, name: str, t_ns: int, until_ns: int = FOREVER) -> None:
        """Put every node of this name off the bus at ``t_ns``; it does not recover before ``until_ns``."""
        self._holds.append((t_ns, name, until_ns))

    def release(self, name: str, t_ns: int) -> None:
        """Let every node of this name try to recover from ``t_ns`` on."""
        self._holds = [hold for hold in self._holds if hold[1] != name]
        for node in self._nodes.values():
            if node.name == name:
                node.held_off_ns = min(node.held_off_ns, t_ns)

    # -- disturbing -----------------------------------------------------------------------------

    def disturb(self, what: Disturbance) -> ActiveDisturbance:
        """Destroy frames from now on; :meth:`calm` ends it."""
        active = ActiveDisturbance(what)
        self._disturbances.append(active)
        return active

    def calm(self, active: ActiveDisturbance) -> None:
        """End a disturbance."""
        self._disturbances.remove(active)

    def flood(self, name: str, what: Flood) -> Flooding:
        """Add a node that floods the wire; :meth:`end_flood` ends it."""
        node = self._nodes[self.add_node(name)]
        (frame,) = self._pending(what.start_ns, what.record)
        flooding = Flooding(node, what, frame)
        self._floods.append(flooding)
        return flooding

    def end_flood(self, flooding: Flooding) -> None:
        """End a flood, and take its node off the wire."""
        self.remove_node(flooding.node.number)

    # -- running --------------------------------------------------------------------------------

    def submit(self, node: int, t_ns: int, raw: bytes) -> None:
        """Have ``node`` ask for the bus at ``t_ns`` with frames, given as consecutive RECORD bytes."""
        self._latest_ns = t_ns = max(t_ns, self._latest_ns)
        sender = self._nodes[node]
        self._arrivals.extend((t_ns, sender, each) for each in self._pending(t_ns, raw))

    def _pending(self, t_ns: int, raw: bytes) -> list[Pending]:
        bits = bits_of(np.frombuffer(raw, dtype=FRAME))
        found = []
        for i, (nominal, fast) in enumerate(bits.tolist()):
            record = raw[i * RECORD.size : (i + 1) * RECORD.size]
            _, can_id, flags, _, _, _ = RECORD.unpack(record)
            self._order += 1
            duration_ns = self.timing.bits_ns(nominal, fast)
            found.append(Pending(priority(can_id, flags), self._order, t_ns, duration_ns, record))
        return found

    def advance(self, until_ns: int) -> list[Sent]:
        """Run the wire up to ``until_ns`` and return what was sent whole by then, in order."""
        done: list[Sent] = []
        while True:
            if self._current is None:
                if not self._start_next(until_ns):
                    return done
            elif self._current.end_ns > until_ns:
                return done
            else:
                self._finish(done)

    @property
    def next_ns(self) -> int | None:
        """When something may happen next, or None while nothing is to be sent."""
        if self._current is not None:
            return self._current.end_ns
        times = [flood.due_ns for flood in self._floods if flood.waits]
        times += [max(self._free_ns, node.ready_ns) for node in self._nodes.values() if node.queue]
        if self._arrivals:
            times.append(max(self._free_ns, self._arrivals[0][0]))
        return min(times, default=None)

    def take_events(self) -> list[WireEvent]:
        """Return, and forget, the changes of nodes' error states."""
        events, self._events = self._events, []
        return events

    def _start_next(self, until_ns: int) -> bool:
        """Start the next frame that can start by ``until_ns``; returns whether one did."""
        while True:
            moment = max(self._free_ns, self._soonest())
            if moment > until_ns:
                self._idle(until_ns)
                return False
            self._idle(moment)
            self._arrive(moment)
            best: Node | None = None
            for node in self._nodes.values():
                self._forget_overwritten(node)
                if not node.queue or node.ready_ns > moment or node.errors.state == BUS_OFF:
                    continue
                if best is None or node.queue[0] < best.queue[0]:
                    best = node
            if best is not None:
                self._begin(best, moment)
                return True

    def _soonest(self) -> int:
        """Return when a frame might be sent, come, or a node recover, at the soonest."""
        soonest = min([t_ns for t_ns, _, _ in self._holds], default=FOREVER)
        if self._arrivals:
            soonest = min(soonest, self._arrivals[0][0])
        for node in self._nodes.values():
            if node.errors.state == BUS_OFF:
                if node.present and node.held_off_ns < FOREVER:
                    begin = max(self._free_ns, node.held_off_ns)
                    wait = self.timing.bits_ns(node.sequences_left * SEQUENCE)
                    soonest = min(soonest, begin + wait - node.recessive_ns)
            elif node.queue:
                soonest = min(soonest, node.ready_ns)
        for flood in self._floods:
            if flood.waits:
                soonest = min(soonest, flood.due_ns)
        return soonest

    def _idle(self, until_ns: int) -> None:
        """Let the wire be idle until then; nodes that are off count recessive bits."""
        for node in self._nodes.values():
            begin = max(self._free_ns, node.held_off_ns)
            if node.errors.state == BUS_OFF and begin <= until_ns:
                node.recessive_ns += until_ns - begin
                count, node.recessive_ns = divmod(node.recessive_ns, self.timing.bits_ns(SEQUENCE))
                self._count_sequences(node, count, until_ns)
        self._free_ns = max(self._free_ns, until_ns)

    def _count_sequences(self, node: Node, count: int, t_ns: int) -> None:
        node.sequences_left -= count
        if node.sequences_left <= 0 and node.present:
            node.errors.recover()
            self._tell(node, t_ns)

    def _arrive(self, t_ns: int) -> None:
        """Let what was submitted by then, and floods, take part in arbitration, and nodes go off."""
        for hold in [hold for hold in self._holds if hold[0] <= t_ns]:
            self._holds.remove(hold)
            for node in self._nodes.values():
                if node.name == hold[1] and node.present:
                    node.held_off_ns = hold[2]
                    node.errors.turn_off()
                    self._went_off(node, t_ns)
        for flood in self._floods:
            if flood.waits and flood.due_ns <= t_ns:
                flood.node.queue.append(flood.frame)
                flood.due_ns = max(flood.due_ns + flood.what.period_ns, t_ns)
        while self._arrivals and self._arrivals[0][0] <= t_ns:
            submitted_ns, node, pending = self._arrivals.popleft()
            if not node.takes_part:
                self.statistics.lost += 1
            elif not node.mailboxes and len(node.queue) >= QUEUE_FRAMES:
                self.statistics.dropped += 1
            else:
                node.newest[pending.priority] = submitted_ns
                heapq.heappush(node.queue, pending)

    def _forget_overwritten(self, node: Node) -> None:
        queue = node.queue
        while node.mailboxes and queue and queue[0].submitted_ns < node.newest[queue[0].priority]:
            heapq.heappop(queue)
            self.statistics.overwritten += 1

    def _begin(self, node: Node, start_ns: int) -> None:
        """Put the node's first frame on the wire."""
        frame = heapq.heappop(node.queue)
        error = None
        for disturbance in self._disturbances:
            _, can_id, flags, _, _, _ = RECORD.unpack(frame.record)
            if disturbance.strikes(start_ns, node.name, can_id, bool(flags & EXTENDED)):
                error = disturbance
                break
        acknowledged = any(other is not node and other.takes_part for other in self._nodes.values())
        duration = frame.duration_ns
        missed_by = ""
        if error is not None and not self._is_noticed(error, node):
            missed_by = error.what.receiver  # whose flag, it being passive, nobody sees
            error = None
        if error is not None:
            duration = int(duration * error.place()) + self.timing.bits_ns(ERROR_FRAME)
        elif not acknowledged:
            # Nobody there: missed at the ACK slot, nine bits before the end.
            duration += self.timing.bits_ns(LONE_ERROR_FRAME) - self.timing.bits_ns(9)
        end_ns = start_ns + duration
        self._current = Transmission(node, frame, start_ns, end_ns, error, acknowledged, missed_by)

    def _is_noticed(self, error: ActiveDisturbance, sender: Node) -> bool:
        """Return whether an error ends the frame for all; a passive finder keeps it to itself."""
        name = error.what.receiver
        return not name or any(
            finder.name == name and finder.takes_part and finder.errors.state != PASSIVE
            for finder in self._nodes.values()
            if finder is not sender
        )

    def _finish(self, done: list[Sent]) -> None:
        """End what is on the wire, whole or not."""
        assert self._current is not None
        node, frame, start_ns, end_ns, error, acknowledged, missed_by = self._current
        self._current = None
        self._free_ns = end_ns + self.timing.bits_ns(INTERMISSION)
        self.statistics.occupy(start_ns, self._free_ns)
        whole = error is None and acknowledged
        before = node.errors.state
        if whole:
            node.errors.sent()
            self.statistics.frames += 1
            node.sent += 1
            record = _STAMP.pack(end_ns) + frame.record[_STAMP.size :]
            done.append(Sent(end_ns, node.number, record, missed_by))
        else:
            node.errors.failed_to_send(unacknowledged=error is None)
            self.statistics.errors += 1
            if node.present:
                heapq.heappush(node.queue, frame)
        self._tell_if(node, before, end_ns)
        for other in self._nodes.values():
            if other is node or not other.present:
                continue
            if other.errors.state == BUS_OFF:
                other.recessive_ns = 0
                if other.held_off_ns <= start_ns:
                    self._count_sequences(other, 1, end_ns)
                continue
            before = other.errors.state
            if whole and other.name == missed_by:
                other.errors.failed_to_receive()
            elif whole:
                other.errors.received()
            elif acknowledged:
                first = error is not None and error.what.receiver == other.name
                other.errors.failed_to_receive(first=first)
            self._tell_if(other, before, end_ns)
        if node.errors.state == BUS_OFF:
            self._went_off(node, end_ns, told=True)
        elif node.errors.state == PASSIVE:
            node.ready_ns = self._free_ns + self.timing.bits_ns(SUSPEND)

    def _went_off(self, node: Node, t_ns: int, *, told: bool = False) -> None:
        """A node that goes off the bus forgets what it had to send."""
        node.sequences_left = RECOVERY_SEQUENCES
        node.recessive_ns = 0
        self.statistics.lost += len(node.queue)
        node.queue.clear()
        if not told:
            self._tell(node, t_ns)

    def _tell_if(self, node: Node, before: str, t_ns: int) -> None:
        if node.errors.state != before:
            self._tell(node, t_ns)

    def _tell(self, node: Node, t_ns: int) -> None:
        errors = node.errors
        self._events.append(
            WireEvent(t_ns, node.name, errors.state, errors.transmit, errors.receive)
        )
