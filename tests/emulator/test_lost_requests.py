"""What the units do when requests stop, come damaged, or ask for nonsense: on CAN alone."""

from __future__ import annotations

import numpy as np
import pytest
from can_bench import IDLE, Bench, Tamper

from hev_can_emu.messages.protection import protect
from hev_can_emu.runtime.setup import Setup

CAR = Setup(model="4dof")


def drop(data: bytearray, count: int) -> None:
    return None


def wrong_crc(data: bytearray, count: int) -> bytearray:
    data[0] ^= 0x5A
    return data


class Frozen:
    """Repeats the first frame it sees, as a sender whose task hangs and whose driver goes on."""

    def __init__(self) -> None:
        self.data: bytearray | None = None

    def __call__(self, data: bytearray, count: int) -> bytearray:
        if self.data is None:
            self.data = data
        return self.data


def too_short(data: bytearray, count: int) -> bytearray:
    return data[:7]


def driving(torque: float = 100.0) -> Bench:
    """Return a car that EM2 has pulled for half a second."""
    return Bench(CAR).ask_and_run(500, EM2TorqueRequest=torque)


def test_a_request_never_received_leaves_the_unit_safe_and_says_so() -> None:
    bench = Bench(CAR, sending={}).run(200)
    for name in ("EM1", "EM2", "Engine", "Clutch", "Synchronizer", "Brake", "HV"):
        assert bench.label(f"{name}RequestStatus") == "NeverReceived"
    assert bench["RequestsFailed"] == 7
    assert bench["EM2Torque"] == 0.0
    assert bench.label("EM2State") == "Standby"
    assert bench.label("EngineState") == "Off"
    assert bench.label("ClutchState") == "Open"
    assert bench.label("ContactorState") == "Closed"  # as it was at the start
    assert np.isnan(bench["EM2TorqueEcho"])


def test_lost_means_older_than_three_periods_to_the_tick() -> None:
    bench = driving()
    last = bench.now_ms - 10
    bench.tamper["HCU_EM2Request"] = drop
    bench.run(30 - (bench.now_ms - last) + 1)  # the tick at last + 30 ms is done
    assert bench.now_ms == last + 31
    assert not [event for event in bench.events if event.kind == "lost"]
    bench.run(1)
    lost = [event for event in bench.events if event.kind == "lost"]
    assert [(event.t_ns, event.text) for event in lost] == [
        ((last + 31) * 1_000_000, "HCU_EM2Request: timed out, ramp to zero, U1102-87")
    ]


@pytest.mark.parametrize(
    ("tamper", "status"),
    [(drop, "Timeout"), (wrong_crc, "CRCWrong"), (too_short, "LengthWrong")],
)
def test_bad_frames_never_refresh_the_time_out(tamper: Tamper, status: str) -> None:
    bench = driving()
    start = bench.now_ms
    bench.tamper["HCU_EM2Request"] = tamper
    bench.run(400)
    assert bench.labels("EM2RequestStatus", start) == ["OK", status]
    assert bench.labels("EM2LimitReason", start)[-1] == "RequestLost"
    assert start + 21 <= bench.first("EM2RequestStatus", status, start) <= start + 31
    assert bench["EM2Torque"] == 0.0
    assert bench["EM2TorqueEcho"] == 100.0  # as last received
    assert bench["RequestsFailed"] == 1
    assert bench["RejectedFrames"] == {"Timeout": 0}.get(status, pytest.approx(36, abs=5))


def test_a_frozen_counter_and_not_available_are_told_as_such() -> None:
    bench = driving()
    start = bench.now_ms
    bench.tamper["HCU_EM2Request"] = Frozen()
    bench.run(400)
    assert bench.labels("EM2RequestStatus", start) == ["OK", "CounterWrong"]
    assert bench["EM2Torque"] == 0.0
    bench = driving()
    start = bench.now_ms
    bench.ask_and_run(20, EM2TorqueRequest=None)
    assert bench["EM2Torque"] == pytest.approx(100.0, abs=0.1)  # the last good request holds
    bench.run(380)
    assert bench.labels("EM2RequestStatus", start) == ["OK", "SignalNotAvailable"]
    assert bench["EM2Torque"] == 0.0


def test_a_value_outside_its_range_is_refused_not_obeyed() -> None:
    bench = driving()
    start = bench.now_ms

    def mode_five(data: bytearray, count: int) -> bytearray:
        data = bytearray(data)
        data[1] = data[1] & 0x8F | 5 << 4
        return protected(bench, "HCU_EM2Request", data)

    bench.tamper["HCU_EM2Request"] = mode_five
    bench.run(400)
    assert bench.labels("EM2RequestStatus", start) == ["OK", "OutOfRange"]
    assert bench["EM2Torque"] == 0.0
    assert bench.label("EM2ControlModeEcho") == "Torque"


def protected(bench: Bench, message: str, data: bytearray) -> bytearray:
    """Return the bytes with a fresh CRC."""
    array = np.frombuffer(bytes(data), dtype=np.uint8).copy()
    definition = bench.database.message(message)
    protect(bench.protection, definition.index, array, definition.length, data[1] & 15)
    return bytearray(array.tobytes())


