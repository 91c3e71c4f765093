"""Thermal nodes, brakes, road, speed control."""

from __future__ import annotations

import math

import machine_defaults as defaults
import msgspec
import numpy as np
import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.plant import brakes, road, speed_control, thermal
from hev_can_emu.plant import torque_source as source


def test_thermal_update_is_the_exact_exponential_for_any_step():
    node = defaults.THERMAL_EM1.winding
    tau = node.capacity * node.resistance
    fine, coarse = defaults.THERMAL_EM1.pack(1e-3), defaults.THERMAL_EM1.pack(1.0)
    a, b = np.full(thermal.N_STATE, 338.15), np.full(thermal.N_STATE, 338.15)
    for _ in range(2000):
        thermal.thermal_step(fine, a, 3000.0, 800.0, 338.15)
    for _ in range(2):
        thermal.thermal_step(coarse, b, 3000.0, 800.0, 338.15)
    exact = 338.15 + 75.0 * (1.0 - math.exp(-2.0 / tau))
    assert a[thermal.X_WINDING] == pytest.approx(exact, rel=1e-12)
    assert a == pytest.approx(b, rel=1e-12)
    assert a[thermal.X_INVERTER] - 338.15 == pytest.approx(16.0 * (1.0 - math.exp(-2.0 / 16.0)))


def test_bad_node_is_named():
    bad = msgspec.structs.replace(
        defaults.THERMAL_EM1, inverter=thermal.ThermalNode(capacity=-1.0, resistance=0.1)
    )
    with pytest.raises(InputError, match=r"em1\.inverter\.capacity"):
        bad.validate("em1")


def brake(request, x, ticks=1, enabled=1.0):
    out = np.zeros(brakes.N_OUT)
    for _ in range(ticks):
        brakes.brake_step(defaults.BRAKES.pack(), x, request, enabled, out)
    return out


def test_brake_capacity_is_shared_front_and_rear():
    x = np.zeros(brakes.N_STATE)
    out = brake(2000.0, x, 1000)
    assert out[source.OUT_TORQUE] == pytest.approx(2000.0)
    assert out[brakes.OUT_FL :] == pytest.approx([650.0, 650.0, 350.0, 350.0])
    assert brake(9000.0, x, 1000)[source.OUT_REASON] == source.LIMIT_PEAK
    assert brake(9000.0, x)[source.OUT_TORQUE] == pytest.approx(6500.0)


def test_brake_rises_after_its_delay_along_slew_and_lag():
    x = np.zeros(brakes.N_STATE)
    assert brake(1000.0, x, 10)[source.OUT_TORQUE] == 0.0
    assert brake(1000.0, x)[source.OUT_SETPOINT] == pytest.approx(40.0)


def test_brake_releases_to_exactly_zero_and_ignores_negative_requests():
    x = np.zeros(brakes.N_STATE)
    brake(3000.0, x, 500)
    assert np.all(brake(0.0, x, 600)[brakes.OUT_FL :] == 0.0)
    assert np.all(brake(-500.0, x, 300)[brakes.OUT_FL :] == 0.0)
    brake(3000.0, x, 500)
    assert brake(3000.0, x, 100, enabled=0.0)[source.OUT_TORQUE] == 0.0


def test_bad_brakes_are_named():
    with pytest.raises(
        InputError, match=r"esc\.front_share: expected a number from 0 to 1, got 1\.2"
    ):
        msgspec.structs.replace(defaults.BRAKES, front_share=1.2).validate("esc")


MASS, RADIUS = 1722.0, 0.356


def load(speed, grade, wind=0.0):
    out = np.zeros(road.N_OUT)
    road.road_load(defaults.ROAD.pack(MASS, RADIUS), speed, grade, wind, out)
    return out


def test_road_load_closed_form():
    out = load(30.0, 0.0)
    assert out[road.OUT_ROLLING_CAPACITY] == pytest.approx(
        (0.009 + 2e-6 * 900.0) * MASS * 9.80665 * RADIUS
    )
    assert out[road.OUT_BODY_TORQUE] == pytest.approx(-0.5 * 1.2041 * 0.66 * 900.0 * RADIUS)
    assert load(-30.0, 0.0)[road.OUT_BODY_TORQUE] == -out[road.OUT_BODY_TORQUE]
    assert load(20.0, 0.0, 10.0)[road.OUT_AIR_TORQUE] == pytest.approx(out[road.OUT_AIR_TORQUE])


def test_grade_is_rise_over_run():
    # 3-4-5: the slope of 0.75 has sine 0.6 and cosine 0.8.
    out = load(0.0, 0.75)
    assert out[road.OUT_BODY_TORQUE] == pytest.approx(-0.6 * MASS * 9.80665 * RADIUS)
    assert out[road.OUT_ROLLING_CAPACITY] == pytest.approx(
        0.8 * load(0.0, 0.0)[road.OUT_ROLLING_CAPACITY]
    )
    assert load(0.0, math.nan)[road.OUT_BODY_TORQUE] == 0.0


