"""The driveline step against closed forms and published event times."""

from __future__ import annotations

import numpy as np
import pytest
from small_drivelines import Bench, inertias_with_clutches

from hev_can_emu.plant import driveline, teeth

pytestmark = pytest.mark.kernels


def test_two_inertias_lock_at_the_closed_form_instant_with_its_heat() -> None:
    # J 0.2 and 0.5 kg m^2, 200 and 50 rad/s, capacity 120 N m, torques 30 and -10 N m:
    # relative deceleration 120/0.2 + 120/0.5 - 30/0.2 - 10/0.5 = 670 rad/s^2; heat = M dw t / 2.
    bench = Bench(inertias_with_clutches([0.2, 0.5], {0: (0, 1)}))
    bench.x[:2] = 200.0, 50.0
    bench.kinetic[0], bench.static[0] = 120.0, 130.0
    start = driveline.energy(bench.bank, bench.x, bench.state)
    work = 0.0
    while bench.state[driveline.HELD] == 0:
        before = bench.x[:2].copy()
        bench.u[0], bench.u[1] = 30.0, -10.0
        bench.step()
        mean = (before + bench.x[:2]) / 2
        work += (30.0 * mean[0] - 10.0 * mean[1]) * 1e-3
        assert bench.t_ns < 400_000_000
    (instant, kind, lock), *_ = bench.events
    assert (kind, lock) == (driveline.LOCKED, 0)
    assert instant == pytest.approx(150.0 / 670.0, abs=1.0e-6)
    assert bench.x[0] == pytest.approx(bench.x[1], abs=1e-12)
    # Speed of the locked pair: total momentum over total inertia.
    momentum = 0.2 * 200 + 0.5 * 50 + 20.0 * bench.t_ns * 1e-9
    assert bench.x[0] == pytest.approx(momentum / 0.7, rel=1e-12)
    heat = start + work - driveline.energy(bench.bank, bench.x, bench.state)
    # The mean speed over the step in which it locks is not exact: one step's share of tolerance.
    assert heat == pytest.approx(2014.925, rel=1e-4)


def test_its_heat_is_booked_where_it_arises() -> None:
    # The same clutch as the detailed plant steps it: heat is friction torque over the slip's exact travel.
    bench = Bench(inertias_with_clutches([0.2, 0.5], {0: (0, 1)}), 5e-5, 6, detailed=True)
    bench.x[:2] = 200.0, 50.0
    bench.kinetic[0], bench.static[0] = 120.0, 130.0
    while bench.t_ns < 300_000_000:
        bench.u[0], bench.u[1] = 30.0, -10.0
        bench.step()
    (instant, kind, lock), *others = bench.events
    assert (kind, lock, others) == (driveline.LOCKED, 0, [])
    assert instant == pytest.approx(150.0 / 670.0, abs=1.0e-6)
    assert bench.lost[teeth.FRICTION] == pytest.approx(120.0 * 150.0**2 / 670.0 / 2.0, rel=1e-9)
    assert bench.lost[teeth.FRICTION] == pytest.approx(2014.925, abs=1e-3)
    assert 0.0 <= bench.lost[teeth.LOST] < 1e-6


def test_stuck_clutch_releases_when_its_static_capacity_is_exceeded() -> None:
    bench = Bench(inertias_with_clutches([0.2, 0.5], {0: (0, 1)}))
    bench.kinetic[0], bench.static[0] = 100.0, 120.0
    for millisecond in range(400):
        # Half of the torque difference, weighted with inertia, passes: 0.5/0.7 of the port torque.
        bench.u[0], bench.u[1] = float(millisecond), 0.0
        bench.step()
    released = [event for event in bench.events if event[1] == driveline.RELEASED]
    assert len(released) == 1
    assert released[0][0] == pytest.approx(np.ceil(120.0 * 0.7 / 0.5) * 1e-3, abs=1.01e-3)
    assert bench.x[0] > bench.x[1]


@pytest.mark.parametrize("detailed", [False, True])
def test_coupled_clutches_of_the_modelica_standard_library(detailed: bool) -> None:
    # Rotational.Examples.CoupledClutches: four inertias of 1 kg m^2, J1 at 10 rad/s, torque
    # 10 sin(2 pi 5 t); capacities 10*|f|, static 11*|f|, f1 = cos(2 pi 0.2 t), f2 from 0.4 s, f3 from 0.9 s.
    structure = inertias_with_clutches([1.0] * 4, {0: (0, 1), 1: (1, 2), 3: (2, 3)})
    bench = Bench(structure, 5e-5, 6, detailed)
    bench.x[0] = 10.0
    while bench.t_ns < 1_500_000_000:
        middle = (bench.t_ns + 25_000) * 1e-9
        force = (
            np.cos(0.4 * np.pi * middle),
            float(middle >= 0.4),
            0.0,
            float(middle >= 0.9),
            0.0,
            0.0,
        )
        bench.u[:4] = 10.0 * np.sin(10.0 * np.pi * middle), 0.0, 0.0, 0.0
        bench.kinetic[:] = 10.0 * np.array(force)
        bench.static[:] = 11.0 * np.array(force)
        bench.step()
    real = [
        e
        for e in bench.events
        if e[1] != driveline.REVERSED and e[0] > 0.401 and not 0.8999 < e[0] < 0.9001
    ]
    expected = [
        (0.709621, driveline.LOCKED, 1),
        (0.791658, driveline.LOCKED, 0),
        (0.831109, driveline.RELEASED, 0),
        (0.906849, driveline.LOCKED, 0),
        (1.000296, driveline.RELEASED, 0),
        (1.143970, driveline.LOCKED, 3),
    ]
    assert [e[1:] for e in real] == [e[1:] for e in expected]
    for (instant, _, _), (published, _, _) in zip(real, expected, strict=True):
        assert instant == pytest.approx(published, abs=1e-4)
    assert bench.x[0] == pytest.approx(3.247035, abs=1e-3)
    assert bench.x[1] == pytest.approx(2.463208, abs=1e-3)


def test_splitting_a_run_between_steps_changes_no_bit() -> None:
    def run(split: int) -> np.ndarray:
        bench = Bench(inertias_with_clutches([0.2, 0.5], {0: (0, 1)}, [(0, 1)], 50.0))
        bench.x[:2] = 30.0, 5.0
        bench.kinetic[0], bench.static[0] = 5.0, 6.0
        for k in range(60):
            bench.u[0], bench.u[1] = 3.0, -1.0
            bench.step()
            if k == split:  # what a pause would do: nothing but carry the state
                bench.x = bench.x.copy()
        return bench.x

    assert run(10).tobytes() == run(37).tobytes()
