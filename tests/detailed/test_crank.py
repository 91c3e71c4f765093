"""The crank against kinematics written down anew, Fourier's orders, and the energy."""

from __future__ import annotations

import math

import engine_defaults as defaults
import msgspec
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from hev_can_emu.errors import InputError
from hev_can_emu.plant import crank

EXACT = defaults.CRANK
TRUNCATED = msgspec.structs.replace(EXACT, exact_rod=False)
M, R, L = EXACT.reciprocating_mass, EXACT.radius, EXACT.rod_length
K = R / L
JE = defaults.ENGINE_INERTIA
ANGLES = np.linspace(-7.0, 7.0, 141)


def travel(parameters, a):
    """Piston travel as the textbook has it; takes complex angles, for complex-step derivatives."""
    if parameters.exact_rod:
        return L + R - (R * np.cos(a) + L * np.sqrt(1.0 - K * K * np.sin(a) ** 2))
    return R * (1.0 + K / 4.0 - np.cos(a) - K / 4.0 * np.cos(2.0 * a))


def rate(parameters, a):
    return np.imag(travel(parameters, a + 1e-30j)) / 1e-30


def curvature(parameters, a, h=1e-4):
    """Second derivative: fourth-order difference of the complex-step first."""
    d = [rate(parameters, a + i * h) for i in (-2, -1, 1, 2)]
    return (d[0] - 8.0 * d[1] + 8.0 * d[2] - d[3]) / (12.0 * h)


def four_cylinders(parameters, a, w, alpha):
    """Sum of -m*x''(t)*dx/da over the cylinders: every piston's force by the virtual work it does."""
    total = 0.0
    for shift in (0.0, math.pi, math.pi, 0.0):
        at = a + shift
        acceleration = rate(parameters, at) * alpha + curvature(parameters, at) * w * w
        total = total - M * acceleration * rate(parameters, at)
    return total


@pytest.mark.parametrize("parameters", [EXACT, TRUNCATED], ids=["exact", "truncated"])
def test_kinematics_against_independent_differentiation(parameters):
    p = parameters.pack()
    x = np.array([crank.piston_travel(p, a) for a in ANGLES])
    v = np.array([crank.piston_rate(p, a) for a in ANGLES])
    c = np.array([crank.piston_curvature(p, a) for a in ANGLES])
    assert x == pytest.approx(travel(parameters, ANGLES), abs=1e-16)
    assert v == pytest.approx(rate(parameters, ANGLES), abs=1e-16)
    assert c == pytest.approx(curvature(parameters, ANGLES), abs=1e-12)
    assert crank.piston_travel(p, math.pi) == pytest.approx(2.0 * R, rel=1e-15)


@pytest.mark.parametrize("parameters", [EXACT, TRUNCATED], ids=["exact", "truncated"])
def test_inertia_is_that_of_four_pistons_less_its_mean(parameters):
    p = parameters.pack()
    grid = 2.0 * math.pi * np.arange(64) / 64
    pistons = 2.0 * M * (rate(parameters, grid) ** 2 + rate(parameters, grid + math.pi) ** 2)
    extra = np.array([crank.extra_inertia(p, a) for a in grid])
    assert pistons - extra == pytest.approx(np.full(64, parameters.mean_inertia), rel=1e-13)
    assert np.mean(extra) == pytest.approx(0.0, abs=1e-18)
    h = 1e-3
    slope = [
        (crank.extra_inertia(p, a + h) - crank.extra_inertia(p, a - h)) / (2.0 * h) for a in grid
    ]
    slopes = [crank.extra_inertia_rate(p, a) for a in grid]
    assert slopes == pytest.approx(slope, abs=1e-5 * max(slopes))


def test_mean_inertia_is_the_one_contained_in_the_engine():
    assert TRUNCATED.mean_inertia == pytest.approx(2.0 * M * R**2 * (1.0 + K**2 / 4.0), rel=1e-15)
    pistons, _ = quad(lambda a: 4.0 * M * rate(EXACT, a) ** 2, 0.0, 2.0 * math.pi, epsrel=1e-12)
    assert EXACT.mean_inertia == pytest.approx(pistons / (2.0 * math.pi), rel=1e-12)


@pytest.mark.parametrize("parameters", [EXACT, TRUNCATED], ids=["exact", "truncated"])
@pytest.mark.parametrize(("w", "alpha"), [(300.0, 0.0), (0.0, 900.0), (-120.0, -400.0)])
def test_torque_is_the_sum_of_the_pistons(parameters, w, alpha):
    p = parameters.pack()
    own = np.array([crank.inertial_torque(p, a, w, alpha) for a in ANGLES])
    mean = -parameters.mean_inertia * alpha
    assert own + mean == pytest.approx(four_cylinders(parameters, ANGLES, w, alpha), abs=1e-8)


def orders(torque):
    return np.fft.rfft(torque) / len(torque) * 2.0


