"""The whole plant over whole manoeuvres: ratios, energy, standstill, shifts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hev_can_emu.plant import powertrain
from hev_can_emu.plant.assembly import build_plant, driveline_structure, start_state
from hev_can_emu.plant.events import EVENT
from hev_can_emu.plant.machines import Machines
from hev_can_emu.plant.start import Start
from hev_can_emu.plant.vehicle import DrivelineParameters

pytestmark = pytest.mark.compiled

G = 9.80665


class Car:
    """A plant with its commands by name."""

    def __init__(self, parameters: DrivelineParameters, machines: Machines, model: str) -> None:
        self.parameters = parameters
        self.capacity = machines.battery.capacity
        self.plant = build_plant(parameters, machines, driveline_structure(parameters, model))
        self.x, self.n, self.y = start_state(self.plant, Start())
        self.u = np.full(len(powertrain.COMMANDS), np.nan)
        self.u[: powertrain.U_GRADE] = 0.0
        for name in ("em1_torque_min", "em1_torque_max", "em2_torque_min", "em2_torque_max"):
            self.u[powertrain.COMMANDS.index(name)] = np.nan
        self.u[powertrain.U_CONTACTOR] = 1.0
        self.work = np.zeros(powertrain.WORK)
        self.events = np.zeros(4096, dtype=EVENT)
        self.n_events = 0
        self.ticks = 0

    def run(self, duration: float, **commands: float) -> list[dict[str, float]]:
        for name, value in commands.items():
            self.u[powertrain.COMMANDS.index(name)] = value
        rows = []
        for _ in range(round(duration * 1000)):
            self.n_events = powertrain.plant_step(
                self.plant, self.x, self.n, self.u, self.y, self.work,
                self.ticks * 1_000_000, self.events, self.n_events,
            )  # fmt: skip
            self.ticks += 1
            rows.append(dict(zip(powertrain.TRUTH, self.y.tolist(), strict=True)))
        return rows


@pytest.fixture(params=["16dof", "4dof"])
def car(
    request: pytest.FixtureRequest, driveline_values: DrivelineParameters, machine_values: Machines
) -> Car:
    return Car(driveline_values, machine_values, request.param)


def test_the_car_accelerates_as_its_rigid_mass_does(car: Car) -> None:
    rows = car.run(6.0, em2_mode=powertrain.TORQUE, em2_torque=100.0)
    last = rows[-1]
    ratios, j = car.parameters.ratios, car.parameters.inertias
    overall = ratios["m2"] * ratios["fd"]
    # What EM2 turns with, referred to the wheel (the gears of both ratios run along, idle).
    inner = (
        j["Jm2"] * ratios["m2"] ** 2 + j["J2"] + j["Jg12"] + j["Jfd1"] + j["Jg22"]
        + j["Jg11"] * ratios["g1"] ** 2 + j["Jg21"] * ratios["g2"] ** 2
    )  # fmt: skip
    inertia = inner * ratios["fd"] ** 2 + j["Jfd2"] + j["Jlw"] + j["Jrw"] + j["Jv"]
    radius = car.parameters.tyre_radius
    mass = j["Jv"] / radius**2
    v = last["vehicle_speed"]
    rolling = mass * G * radius * (0.009 + 2e-6 * v**2)
    drag = 0.5 * 1.2041 * 0.66 * v**2 * radius
    expected = (100.0 * overall - rolling - drag) / inertia * radius
    mean = np.mean([row["acceleration"] for row in rows[-500:]])
    assert mean == pytest.approx(expected, rel=2e-3)
    assert last["em2_speed"] == pytest.approx(last["body_speed"] * overall, rel=2e-3)


def test_state_of_charge_is_the_integral_of_terminal_current(car: Car) -> None:
    rows = car.run(4.0, em2_mode=powertrain.TORQUE, em2_torque=180.0)
    charge = sum(row["battery_current"] for row in rows) * 1e-3
    assert charge < -50.0
    assert rows[-1]["state_of_charge"] == pytest.approx(0.6 + charge / car.capacity, abs=1e-12)


def test_battery_current_solves_the_battery_with_all_loads(car: Car) -> None:
    row = car.run(2.0, em2_mode=powertrain.TORQUE, em2_torque=150.0)[-1]
    load = row["em1_power"] + row["em2_power"] + 500.0
    assert row["battery_voltage"] * -row["battery_current"] == pytest.approx(load, rel=1e-9)


def test_brakes_hold_the_car_on_a_hill_without_creeping_and_it_rolls_back_without_them(
    car: Car,
) -> None:
    rows = car.run(6.0, grade=0.15, brake_torque=2500.0)
    assert rows[-1]["body_held"] == 1.0
    assert rows[-1]["vehicle_speed"] == 0.0
    settled = rows[3000]["body_speed"], car.x[powertrain.X_DRIVELINE :].copy()
    car.run(30.0)
    assert car.y[powertrain.Y_VEHICLE_SPEED] == settled[0] == 0.0
    rows = car.run(1.0, brake_torque=0.0)
    slope = math.sin(math.atan(0.15))
    ceiling = G * slope
    assert rows[-1]["vehicle_speed"] < -0.8
    assert -ceiling < rows[-1]["acceleration"] < -0.75 * ceiling
    # An accelerometer on a car rolling freely feels little of gravity; at rest, all of it.
    assert abs(rows[-1]["accelerometer"]) < 0.3 * ceiling


def test_too_weak_a_brake_does_not_hold(car: Car) -> None:
    rows = car.run(3.0, grade=0.15, brake_torque=300.0)
    assert rows[-1]["body_held"] == 0.0
    assert rows[-1]["vehicle_speed"] < -0.5


def _series(car: Car) -> None:
    car.run(1.0, clutch_capacity=200.0, em1_mode=powertrain.SPEED, em1_speed=160.0)
    car.run(1.0, engine_run=1.0, em2_mode=powertrain.TORQUE, em2_torque=150.0)
    assert car.y[powertrain.Y_ENGINE_PHASE] == 2.0
    assert car.y[powertrain.Y_CLUTCH_HELD] == 1.0


def test_em1_starts_the_engine_through_c1_and_charges(car: Car) -> None:
    _series(car)
    rows = car.run(2.0, engine_torque=60.0, em2_torque=0.0)
    assert rows[-1]["em1_torque"] < -30.0
    assert rows[-1]["em1_power"] < -5e3
    assert rows[-1]["battery_current"] > 5.0
    assert rows[-1]["clutch_torque"] == pytest.approx(60.0, rel=0.03)


def test_a_matched_shift_engages_and_ties_the_speeds(car: Car) -> None:
    _series(car)
    car.run(2.0)
    car.run(0.2, clutch_capacity=0.0)
    ratios = car.parameters.ratios
    to_em1 = ratios["g1"] * ratios["id1"] * ratios["id2"] / ratios["m2"]
    car.run(0.4, em1_speed=car.y[powertrain.Y_EM2_SPEED] * to_em1)
    car.run(0.3, em1_mode=powertrain.FREEWHEEL, gear=1.0, shift_force=900.0)
    assert car.y[powertrain.Y_GEAR] == 1.0
    rows = car.run(1.0, em2_torque=0.0)
    assert rows[-1]["em1_speed"] == pytest.approx(rows[-1]["em2_speed"] * to_em1, rel=1e-3)


def test_a_shift_against_speed_control_is_aborted(car: Car) -> None:
    _series(car)
    car.run(2.0)
    car.run(0.2, clutch_capacity=0.0)
    # EM1 holds a speed far from the gear's: the cone's torque is less than EM1's.
    rows = car.run(2.0, em1_speed=500.0, gear=1.0, shift_force=300.0)
    phases = {row["sync_phase"] for row in rows}
    assert 2.0 in phases  # synchronising
    assert 6.0 in phases  # aborted
    assert car.y[powertrain.Y_GEAR] == 0.0


def test_the_dogs_do_not_leave_under_torque(car: Car) -> None:
    _series(car)
    car.run(2.0)
    car.run(0.2, clutch_capacity=0.0)
    ratios = car.parameters.ratios
    to_em1 = ratios["g1"] * ratios["id1"] * ratios["id2"] / ratios["m2"]
    car.run(0.4, em1_speed=car.y[powertrain.Y_EM2_SPEED] * to_em1)
    car.run(0.5, em1_mode=powertrain.TORQUE, em1_torque=0.0, gear=1.0, shift_force=900.0)
    car.run(0.5, em1_torque=110.0)
    rows = car.run(0.3, gear=0.0)
    assert rows[-1]["sync_phase"] == 7.0  # blocked by torque
    assert rows[-1]["gear"] != 0.0
    rows = car.run(0.5, em1_torque=0.0)
    assert rows[-1]["gear"] == 0.0


def test_a_motor_without_high_voltage_gives_nothing(car: Car) -> None:
    rows = car.run(1.0, contactor=0.0, em2_mode=powertrain.TORQUE, em2_torque=150.0)
    assert rows[-1]["contactor_phase"] == 0.0
    assert max(row["em2_torque"] for row in rows[100:]) == 0.0
    assert rows[-1]["vehicle_speed"] == 0.0
    rows = car.run(1.0, contactor=1.0)
    assert {1.0, 2.0} <= {row["contactor_phase"] for row in rows}  # precharge, closed
    assert rows[-1]["em2_torque"] == pytest.approx(150.0, rel=1e-3)


def test_power_beyond_the_battery_is_cut_to_the_watt(car: Car) -> None:
    car.x[powertrain.X_BATTERY] = 0.1  # little charge: 60 kW at most
    rows = car.run(14.0, em2_mode=powertrain.TORQUE, em2_torque=230.0)
    cut = [row for row in rows if row["em2_reason"] in (2.0, 3.0)]
    assert len(cut) > 1000
    for row in cut[100:]:
        load = row["em1_power"] + row["em2_power"] + 500.0
        assert load == pytest.approx(row["discharge_limit"], rel=1e-6)
        assert row["em2_torque"] <= row["em2_torque_max"] + 0.5


def test_short_circuited_motor_brakes_and_feeds_nothing_back(car: Car) -> None:
    car.run(4.0, em2_mode=powertrain.TORQUE, em2_torque=150.0)
    rows = car.run(0.5, em2_mode=powertrain.SHORT_CIRCUIT)
    assert rows[-1]["em2_torque"] < -10.0
    assert rows[-1]["em2_power"] == 0.0
