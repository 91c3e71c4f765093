"""Broken actuators, machines, valves and sensors: what acts, and what a client on the bus is told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from can_bench import Bench, build

from hev_can_emu.ecu.faults import parse
from hev_can_emu.errors import InputError
from hev_can_emu.runtime.setup import Setup

CAR = Setup(model="4dof")


def series(setup: Setup = CAR) -> Bench:
    """Return a car in series: the engine gives 40 N m against EM1's speed control, EM2 80 N m."""
    bench = Bench(setup).ask_and_run(
        1200, EM1ControlMode="Speed", EM1SpeedRequest=1500.0, ClutchTorqueCapacityRequest=200.0
    )
    bench.ask_and_run(1500, EngineRunRequest="Run", EngineTorqueRequest=40.0, EM2TorqueRequest=80.0)
    assert bench.label("DrivingMode") == "Series"
    return bench


def broken(bench: Bench, ms: int = 600, ask: dict[str, Any] | None = None, **fault: Any) -> Bench:
    name = bench.emulator.inject(parse(fault))
    bench.ask_and_run(ms, **(ask or {}))
    assert bench["FaultsActive"] == 1
    record = bench.emulator.faults[-1]
    assert (record.name, record.hits) == (name, ms)
    return bench


@pytest.mark.parametrize("model", ["4dof", "16dof"])
@pytest.mark.parametrize(
    ("actuator", "ask", "signal", "value"),
    [
        ("engine", {"EngineTorqueRequest": 90.0}, "EngineTorque", 40.0),
        ("em2", {"EM2TorqueRequest": -50.0}, "EM2Torque", 80.0),
        ("em2", {"EM2ControlMode": "Off"}, "EM2Torque", 80.0),
        ("clutch", {"ClutchTorqueCapacityRequest": 0.0}, "ClutchTorqueCapacity", 200.0),
        ("brake", {"BrakeTorqueRequest": 700.0}, "BrakeTorque", 0.0),
        ("contactors", {"ContactorRequest": "Open"}, "ContactorState", 2.0),
        ("shift", {"GearRequest": "G1", "ShiftForceRequest": 900.0}, "SleevePosition", 0.0),
    ],
)
def test_a_stuck_actuator_stays_where_it_is(
    model: str, actuator: str, ask: dict[str, Any], signal: str, value: float
) -> None:
    bench = broken(series(Setup(model=model)), ask=ask, fault="actuator_stuck", actuator=actuator)
    assert bench[signal] == pytest.approx(value, abs=0.3)


def test_where_an_actuator_is_stuck_may_be_said_and_its_unit_does_not_know() -> None:
    bench = broken(series(), fault="actuator_stuck", actuator="clutch", value="15 Nm")
    assert bench["ClutchTorqueCapacity"] == pytest.approx(15.0, abs=0.2)
    assert bench["ClutchTorqueCapacitySetpoint"] == 200.0
    assert bench.label("ClutchState") == "Slipping"
    assert bench.label("ClutchLimitReason") == "None"
    bench.emulator.clear("actuator_stuck clutch")
    bench.run(600)
    assert bench.label("ClutchState") == "Locked"
    assert bench["FaultsActive"] == 0


@pytest.mark.parametrize(
    ("actuator", "ask", "signal", "start", "end"),
    [
        ("engine", {"EngineTorqueRequest": 80.0}, "EngineTorqueSetpoint", 40.0, 80.0),
        ("em2", {"EM2TorqueRequest": 20.0}, "EM2Torque", 80.0, 20.0),
        ("clutch", {"ClutchTorqueCapacityRequest": 60.0}, "ClutchTorqueCapacity", 200.0, 60.0),
        ("brake", {"BrakeTorqueRequest": 900.0}, "BrakeTorque", 0.0, 900.0),
    ],
)
def test_a_slow_actuator_lags(
    actuator: str, ask: dict[str, Any], signal: str, start: float, end: float
) -> None:
    """After one time constant 63 % of the way are done; the actuator's own lag comes on top."""
    bench = broken(
        series(), 500, ask, fault="actuator_slow", actuator=actuator, time_constant="500 ms"
    )
    done = (bench[signal] - start) / (end - start)
    assert 0.55 < done < 0.66
    bench.run(3000)
    assert bench[signal] == pytest.approx(end, abs=2.0)