@pytest.mark.parametrize("torque", [100.0, -60.0])
def test_torque_goes_to_zero_on_a_straight_line_within_200_ms(torque: float) -> None:
    bench = driving(torque)
    start = bench.now_ms
    bench.tamper["HCU_EM2Request"] = drop
    bench.run(400)
    lost = next(event.t_ns for event in bench.events if event.kind == "lost") / 1e6
    t, values = bench.series("EM2Torque", start)
    line = torque * np.clip(1.0 - (t - lost) / 150.0, 0.0, 1.0)
    assert np.abs(values - line).max() < 0.05 * abs(torque)
    assert np.all(values[t >= lost + 200.0] == 0.0)
    t, values = bench.series("EM2TorqueSetpoint", start)
    assert np.all(values[t >= lost + 155.0] == 0.0)


@pytest.mark.parametrize("bound", [None, 40.0])
def test_speed_control_gives_up_its_torque_too(bound: float | None) -> None:
    bench = engaged("G1")  # the whole car to accelerate
    bench.ask_and_run(300, EM1ControlMode="Speed", EM1SpeedRequest=6000.0, EM1TorqueMax=bound)
    assert bench["EM1Torque"] > 35.0
    start = bench.now_ms
    bench.tamper["HCU_EM1Request"] = drop
    bench.run(500)
    lost = next(event.t_ns for event in bench.events if event.kind == "lost") / 1e6
    t, values = bench.series("EM1Torque", start)
    most = bound or 130.0
    line = most * np.clip(1.0 - (t - lost) / 150.0, 0.0, 1.0)
    assert np.all(np.abs(values) <= line + 0.05 * most)
    assert np.all(values[t >= lost + 200.0] == 0.0)
    assert bench.labels("EM1LimitReason", start)[-1] == "RequestLost"


def test_a_short_circuit_ends_with_the_request() -> None:
    bench = Bench(CAR).ask_and_run(800, EM1ControlMode="Speed", EM1SpeedRequest=3000.0)
    bench.ask_and_run(50, EM1ControlMode="ASC")
    assert bench["EM1Torque"] < -5.0
    bench.tamper["HCU_EM1Request"] = drop
    bench.run(260)
    assert bench["EM1Torque"] == 0.0
    assert bench.label("EM1State") == "Standby"


def test_the_engine_falls_to_idle_and_c1_opens() -> None:
    bench = running_engine()
    assert bench.label("ClutchState") == "Locked"
    start = bench.now_ms
    for name in bench.sending:
        bench.tamper[name] = drop
    bench.run(1000)
    t, setpoint = bench.series("EngineTorqueSetpoint", start)
    lost = min(event.t_ns for event in bench.events if event.kind == "lost") / 1e6
    assert setpoint[(t > start) & (t < lost)].min() > 35.0
    assert np.abs(setpoint[t >= lost + 90.0]).max() < 1.0  # the idle governor takes over
    t, torque = bench.series("EngineTorque", start)
    assert np.abs(torque[t >= lost + 200.0]).max() < 0.1 * 40.0  # the intake's lag is 50 ms
    t, capacity = bench.series("ClutchTorqueCapacity", start)
    assert capacity[t >= lost + 200.0].max() < 1.0
    assert capacity[t >= lost + 300.0].max() == 0.0
    assert bench.labels("ClutchState", start)[-1] == "Open"
    assert bench.label("ClutchRequestStatus") == "Timeout"
    assert bench.label("EngineState") == "Running"
    speed = bench["EngineSpeed"]
    bench.run(2000)
    assert abs(bench["EngineTorque"]) < 1.0  # after friction: it neither races nor stalls
    assert 835.0 < bench["EngineSpeed"] < speed + 5.0
    assert bench.label("ContactorState") == "Closed"
    assert bench["RequestsFailed"] == 7


def running_engine() -> Bench:
    """Return a car in series: engine cranked by EM1 through C1, 40 N m against EM1's speed control."""
    bench = Bench(CAR).ask_and_run(
        1200, EM1ControlMode="Speed", EM1SpeedRequest=1500.0, ClutchTorqueCapacityRequest=200.0
    )
    bench.ask_and_run(1500, EngineRunRequest="Run", EngineTorqueRequest=40.0)
    assert bench.label("EngineState") == "Running"
    return bench


def engaged(gear: str) -> Bench:
    """Return a car at rest in a gear."""
    bench = Bench(CAR).ask_and_run(300, GearRequest=gear, ShiftForceRequest=800.0)
    assert bench.label("Gear") == gear
    return bench


@pytest.mark.parametrize("gear", ["Neutral", "G1", "G2"])
def test_the_sleeve_stays(gear: str) -> None:
    bench = Bench(CAR).run(100) if gear == "Neutral" else engaged(gear)
    start, position = bench.now_ms, bench["SleevePosition"]
    bench.tamper["HCU_SynchronizerRequest"] = drop
    bench.run(1000)
    assert bench.labels("Gear", start) == [gear]
    assert bench["SleevePosition"] == position
    assert bench.labels("SynchronizerLimitReason", start) == ["None", "RequestLost"]


