from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from hev_can_emu.errors import InputError
from hev_can_emu.plant import tyre

SLIP = tyre.TyreSlipParameters(slip_stiffness=22.0, friction=1.0)
LOAD, RADIUS, STIFFNESS, DAMPING = 4200.0, 0.356, 7922.0, 15.2
WHEEL, BODY = 1.07, 55.0
LIMIT, SLOPE = LOAD * RADIUS, 22.0 * LOAD * RADIUS


class Corner:
    """A wheel and its share of the body; the tyre's spring and damper are exact, the slip is tyre_step's."""

    def __init__(self, wheel=0.0, body=0.0, twist=0.0, wheel_held=False, body_held=False, dt=5e-5):
        self.dt = dt
        self.p = SLIP.pack(LOAD, RADIUS, STIFFNESS, DAMPING, WHEEL, BODY, dt)
        self.state, self.out = np.array([twist, wheel, body]), np.zeros(tyre.N_OUT)
        self.held = (float(wheel_held), float(body_held))
        eases = np.array([0.0 if wheel_held else 1 / WHEEL, 0.0 if body_held else 1 / BODY])
        pull = np.array([STIFFNESS, DAMPING, -DAMPING])
        rate = np.zeros((6, 6))
        rate[0, 1], rate[0, 2] = 1.0, -1.0
        rate[1, :3], rate[2, :3] = -eases[0] * pull, eases[1] * pull
        rate[1, 3], rate[2, 4] = eases
        self.flow = scipy.linalg.expm(rate * dt)
        self.slip_loss = 0.0

    @property
    def energy(self):
        q, w, b = self.state
        return 0.5 * (STIFFNESS * q * q + WHEEL * w * w + BODY * b * b)

    def step(self, drive=0.0, brake_body=0.0):
        full = np.array([*self.state, drive, brake_body, 0.0])
        self.state[:] = (self.flow @ full)[:3]
        tyre.tyre_step(self.p, self.state, *self.held, self.out)
        self.slip_loss += self.out[tyre.OUT_SLIP_LOSS]

    def run(self, time, drive=0.0, body=0.0):
        for _ in range(round(time / self.dt)):
            self.step(drive, body)
        return self

    @property
    def slip(self):
        return self.out[tyre.OUT_SLIP]


def brush(slip):
    """The brush model as its textbooks write it."""
    x = SLOPE * abs(slip) / LIMIT
    size = LIMIT if x >= 3.0 else LIMIT * (x - x * x / 3.0 + x**3 / 27.0)
    return math.copysign(size, slip)