def test_truncated_sum_keeps_orders_two_and_four():
    p, w, n = TRUNCATED.pack(), 250.0, 256
    grid = 2.0 * math.pi * np.arange(n) / n
    torque = np.array([crank.inertial_torque(p, a, w, 0.0) for a in grid])
    expected = -M * R**2 * w**2 * (2.0 * np.sin(2.0 * grid) + K**2 * np.sin(4.0 * grid))
    assert torque == pytest.approx(expected, abs=1e-13 * M * R**2 * w**2 * 1e2)
    # The paper's single cylinder, summed with its four phases, is the same.
    single = sum(
        (K / 4.0) * np.sin(grid + s)
        - 0.5 * np.sin(2.0 * (grid + s))
        - (3.0 * K / 4.0) * np.sin(3.0 * (grid + s))
        - (K**2 / 4.0) * np.sin(4.0 * (grid + s))
        for s in (0.0, math.pi, math.pi, 0.0)
    )
    assert torque == pytest.approx(M * R**2 * w**2 * single, abs=1e-10)


def test_exact_rod_by_fourier():
    p, w, n = EXACT.pack(), 250.0, 256
    unit = M * R**2 * w**2
    grid = 2.0 * math.pi * np.arange(n) / n
    own = orders(np.array([crank.inertial_torque(p, a, w, 0.0) for a in grid])) / unit
    reference = orders(four_cylinders(EXACT, grid, w, 0.0)) / unit
    assert np.abs(own - reference).max() < 1e-10
    assert abs(own[0]) < 1e-14  # no mean torque at constant speed
    assert np.abs(own[1::2]).max() < 1e-13  # and no odd order
    assert np.abs(own.real).max() < 1e-13
    # What truncation leaves out: k^4/8 of order 2 and less, k^4 of 4, and order 6 of size k^4.
    assert -own[2].imag == pytest.approx(-2.0, abs=K**4)
    assert -own[4].imag == pytest.approx(-(K**2), abs=0.6 * K**4)
    assert abs(-own[4].imag + K**2) > 0.1 * K**4
    assert 0.1 * K**4 < abs(own[6]) < K**4


def coast(parameters, torque_of, h, seconds, speed=300.0, angle=0.3):
    """A crank of inertia JE alone, moved exactly under the torque held over each step.

    Returns the greatest relative change of the total energy, and angle travelled and speed.
    """
    p = parameters.pack()

    def total(a, w):
        return 0.5 * JE * w * w + crank.reciprocating_energy(p, a, w)

    start = total(angle, speed)
    worst = turned = last = 0.0
    for _ in range(round(seconds / h)):
        last = torque_of(p, angle, speed, h, last)
        moved = h * speed + 0.5 * h * h * last / JE
        angle = crank.wrap(angle + moved)
        turned += moved
        speed += h * last / JE
        worst = max(worst, abs(total(angle, speed) / start - 1.0))
    return worst, turned, speed


def held(p, angle, speed, h, _last):
    return crank.crank_torque(p, angle, speed, speed, h * speed, h / JE, 0.5 * h * h / JE, h, 1.0)


def lagged(p, angle, speed, h, last):
    return crank.inertial_torque(p, angle, speed, last / JE)


def implicit(p, angle, speed, h, _last):
    velocity = crank.inertial_torque(p, angle, speed, 0.0)
    return velocity * JE / (JE + crank.extra_inertia(p, angle))


def middle(p, angle, speed, h, _last):
    torque = 0.0
    for _ in range(4):  # fixed point at the middle of the step
        w = speed + 0.5 * h * torque / JE
        torque = crank.inertial_torque(p, angle + 0.25 * h * (speed + w), w, torque / JE)
    return torque


@pytest.mark.parametrize("parameters", [EXACT, TRUNCATED], ids=["exact", "truncated"])
@pytest.mark.parametrize("h", [100e-6, 50e-6])
def test_free_crank_keeps_its_energy(parameters, h):
    worst, turned, _ = coast(parameters, held, h, 2.0)
    assert worst < 1e-10
    assert turned == pytest.approx(600.0, rel=0.02)


def test_other_ways_of_holding_the_torque_do_not():
    h, seconds = 50e-6, 0.5
    assert coast(EXACT, held, h, seconds)[0] < 1e-11
    assert coast(EXACT, lagged, h, seconds)[0] > 1e-4
    assert coast(EXACT, implicit, h, seconds)[0] > 1e-4
    fixed_point = coast(EXACT, middle, h, seconds)[0]
    assert 1e-7 < fixed_point < 1e-5
    assert coast(EXACT, middle, 0.5 * h, seconds)[0] == pytest.approx(fixed_point / 4.0, rel=0.2)


def test_motion_is_second_order():
    # Energy gives the speed at any angle, and the integral over the angle the time.
    p, w0, a0, seconds = EXACT.pack(), 300.0, 0.3, 0.05
    energy = 0.5 * (JE + crank.extra_inertia(p, a0)) * w0**2

    def pace(a):
        return math.sqrt(0.5 * (JE + crank.extra_inertia(p, a)) / energy)

    gaps = []
    for h in (200e-6, 100e-6, 50e-6):
        _, turned, speed = coast(EXACT, held, h, seconds)
        time, _ = quad(pace, a0, a0 + turned, epsabs=1e-13, epsrel=1e-13, limit=200)
        gaps.append((time - seconds) * w0)
        assert 1.0 / speed == pytest.approx(pace(a0 + turned), rel=1e-9)
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.1)
    assert gaps[1] / gaps[2] == pytest.approx(4.0, rel=0.1)
    assert abs(gaps[2]) < 2e-6


