"""The vehicle file's schema: every value with its unit and source, turned into checked SI records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import msgspec

from hev_can_emu.errors import InputError
from hev_can_emu.plant.detailed_file import DetailedFile, detailed_parameters
from hev_can_emu.plant.detailed_parameters import DetailedParameters
from hev_can_emu.plant.machines import Machines, MachinesFile, machines_parameters
from hev_can_emu.plant.values import Value, si_number
from hev_can_emu.plant.vehicle import MESHES, SHAFTS, DrivelineParameters


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

    version: Literal[1]
    name: str
    provenance: str
    driveline: DrivelineFile
    machines: MachinesFile | None = None
    detailed: DetailedFile | None = None


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


def machine_parameters(file: VehicleFile, where: str) -> Machines:
    """Return the machines' parameters in SI, checked; a file with a driveline only is refused."""
    path = f"{where}: $.machines"
    if file.machines is None:
        raise InputError(path, "the machines' parameters", "nothing", "a car that runs needs them")
    return machines_parameters(file.machines, path)


def finer_parameters(file: VehicleFile, where: str) -> DetailedParameters:
    """Return the detailed model's parameters in SI, checked; a file without them is refused."""
    path = f"{where}: $.detailed"
    if file.detailed is None:
        raise InputError(
            path, "the detailed model's parameters", "nothing", "or take --model 16dof"
        )
    found = detailed_parameters(file.detailed, path)
    body = file.driveline.inertias["Jv"]
    found.rear_axle.check_fits(si_number(body, "kg m^2", path), f"{path}.rear_axle")
    crank_inertia = si_number(file.driveline.inertias["Je"], "kg m^2", path)
    found.engine.crank.validate(f"{path}.engine.crank", crank_inertia)
    return found
