"""Equal inputs give equal bytes, however time is cut; and the order of events within a tick."""

from __future__ import annotations

import numpy as np
import pytest
from can_bench import IDLE, MS, Bench, build

from hev_can_emu.ecu import ports
from hev_can_emu.messages.frame import FRAME, SENT, make_frames
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

CAR = Setup(model="16dof")


def drive() -> np.ndarray:
    """Return 3 s of a tester's frames: cranking, a shift, torque, a lost request."""
    bench = Bench(CAR)
    parts = []
    clock = 0
    for ms, signals in (
        (600, {"EM1ControlMode": "Speed", "EM1SpeedRequest": 2000.0}),
        (700, {"ClutchTorqueCapacityRequest": 150.0, "EngineRunRequest": "Run"}),
        (700, {"EM2TorqueRequest": 180.0, "ClutchTorqueCapacityRequest": 0.0}),
        (500, {"GearRequest": "G1", "ShiftForceRequest": 1500.0, "EM1ControlMode": "Torque"}),
        (500, {"EM2TorqueRequest": -120.0, "BrakeTorqueRequest": 900.0}),
    ):
        bench.ask(**signals)
        parts.append(bench.due(clock, clock + ms))
        clock += ms
    frames = np.concatenate(parts)
    return frames[(frames["id"] != 0x0C0) | (frames["t_ns"] < 2_700 * MS)]


def play(emulator: Emulator, frames: np.ndarray, cuts: list[int], start: int = 0) -> bytes:
    """Advance through times in ms, each stretch with the frames that come in it; return what is sent."""
    sent = []
    for stop in cuts:
        inside = (frames["t_ns"] >= start * MS) & (frames["t_ns"] < stop * MS)
        given = np.ascontiguousarray(frames[inside])
        sent.append(emulator.advance(stop * MS, given, len(given)).tobytes())
        start = stop
    return b"".join(sent)


def test_two_emulators_agree_to_the_byte() -> None:
    frames = drive()
    first, second = Emulator(CAR), Emulator(CAR)
    assert play(first, frames, [3000]) == play(second, frames, [3000])
    assert first.snapshot() == second.snapshot()
    assert len(first.take_events()) > 10


@pytest.mark.parametrize("step", [1, 7, 250])
def test_how_time_is_cut_makes_no_difference(step: int) -> None:
    frames = drive()
    whole = build(CAR)
    expected = play(whole, frames, [3000])
    state, events = whole.snapshot(), whole.take_events()
    assert len(expected) > 4000 * FRAME.itemsize
    pieces = build(CAR)
    assert play(pieces, frames, [*range(step, 3000, step), 3000]) == expected
    assert pieces.snapshot() == state
    assert pieces.take_events() == events


def test_an_advance_longer_than_the_buffers_is_the_same_too() -> None:
    none = np.zeros(0, dtype=FRAME)
    emulator = build(CAR)
    expected = play(emulator, none, list(range(500, 9001, 500)))
    assert len(expected) > 8192 * FRAME.itemsize
    assert play(build(CAR), none, [9000]) == expected


@pytest.mark.parametrize("at", [650, 1234, 2030, 2710])
def test_a_snapshot_goes_on_as_the_run_did(at: int) -> None:
    frames = drive()
    emulator = build(CAR)
    play(emulator, frames, [at])
    saved = emulator.snapshot()
    rest = play(emulator, frames, [3000], at)
    state = emulator.snapshot()
    emulator.restore(saved)
    assert emulator.now_ns == at * MS
    assert play(emulator, frames, [3000], at) == rest
    assert emulator.snapshot() == state
    other = Emulator(CAR)
    other.restore(saved)
    assert play(other, frames, [3000], at) == rest


@pytest.mark.parametrize(
    "other", [Setup(model="4dof"), Setup(model="16dof", nodes={"MCU2": "external"})]
)
def test_a_snapshot_of_another_emulator_is_refused(other: Setup) -> None:
    with pytest.raises(ValueError, match="another emulator"):
        build(CAR).restore(build(other).snapshot())
    build(Setup(model="16dof", start="off")).restore(build(CAR).snapshot())


def echo_times(bench: Bench, t_ns: int) -> list[tuple[float, float]]:
    """Send one request at a time in ns; return when its echo is seen."""
    bench.run(300)
    del bench.sending["HCU_EM2Request"]
    data = bench.frame(
        "HCU_EM2Request",
        {**IDLE["HCU_EM2Request"], "EM2TorqueRequest": 77.0},
        bench.counters["HCU_EM2Request"],
    )
    frames = make_frames(1)
    frames[0]["t_ns"], frames[0]["id"], frames[0]["length"] = t_ns, 0x0C0, len(data)
    frames[0]["data"][: len(data)] = list(data)
    sent = bench.emulator.advance(330 * MS, frames, 1)
    bench.log.add(sent, len(sent))
    t, values = bench.series("EM2TorqueEcho", 300)
    return list(zip(t.round(3).tolist(), values.tolist(), strict=True))


