"""Mode switches by CAN requests: what succeeds, what is refused, and what the bus says about it."""

from __future__ import annotations

import pytest
from can_bench import Bench

from hev_can_emu.runtime.setup import Setup

CAR = Setup(model="4dof")
MODELS = ["4dof", "16dof"]
EM1_RATIO, EM2_RATIO, G1_RATIO = 1.298737, 1.850703, 1.843526


def start_engine(bench: Bench, speed: float = 2340.0, torque: float = 0.0) -> Bench:
    """Crank the engine by EM1 through C1 and let it run against EM1's speed control."""
    bench.ask_and_run(
        1200, EM1ControlMode="Speed", EM1SpeedRequest=speed, ClutchTorqueCapacityRequest=200.0
    )
    bench.ask(EngineRunRequest="Run", EngineTorqueRequest=torque)
    bench.run_until(lambda: bench.label("EngineState") == "Running", 2000)
    return bench.run(800)


@pytest.mark.parametrize("model", MODELS)
def test_series_to_parallel_by_requests(model: str) -> None:
    bench = start_engine(Bench(Setup(model=model)), torque=40.0)
    assert bench.label("DrivingMode") == "Series"
    bench.ask(EM2TorqueRequest=150.0)
    bench.run_until(lambda: bench["VehicleSpeed"] > 30.0, 15_000)
    start = bench.now_ms
    bench.ask_and_run(
        500, EngineTorqueRequest=0.0, ClutchTorqueCapacityRequest=0.0, EM2TorqueRequest=20.0
    )
    assert bench.label("DrivingMode") == "ElectricNeutral"
    aim = bench["EM2Speed"] / EM2_RATIO * G1_RATIO * EM1_RATIO
    bench.ask_and_run(800, EM1SpeedRequest=aim)
    assert abs(bench["EM1Speed"] - aim) < 80.0
    bench.ask(EM1ControlMode="Torque", EM1TorqueRequest=0.0)
    bench.ask_and_run(300, GearRequest="G1", ShiftForceRequest=900.0)
    assert bench.label("Gear") == "G1"
    assert bench.label("DrivingMode") == "ElectricG1"
    assert bench["SleevePosition"] == pytest.approx(9.0, abs=0.05)
    told = bench.labels("SynchronizerState", start)
    assert told[0] == "Neutral"
    assert told[-1] == "Engaged"
    assert set(told) <= {"Neutral", "Travel", "Synchronising", "Index", "Engaged"}
    bench.ask_and_run(1500, ClutchTorqueCapacityRequest=120.0)
    assert bench.label("ClutchState") == "Locked"
    assert bench.labels("DrivingMode", start) == [
        "Series", "Transition", "ElectricNeutral", "Transition", "ElectricG1", "Transition",
        "ParallelG1",
    ]  # fmt: skip
    bench.ask_and_run(1500, EngineTorqueRequest=60.0, ClutchTorqueCapacityRequest=250.0)
    assert bench["EngineSpeed"] == pytest.approx(bench["EM1Speed"] / EM1_RATIO, abs=20.0)
    assert bench["EM1Speed"] == pytest.approx(
        bench["EM2Speed"] / EM2_RATIO * G1_RATIO * EM1_RATIO, abs=20.0
    )
    assert bench["ClutchTorqueTransmitted"] == pytest.approx(55.0, abs=10.0)


@pytest.mark.parametrize("model", MODELS)
def test_a_synchronisation_that_em1_fights_is_aborted(model: str) -> None:
    bench = Bench(Setup(model=model))
    bench.ask_and_run(1500, EM1ControlMode="Speed", EM1SpeedRequest=6000.0)
    start = bench.now_ms
    bench.ask_and_run(1500, GearRequest="G1", ShiftForceRequest=600.0)
    assert bench.labels("SynchronizerState", start) == ["Travel", "Synchronising", "Aborted"]
    assert bench.label("SynchronizerLimitReason") == "SyncTimeout"
    assert bench.label("Gear") == "Neutral"
    assert bench["SleevePosition"] == 0.0
    assert "G1" not in bench.labels("Gear", start)
    aborted = bench.first("SynchronizerState", "Aborted", start)
    begun = bench.first("SynchronizerState", "Synchronising", start)
    assert aborted - begun == pytest.approx(1000.0, abs=11.0)
    # It stays aborted until neutral or another gear is asked for, then it may try again.
    bench.ask_and_run(1000, EM1ControlMode="Torque", EM1TorqueRequest=0.0)
    assert bench.label("SynchronizerState") == "Aborted"
    bench.ask_and_run(100, GearRequest="Neutral")
    assert bench.label("SynchronizerState") == "Neutral"
    assert bench.label("SynchronizerLimitReason") == "None"
    bench.ask_and_run(1200, GearRequest="G1", ShiftForceRequest=1500.0)
    assert bench.label("Gear") == "G1"


