"""What the signals mean: signs and quantities checked against each other on CAN."""

from __future__ import annotations

import math

import numpy as np
import pytest
from can_bench import Bench

from hev_can_emu.runtime.setup import Setup

G = 9.80665


def on_hill(grade: float, **requests: float) -> Bench:
    """Return a car at rest on a slope, %, whose driver is external."""
    bench = Bench(Setup(model="4dof", nodes={"VEH": "external"}))
    bench.ask(IgnitionState="On", SelectorPosition="D", BrakePedal=0.0, AcceleratorPedal=0.0)
    bench.ask(RoadGrade=grade, AmbientTemperature=20.0, **requests)
    return bench


@pytest.mark.parametrize("model", ["4dof", "16dof"])
def test_positive_torque_drives_forward_and_consumes(model: str) -> None:
    bench = Bench(Setup(model=model)).ask_and_run(6000, EM2TorqueRequest=100.0)
    for name in ("VehicleSpeed", "WheelSpeedFL", "WheelSpeedFR", "WheelSpeedRL", "WheelSpeedRR"):
        assert bench[name] > 5.0
    assert bench["EM2Speed"] > 0.0
    assert bench["EM2DCPower"] > 1.0
    assert bench["EM2DCCurrent"] > 3.0
    assert bench["BatteryCurrent"] < -3.0
    assert bench["LongitudinalAcceleration"] > 0.5
    power = bench["EM2DCVoltage"] * bench["EM2DCCurrent"] / 1e3
    assert power == pytest.approx(bench["EM2DCPower"], rel=0.02, abs=0.05)
    # Mechanical power and losses: what the terminals take is more than what the shaft gives.
    shaft = bench["EM2Torque"] * bench["EM2Speed"] * math.pi / 30e3
    assert shaft < bench["EM2DCPower"] < 1.3 * shaft + 2.0
    bench.ask_and_run(300, EM2TorqueRequest=-60.0)
    assert bench["EM2DCPower"] < -1.0
    assert bench["BatteryCurrent"] > 3.0
    assert bench["LongitudinalAcceleration"] < -0.4


def test_negative_torque_drives_backward() -> None:
    bench = Bench(Setup(model="4dof")).ask_and_run(3000, EM2TorqueRequest=-60.0)
    for name in ("VehicleSpeed", "WheelSpeedFL", "WheelSpeedRR", "EM2Speed"):
        assert bench[name] < -3.0
    assert bench["EM2DCPower"] > 0.5  # driving backward consumes all the same
    assert bench["BatteryCurrent"] < 0.0


def test_wheels_follow_the_ratio_and_the_body() -> None:
    bench = Bench(Setup(model="16dof")).ask_and_run(6000, EM2TorqueRequest=60.0)
    bench.ask_and_run(3000, EM2TorqueRequest=0.0)
    ratio = 1.850703 * 3.0276
    wheel = bench["EM2Speed"] * math.pi / 30 / ratio * 0.356033146 * 3.6
    for name in ("WheelSpeedFL", "WheelSpeedFR"):
        assert bench[name] == pytest.approx(wheel, abs=0.03)
    for name in ("WheelSpeedRL", "WheelSpeedRR"):
        assert bench[name] == pytest.approx(bench["VehicleSpeed"], abs=0.011)


def test_state_of_charge_is_the_integral_of_the_terminal_current() -> None:
    bench = Bench(Setup(model="4dof")).run(100)
    start, truth = bench["StateOfCharge"], bench.emulator.truth("state_of_charge")
    begin = bench.now_ms
    for torque in (200.0, 50.0, -150.0, 120.0, 200.0, -80.0):
        bench.ask_and_run(4000, EM2TorqueRequest=torque)
    t, current = bench.series("BatteryCurrent", begin)
    assert current.min() < -60.0
    assert current.max() > 10.0
    assert np.diff(t) == pytest.approx(20.0)
    charge = 0.020 * current.sum()
    capacity = 51.3889 * 3600.0
    moved = (bench.emulator.truth("state_of_charge") - truth) * capacity
    assert moved < -100.0
    assert charge == pytest.approx(moved, rel=0.01)
    told = (bench["StateOfCharge"] - start) / 100.0 * capacity
    step = bench.database.signal("StateOfCharge").scale / 100.0 * capacity
    assert told == pytest.approx(moved, abs=step)