@pytest.mark.parametrize("after", [5, 12, 40, 200])
def test_a_shift_under_way_is_given_up(after: int) -> None:
    bench = Bench(CAR).ask_and_run(1500, EM1ControlMode="Speed", EM1SpeedRequest=5000.0)
    bench.ask_and_run(after, GearRequest="G1", ShiftForceRequest=300.0)
    assert bench.label("Gear") in ("Between", "Neutral")
    bench.tamper["HCU_SynchronizerRequest"] = drop
    bench.run(500)
    assert bench.label("Gear") == "Neutral"
    assert bench["SleevePosition"] == 0.0
    assert "G1" not in bench.labels("Gear")


def test_the_brake_falls_back_to_the_pedal() -> None:
    bench = Bench(Setup(model="4dof", nodes={"VEH": "external"}))
    bench.ask(SelectorPosition="D", AcceleratorPedal=0.0, BrakePedal=30.0, IgnitionState="On")
    bench.ask_and_run(300, BrakeTorqueRequest=500.0)
    assert bench["BrakeTorque"] == pytest.approx(500.0, abs=1.0)  # the request rules
    bench.tamper["HCU_BrakeRequest"] = drop
    bench.run(600)
    assert bench["BrakeTorque"] == pytest.approx(0.3 * 6500.0, rel=0.01)
    assert bench.label("BrakeRequestStatus") == "Timeout"
    assert bench.label("BrakeLimitReason") == "RequestLost"
    del bench.tamper["HCU_BrakeRequest"]
    bench.run(600)
    assert bench["BrakeTorque"] == pytest.approx(500.0, abs=1.0)


@pytest.mark.parametrize("lost", [80, 150, 600, 650])
def test_everything_recovers_when_requests_return(lost: int) -> None:
    bench = driving()
    bench.tamper["HCU_EM2Request"] = drop
    bench.run(lost)
    del bench.tamper["HCU_EM2Request"]
    start = bench.now_ms
    bench.run(60)
    told = bench.labels("EM2RequestStatus", start - 20)
    # After a gap the first frame's counter may have jumped: the second is taken at the latest.
    assert told in (["Timeout", "OK"], ["Timeout", "CounterWrong", "OK"])
    assert bench.first("EM2RequestStatus", "OK", start) - start <= 21
    assert bench["EM2Torque"] == pytest.approx(100.0, abs=0.1)
    bench.run(100)
    assert bench["RequestsFailed"] == 0
    assert [event.kind for event in bench.events if event.kind in ("lost", "healed")] == [
        "lost", "healed",
    ]  # fmt: skip


def test_single_frames_may_go_missing_or_astray() -> None:
    """One lost frame in a row is tolerated; every second one damaged keeps the request alive."""
    for tamper in (
        lambda data, count: None if count % 2 else data,
        lambda data, count: wrong_crc(data, count) if count % 2 else data,
    ):
        bench = driving()
        start = bench.now_ms
        bench.tamper["HCU_EM2Request"] = tamper
        bench.run(500)
        assert bench.labels("EM2RequestStatus", start) == ["OK"]
        assert bench["EM2Torque"] == pytest.approx(100.0, abs=0.1)


@pytest.mark.parametrize(
    ("mode", "obeyed", "rejected"),
    [("off", True, 0), ("observe", True, 40), ("enforce", False, 40)],
)
def test_protection_modes(mode: str, obeyed: bool, rejected: int) -> None:
    """off does not look, observe counts and obeys, enforce counts and refuses."""
    bench = Bench(Setup(model="4dof", protection=mode))
    bench.tamper["HCU_EM2Request"] = wrong_crc
    bench.ask_and_run(400, EM2TorqueRequest=100.0)
    assert bench["EM2Torque"] == pytest.approx(100.0 if obeyed else 0.0, abs=0.1)
    assert bench.label("EM2RequestStatus") == ("OK" if obeyed else "CRCWrong")
    assert bench["RejectedFrames"] == pytest.approx(rejected, abs=5)


def test_observe_still_refuses_what_cannot_be_read() -> None:
    bench = Bench(Setup(model="4dof", protection="off"))
    bench.tamper["HCU_EM2Request"] = too_short
    bench.ask_and_run(300, EM2TorqueRequest=100.0)
    assert bench.label("EM2RequestStatus") == "LengthWrong"
    assert bench["EM2Torque"] == 0.0


def test_messages_are_watched_one_by_one() -> None:
    bench = Bench(CAR, sending={"HCU_EM2Request": IDLE["HCU_EM2Request"]})
    bench.ask_and_run(500, EM2TorqueRequest=50.0)
    assert bench["EM2Torque"] == pytest.approx(50.0, abs=0.1)
    assert bench["RequestsFailed"] == 6