@pytest.mark.parametrize("model", ["4dof", "16dof"])
def test_a_derated_machine_says_so(model: str) -> None:
    bench = series(Setup(model=model))
    most = bench["EM2TorqueAvailableMax"]
    broken(
        bench, ask={"EM2TorqueRequest": 200.0}, fault="machine_derated", machine="em2", share=0.3
    )
    assert bench["EM2Torque"] == pytest.approx(0.3 * most, abs=0.2)
    assert bench["EM2TorqueAvailableMax"] == pytest.approx(0.3 * most, abs=0.2)
    assert bench["EM2TorqueAvailableMin"] == pytest.approx(-0.3 * most, abs=0.2)
    assert bench.label("EM2LimitReason") == "Fault"
    bench.ask_and_run(200, EM2TorqueRequest=20.0)
    assert bench.label("EM2LimitReason") == "None"  # enough for this
    assert bench.label("EM2State") == "Torque"


def test_derated_engine_and_speed_control() -> None:
    bench = broken(series(), ask={"EngineTorqueRequest": 90.0}, fault="machine_derated",
                   machine="engine", share=0.5)  # fmt: skip
    assert bench["EngineTorque"] == pytest.approx(bench["EngineTorqueAvailableMax"], abs=0.3)
    assert bench.label("EngineLimitReason") == "Fault"
    bench = broken(series(), fault="machine_derated", machine="em1", share=0.1)
    assert bench.label("EM1LimitReason") == "Fault"
    assert bench["EM1Torque"] == pytest.approx(bench["EM1TorqueAvailableMin"], abs=0.3)
    assert bench["EngineSpeed"] > 1700.0  # EM1 cannot hold it any more


@pytest.mark.parametrize("model", ["4dof", "16dof"])
def test_a_tripped_machine(model: str) -> None:
    bench = broken(series(Setup(model=model)), fault="machine_tripped", machine="em2")
    assert (
        bench["EM2Torque"]
        == bench["EM2TorqueAvailableMax"]
        == bench["EM2TorqueAvailableMin"]
        == 0.0
    )
    assert (bench.label("EM2State"), bench.label("EM2LimitReason")) == ("Fault", "Fault")
    assert bench["EM2TorqueEcho"] == 80.0
    bench = broken(series(Setup(model=model)), fault="machine_tripped", machine="engine")
    assert (bench.label("EngineState"), bench.label("EngineLimitReason")) == ("Fault", "Fault")
    assert bench["EngineTorque"] < -5.0  # its drag
    bench.emulator.clear("machine_tripped engine")
    bench.run(500)
    assert bench.label("EngineState") == "Running"


@pytest.mark.parametrize("model", ["4dof", "16dof"])
def test_an_active_short_circuit_brakes(model: str) -> None:
    bench = broken(series(Setup(model=model)), fault="machine_short_circuit", machine="em2")
    assert (bench.label("EM2State"), bench.label("EM2LimitReason")) == ("ASC", "Fault")
    assert bench["EM2Torque"] < -5.0
    assert bench["EM2DCPower"] == 0.0


@pytest.mark.parametrize("model", ["4dof", "detailed"])
def test_a_leak_lets_the_clutch_slip(model: str) -> None:
    bench = broken(series(Setup(model=model)), fault="clutch_leak", share=0.9)
    assert bench["ClutchTorqueCapacity"] == pytest.approx(20.0, abs=0.2)
    assert bench["ClutchTorqueCapacitySetpoint"] == 200.0
    assert bench.label("ClutchState") == "Slipping"


@pytest.mark.parametrize(("model", "within"), [("4dof", 0.3), ("detailed", 1.5)])
@pytest.mark.parametrize(("opening", "capacity"), [(0.0, 0.0), (0.5, 200.0)])
def test_a_stuck_clutch_valve(opening: float, capacity: float, model: str, within: float) -> None:
    car = series(Setup(model=model))
    bench = broken(car, fault="valve_stuck", valve="clutch", opening=opening)
    assert bench["ClutchTorqueCapacity"] == pytest.approx(capacity, abs=within)
    bench.ask_and_run(600, ClutchTorqueCapacityRequest=0.0)
    assert bench["ClutchTorqueCapacity"] == pytest.approx(capacity, abs=within)