def test_battery_balances_the_machines() -> None:
    bench = Bench(Setup(model="4dof")).ask_and_run(3000, EM2TorqueRequest=150.0)
    power = -bench["BatteryVoltage"] * bench["BatteryCurrent"] / 1e3
    load = bench["EM1DCPower"] + bench["EM2DCPower"] + 0.5  # auxiliaries
    assert power == pytest.approx(load, rel=0.03)
    assert bench["BatteryVoltage"] < 355.0  # sags under load


def test_engine_torque_is_after_friction() -> None:
    bench = Bench(Setup(model="4dof")).ask_and_run(
        1500, EM1ControlMode="Speed", EM1SpeedRequest=2600.0, ClutchTorqueCapacityRequest=200.0
    )
    # Dragged by EM1: friction shows as negative torque, carried through C1.
    assert bench.label("EngineState") == "Off"
    assert bench.label("ClutchState") == "Locked"
    assert -20.0 < bench["EngineTorque"] < -14.0
    assert bench["ClutchTorqueTransmitted"] == pytest.approx(bench["EngineTorque"], abs=1.0)
    assert bench["EM1DCPower"] > 1.0
    bench.ask_and_run(2000, EngineRunRequest="Run", EngineTorqueRequest=60.0)
    assert bench["EngineTorque"] == pytest.approx(60.0, abs=1.0)
    assert bench["ClutchTorqueTransmitted"] == pytest.approx(60.0, abs=2.0)
    assert bench["EM1Torque"] == pytest.approx(-60.0 / 1.2987, abs=2.0)
    assert bench["EM1DCPower"] < -5.0
    assert bench["BatteryCurrent"] > 10.0  # series: the engine charges


def test_clutch_slip_is_engine_side_minus_transmission_side() -> None:
    bench = Bench(Setup(model="4dof"))
    bench.ask_and_run(1000, EM1ControlMode="Speed", EM1SpeedRequest=2000.0)
    assert bench["EngineSpeed"] == 0.0
    assert bench["ClutchSlipSpeed"] == pytest.approx(-2000.0 / 1.2987, abs=15.0)


def test_held_on_a_hill_the_accelerometer_feels_gravity() -> None:
    bench = on_hill(10.0, BrakeTorqueRequest=2000.0).run(1500)
    sine = math.sin(math.atan(0.10))
    assert bench.label("VehicleStandstill") == "Held"
    assert bench["VehicleSpeed"] == 0.0
    assert bench["LongitudinalAcceleration"] == pytest.approx(0.0, abs=0.002)
    assert bench["LongitudinalAccelerationSensor"] == pytest.approx(G * sine, abs=0.003)


@pytest.mark.parametrize("grade", [10.0, -10.0])
def test_without_brakes_it_rolls_down(grade: float) -> None:
    bench = on_hill(grade).run(3000)
    down = -math.copysign(1.0, grade)
    assert bench.label("VehicleStandstill") == "Moving"
    for name in ("VehicleSpeed", "WheelSpeedFL", "WheelSpeedRL"):
        assert down * bench[name] > 5.0
    sine = math.sin(math.atan(grade / 100.0))
    acceleration = bench["LongitudinalAcceleration"]
    assert down * acceleration > 0.5
    assert bench["LongitudinalAccelerationSensor"] == pytest.approx(
        acceleration + G * sine, abs=0.003
    )


def test_torque_against_the_slope_holds_it_about_as_physics_says() -> None:
    mass, radius, ratio = 1722.0, 0.356033146, 1.850703 * 3.0276
    torque = mass * G * math.sin(math.atan(0.10)) * radius / ratio
    bench = on_hill(10.0, BrakeTorqueRequest=3000.0, EM2TorqueRequest=torque).run(1000)
    bench.ask_and_run(2000, BrakeTorqueRequest=0.0)
    assert abs(bench["VehicleSpeed"]) < 0.3
    bench.ask_and_run(1500, EM2TorqueRequest=1.3 * torque)
    assert bench["VehicleSpeed"] > 0.5
