from __future__ import annotations

import math

import hydraulics_defaults as defaults
import msgspec
import numpy as np
import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.plant import wet_clutch as w

C = defaults.WET_CLUTCH
F = C.friction
WARM = 363.15  # K, factor 1
OIL = 353.15


def capacity(p, force, slip, piston=C.kiss_travel, temperature=WARM):
    out = np.zeros(w.N_OUT)
    w.capacity_step(p, np.array([temperature]), force, piston, slip, OIL, out)
    return out


def with_friction(**changes):
    return msgspec.structs.replace(C, friction=msgspec.structs.replace(F, **changes))


def test_capacity_is_friction_times_force_times_radius_times_surfaces():
    p = C.pack()
    radius = C.friction_radius
    assert radius == pytest.approx(0.0804, abs=2e-4)
    area = math.pi * (0.09**2 - 0.07**2) * 0.6
    force = 5e5 * area  # where the pressure's factor is 1
    out = capacity(p, force, 2.0 / radius)
    assert out[w.OUT_FRICTION] == pytest.approx(0.130, rel=1e-12)
    assert out[w.OUT_KINETIC] == pytest.approx(0.130 * force * 8.0 * radius, rel=1e-12)
    assert out[w.OUT_STATIC] == pytest.approx(0.118 * force * 8.0 * radius, rel=1e-12)
    for force in (0.0, -100.0):
        assert capacity(p, force, 10.0)[: w.OUT_DRAG].tolist() == [0.0, 0.0]


def test_friction_depends_on_pressure_and_temperature_by_their_factors():
    p = C.pack()
    half = C.friction_radius * 0.5
    base = w.friction_coefficient(p, 50.0, 5e5 / p[w.P_PER_AREA], WARM)
    hot = w.friction_coefficient(p, 50.0, 5e5 / p[w.P_PER_AREA], 423.15)
    pressed = w.friction_coefficient(p, -50.0, 2e6 / p[w.P_PER_AREA], WARM)
    assert hot / base == pytest.approx(0.96)
    assert pressed / base == pytest.approx(0.95)
    assert half > 0.0
    # Held beyond the ends of every axis.
    assert w.friction_coefficient(p, 1e6, 1e9, 1e3) == pytest.approx(0.130 * 0.92 * 0.88)
    assert w.friction_coefficient(p, 0.0, 0.0, 1.0) == pytest.approx(0.112 * 1.04 * 1.12)


def test_slip_is_foreseen_to_the_middle_of_the_step_but_not_past_zero():
    x = np.zeros(w.N_STATE)
    found = [w.foreseen_slip(x, slip) for slip in (10.0, 8.0, 6.0, 1.0, -1.0, 0.0)]
    assert found == [15.0, 7.0, 5.0, 0.0, -2.0, 0.0]


@pytest.mark.parametrize("wear", [0.0, 0.3, 1.0])
def test_stick_holds_at_least_what_slip_carries_at_rest(wear):
    out = capacity(C.pack(wear=wear), 3000.0, 0.0)
    assert out[w.OUT_STATIC] >= out[w.OUT_KINETIC] > 0.0
    assert out[w.OUT_DRAG] == 0.0


def test_wear_blends_the_curves_at_any_time():
    p = C.pack()
    w.set_wear(p, 1.0)
    assert np.array_equal(p, C.pack(wear=1.0))
    w.set_wear(p, 0.25)
    expected = 0.75 * np.array(F.fresh) + 0.25 * np.array(F.aged)
    assert p[w.P_CURVE : w.P_CURVE + w.POINTS] == pytest.approx(expected)
    w.set_wear(p, -3.0)
    assert np.array_equal(p, C.pack())


