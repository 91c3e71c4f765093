"""The default car and seeded random ones: a check on the default alone would only confirm a fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hev_can_emu import config
from hev_can_emu.ecu.transmission_file import CarFile
from hev_can_emu.plant.vehicle import DrivelineParameters
from hev_can_emu.plant.vehicle_file import driveline_parameters

_DEFAULT = Path(__file__).resolve().parents[2] / "vehicles" / "dai2024.yaml"
CARS = ("default", 1, 2, 3, 4, 5)


def car(which: str | int) -> DrivelineParameters:
    """Return the default car, or one whose every parameter lies within a factor of two of it."""
    default = driveline_parameters(config.load(_DEFAULT, CarFile).driveline, "dai2024")
    if which == "default":
        return default
    random = np.random.default_rng(int(which))

    def scattered(values: dict[str, float], factor: float) -> dict[str, float]:
        bound = np.log(factor)
        return {k: v * float(np.exp(random.uniform(-bound, bound))) for k, v in values.items()}

    made = DrivelineParameters(
        scattered(default.inertias, 2.0),
        scattered(default.stiffness, 2.0),
        scattered(default.damping, 2.0),
        scattered(default.base_radii, 1.25),
        {},
        0.33,
    )
    return DrivelineParameters(
        made.inertias,
        made.stiffness,
        made.damping,
        made.base_radii,
        made.ratios,
        made.tyre_radius,
    )


def changed(parameters: DrivelineParameters, section: str, **values: float) -> DrivelineParameters:
    """Return ``parameters`` with some values of a section replaced."""
    fields = {
        name: dict(getattr(parameters, name))
        for name in ("inertias", "stiffness", "damping", "base_radii", "reduced_ratios")
    }
    fields[section].update(values)
    return DrivelineParameters(**fields, tyre_radius=parameters.tyre_radius)


def rigid_shape(structure, configuration):  # type: ignore[no-untyped-def]
    """Return the rigid-body shapes (n, r) of all inertias' speeds in a configuration."""
    transform = structure.lock_map(configuration)
    _, values, rows = np.linalg.svd(structure.incidence @ transform)
    rank = int(np.sum(values > 1e-9 * values[0]))
    return transform @ rows[rank:].T