@pytest.mark.parametrize("share", [-0.99, -0.5, -0.05, 0.0, 0.05, 0.5, 0.99])
def test_the_slip_law_is_the_brush_model(share):
    slip = tyre.slip_share(share * LIMIT, SLOPE, LIMIT)
    assert brush(slip) == pytest.approx(share * LIMIT, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("torque", [700.0, -700.0, 1400.0])
@pytest.mark.parametrize("speed", [60.0, -60.0])
def test_steady_slip_is_the_brush_model(torque, speed):
    corner = Corner(speed, speed).run(1.0, torque, -torque)
    # Both speeds now stay: what drives the wheel brakes the body.
    assert corner.out[tyre.OUT_TORQUE] == pytest.approx(torque, rel=1e-3)
    share = corner.slip / abs(corner.state[2])
    assert brush(share) == pytest.approx(torque, rel=1e-3)
    assert corner.state[1] - corner.state[2] == pytest.approx(corner.slip, rel=0.03)


@pytest.mark.parametrize("speed", [20.0, 80.0])
def test_a_small_twist_runs_off_over_the_relaxation_length(speed):
    held = Corner(speed, speed, 1e-4, wheel_held=True, body_held=True)
    rate = STIFFNESS / (SLOPE / speed + DAMPING)  # without the damper the length is C*r/k
    held.run(0.02)
    assert held.state[0] == pytest.approx(1e-4 * math.exp(-0.02 * rate), rel=0.01)


def test_a_locked_wheel_brakes_with_mu_and_turns_all_energy_into_heat():
    corner = Corner(0.0, 50.0, wheel_held=True)
    start = corner.energy
    time = 50.0 * BODY / LIMIT
    corner.run(0.5 * time)
    assert corner.state[2] == pytest.approx(25.0, rel=5e-3)  # the tyre winds up first
    assert corner.out[tyre.OUT_TORQUE] == pytest.approx(-LIMIT, rel=1e-9)
    corner.run(time)
    assert abs(corner.state[2]) < 2.0  # it still swings on the tyre
    assert corner.slip_loss == pytest.approx(start, rel=0.02)


def test_a_spun_wheel_pushes_with_mu_whatever_drives_it():
    corner = Corner(0.0, 0.0).run(0.3, 4000.0)
    assert corner.out[tyre.OUT_TORQUE] == pytest.approx(LIMIT, rel=1e-9)
    assert corner.state[2] == pytest.approx(0.3 * LIMIT / BODY, rel=0.06)
    assert corner.state[1] == pytest.approx(0.3 * (4000.0 - LIMIT) / WHEEL, rel=0.06)


def test_at_standstill_nothing_creeps():
    corner = Corner(wheel_held=True, body_held=True, twist=0.9 * LIMIT / STIFFNESS)
    twist = corner.state[0]
    corner.run(5.0 / 20)
    assert corner.state[0] == twist
    assert corner.slip_loss == 0.0


def test_the_step_is_of_first_order():
    ends = []
    for dt in (1e-4, 5e-5, 2.5e-5, 1.25e-5):
        corner = Corner(40.0, 40.0, dt=dt).run(0.05, 900.0, -300.0)
        ends.append(corner.state[1])
    steps = np.diff(ends)
    assert steps[0] / steps[1] == pytest.approx(2.0, rel=0.1)
    assert steps[1] / steps[2] == pytest.approx(2.0, rel=0.1)


@given(
    st.floats(-0.5, 0.5),
    st.floats(-200.0, 200.0),
    st.floats(-200.0, 200.0),
    st.booleans(),
    st.booleans(),
    st.sampled_from([1e-6, 5e-5, 1e-3]),
)
def test_what_creeping_takes_is_slip_heat_and_the_dampers_change(q, w, b, held_w, held_b, dt):
    p = SLIP.pack(LOAD, RADIUS, STIFFNESS, DAMPING, WHEEL, BODY, dt)
    w, b = 0.0 if held_w else w, 0.0 if held_b else b  # what is held stands
    state, out = np.array([q, w, b]), np.zeros(tyre.N_OUT)
    tyre.tyre_step(p, state, float(held_w), float(held_b), out)
    before = 0.5 * np.array([STIFFNESS, WHEEL, BODY]) * np.array([q, w, b]) ** 2
    after = 0.5 * np.array([STIFFNESS, WHEEL, BODY]) * state**2
    taken = out[tyre.OUT_SLIP_LOSS] + out[tyre.OUT_DAMPER_CHANGE]
    assert np.sum(before - after) == pytest.approx(taken, rel=1e-9, abs=1e-8)
    assert abs(out[tyre.OUT_TORQUE]) <= LIMIT * (1.0 + 1e-9)
    assert out[tyre.OUT_SLIP] * out[tyre.OUT_TORQUE] >= 0.0
    if not (held_w or held_b):
        assert WHEEL * state[1] + BODY * state[2] == pytest.approx(WHEEL * w + BODY * b, abs=1e-9)


def test_a_bad_tyre_is_named():
    with pytest.raises(InputError, match=r"tyre\.friction: expected a number greater than 0"):
        tyre.TyreSlipParameters(slip_stiffness=20.0, friction=0.0).validate("tyre")
