"""Undamped, nothing is lost or gained over 200,000 exact steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from random_cars import car, changed, rigid_shape

from hev_can_emu.plant.bank import propagators
from hev_can_emu.plant.geared import RearAxle, geared
from hev_can_emu.plant.linear import state_space
from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.structure import CONFIGURATIONS, Configuration, Structure, full_order
from hev_can_emu.plant.vehicle import DrivelineParameters

STEPS = 200_000
REAR = RearAxle(inertia=2.0, stiffness=16e3, damping=0.0)
# How each is built, and its step, s.
MODELS: dict[str, tuple[Callable[[DrivelineParameters], Structure], float]] = {
    "16dof": (full_order, 1e-3),
    "4dof": (reduced, 1e-3),
    "detailed": (lambda p: geared(p, REAR), 5e-5),
}


def undamped(p: DrivelineParameters) -> DrivelineParameters:
    return changed(p, "damping", **dict.fromkeys(p.damping, 0.0))


def energy(structure: Structure, configuration: Configuration, x: np.ndarray) -> float:
    n = structure.n
    bending = structure.basis @ x[n:]
    stiffness = structure.stiffness[configuration.driving]
    return float(x[:n] @ (structure.inertia * x[:n]) + bending @ stiffness @ bending) / 2


@pytest.mark.parametrize("which", ["default", 1, 2])
@pytest.mark.parametrize("name", ["parallel_g1", "series", "electric_neutral"])
@pytest.mark.parametrize("model", ["16dof", "4dof", "detailed"])
def test_energy_and_momentum_over_two_hundred_thousand_steps(
    which: str | int, name: str, model: str
) -> None:
    p = undamped(car(which))
    build, step = MODELS[model]
    structure = build(p)
    configuration = CONFIGURATIONS[name]
    a, b = state_space(structure, configuration)
    flow = propagators(a, b, step, 0)[0, :, : len(a)]
    random = np.random.default_rng(3)
    z = rigid_shape(structure, configuration)
    transform = structure.lock_map(configuration)
    x = np.concatenate(
        [
            z @ random.uniform(50.0, 200.0, z.shape[1])
            + transform @ random.uniform(-20.0, 20.0, transform.shape[1]),
            np.zeros(structure.nq),
        ]
    )
    x = np.ascontiguousarray(x)
    start = energy(structure, configuration, x)
    momentum = z.T @ (structure.inertia * x[: structure.n])
    scale = np.abs(z).T @ (structure.inertia * np.abs(x[: structure.n]))
    worst_energy, worst_momentum = 0.0, 0.0
    for _ in range(100):
        for _ in range(STEPS // 100):
            x = flow @ x
        worst_energy = max(worst_energy, abs(energy(structure, configuration, x) / start - 1))
        now = z.T @ (structure.inertia * x[: structure.n])
        worst_momentum = max(worst_momentum, float(np.max(np.abs(now - momentum) / scale)))
    assert worst_energy < 1e-9
    assert worst_momentum < 1e-9
