from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from hev_can_emu.commands._vehicle import load_driveline
from hev_can_emu.errors import InputError
from hev_can_emu.plant import driveline, holding, teeth, tyre
from hev_can_emu.plant.bank import build_bank
from hev_can_emu.plant.events import EVENT
from hev_can_emu.plant.geared import RearAxle, geared

replace = msgspec.structs.replace
SLIP = tyre.TyreSlipParameters(slip_stiffness=22.0, friction=1.0, front_load=0.6)
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
    for dt in (2e-4, 1e-4, 5e-5, 3.125e-6):
        corner = Corner(40.0, 40.0, dt=dt).run(0.05, 900.0, -300.0)
        ends.append(corner.state[0])
    errors = np.abs(np.array(ends[:-1]) - ends[-1])
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)
    assert errors[2] < 1e-3 * abs(ends[-1])


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


class Driven:
    """The whole detailed driveline in neutral, tyres slipping after each step."""

    def __init__(self, repository, slip=SLIP):
        parameters = load_driveline(str(repository / "vehicles" / "dai2024.yaml"))
        self.structure = geared(parameters, RearAxle(inertia=2.1, stiffness=15844.0, damping=30.4))
        self.bank = build_bank(self.structure, 5e-5, 0, travel=True, dampers=True)
        self.extras = teeth.build_extras(self.structure, self.bank, np.zeros(0), {}, True)
        self.slip = tyre.build_tyre_slip(self.structure, slip, parameters.tyre_radius)
        n, m = self.structure.n, len(self.structure.locks)
        self.x = np.zeros(n + self.structure.nq)
        self.state = np.zeros(holding.N_INTEGERS, dtype=np.int64)
        self.state[holding.SIGN : holding.SIGN + m] = 1
        self.u, self.capacity = np.zeros(4 + m), np.zeros(m)
        self.books, self.trial = np.zeros(teeth.N_BOOKS), np.zeros(driveline.TRIAL)
        self.record, self.t_ns = np.zeros(64, dtype=EVENT), 0
        self.heat, self.work, self.given = 0.0, np.zeros(tyre.WORK), 0.0
        self.slips = np.zeros(tyre.N_TYRES)
        self.mass = self.structure.inertia[self.structure.names.index("Jv")] / 0.356033146**2

    @property
    def energy(self):
        n = self.structure.n
        stiffness = np.diagonal(self.structure.stiffness[0])
        return 0.5 * float(self.structure.inertia @ self.x[:n] ** 2 + stiffness @ self.x[n:] ** 2)

    def run(self, time, em2=0.0):
        for _ in range(round(time / 5e-5)):
            self.u[:] = 0.0
            self.u[2] = em2
            driveline.step(
                self.bank, self.x, self.state, self.u, self.capacity, self.capacity, self.books,
                self.trial, self.t_ns, 50_000, self.record, 0, self.extras,
            )  # fmt: skip
            self.t_ns += 50_000
            self.given += em2 * self.books[teeth.TRAVEL + 2]
            self.heat += tyre.slip_tyres(
                self.slip, self.x, self.state, self.books[teeth.DAMPERS :], self.slips, self.work
            )
        return self


def test_the_whole_car_spins_its_front_wheels_and_every_joule_is_told(repository):
    car = Driven(repository).run(1.0, 1500.0)
    names = car.structure.names
    spun, body = car.x[names.index("Jlw")], car.x[names.index("Jv")]
    front = 0.6 * car.mass * 9.80665
    assert body * 0.356033146 == pytest.approx(front / (car.mass + 2.1 / 0.356033146**2), rel=0.05)
    assert spun > 3.0 * body
    assert car.x[names.index("Jrear")] == pytest.approx(body, rel=0.02)
    spent = car.heat + car.books[teeth.DAMPERS : teeth.DAMPERS + 17].sum() + car.energy
    assert spent == pytest.approx(car.given, rel=1e-5)
    assert car.heat > 0.3 * car.given


def test_without_parameters_no_tyre_slips(repository):
    car = Driven(repository)
    assert tyre.build_tyre_slip(car.structure, None, 0.356033146) is None
    assert car.slip.parameters[:, tyre.P_LIMIT] == pytest.approx(
        np.array([0.3, 0.3, 0.4]) * car.mass * 9.80665 * 0.356033146
    )


def test_a_bad_tyre_is_named():
    with pytest.raises(InputError, match=r"tyre\.friction: expected a number greater than 0"):
        replace(SLIP, friction=0.0).validate("tyre")
    for share in (0.0, 1.0):
        with pytest.raises(InputError, match=r"tyre\.front_load: expected between 0 and 1"):
            replace(SLIP, front_load=share).validate("tyre")