def test_drag_is_that_of_the_sheared_film_and_falls_when_the_oil_is_thrown_out():
    p = C.pack()
    gap = (C.kiss_travel + 8.0 * C.least_gap) / 8.0
    annulus = math.pi / 2.0 * (0.09**4 - 0.07**4) * 0.6
    slow = w.drag_torque(p, -5.0, 0.0, 0.0, OIL)
    assert slow == pytest.approx(8.0 * 7e-3 * annulus * 5.0 / gap / (1.0 + (5.0 / 150.0) ** 2))
    slips = np.linspace(0.0, 600.0, 121)
    torques = [w.drag_torque(p, slip, 0.0, 0.0, OIL) for slip in slips]
    assert slips[int(np.argmax(torques))] == C.expulsion_slip
    assert 0.3 < max(torques) < 3.0
    # Cold oil is thicker, a smaller gap shears more, to a bound at the kiss point.
    assert w.drag_torque(p, 5.0, 0.0, 0.0, OIL - 40.0) == pytest.approx(slow * math.e)
    assert w.drag_torque(p, 5.0, 1e-3, 0.0, OIL) > slow
    kissing = w.drag_torque(p, 5.0, C.kiss_travel, 0.0, OIL)
    assert kissing == pytest.approx(slow * gap / C.least_gap)


def test_pressed_plates_squeeze_the_film_out_and_carry_what_is_asked_cold_as_well():
    p = C.pack()
    area = math.pi * (0.09**2 - 0.07**2) * 0.6
    cold = OIL - 60.0
    kissing = w.drag_torque(p, 100.0, C.kiss_travel, 0.0, cold)
    assert kissing > 10.0
    pressed = w.drag_torque(p, 100.0, 2e-3, 2.0 * C.film_pressure * area, cold)
    assert pressed == pytest.approx(kissing * math.exp(-2.0))
    out = np.zeros(w.N_OUT)
    w.capacity_step(p, np.array([cold]), 700.0, 2e-3, 100.0, cold, out)
    assert out[w.OUT_KINETIC] > 50.0
    assert out[w.OUT_DRAG] < 0.005 * out[w.OUT_KINETIC]


@pytest.mark.parametrize("flow", [0.0, 2e-4])
@pytest.mark.parametrize("dt", [5e-5, 1e-3, 30.0])
def test_plate_temperature_is_the_exponential_of_an_even_heat_flow(dt, flow):
    p = C.pack(dt)
    power, start = 4e3, 400.0
    x, out = np.array([start]), np.zeros(w.N_HEAT)
    taken = given = 0.0
    steps = 20
    for _ in range(steps):
        w.heat_step(p, x, power * dt, flow, OIL, out)
        taken += out[w.HEAT_IN]
        given += out[w.HEAT_TO_OIL]
    cooling = C.still_cooling + flow * C.oil_heat
    end = OIL + power / cooling
    expected = end + (start - end) * math.exp(-cooling * steps * dt / C.heat_capacity)
    assert x[0] == pytest.approx(expected, rel=1e-12)
    stored = C.heat_capacity * (x[0] - start)
    assert abs(taken - given - stored) <= 1e-9 * (taken + abs(given))


def test_without_any_cooling_all_heat_stays():
    p = msgspec.structs.replace(C, still_cooling=0.0).pack()
    x, out = np.array([300.0]), np.zeros(w.N_HEAT)
    w.heat_step(p, x, 150.0, 0.0, OIL, out)
    assert x[0] == pytest.approx(300.0 + 150.0 / C.heat_capacity)
    assert out.tolist() == [150.0, 0.0]


class Oscillator:
    """Inertias before and behind the clutch: the rear one on a spring against the car, the front one
    driven so that it keeps its speed; both at the equilibrium of steady sliding, slightly disturbed."""

    force, slip, inertia, stiffness, front = 2000.0, 12.0, 0.04, 4000.0, 50.0

    def __init__(self, wear, damping=0.0):
        self.p = C.pack(wear=wear)
        self.damping = damping
        self.x = np.array([WARM])
        self.out = np.zeros(w.N_OUT)
        self.torque(self.slip)
        self.steady = self.out[w.OUT_KINETIC]

    def torque(self, slip):
        w.capacity_step(self.p, self.x, self.force, C.kiss_travel, slip, OIL, self.out)
        return self.out[w.OUT_KINETIC]

    def slope(self):
        return (self.torque(self.slip + 0.01) - self.torque(self.slip - 0.01)) / 0.02

    def amplitude_rate(self, periods=12):
        """Growth rate of the twist's amplitude, 1/s: velocities by leapfrog, friction at mid-step."""
        dt = 5e-5
        frequency = math.sqrt(self.stiffness / self.inertia)
        front, twist, speed = self.slip, 1e-5, 0.0
        steps = round(2.0 * math.pi * periods / frequency / dt)
        heat = work = 0.0
        peaks = []
        before = 0.0
        for _ in range(steps):
            twist += 0.5 * dt * speed
            torque = self.torque(front - speed)
            push = torque - self.steady - self.stiffness * twist - self.damping * speed
            front += dt * (self.steady - torque) / self.front
            heat += torque * (front - speed) * dt
            work += dt * torque * front - dt * torque * speed
            speed += dt * push / self.inertia
            twist += 0.5 * dt * speed
            peaks.append(abs(twist))
            before = twist
        assert math.isfinite(before)
        assert heat == pytest.approx(work, rel=1e-12)
        quarter = steps // 4
        first, last = max(peaks[:quarter]), max(peaks[-quarter:])
        return math.log(last / first) / (0.75 * steps * dt)