def test_too_little_force_does_not_synchronise_in_time() -> None:
    bench = Bench(CAR).ask_and_run(1500, EM1ControlMode="Speed", EM1SpeedRequest=6000.0)
    bench.ask(EM1ControlMode="Torque", EM1TorqueRequest=0.0)
    bench.ask_and_run(2000, GearRequest="G2", ShiftForceRequest=80.0)
    assert bench.label("SynchronizerState") == "Aborted"
    assert bench.label("SynchronizerLimitReason") == "SyncTimeout"
    assert bench.label("Gear") == "Neutral"


def test_no_force_no_shift() -> None:
    bench = Bench(CAR).ask_and_run(500, GearRequest="G1", ShiftForceRequest=0.0)
    assert bench.labels("SynchronizerState") == ["Neutral"]
    assert bench.label("GearEcho") == "G1"


def test_the_engine_behind_a_closed_clutch_makes_synchronising_slow() -> None:
    times = []
    for capacity in (0.0, 200.0):
        bench = start_engine(Bench(CAR))
        bench.ask_and_run(600, ClutchTorqueCapacityRequest=capacity, EngineRunRequest="Stop")
        bench.ask_and_run(600, EM1SpeedRequest=1500.0)
        bench.ask(EM1ControlMode="Torque", EM1TorqueRequest=0.0)
        start = bench.now_ms
        bench.ask_and_run(1200, GearRequest="G1", ShiftForceRequest=1200.0)
        assert bench.label("Gear") == "G1"
        times.append(bench.first("SynchronizerState", "Engaged", start) - start)
    assert times[1] > 1.5 * times[0]


def test_leaving_a_gear_under_torque_is_blocked_and_says_so() -> None:
    bench = Bench(CAR).ask_and_run(
        400, GearRequest="G1", ShiftForceRequest=800.0, BrakeTorqueRequest=5000.0
    )
    assert bench.label("Gear") == "G1"
    bench.ask_and_run(300, EM1TorqueRequest=110.0)
    start = bench.now_ms
    bench.ask_and_run(400, GearRequest="Neutral", ShiftForceRequest=400.0)
    assert bench.labels("SynchronizerState", start)[-1] == "BlockedByTorque"
    assert bench.label("SynchronizerLimitReason") == "TorqueOnDogs"
    assert bench["SleevePosition"] > 6.0
    # Without torque the sleeve comes free between the swings of the unwinding driveline.
    bench.ask_and_run(800, EM1TorqueRequest=0.0)
    assert bench.label("SynchronizerState") == "Neutral"
    assert bench.label("Gear") == "Neutral"
    assert bench.label("SynchronizerLimitReason") == "None"


def test_the_engine_stalls_when_c1_closes_in_gear_at_standstill() -> None:
    bench = start_engine(Bench(CAR), speed=1300.0)
    bench.ask_and_run(600, ClutchTorqueCapacityRequest=0.0, BrakeTorqueRequest=6000.0)
    bench.ask_and_run(500, EM1SpeedRequest=0.0)
    bench.ask(EM1ControlMode="Torque", EM1TorqueRequest=0.0)
    bench.ask_and_run(1500, GearRequest="G1", ShiftForceRequest=1500.0)
    assert bench.label("Gear") == "G1"
    assert bench.label("EngineState") == "Running"
    start = bench.now_ms
    bench.ask_and_run(1500, ClutchTorqueCapacityRequest=300.0)
    assert bench.labels("EngineState", start) == ["Running", "Stalled"]
    assert bench.label("ClutchState") == "Locked"
    bench.run(2000)
    assert bench.label("EngineState") == "Stalled"  # a stalled engine does not start by itself
    assert bench["EngineSpeed"] == pytest.approx(0.0, abs=5.0)
    bench.ask_and_run(200, EngineRunRequest="Stop")
    assert bench.label("EngineState") == "Off"


def test_the_engine_starts_only_when_em1_turns_it() -> None:
    bench = Bench(CAR).ask_and_run(500, EngineRunRequest="Run")
    assert bench.label("EngineState") == "Cranking"
    assert bench["EngineSpeed"] == 0.0
    bench.ask(EM1ControlMode="Speed", EM1SpeedRequest=1200.0)
    bench.ask_and_run(1500, ClutchTorqueCapacityRequest=150.0)
    assert bench.labels("EngineState")[-2:] == ["Cranking", "Running"]
    bench.ask_and_run(2500, ClutchTorqueCapacityRequest=0.0)
    assert bench["EngineSpeed"] == pytest.approx(850.0, abs=60.0)


def test_from_one_gear_straight_to_the_other() -> None:
    bench = Bench(CAR).ask_and_run(300, GearRequest="G1", ShiftForceRequest=900.0)
    start = bench.now_ms
    bench.ask_and_run(600, GearRequest="G2")
    assert bench.label("Gear") == "G2"
    assert bench["SleevePosition"] == pytest.approx(-9.0, abs=0.05)
    assert bench.label("DrivingMode") == "ElectricG2"
    _, force = bench.series("ShiftForce", start)
    assert force.min() < 0.0  # positive towards G1
