"""The wire: who sends when, what errors cost, when a node goes off the bus and comes back."""

from __future__ import annotations

import pytest

from hev_can_emu.bus.disturbance import Disturbance, Flood
from hev_can_emu.bus.error_counters import ACTIVE, BUS_OFF, PASSIVE, ErrorCounters
from hev_can_emu.bus.port import RECORD
from hev_can_emu.bus.wire import FOREVER, QUEUE_FRAMES, Wire
from hev_can_emu.bus.wire_parts import Sent, Timing
from hev_can_emu.messages.frame import BRS, FD, frame

BIT = 2000  # ns at 500 kbit/s
MS = 1_000_000
EMPTY_BITS = 45  # identifier 0x555 without data: see test_bits


def record(can_id: int, data: bytes = b"", flags: int = 0) -> bytes:
    return frame(can_id, data, flags=flags).tobytes()


def ids(sent: list[Sent]) -> list[int]:
    return [RECORD.unpack(each.record)[1] for each in sent]


def wire_of(*names: str, mailboxes: bool = False) -> Wire:
    wire = Wire(Timing())
    for name in names:
        wire.add_node(name, mailboxes=mailboxes)
    return wire


def test_a_frame_takes_its_bits_and_the_next_one_the_intermission_more() -> None:
    wire = wire_of("A", "B")
    wire.submit(0, 0, record(0x555) * 2)
    assert wire.advance(EMPTY_BITS * BIT - 1) == []
    assert wire.next_ns == EMPTY_BITS * BIT
    sent = wire.advance(10 * MS)
    assert [each.t_ns for each in sent] == [
        EMPTY_BITS * BIT,
        (EMPTY_BITS + 3 + EMPTY_BITS) * BIT,
    ]
    assert [RECORD.unpack(each.record)[0] for each in sent] == [each.t_ns for each in sent]
    assert wire.next_ns is None
    assert wire.statistics.load(10 * MS) == pytest.approx(2 * 48 * BIT / (10 * MS))


def test_a_switched_bit_rate_shortens_the_data_phase_only() -> None:
    slow, fast = wire_of("A", "B"), wire_of("A", "B")
    slow.submit(0, 0, record(0x123, bytes(range(64)), FD))
    fast.submit(0, 0, record(0x123, bytes(range(64)), FD | BRS))
    (one,), (other,) = slow.advance(MS * 10), fast.advance(MS * 10)
    # 579 bits without stuffing, of which 17 + 12 - 3 are nominal
    assert 0.25 < other.t_ns / one.t_ns < 0.30


def test_the_least_identifier_wins_whoever_asked_first_but_takes_nothing_away() -> None:
    wire = wire_of("A", "B", "C")
    wire.submit(0, 0, record(0x300))
    wire.submit(1, 10 * BIT, record(0x200))
    wire.submit(2, 20 * BIT, record(0x100))
    assert ids(wire.advance(10 * MS)) == [0x300, 0x100, 0x200]


def test_what_comes_later_does_not_take_part_earlier() -> None:
    wire = wire_of("A", "B")
    wire.submit(0, 0, record(0x300))
    wire.submit(1, 1 * MS, record(0x100))
    (first, second) = wire.advance(10 * MS)
    assert first.t_ns < 1 * MS < second.t_ns