def test_accelerometer_feels_the_slope():
    assert road.accelerometer(1.5, 0.0) == 1.5
    assert road.accelerometer(0.0, 0.75) == pytest.approx(0.6 * 9.80665)
    # Rolling freely down a slope it reads nothing.
    assert road.accelerometer(0.6 * 9.80665, -0.75) == pytest.approx(0.0, abs=1e-12)


# Speed control

CONTROL = defaults.SPEED_CONTROL_EM1


class Shaft:
    def __init__(self, parameters=CONTROL, inertia=CONTROL.inertia, speed=0.0, dt=1e-3):
        self.p = parameters.pack(dt)
        self.x = np.zeros(speed_control.N_STATE)
        self.out = np.zeros(speed_control.N_OUT)
        self.inertia, self.speed, self.dt, self.torque = inertia, speed, dt, 0.0

    def step(self, reference, lower=-130.0, upper=130.0, load=0.0, active=1.0, inertia=0.0):
        speed_control.speed_control_step(
            *(self.p, self.x, active, reference, self.speed, lower, upper, self.torque, inertia),
            self.out,
        )
        self.torque = self.out[speed_control.OUT_REQUEST]
        self.speed += self.dt * (self.torque + load) / self.inertia
        return self.torque

    def follow(self, reference, ticks):
        speeds = []
        for _ in range(ticks):
            self.step(reference)
            speeds.append(self.speed)
        return np.array(speeds)


def test_closed_loop_follows_its_poles():
    # Damping 1: a double pole.  From the bumpless start it has no zero; for a later step of the set
    # speed, half weight puts the zero on one of the poles and leaves a first-order response.
    shaft = Shaft(dt=1e-4)
    w = CONTROL.bandwidth
    times = 1e-4 * np.arange(1, 4001)
    speeds = shaft.follow(10.0, times.size)
    # The first request repeats the acting torque, 0, so the response starts one period later.
    assert speeds[0] == 0.0
    lagged = 10.0 * (1.0 - np.exp(-w * times) * (1.0 + w * times))
    assert np.max(np.abs(speeds - lagged)) < 0.03
    for _ in range(10000):
        shaft.step(10.0)
    speeds = shaft.follow(20.0, times.size)
    assert np.max(np.abs(speeds - (20.0 - 10.0 * np.exp(-w * times)))) < 0.03


def test_load_is_carried_without_error_left():
    shaft = Shaft(speed=100.0)
    for _ in range(1000):
        shaft.step(100.0, load=-25.0)
    assert shaft.speed == pytest.approx(100.0, abs=1e-3)
    assert shaft.torque == pytest.approx(25.0, abs=1e-3)


def test_torque_bounds_hold_and_the_integrator_does_not_wind_up():
    shaft = Shaft()
    peak = 0.0
    for _ in range(3000):
        torque = shaft.step(300.0, lower=-8.0, upper=8.0)
        assert -8.0 <= torque <= 8.0
        peak = max(peak, shaft.speed)
    assert peak < 303.0
    assert shaft.speed == pytest.approx(300.0, abs=0.1)
    # Seconds at the bound under too great a load; once it is gone, no lasting overshoot.
    for _ in range(5000):
        shaft.step(300.0, upper=8.0, load=-9.0)
    assert shaft.out[speed_control.OUT_AT_BOUND] == 1.0
    assert shaft.speed < 200.0
    peak = 0.0
    for _ in range(2000):
        shaft.step(300.0)
        peak = max(peak, shaft.speed)
    assert peak < 303.0
    assert shaft.speed == pytest.approx(300.0, abs=0.1)


def test_entry_and_a_change_of_inertia_do_not_jerk():
    shaft = Shaft(speed=200.0)
    shaft.torque = 40.0
    assert shaft.step(350.0) == pytest.approx(40.0)
    for _ in range(500):
        shaft.step(350.0, load=-20.0)
    before = shaft.torque
    shaft.inertia = 0.17
    assert shaft.step(350.0, load=-20.0, inertia=0.17) == pytest.approx(before, abs=0.5)


def test_crossed_bounds_nan_and_inactive_are_harmless():
    shaft = Shaft(speed=50.0)
    assert shaft.step(80.0, lower=10.0, upper=-5.0) == -5.0
    assert shaft.step(80.0, active=0.0) == 0.0
    shaft = Shaft(speed=50.0)
    for _ in range(100):
        assert shaft.step(math.nan) == pytest.approx(0.0, abs=1e-9)


def test_bad_speed_control_is_named():
    with pytest.raises(InputError, match=r"mcu1\.setpoint_weight"):
        msgspec.structs.replace(CONTROL, setpoint_weight=-0.1).validate("mcu1")
