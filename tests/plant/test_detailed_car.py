"""The whole detailed car on the bench: what every car does, and what each machine adds to it."""

from __future__ import annotations

import math

import pytest

from hev_can_emu.plant import contactors
from hev_can_emu.plant.holding import PARTED, TOUCHED
from hev_can_emu.plant.start import Start
from hev_can_emu.runtime.bench import Bench

pytestmark = pytest.mark.compiled

OFF, TORQUE, SPEED, FREEWHEEL, SHORT = 0.0, 1.0, 2.0, 3.0, 4.0


def _closes(car: Bench) -> bool:
    ledger = car.ledger()
    assert ledger is not None
    return abs(ledger.residue) < 1e-7 * ledger.moved


def test_it_holds_on_a_hill_without_creeping_and_rolls_back_when_let_go() -> None:
    car = Bench()
    car.command(grade=0.1, brake_torque=3000.0)
    car.run(1500)
    assert car.truth("body_held") == 1.0
    trace = car.advance(1000, ("body_speed", "wheel_left_speed", "wheel_rear_speed"))
    assert abs(trace).max() == 0.0
    car.command(brake_torque=0.0)
    car.run(1000)
    # Freely down the slope, less what rolls, over 1 s less the brakes' own time.
    assert -0.95 < car.truth("vehicle_speed") < -0.6
    assert car.truth("wheel_rear_speed") == pytest.approx(car.truth("body_speed"), rel=1e-2)
    assert _closes(car)


def test_rear_brakes_stop_the_rear_wheels_with_the_car() -> None:
    car = Bench()
    car.command(em2_mode=TORQUE, em2_torque=200.0)
    car.run(1500)
    car.command(em2_mode=OFF, em2_torque=0.0, brake_torque=4000.0)
    trace = car.advance(6000, ("body_speed", "wheel_rear_speed"))
    ledger = car.ledger()
    assert ledger is not None
    assert car.truth("body_held") == 1.0
    assert trace[-1].tolist() == [0.0, 0.0]
    # It rocks on its tyres first.  35 % of the torque acts behind, on nearly the same way.
    rear = ledger["friction_brake_rear"]
    front = ledger["friction_brake_left"] + ledger["friction_brake_right"]
    assert rear / (rear + front) == pytest.approx(0.35, abs=0.03)


def test_the_link_is_precharged_and_discharged() -> None:
    car = Bench(start=Start(closed=False))
    assert car.truth("link_voltage") == 0.0
    car.command(contactor=1.0)
    trace = car.advance(400, ("link_voltage", "contactor_phase"))
    open_circuit = 355.5  # at 60 %
    assert trace[-1, 1] == contactors.CLOSED
    assert trace[-1, 0] == pytest.approx(open_circuit, abs=1.0)
    closed = int((trace[:, 1] == contactors.CLOSED).argmax())
    # First order through 30 ohm, the battery's own resistance beside: 95 % after three time constants.
    tau = 30.1 * 1.2e-3
    assert closed * 1e-3 == pytest.approx(-tau * math.log(0.05), rel=0.03)
    ledger = car.ledger()
    assert ledger is not None
    # Charging a capacitor through a resistor loses as much as it stores.
    assert ledger["battery_resistance"] == pytest.approx(ledger["link"], rel=0.01)
    car.command(contactor=0.0)
    car.run(3000)
    assert car.truth("link_voltage") < 1.0
    assert _closes(car)


def test_the_engine_is_cranked_fires_idles_and_stalls() -> None:
    car = Bench()
    car.command(em1_mode=SPEED, em1_speed=130.0, clutch_capacity=200.0)
    car.run(600)
    assert car.truth("clutch_held") == 1.0
    assert car.truth("fuel_flow") == 0.0
    car.command(engine_run=1.0)
    car.run(600)
    assert car.truth("fuel_flow") > 0.0
    car.command(em1_mode=OFF, clutch_capacity=0.0)
    car.run(4000)
    assert car.truth("engine_speed") == pytest.approx(89.0, abs=3.0)  # idle
    # Let in against a standing car in gear, hard, it dies.
    car.command(gear=1.0, shift_force=900.0)
    car.run(800)
    assert car.truth("gear") == 1.0
    car.command(brake_torque=6000.0, clutch_capacity=300.0)
    car.run(800)
    assert car.truth("engine_phase") == 3.0
    assert _closes(car)
    assert {TOUCHED, PARTED} & {event.kind for event in car.events}


def test_a_shorted_motor_brakes_and_a_blocked_one_runs_free() -> None:
    car = Bench()
    car.command(em2_mode=TORQUE, em2_torque=200.0)
    car.run(3000)
    speed = car.truth("em2_speed")
    assert 40.0 < speed < 871.0
    car.command(em2_mode=FREEWHEEL, em2_torque=0.0)
    car.run(50)
    blocked = car.truth("em2_torque")
    assert -3.0 < blocked < 0.0  # iron and bearings
    assert car.truth("em2_power") == pytest.approx(0.0, abs=1.0)
    car.command(em2_mode=SHORT)
    trace = car.advance(300, ("em2_torque", "em2_power"))
    assert trace[-1, 0] < 10.0 * blocked
    assert trace[-1, 1] == pytest.approx(0.0, abs=1e-6)
    assert _closes(car)