@pytest.mark.parametrize(("wear", "sign"), [(0.0, -1.0), (1.0, 1.0)])
def test_falling_friction_excites_judder_and_rising_friction_damps_it(wear, sign):
    # J*d(speed) = T(slip) - k*twist - c*speed: the friction's slope adds to the damping c.
    oscillator = Oscillator(wear)
    expected = -0.5 * oscillator.slope() / oscillator.inertia
    assert math.copysign(1.0, expected) == sign
    assert abs(expected) > 0.5
    assert oscillator.amplitude_rate() == pytest.approx(expected, rel=0.1)


def test_enough_damping_stops_judder_of_aged_linings():
    aged = Oscillator(1.0)
    least = -aged.slope()
    assert Oscillator(1.0, 0.5 * least).amplitude_rate() > 0.0
    assert Oscillator(1.0, 1.5 * least).amplitude_rate() < 0.0


def test_heat_in_is_the_slip_power_of_a_clutch_that_closes():
    # Two free inertias and constant force: the heat is the kinetic energy that is lost.
    p = C.pack()
    x, out, heat_out = np.array([WARM]), np.zeros(w.N_OUT), np.zeros(w.N_HEAT)
    inertia, other, speed, driven, dt = 0.2, 0.5, 200.0, 50.0, p[w.P_DT]
    start = 0.5 * inertia * speed**2 + 0.5 * other * driven**2
    total = 0.0
    while speed - driven > 1.0:
        w.capacity_step(p, x, 1500.0, C.kiss_travel, speed - driven, OIL, out)
        torque = out[w.OUT_KINETIC]
        slip = speed - driven
        speed -= dt * torque / inertia
        driven += dt * torque / other
        w.heat_step(p, x, torque * 0.5 * (slip + speed - driven) * dt, 0.0, OIL, heat_out)
        total += heat_out[w.HEAT_IN]
    end = 0.5 * inertia * speed**2 + 0.5 * other * driven**2
    assert total == pytest.approx(start - end, rel=1e-9)
    assert x[0] > WARM + 0.5


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("speed", (0.1, 1.0), "speed[0]: expected 0"),
        ("speed", tuple(float(i) for i in range(9)), "speed: expected at most 8 values"),
        ("fresh", (0.1, 0.1), "fresh: expected 8 values"),
        ("static_aged", 0.1, "static_aged: expected at least aged[0] (0.142)"),
        ("pressure", (1.0, 1.0), "pressure[1]: expected more"),
        ("temperature_factor", (1.0, 1.0, 0.0, 1.0, 1.0), "temperature_factor[2]: expected"),
    ],
)
def test_bad_friction_maps_are_told_by_their_place(field, value, told):
    C.validate("clutch")
    with pytest.raises(InputError) as caught:
        with_friction(**{field: value}).validate("clutch")
    assert str(caught.value).startswith(f"clutch.friction.{told}")


@pytest.mark.parametrize(
    ("field", "value"),
    [("outer_radius", 0.05), ("groove_share", 1.0), ("surfaces", 0.0), ("viscosity", -1.0)],
)
def test_bad_plates_are_told_by_their_place(field, value):
    with pytest.raises(InputError) as caught:
        msgspec.structs.replace(C, **{field: value}).validate("clutch")
    assert str(caught.value).startswith(f"clutch.{field}: expected")
