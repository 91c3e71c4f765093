"""The machine itself: transforms, exactness and order, energy, short circuit, freewheel."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
import pytest
from diode_bridge import bridge
from drive_defaults import BOOK, EM1, EM2
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from hev_can_emu.errors import InputError
from hev_can_emu.plant import freewheel, pmsm
from hev_can_emu.plant.pmsm import (
    OUT_AIR_GAP,
    OUT_COPPER,
    OUT_DRAG,
    OUT_IRON,
    OUT_MAGNETIC,
    OUT_SERIES,
    OUT_SHAFT,
    OUT_TERMINAL,
    OUT_TORQUE,
)
from hev_can_emu.plant.transforms import clarke, inverse_clarke, inverse_park, park

replace = msgspec.structs.replace
DT = 5e-5
SPENT = [OUT_SHAFT, OUT_COPPER, OUT_SERIES, OUT_IRON, OUT_DRAG]

phase = st.floats(-1e3, 1e3)
angle = st.floats(-20.0, 20.0)


@given(phase, phase, phase, angle)
def test_transforms_undo_each_other(a, b, c, theta):
    alpha, beta, zero = clarke(a, b, c)
    assert inverse_clarke(alpha, beta, zero) == pytest.approx((a, b, c), abs=1e-9)
    d, q = park(alpha, beta, theta)
    assert inverse_park(d, q, theta) == pytest.approx((alpha, beta), abs=1e-9)
    # Power: 3/2 of the vector's, and three times the zero components'.
    power = 1.5 * (d * d + q * q) + 3.0 * zero * zero
    assert power == pytest.approx(a * a + b * b + c * c, rel=1e-9, abs=1e-9)


@given(st.floats(0.1, 500.0), angle, angle)
def test_a_balanced_system_keeps_its_amplitude_and_stands_still_on_the_rotor(peak, theta, ahead):
    third = 2.0 * math.pi / 3.0
    a, b, c = (peak * math.cos(theta + ahead - k * third) for k in range(3))
    alpha, beta, zero = clarke(a, b, c)
    assert zero == pytest.approx(0.0, abs=1e-9)
    expected = (peak * math.cos(ahead), peak * math.sin(ahead))
    assert park(alpha, beta, theta) == pytest.approx(expected, abs=1e-9)


def exact(machine, i, v_d, v_q, speed, time):
    """The same by the matrix exponential."""
    w = machine.pole_pairs * speed
    ld, lq, r = machine.inductance_d, machine.inductance_q, machine.resistance
    system = np.zeros((3, 3))
    system[0] = -r / ld, w * lq / ld, v_d / ld
    system[1] = -w * ld / lq, -r / lq, (v_q - w * machine.flux) / lq
    return (expm(system * time) @ np.array([*i, 1.0]))[:2]


def steps(machine, i, v_d, v_q, speed, dt, time):
    p, x, out = machine.pack(dt), np.array(i, dtype=float), np.zeros(pmsm.N_OUT)
    for _ in range(round(time / dt)):
        pmsm.pmsm_step(p, x, v_d, v_q, speed, machine.resistance, 0.0, out)
    return x


@pytest.mark.parametrize("speed", [0.0, 200.0, -900.0, 1466.0])
def test_currents_converge_with_fourth_order(speed):
    case = (EM2.machine, (-100.0, 150.0), -60.0, 90.0, speed)
    true = exact(*case, 2e-3)
    errors = [np.abs(steps(*case, dt, 2e-3) - true).max() for dt in (1e-4, 5e-5, 2.5e-5)]
    assert errors[0] < 1.0
    assert errors[1] < 0.06
    for coarse, fine in itertools.pairwise(errors):
        if fine > 1e-9:
            assert math.log2(coarse / fine) == pytest.approx(4.0, abs=0.15)


@given(
    st.floats(-400.0, 400.0), st.floats(-400.0, 400.0), st.floats(-250.0, 250.0),
    st.floats(-250.0, 250.0), st.floats(-1500.0, 1500.0), st.floats(0.0, 0.01),
    st.sampled_from([2.5e-5, 5e-5, 1e-4]),
)  # fmt: skip
def test_energy_of_every_step_closes(i_d, i_q, v_d, v_q, speed, series, dt):
    p, x, out = EM1.machine.pack(dt), np.array([i_d, i_q]), np.zeros(pmsm.N_OUT)
    before = pmsm.magnetic_energy(p, i_d, i_q)
    pmsm.pmsm_step(p, x, v_d, v_q, speed, 0.02, series, out)
    spent = out[SPENT].sum() + out[OUT_MAGNETIC] - before
    scale = np.abs(out[[*SPENT, OUT_TERMINAL]]).sum() + before + out[OUT_MAGNETIC]
    assert abs(out[OUT_TERMINAL] - spent) <= 1e-12 * scale
    assert out[OUT_COPPER] >= 0.0
    assert out[OUT_IRON] >= 0.0
    assert out[OUT_DRAG] >= 0.0
    assert out[OUT_SHAFT] == pytest.approx(speed * out[OUT_TORQUE] * dt, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("speed", [5.0, 60.0, -400.0, 1400.0])
def test_steady_short_circuit_torque_is_the_closed_form(speed):
    machine = replace(BOOK, resistance=0.05)
    series, total = 0.01, 0.06
    p, x, out = machine.pack(1e-4), np.zeros(2), np.zeros(pmsm.N_OUT)
    for _ in range(2500):
        pmsm.pmsm_step(p, x, 0.0, 0.0, speed, 0.05, series, out)
    w, ld, lq, psi = 4.0 * speed, BOOK.inductance_d, BOOK.inductance_q, BOOK.flux
    below = total**2 + w * w * ld * lq
    assert x == pytest.approx([-w * w * lq * psi / below, -w * total * psi / below], rel=1e-9)
    torque = -1.5 * 4.0 * psi**2 * total * w * (total**2 + w * w * lq * lq) / below**2
    assert out[OUT_AIR_GAP] == pytest.approx(torque, rel=1e-9)
    assert out[OUT_TORQUE] == out[OUT_AIR_GAP]  # no iron loss, no drag in this machine
    assert out[OUT_SERIES] == pytest.approx(out[OUT_COPPER] * series / 0.05, rel=1e-12)


def test_idle_losses_are_those_of_the_magnets_flux_and_vanish_at_standstill():
    machine = EM2.machine
    p, x, out = machine.pack(DT), np.zeros(2), np.zeros(freewheel.N_OUT)
    freewheel.freewheel_step(p, x, 350.0, 0.8, 500.0, 0.01, 0.0, out)
    iron = (machine.hysteresis * 2000.0 + machine.eddy * 2000.0**2) * machine.flux**2
    assert out[OUT_IRON] / DT == pytest.approx(iron, rel=1e-12)
    assert out[OUT_DRAG] / DT == pytest.approx(0.08 * 500.0 + 2.5e-7 * 500.0**3, rel=1e-12)
    assert out[OUT_TORQUE] < 0.0
    freewheel.freewheel_step(p, x, 350.0, 0.8, 0.0, 0.01, 0.0, out)
    assert out[OUT_TORQUE] == 0.0


def coast(machine, i, link, diode, speed, count, series=0.001, dt=DT):
    """Run blocked; return rows of outputs and of currents, with the balance checked in each step."""
    p, x, out = machine.pack(dt), np.array(i, dtype=float), np.zeros(freewheel.N_OUT)
    rows, currents = [], []
    for _ in range(count):
        before = pmsm.magnetic_energy(p, x[0], x[1])
        freewheel.freewheel_step(p, x, link, diode, speed, machine.resistance, series, out)
        spent = out[SPENT].sum() + out[freewheel.OUT_LINK] + out[freewheel.OUT_DIODES]
        terms = out[[*SPENT, freewheel.OUT_LINK, freewheel.OUT_DIODES]]
        scale = np.abs(terms).sum() + before + out[OUT_MAGNETIC]
        assert abs(spent + out[OUT_MAGNETIC] - before) <= 1e-11 * scale + 1e-20
        assert out[freewheel.OUT_LINK] >= 0.0
        assert out[freewheel.OUT_DIODES] >= 0.0
        rows.append(out.copy())
        currents.append(x.copy())
    return np.array(rows), np.array(currents)


@given(
    st.floats(-400.0, 400.0), st.floats(-400.0, 400.0), st.floats(0.0, 450.0),
    st.floats(-1466.0, 1466.0), st.sampled_from([2.5e-5, 5e-5, 1e-4]),
)  # fmt: skip
def test_freewheel_closes_its_balance_and_stays_bounded(i_d, i_q, link, speed, dt):
    _, currents = coast(EM2.machine, (i_d, i_q), link, 0.8, speed, 40, dt=dt)
    assert np.isfinite(currents).all()
    assert np.abs(currents).max() < 2500.0  # into an empty link: a short circuit


@pytest.mark.parametrize("speed", [0.0, 150.0, -500.0, 800.0])
def test_below_the_link_the_current_dies_into_it_and_stays_zero(speed):
    rows, currents = coast(EM2.machine, (-150.0, 200.0), 350.0, 0.8, speed, 40)
    assert np.all(currents[20:] == 0.0)
    assert np.all(rows[20:, freewheel.OUT_LINK] == 0.0)
    assert rows[:, freewheel.OUT_LINK].sum() > 0.0


def test_the_dying_current_of_a_round_machine_at_rest_takes_the_time_it_must():
    # No resistance, equal inductances, no speed: |i| falls at k*V/L; within one step at the edge's k.
    machine = replace(BOOK, inductance_q=BOOK.inductance_d, resistance=0.0)
    rows, currents = coast(machine, (0.0, 60.0), 300.0, 0.0, 0.0, 2, series=0.0)
    assert np.all(currents == 0.0)
    given = rows[:, freewheel.OUT_LINK].sum()
    assert given == pytest.approx(0.75 * BOOK.inductance_d * 60.0**2, rel=1e-12)


@pytest.mark.parametrize("drive", [EM1, EM2])
def test_conduction_starts_where_the_line_voltage_reaches_link_and_diodes(drive):
    edge = (350.0 + 1.6) / math.sqrt(3.0) / drive.machine.flux / 4.0
    for sign in (1.0, -1.0):
        _, below = coast(drive.machine, (0.0, 0.0), 350.0, 0.8, sign * 0.9999 * edge, 20)
        _, above = coast(drive.machine, (0.0, 0.0), 350.0, 0.8, sign * 1.01 * edge, 200)
        assert np.all(below == 0.0)
        assert sign * above[-1, 1] < 0.0  # brakes
        assert above[-1] == pytest.approx(above[-2], abs=1e-5)


@pytest.mark.compiled
@pytest.mark.parametrize(("over", "tolerance"), [(1.2, 0.25), (1.4, 0.03), (1.65, 0.03)])
def test_rectifying_agrees_with_a_switched_bridge(over, tolerance):
    machine = replace(EM2.machine, hysteresis=0.0, eddy=0.0, drag=0.0, windage=0.0)
    speed = over * 350.0 / math.sqrt(3.0) / machine.flux / 4.0
    turn = 2.0 * math.pi / (4.0 * speed)
    torque, current, *_ = bridge(
        4.0, machine.flux, machine.inductance_d, machine.inductance_q, machine.resistance, speed,
        350.0, 0.03, 10 * turn,
    )  # fmt: skip
    rows, _ = coast(machine, (0.0, 0.0), 350.0, 0.0, speed, 1500, series=0.0)
    assert rows[-1, OUT_AIR_GAP] == pytest.approx(torque, rel=tolerance)
    assert rows[-1, freewheel.OUT_LINK] / DT / 350.0 == pytest.approx(current, rel=tolerance)


def test_freewheel_converges_with_second_order():
    def torque_work(dt):
        rows, _ = coast(EM2.machine, (-200.0, -100.0), 350.0, 0.8, 1400.0, round(2e-3 / dt), dt=dt)
        return rows[:, OUT_SHAFT].sum()

    values = [torque_work(dt) for dt in (1e-4, 5e-5, 2.5e-5, 1.25e-5)]
    steps_between = np.abs(np.diff(values))
    assert steps_between[0] / steps_between[1] == pytest.approx(4.0, rel=0.35)
    assert steps_between[1] / steps_between[2] == pytest.approx(4.0, rel=0.15)


def test_hot_copper_has_more_resistance():
    p = EM1.machine.pack(DT)
    hot = pmsm.phase_resistance(p, 293.15 + 100.0)
    assert hot == pytest.approx(0.016 * 1.393, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"flux": 0.0}, "flux: expected a number greater than 0"),
        ({"pole_pairs": 2.5}, "pole_pairs: expected a whole number"),
        ({"inductance_q": 1e-5}, "inductance_q: expected at least inductance_d"),
        ({"resistance": -1.0}, "resistance: expected a number of at least 0"),
    ],
)
def test_bad_machines_are_named(change, words):
    with pytest.raises(InputError, match=words):
        replace(BOOK, **change).validate("em1")
