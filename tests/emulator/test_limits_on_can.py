"""Requests beyond what a machine can do: limited, echoed as received, and the reason told on CAN."""

from __future__ import annotations

import pytest
from can_bench import Bench

from hev_can_emu.runtime.setup import Setup

CAR = Setup(model="4dof")


def with_battery(voltage: float, discharge: float = 100.0, charge: float = 60.0) -> Bench:
    """Return a car whose battery is external."""
    bench = Bench(Setup(model="4dof", nodes={"BMS": "external"}))
    bench.ask(BatteryVoltage=voltage, ContactorState="Closed", StateOfCharge=50.0)
    bench.ask(BatteryCurrent=0.0, ChargePowerLimit=charge, DischargePowerLimit=discharge)
    bench.ask(BatteryTemperature=25.0)
    return bench.run(100)


def test_peak_torque() -> None:
    bench = Bench(CAR).ask_and_run(200, EM2TorqueRequest=400.0)
    assert bench["EM2TorqueEcho"] == 400.0
    assert bench["EM2TorqueSetpoint"] == bench["EM2TorqueAvailableMax"] == 230.0
    assert bench.label("EM2LimitReason") == "PeakTorque"
    bench.ask_and_run(200, EM2TorqueRequest=-800.0)
    assert bench["EM2TorqueSetpoint"] == bench["EM2TorqueAvailableMin"] == -230.0
    assert bench["EM2TorqueEcho"] == -800.0


def test_speed() -> None:
    bench = Bench(CAR).ask_and_run(1500, EM1TorqueRequest=100.0)
    assert bench["EM1Speed"] > 11500.0
    assert bench["EM1TorqueSetpoint"] < 30.0
    assert bench.label("EM1LimitReason") == "Speed"
    assert bench["EM1TorqueAvailableMax"] < 30.0
    assert bench["EM1TorqueAvailableMin"] < -40.0  # braking torque stays
    assert bench["EM1TorqueEcho"] == 100.0


def test_voltage() -> None:
    bench = with_battery(215.0).ask_and_run(300, EM2TorqueRequest=200.0)
    assert bench.label("EM2LimitReason") == "Voltage"
    # No torque at 200 V, full at 240 V.
    expected = 230.0 * (215.0 - 200.0) / 40.0
    assert bench["EM2TorqueSetpoint"] == pytest.approx(expected, abs=0.2)


def test_battery_power_both_ways() -> None:
    bench = with_battery(350.0, discharge=10.0, charge=4.0)
    bench.ask_and_run(4000, EM2TorqueRequest=200.0)
    assert bench.label("EM2LimitReason") == "BatteryPower"
    assert bench["EM2DCPower"] == pytest.approx(9.5, abs=0.6)  # the auxiliaries take 0.5 kW
    start = bench.now_ms
    bench.ask_and_run(400, EM2TorqueRequest=-200.0)
    # Power held constant feeds the driveline's oscillation, so the limit comes and goes.
    assert "BatteryPower" in bench.labels("EM2LimitReason", start)
    _, power = bench.series("EM2DCPower", start + 20)
    # The auxiliaries and EM1's inverter take what the battery does not have to.
    assert power.min() == pytest.approx(-4.58, abs=0.02)


def test_an_empty_battery_drives_nothing_and_a_full_one_takes_nothing() -> None:
    for charge, torque in ((0.0, 100.0), (1.0, -100.0)):
        bench = Bench(Setup(model="4dof", state_of_charge=charge))
        bench.ask(EM1ControlMode="Off")
        bench.ask_and_run(1000, EM2TorqueRequest=torque)
        name = "DischargePowerLimit" if torque > 0 else "ChargePowerLimit"
        assert bench[name] < 0.1
        if torque > 0:
            assert bench["EM2Torque"] == 0.0
            assert bench.label("EM2LimitReason") == "BatteryPower"


def test_temperature() -> None:
    bench = Bench(Setup(model="4dof", nodes={"VEH": "external"}))
    bench.ask(IgnitionState="On", SelectorPosition="D", BrakePedal=0.0, AcceleratorPedal=0.0)
    bench.ask(RoadGrade=0.0, AmbientTemperature=75.0, BrakeTorqueRequest=6000.0)
    bench.ask(EM2TorqueRequest=200.0)
    bench.run_until(lambda: bench["EM2InverterTemperature"] > 90.0, 120_000, 500)
    bench.run(100)
    assert bench.label("EM2LimitReason") == "Temperature"
    assert bench["EM2TorqueSetpoint"] < 190.0
    assert bench["VehicleSpeed"] == 0.0