@pytest.mark.parametrize(("trapezoid", "least"), [(False, 1e-11), (True, 1e-9)])
def test_energy_is_kept_on_an_elastic_shaft_too(trapezoid, least):
    """Crank, spring, hub by the exact propagator; travel from the angle as a state, or by trapezoid."""
    p, h, k, j2 = EXACT.pack(), 50e-6, 264257.0, 0.0085
    rates = np.zeros((5, 5))  # angle, speed 1, speed 2, twist; torque
    rates[0, 1] = 1.0
    rates[1, 3], rates[1, 4] = -k / JE, 1.0 / JE
    rates[2, 3] = k / j2
    rates[3, 1], rates[3, 2] = 1.0, -1.0
    flow = expm(rates * h)
    x = np.array([0.4, 200.0, 199.0, 0.0])

    def total():
        elastic = 0.5 * k * x[3] ** 2
        kinetic = 0.5 * JE * x[1] ** 2 + 0.5 * j2 * x[2] ** 2
        return kinetic + elastic + crank.reciprocating_energy(p, x[0], x[1])

    start = total()
    worst = work = 0.0
    for _ in range(4000):
        free = flow[:4, :4] @ x
        gains = flow[:4, 4]
        moves = (free[0] - x[0], gains[1], gains[0])
        if trapezoid:
            moves = (0.5 * h * (x[1] + free[1]), gains[1], 0.5 * h * gains[1])
        torque = crank.crank_torque(p, x[0], x[1], free[1], *moves, h, 1.0)
        before = crank.reciprocating_energy(p, x[0], x[1])
        moved = free + gains * torque
        work += torque * (moved[0] - x[0])
        work += crank.reciprocating_energy(p, moved[0], moved[1]) - before
        x = moved
        x[0] = crank.wrap(x[0])
        worst = max(worst, abs(total() / start - 1.0))
    assert worst < least
    assert abs(work) < least * start


def test_turning_round_and_standing_still():
    p = EXACT.pack()
    h = 50e-6
    assert crank.crank_torque(p, 1.0, 0.0, 0.0, 0.0, h / JE, 0.5 * h * h / JE, h, 1.0) == 0.0
    # Pushed backwards through standstill the step's torque stays what the acceleration demands.
    alpha = -1000.0
    for w in (0.02, 0.025, 0.03, 0.0, -0.01):
        torque = crank.crank_torque(
            p, 1.0, w, w + alpha * h, w * h + 0.5 * alpha * h * h, h / JE, 0.5 * h * h / JE, h, 1.0
        )
        extra = crank.extra_inertia(p, 1.0)
        assert torque == pytest.approx(-extra * alpha * JE / (JE + extra), rel=1e-3)


def test_substeps_and_a_step_of_any_length_keep_the_energy():
    p = EXACT.pack()
    for h in (1e-6, 1e-3):
        angle, speed = 2.0, 500.0
        energy = crank.reciprocating_energy(p, angle, speed) + 0.5 * JE * speed**2
        torque = held(p, angle, speed, h, 0.0)
        angle += h * speed + 0.5 * h * h * torque / JE
        speed += h * torque / JE
        after = crank.reciprocating_energy(p, angle, speed) + 0.5 * JE * speed**2
        assert after == pytest.approx(energy, rel=1e-7 if h > 1e-4 else 1e-14)


def test_throttle_scales_only_where_asked_for():
    h, w = 50e-6, 300.0
    gains = (h / JE, 0.5 * h * h / JE, h)
    paper = msgspec.structs.replace(EXACT, throttled=True).pack()

    def torque(p, throttle):
        return crank.crank_torque(p, 0.7, w, w, h * w, *gains, throttle)

    assert torque(EXACT.pack(), 0.3) == torque(EXACT.pack(), 1.0)
    assert torque(paper, 1.0) == torque(EXACT.pack(), 1.0)
    assert torque(paper, 0.3) == pytest.approx(0.3 * torque(paper, 1.0), rel=0.02)
    assert torque(paper, 0.0) == 0.0


@pytest.mark.parametrize(
    "angle", [0.0, -1e-18, 2.0 * math.pi, -2.0 * math.pi, 1e4, -1e4, 6.283185307179586]
)
def test_angle_is_wrapped(angle):
    wrapped = crank.wrap(angle)
    assert 0.0 <= wrapped < 2.0 * math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-11)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-11)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"radius": 0.0}, r"crank\.radius: expected a number greater than 0"),
        ({"rod_length": 0.05}, r"crank\.rod_length: expected at least twice"),
        ({"reciprocating_mass": 60.0}, r"crank\.reciprocating_mass: expected a reciprocating inertia"),
    ],
)  # fmt: skip
def test_bad_crank_is_named(change, where):
    with pytest.raises(InputError, match=where):
        msgspec.structs.replace(EXACT, **change).validate("crank", JE)