def shift(model: str, gear: str, **fault: Any) -> Bench:
    bench = Bench(Setup(model=model)).run(50)
    bench.emulator.inject(parse({"fault": "valve_stuck", **fault}))
    return bench.ask_and_run(400, GearRequest=gear, ShiftForceRequest=800.0)


@pytest.mark.parametrize("model", ["4dof", "detailed"])
def test_stuck_shift_valves(model: str) -> None:
    assert shift(model, "G1", valve="g1", opening=0.0)["SleevePosition"] == 0.0
    assert shift(model, "G2", valve="g1", opening=0.0).label("Gear") == "G2"
    # Pressure on one side only moves the sleeve though nobody asks.
    assert shift(model, "Neutral", valve="g2", opening=0.5).label("Gear") == "G2"
    # The stronger side wins.
    assert shift(model, "G2", valve="g1", opening=1.0).label("Gear") == "G1"


def test_a_lost_speed_sensor_trips_its_machine() -> None:
    bench = broken(series(), fault="sensor_failure", sensor="em2_speed")
    assert np.isnan(bench["EM2Speed"])
    assert (bench.label("EM2State"), bench["EM2Torque"]) == ("Fault", 0.0)
    assert bench.emulator.truth("em2_speed") > 1.0


def test_a_sensor_that_stays() -> None:
    bench = series()
    before = bench.emulator.measured("vehicle_speed")
    broken(bench, fault="sensor_failure", sensor="vehicle_speed", mode="stuck")
    assert bench["VehicleSpeed"] == pytest.approx(3.6 * before, abs=0.02)
    assert bench.emulator.measured("vehicle_speed") == pytest.approx(before, abs=0.01)
    assert bench.emulator.truth("vehicle_speed") > before + 0.3
    assert bench["WheelSpeedFL"] > 3.6 * before + 1.0


def test_measured_is_not_true() -> None:
    """The shipped sensors: a dead zone at the wheels, whole kelvins, a filtered accelerometer."""
    bench = Bench(CAR).ask_and_run(600, EM2TorqueRequest=40.0)
    _, wheel = bench.series("WheelSpeedFL")
    small = np.abs(wheel) < 0.295
    assert set(wheel[small].tolist()) == {0.0}
    assert small.sum() > 5
    assert bench.emulator.truth("em2_winding_temperature") % 1.0 != 0.0
    assert bench.emulator.measured("em2_temperature") % 1.0 == 0.0


def test_emstate_while_booting() -> None:
    bench = Bench(Setup(model="4dof", start="off", nodes={"VEH": "external"}), sending={})
    bench.ask(SelectorPosition="D", AcceleratorPedal=0.0, BrakePedal=0.0, IgnitionState="On")
    bench.run(400)
    for motor in ("EM1", "EM2"):
        assert bench.labels(f"{motor}State") == ["Init", "Standby"]
        assert np.isnan(bench.series(f"{motor}Speed")[1][0])


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        (
            {"fault": "sensor_failure", "sensor": "em2_sped"},
            "fault.sensor: expected a status port, got 'em2_sped'; did you mean ",
        ),
        (
            {"fault": "actuator_stuck", "actuator": "contactors", "value": 0.5},
            "fault.value: expected 0 (open) or 1 (closed), got 0.5",
        ),
        (
            {"fault": "actuator_stuck", "actuator": "shift", "value": "5 Nm"},
            "fault.value: expected a number with a unit such as '1 N', got '5 Nm'",
        ),
        (
            {"fault": "actuator_stuck", "actuator": "clutch", "value": -1},
            "fault.value: expected 0 or more, got -1",
        ),
    ],
)
def test_what_is_refused(fault: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError) as refused:
        build(CAR).inject(parse(fault))
    assert str(refused.value).startswith(complaint)
    with pytest.raises(InputError, match=r"one of em1, em2, engine, got 'em3'"):
        parse({"fault": "machine_tripped", "machine": "em3"})
