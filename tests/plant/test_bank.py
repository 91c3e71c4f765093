"""The bank of propagators and the switch between configurations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from hev_can_emu.plant import driveline
from hev_can_emu.plant.bank import Bank, build_bank
from hev_can_emu.plant.events import EVENT
from hev_can_emu.plant.linear import modes, state_space
from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.structure import CONFIGURATIONS, Structure, configuration_at, full_order
from hev_can_emu.plant.vehicle import DrivelineParameters

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module", params=["16dof", "4dof", "4dof paper"])
def car(
    request: pytest.FixtureRequest, driveline_values: DrivelineParameters
) -> tuple[Structure, Bank]:
    if request.param == "16dof":
        structure = full_order(driveline_values)
    else:
        structure = reduced(
            driveline_values, "paper" if "paper" in request.param else "load-weighted"
        )
    return structure, build_bank(structure)


@pytest.mark.parametrize("row", [0, 3, 5, 23, 32, 47])
def test_propagators_agree_with_an_independent_matrix_exponential(
    car: tuple[Structure, Bank], row: int
) -> None:
    structure, bank = car
    a, b = state_space(structure, configuration_at(row))
    nx, nu = b.shape
    # Twists in units that make all states of like size, so that one tolerance serves.
    scale = np.concatenate([np.ones(structure.n), np.full(structure.nq, 1e3), np.ones(nu)])
    for level in (0, 5, 10):
        h = 1e-3 / 2 ** (10 - level)
        generator = np.zeros((nx + nu, nx + nu))
        generator[:nx, :nx], generator[:nx, nx:] = a * h, b * h
        expected = linalg.expm(generator)[:nx]
        difference = (
            (bank.flow[row, level, : nx + nu, :nx].T - expected) * scale[:nx, None] / scale[None, :]
        )
        assert np.abs(difference).max() < 1e-10


def test_switching_keeps_momentum_and_books_what_is_lost(car: tuple[Structure, Bank]) -> None:
    structure, bank = car
    rng = np.random.default_rng(7)
    for new in range(48):
        held = configuration_at(new)
        x = rng.normal(size=structure.n + structure.nq)
        x[structure.n :] *= 1e-3
        state = np.zeros(driveline.N_INTEGERS, dtype=np.int64)
        before, energy = x.copy(), driveline.energy(bank, x, state)
        lost = driveline.set_row(bank, x, state, new)
        # Everything that can move freely in the new configuration keeps its momentum.
        free = structure.lock_map(held)
        momentum = free.T @ (structure.inertia * before[: structure.n])
        assert free.T @ (structure.inertia * x[: structure.n]) == pytest.approx(momentum, abs=1e-11)
        held_rows = structure.locks[[lock for lock, holds in enumerate(held.locks) if holds]]
        assert np.abs(held_rows @ x[: structure.n]).max(initial=0.0) < 1e-12
        assert energy - lost == pytest.approx(driveline.energy(bank, x, state), rel=1e-12)


def test_half_shaft_torque_does_not_jump_at_a_switch(car: tuple[Structure, Bank]) -> None:
    structure, bank = car
    rng = np.random.default_rng(3)
    halves = [
        i for i, name in enumerate(structure.branch_names) if name in ("klh", "krh", "eq1", "eq2")
    ]
    for old in range(6):
        for new in range(6):
            x = rng.normal(size=structure.n + structure.nq)
            x[structure.n :] *= 1e-3
            state = np.zeros(driveline.N_INTEGERS, dtype=np.int64)
            state[driveline.ROW] = old
            torque = structure.stiffness[old] @ structure.basis @ x[structure.n :]
            driveline.set_row(bank, x, state, new)
            after = structure.stiffness[new] @ structure.basis @ x[structure.n :]
            assert after[halves].sum() == pytest.approx(torque[halves].sum(), rel=1e-9)


@pytest.mark.parametrize("name", sorted(CONFIGURATIONS))
def test_a_kick_rings_at_the_first_mode(car: tuple[Structure, Bank], name: str) -> None:
    structure, bank = car
    configuration = CONFIGURATIONS[name]
    found = modes(structure, configuration)
    x = np.zeros(structure.n + structure.nq)
    state = np.zeros(driveline.N_INTEGERS, dtype=np.int64)
    for lock, holds in enumerate(configuration.locks):
        state[driveline.HELD + lock] = holds
    state[driveline.ROW] = configuration.row
    # Let go from the first mode's shape, at rest, and watch a twist cross zero.
    shape = structure.lock_map(configuration) @ found.shapes[:, 0]
    x[structure.n :] = structure.incidence[list(structure.independent)] @ shape
    u, static = np.zeros(10), np.full(6, np.inf)
    kinetic, lost, trial = np.zeros(6), np.zeros(1), np.zeros(driveline.TRIAL)
    events = np.zeros(4, dtype=EVENT)
    trace = []
    watched = int(np.abs(x[structure.n :]).argmax())
    for k in range(2000):
        driveline.step(bank, x, state, u, kinetic, static, lost, trial, k * 10**6, 10**6, events, 0)
        trace.append(x[structure.n + watched])
    # The higher modes, which die out sooner, are part of the first crossings.
    crossings = np.flatnonzero(np.diff(np.signbit(trace)))
    crossings = crossings[crossings > 900]
    values = np.array(trace)
    instants = crossings - values[crossings] / (values[crossings + 1] - values[crossings])
    period = 2e-3 * (instants[-1] - instants[0]) / (len(instants) - 1)
    assert 1.0 / period == pytest.approx(found.oscillation_hz[0], rel=5e-3)


def test_a_row_without_locks_is_configuration_zero() -> None:
    for row in range(48):
        assert configuration_at(row).row == row