def test_how_often_the_wire_is_looked_at_changes_nothing() -> None:
    def run(step_ns: int) -> list[Sent]:
        wire = wire_of("A", "B", "C")
        wire.disturb(Disturbance(chance=0.2, seed=7))
        for k in range(30):
            wire.submit(k % 3, k * 150_000, record(0x100 + (7 * k) % 40, bytes([k, 0, 255])))
        sent = []
        for now in range(0, 40 * MS, step_ns):
            sent += wire.advance(now)
        return sent

    assert len(run(MS)) == 30
    assert run(MS) == run(MS // 7) == run(20 * MS)


def test_an_overloaded_control_unit_sends_the_newest_and_a_program_queues() -> None:
    unit, program = wire_of("A", "B", mailboxes=True), wire_of("A", "B")
    for wire in (unit, program):
        wire.submit(1, 0, record(0x001, bytes(8)) * 40)  # keeps the bus for 9 ms
        for k in range(5):
            wire.submit(0, k * MS, record(0x200, bytes([k])))
    late = [RECORD.unpack(s.record) for s in unit.advance(50 * MS) if s.node == 0]
    assert [data[0] for *_, data in late] == [4]
    assert unit.statistics.overwritten == 4
    assert ids(program.advance(50 * MS)).count(0x200) == 5
    assert program.statistics.overwritten == 0


def test_a_queue_is_bounded() -> None:
    wire = wire_of("A", "B")
    wire.submit(0, 0, record(0x100) * (QUEUE_FRAMES + 5))
    wire.advance(0)
    assert wire.statistics.dropped == 5


def test_a_destroyed_frame_is_sent_again_and_costs_counts() -> None:
    wire = wire_of("A", "B")
    active = wire.disturb(Disturbance(frames=1, place=0.5))
    wire.submit(0, 0, record(0x555))
    (sent,) = wire.advance(MS)
    # Half a frame, 20 bits of error frame, intermission, the whole frame.
    assert sent.t_ns == (EMPTY_BITS * BIT) // 2 + (20 + 3 + EMPTY_BITS) * BIT
    assert active.hits == wire.statistics.errors == 1
    assert (wire.errors(0).transmit, wire.errors(1).receive) == (8 - 1, 1 - 1)


def test_a_sender_whose_frames_are_destroyed_goes_passive_then_off_then_recovers() -> None:
    wire = wire_of("A", "B")
    disturbance = wire.disturb(Disturbance(sender="A", frames=32))
    wire.submit(0, 0, record(0x555))
    wire.submit(0, 40 * MS, record(0x111))
    sent = wire.advance(100 * MS)
    assert disturbance.hits == 32
    events = [(e.node, e.state) for e in wire.take_events()]
    # A passes 127 at its 16th error; B hears 32 errors, which is no harm.
    assert events == [("A", PASSIVE), ("A", BUS_OFF), ("A", ACTIVE)]
    # What was pending went with it; what came after the recovery is sent.
    assert ids(sent) == [0x111]
    assert wire.statistics.lost == 1


def test_recovery_takes_128_times_11_recessive_bits() -> None:
    wire = wire_of("A", "B")
    wire.hold_off("A", 5 * MS, 5 * MS)
    wire.advance(5 * MS)
    wire.advance(5 * MS + 128 * 11 * BIT - 1)
    assert not wire.is_on(0)
    wire.advance(5 * MS + 128 * 11 * BIT)
    assert wire.is_on(0)
    assert [e.t_ns for e in wire.take_events()][-1] == 5 * MS + 128 * 11 * BIT
    # On a busy bus each frame's end is one such sequence.
    busy = wire_of("A", "B", "C")
    busy.hold_off("A", 0, 0)
    busy.submit(1, 0, record(0x001, b"\x55" * 8) * 200)
    busy.advance(1000 * MS)
    back = busy.take_events()[-1]
    assert (back.node, back.state) == ("A", ACTIVE)
    assert 27 * MS < back.t_ns < 35 * MS  # 128 frames of about 0.23 ms


def test_a_node_held_off_neither_sends_nor_recovers_until_released() -> None:
    wire = wire_of("A", "B", "C")
    wire.hold_off("A", 0)
    wire.submit(0, 1 * MS, record(0x100))
    wire.submit(1, 1 * MS, record(0x200))
    assert ids(wire.advance(500 * MS)) == [0x200]
    wire.release("A", 500 * MS)
    wire.advance(600 * MS)
    assert wire.is_on(0)


def test_alone_nobody_acknowledges_and_a_passive_sender_never_goes_off() -> None:
    wire = wire_of("A", "B")
    wire.hold_off("B", 0)
    wire.submit(0, 0, record(0x555))
    assert wire.advance(50 * MS) == []
    assert wire.errors(0).state == PASSIVE
    assert wire.errors(0).transmit == 128
    wire.release("B", 50 * MS)
    assert ids(wire.advance(100 * MS)) == [0x555]


def test_a_receiver_that_finds_fault_pays_most_and_goes_silent_when_passive() -> None:
    wire = wire_of("A", "B", "C")
    wire.disturb(Disturbance(receiver="B"))
    wire.submit(0, 0, record(0x100) * 30)
    wire.advance(2 * MS)
    assert wire.errors(1).receive >= 9
    sent = wire.advance(100 * MS)
    # Once passive, its flag disturbs nobody: the frames get through.
    assert wire.errors(1).state == PASSIVE
    assert wire.statistics.frames == 30
    assert 0 < wire.statistics.errors < 20
    assert wire.errors(2).receive == 0
    assert {each.missed_by for each in sent} == {"B"}


def test_a_passive_sender_lets_others_go_first() -> None:
    wire = wire_of("A", "B")
    wire.disturb(Disturbance(sender="A", frames=16))
    wire.submit(0, 0, record(0x100))
    wire.advance(5 * MS)
    (last,) = [event.t_ns for event in wire.take_events() if event.state == PASSIVE]
    # Had it tried again at once, it would have won over 0x700.
    wire2 = wire_of("A", "B")
    wire2.disturb(Disturbance(sender="A", frames=16))
    wire2.submit(0, 0, record(0x100))
    wire2.submit(1, last, record(0x700))
    assert ids(wire2.advance(10 * MS)) == [0x700, 0x100]


def test_a_flood_takes_what_it_is_given() -> None:
    wire = wire_of("A", "B")
    bits = EMPTY_BITS + 3
    wire.flood("babbler", Flood(record(0x555), period_ns=2 * bits * BIT, end_ns=100 * MS))
    sent = wire.advance(200 * MS)
    assert len(sent) == pytest.approx(100 * MS / (2 * bits * BIT), abs=1)
    assert wire.statistics.load(100 * MS) == pytest.approx(0.5, abs=0.005)


def test_a_full_flood_leaves_nothing_to_others() -> None:
    wire = wire_of("A", "B")
    flood = wire.flood("babbler", Flood(record(0x000), period_ns=0))
    wire.submit(0, 1 * MS, record(0x001))
    assert set(ids(wire.advance(1000 * MS))) == {0x000}
    assert wire.statistics.load(1000 * MS) > 0.99
    wire.end_flood(flood)
    assert flood.node.sent > 1000
    assert ids(wire.advance(1001 * MS))[-1] == 0x001


def test_disturbances_hit_what_they_name_when_they_are_to() -> None:
    wire = wire_of("A", "B", "C")
    hit = wire.disturb(Disturbance(identifier=0x200, start_ns=10 * MS, end_ns=20 * MS))
    for t in (0, 12 * MS, 30 * MS):
        wire.submit(0, t, record(0x100))
        wire.submit(1, t, record(0x200))
    sent = wire.advance(15 * MS)
    assert ids(sent) == [0x100, 0x200, 0x100]
    assert hit.hits > 3
    wire.calm(hit)
    assert ids(wire.advance(50 * MS)) == [0x200, 0x100, 0x200]


def test_counters_follow_the_rules() -> None:
    counters = ErrorCounters()
    counters.received()
    counters.sent()
    assert (counters.transmit, counters.receive) == (0, 0)
    for _ in range(15):
        counters.failed_to_receive(first=True)
    assert (counters.receive, counters.state) == (135, PASSIVE)
    counters.received()
    assert (counters.receive, counters.state) == (127, ACTIVE)
    for _ in range(16):
        counters.failed_to_send()
    assert (counters.transmit, counters.state) == (128, PASSIVE)
    counters.failed_to_send(unacknowledged=True)
    assert counters.transmit == 128
    for _ in range(16):
        counters.failed_to_send()
    assert (counters.transmit, counters.state) == (256, BUS_OFF)
    counters.recover()
    assert (counters.transmit, counters.receive, counters.state) == (0, 0, ACTIVE)


def test_no_time_is_too_late() -> None:
    wire = wire_of("A", "B")
    assert wire.advance(FOREVER - 1) == []


def test_nodes_that_have_left_are_forgotten() -> None:
    wire = wire_of("A", "B")
    for k in range(1000):
        guest = wire.add_node(f"guest {k}")
        wire.submit(guest, k * MS, record(0x100))
        wire.advance(k * MS)
        wire.remove_node(guest)
    wire.submit(0, 2000 * MS, record(0x200))
    # Each guest's frame was on the wire when it left.
    assert len(wire.advance(3000 * MS)) == 2
    assert wire.statistics.frames == 1001
    assert len(wire._nodes) == 2