def test_a_frame_acts_at_the_first_tick_at_or_after_its_time() -> None:
    # MCU2_Torque is sent at 300 and 320 ms.
    assert echo_times(Bench(CAR), 320 * MS) == [(300.0, 0.0), (320.0, 77.0)]
    assert echo_times(Bench(CAR), 320 * MS - 1) == [(300.0, 0.0), (320.0, 77.0)]
    assert echo_times(Bench(CAR), 320 * MS + 1) == [(300.0, 0.0), (320.0, 0.0)]
    assert echo_times(Bench(CAR), 299 * MS) == [(300.0, 77.0), (320.0, 77.0)]


def test_what_is_sent_at_a_tick_knows_the_request_but_not_yet_its_effect() -> None:
    bench = Bench(CAR).run(301)
    bench.ask(BrakeTorqueRequest=0.0, EM2TorqueRequest=200.0)
    for _ in range(20):
        bench.run(1)
        if bench.emulator.truth("em2_torque") > 0.0:
            break
    # Received at 310, acted on in the same tick: the plant moves from 310 to 311 ms, after one
    # period of delay in the machine.
    assert bench.now_ms == 311 + 1
    t, torque = bench.series("EM2Torque", 300)
    assert t.tolist() == pytest.approx([301.0, 311.0])
    assert torque[-1] == 0.0


def test_a_frame_later_than_the_last_tick_is_never_lost_in_silence() -> None:
    frames = make_frames(1)
    frames[0]["t_ns"] = 10 * MS - 999_999  # the tick at 9 ms is the last before 10 ms
    with pytest.raises(ValueError, match="1 frames later"):
        build(CAR).advance(10 * MS, frames, 1)
    frames[0]["t_ns"] = 9 * MS
    build(CAR).advance(10 * MS, frames, 1)


def test_of_two_frames_in_a_tick_the_later_one_counts() -> None:
    bench = Bench(CAR).run(300)
    frames = make_frames(2)
    for i, (torque, t_ns) in enumerate(((50.0, 309 * MS + 100), (90.0, 310 * MS))):
        counter = bench.counters["HCU_EM2Request"] + i
        values = {**IDLE["HCU_EM2Request"], "EM2TorqueRequest": torque}
        data = bench.frame("HCU_EM2Request", values, counter)
        frames[i]["t_ns"], frames[i]["id"], frames[i]["length"] = t_ns, 0x0C0, len(data)
        frames[i]["data"][: len(data)] = list(data)
    bench.emulator.advance(325 * MS, frames, 2)
    assert bench["EM2TorqueEcho"] == 90.0


def test_frames_of_a_tick_leave_by_identifier_and_carry_its_time() -> None:
    bench = Bench(CAR).run(2000)
    t, ids = bench.frames["t_ns"], bench.frames["id"].astype(np.int64)
    assert (np.diff(t) >= 0).all()
    assert (t % MS == 0).all()
    together = np.diff(t) == 0
    assert together.sum() > 500
    assert (np.diff(ids)[together] > 0).all()
    assert (bench.frames["flags"] & SENT == SENT).all()


def test_mean_periods_are_exact() -> None:
    bench = Bench(CAR).run(5000)
    for message in bench.database.messages:
        if message.sender == "HCU":
            continue
        times = bench.frames["t_ns"][bench.frames["id"] == message.can_id]
        assert (np.diff(times) == message.cycle_time_ns).all()
        assert len(times) == 5_000 * MS // message.cycle_time_ns


def test_a_played_frame_acts_one_tick_after_it_was_sent() -> None:
    bench = Bench(Setup(model="16dof", nodes={"HCU": "emulated"}), sending={}).run(100)
    emulator = bench.emulator
    emulator.set_value(bench.database.signal("BrakeTorqueRequest").index, 1000.0)
    bench.run(1)  # HCU_BrakeRequest goes out at 100 ms
    assert bench["BrakeTorqueRequest"] == 1000.0
    assert emulator.state.requests[ports.BRAKE_TORQUE_REQUEST] == 0.0
    bench.run(1)
    assert emulator.state.requests[ports.BRAKE_TORQUE_REQUEST] == 1000.0
    bench.run(1)  # ESC_Brake goes out at 102 ms
    assert bench["BrakeTorqueEcho"] == 1000.0