def test_disabled() -> None:
    bench = Bench(CAR)
    bench.ask_and_run(100, EM2ControlMode="Off", EM2TorqueRequest=50.0, EngineTorqueRequest=80.0)
    assert bench.label("EM2LimitReason") == "Disabled"
    assert bench.label("EM2State") == "Standby"
    assert bench["EM2TorqueSetpoint"] == 0.0
    assert bench["EM2TorqueEcho"] == 50.0
    assert bench.label("EngineLimitReason") == "Disabled"
    assert bench["EngineTorque"] == 0.0
    bench.ask_and_run(200, EM2ControlMode="Torque", ContactorRequest="Open")
    assert bench.label("ContactorState") == "Open"
    assert bench.label("EM2LimitReason") == "Disabled"
    assert bench["EM2Torque"] == 0.0
    for mode in ("Freewheel", "ASC"):
        bench.ask_and_run(100, EM2ControlMode=mode)
        assert bench.label("EM2State") == mode


def test_slew_while_the_torque_rises() -> None:
    bench = Bench(CAR).run(100)
    start = bench.now_ms
    bench.ask_and_run(100, EM2TorqueRequest=230.0)
    assert bench.labels("EM2LimitReason", start) == ["None", "SlewRate", "None"]


def test_bounds_of_speed_control() -> None:
    bench = Bench(CAR)
    bench.ask(EM2ControlMode="Speed", EM2SpeedRequest=3000.0, EM2TorqueMin=-40.0)
    bench.ask_and_run(500, EM2TorqueMax=60.0)
    assert bench["EM2Torque"] == pytest.approx(60.0, abs=0.1)
    assert bench.label("EM2LimitReason") == "TorqueBound"
    assert bench["EM2SpeedEcho"] == 3000.0
    bench.ask_and_run(1000, EM2SpeedRequest=-500.0)
    assert bench["EM2Torque"] == pytest.approx(-40.0, abs=0.1)
    bench.ask_and_run(300, EM2TorqueMin=30.0, EM2TorqueMax=-30.0)  # bounds that cross
    assert abs(bench["EM2Torque"]) == pytest.approx(30.0, abs=0.1)


def test_clutch_and_brake_capacity() -> None:
    bench = Bench(CAR)
    bench.ask_and_run(500, ClutchTorqueCapacityRequest=1500.0, BrakeTorqueRequest=8000.0)
    assert bench["ClutchTorqueCapacitySetpoint"] == 400.0
    assert bench["ClutchTorqueCapacityEcho"] == 1500.0
    assert bench.label("ClutchLimitReason") == "PeakTorque"
    assert bench["BrakeTorqueSetpoint"] == 6500.0
    assert bench["BrakeTorqueEcho"] == 8000.0
    assert bench.label("BrakeLimitReason") == "PeakTorque"
    bench.ask_and_run(500, ClutchTorqueCapacityRequest=100.0, BrakeTorqueRequest=100.0)
    assert bench.label("ClutchLimitReason") == bench.label("BrakeLimitReason") == "None"


def test_engine_limits() -> None:
    bench = Bench(CAR).ask_and_run(
        1200, EM1ControlMode="Speed", EM1SpeedRequest=2600.0, ClutchTorqueCapacityRequest=250.0
    )
    bench.ask_and_run(2500, EngineRunRequest="Run", EngineTorqueRequest=300.0)
    assert bench.label("EngineState") == "Running"
    assert bench["EngineTorqueEcho"] == 300.0
    assert bench["EngineTorqueSetpoint"] == pytest.approx(bench["EngineTorqueAvailableMax"], abs=1)
    assert bench.label("EngineLimitReason") == "PeakTorque"
    bench.ask_and_run(600, EngineTorqueRequest=-300.0)
    assert bench["EngineTorque"] == pytest.approx(bench["EngineTorqueAvailableMin"], abs=1)
    assert -30.0 < bench["EngineTorque"] < -10.0  # drag: fuel cut
    assert bench.label("EngineLimitReason") == "PeakTorque"


def test_a_force_beyond_what_the_unit_allows_is_limited_and_told() -> None:
    bench = Bench(CAR).ask_and_run(400, GearRequest="G1", ShiftForceRequest=1900.0)
    assert bench.label("SynchronizerLimitReason") == "Range"
    assert bench["ShiftForceEcho"] == 1900.0
    assert bench.series("ShiftForce")[1].max() <= 1801.0
    bench.ask_and_run(200, ShiftForceRequest=1000.0)
    assert bench.label("SynchronizerLimitReason") == "None"
