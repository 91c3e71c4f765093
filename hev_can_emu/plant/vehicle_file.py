"""The vehicle file's schema: every value with its unit and source, turned into checked SI records."""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec

from hev_can_emu.errors import InputError
from hev_can_emu.plant.vehicle import MESHES, SHAFTS, DrivelineParameters
from hev_can_emu.units import unit


class Value(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A number (or a table's numbers) as written: with unit, and where it comes from."""

    value: float | list[float]
    unit: str
    source: str = ""
    note: str = ""


class DrivelineFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The section ``driveline``."""

    inertias: dict[str, Value]
    stiffness: dict[str, Value]
    damping: dict[str, Value]
    base_radii: dict[str, Value]
    tyre_radius: Value
    reduced_ratios: dict[str, Value] = {}


class VehicleFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A vehicle file.  ``provenance`` says in plain words where the numbers come from."""

    version: int
    name: str
    provenance: str
    driveline: DrivelineFile
    machines: dict[str, dict[str, Value]] = {}


def si_number(given: Value, expected_unit: str, where: str) -> float:
    """Return a single value in SI; raises InputError for a table, a non-number or a foreign dimension."""
    if isinstance(given.value, list):
        raise InputError(where, f"one number in {expected_unit}", f"a list of {len(given.value)}")
    return si_list(given, expected_unit, where)[0]


def si_list(given: Value, expected_unit: str, where: str) -> tuple[float, ...]:
    """Return a table's values in SI; raises InputError for a non-number or a foreign dimension."""
    used = unit(given.unit, f"{where}.unit")
    wanted = unit(expected_unit)
    if used.dimension != wanted.dimension:
        raise InputError(f"{where}.unit", f"a unit of {expected_unit}", f"'{given.unit}'")
    values = given.value if isinstance(given.value, list) else [given.value]
    for value in values:
        if not math.isfinite(value):
            raise InputError(f"{where}.value", "a finite number", str(value))
    return tuple(used.to_si(value) for value in values)


def driveline_parameters(file: DrivelineFile, where: str) -> DrivelineParameters:
    """Return the driveline's parameters in SI, checked; ``where`` names the file in errors.

    Ratios of the reduced model that the file leaves out follow from the base radii.
    """
    path = f"{where}: $.driveline"

    def section(
        given: Mapping[str, Value], name: str, units: Mapping[str, str], default: str
    ) -> dict[str, float]:
        return {
            key: si_number(value, units.get(key, default), f"{path}.{name}.{key}")
            for key, value in given.items()
        }

    shaft_k = {"k" + name: "N m/rad" for name in SHAFTS}
    mesh_k = {"k" + name: "N/m" for name in MESHES}
    shaft_c = {"c" + name: "N m s/rad" for name in SHAFTS}
    mesh_c = {"c" + name: "N s/m" for name in MESHES}
    parameters = DrivelineParameters(
        inertias=section(file.inertias, "inertias", {}, "kg m^2"),
        stiffness=section(file.stiffness, "stiffness", shaft_k | mesh_k, "N m/rad"),
        damping=section(file.damping, "damping", shaft_c | mesh_c, "N m s/rad"),
        base_radii=section(file.base_radii, "base_radii", {}, "m"),
        reduced_ratios=section(file.reduced_ratios, "reduced_ratios", {}, "1"),
        tyre_radius=si_number(file.tyre_radius, "m", f"{path}.tyre_radius"),
    )
    parameters.check_known(path)
    completed = DrivelineParameters(
        parameters.inertias,
        parameters.stiffness,
        parameters.damping,
        parameters.base_radii,
        parameters.ratios | parameters.reduced_ratios,
        parameters.tyre_radius,
    )
    completed.check_possible(path)
    return completed
