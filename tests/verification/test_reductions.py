"""The reduced models against the full order, in every configuration."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from random_cars import CARS, car, rigid_shape

from hev_can_emu.plant.linear import modes
from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.structure import CONFIGURATIONS, full_order
from hev_can_emu.plant.vehicle import DrivelineParameters


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_load_weighted_is_within_its_promise_on_the_default_car(name: str) -> None:
    full = modes(full_order(car("default")), CONFIGURATIONS[name])
    close = modes(reduced(car("default")), CONFIGURATIONS[name])
    kept = len(close.undamped_hz)
    assert kept == 3
    assert close.undamped_hz == pytest.approx(full.undamped_hz[:kept], rel=2e-4)
    assert close.damped_hz == pytest.approx(full.damped_hz[:kept], rel=2e-4)
    assert close.damping_ratio == pytest.approx(full.damping_ratio[:kept], rel=1e-2)


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_load_weighted_beats_the_literal_rule_by_far(name: str) -> None:
    full = modes(full_order(car("default")), CONFIGURATIONS[name])
    errors = {}
    for rule in ("paper", "load-weighted"):
        found = modes(reduced(car("default"), rule), CONFIGURATIONS[name])
        errors[rule] = np.abs(found.undamped_hz / full.undamped_hz[:3] - 1.0).max()
    assert errors["load-weighted"] < errors["paper"] / 50


@pytest.mark.parametrize(("which", "name"), list(itertools.product(CARS, CONFIGURATIONS)))
def test_rigid_acceleration_is_equal_where_the_ratios_are(which: str | int, name: str) -> None:
    p = car(which)
    configuration = CONFIGURATIONS[name]
    torques = np.array([150.0, -30.0, 200.0, -100.0])
    found = []
    for structure in (full_order(p), reduced(p)):
        z = rigid_shape(structure, configuration)
        mass = z.T @ (structure.inertia[:, None] * z)
        acceleration = z @ np.linalg.solve(mass, z.T @ (structure.ports.T @ torques))
        found.append(structure.ports @ acceleration)
    assert found[1] == pytest.approx(found[0], rel=1e-12, abs=1e-12 * np.abs(found[0]).max())


@pytest.mark.parametrize(("which", "name"), list(itertools.product(CARS[1:], CONFIGURATIONS)))
def test_load_weighted_holds_for_other_cars(which: int, name: str) -> None:
    full = modes(full_order(car(which)), CONFIGURATIONS[name])
    close = modes(reduced(car(which)), CONFIGURATIONS[name])
    assert close.undamped_hz == pytest.approx(full.undamped_hz[:3], rel=1e-3)
    assert close.damping_ratio == pytest.approx(full.damping_ratio[:3], rel=1e-2)


@pytest.mark.parametrize(("which", "name"), list(itertools.product(CARS, CONFIGURATIONS)))
def test_lumped_inertia_is_the_rigid_projection_of_the_full_order(
    which: str | int, name: str
) -> None:
    p = car(which)
    configuration = CONFIGURATIONS[name]
    sums = []
    for structure in (full_order(p), reduced(p)):
        z = rigid_shape(structure, configuration)
        wheel = structure.locks[3] @ z
        # The shape that turns the wheels, and whatever else may turn by itself at rest.
        z = (
            z
            @ np.linalg.lstsq(
                np.vstack([wheel, structure.ports[:2] @ z]),
                np.concatenate([[1.0], _input_speeds(p, name)]),
                rcond=None,
            )[0]
        )
        sums.append(float(z @ (structure.inertia * z)))
    assert sums[1] == pytest.approx(sums[0], rel=1e-12)


def _input_speeds(p: DrivelineParameters, name: str) -> np.ndarray:
    """Engine and EM1 speed per wheel speed; what is not coupled stands still."""
    configuration = CONFIGURATIONS[name]
    if not configuration.gear:
        return np.zeros(2)
    ratio = p.ratios["g1" if configuration.gear == 1 else "g2"] * p.ratios["fd"]
    engine = ratio if configuration.clutch else 0.0
    return np.array([engine, ratio * p.ratios["id1"] * p.ratios["id2"]])
