"""Finds a vehicle file by name or path and reads its driveline."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import NamedTuple

from hev_can_emu import config
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.plant.vehicle import DrivelineParameters
from hev_can_emu.plant.vehicle_file import VehicleFile, driveline_parameters
from hev_can_emu.resources import folder

DEFAULT = "dai2024"


class Vehicle(NamedTuple):
    """A driveline with its name and where its numbers come from."""

    name: str
    provenance: str
    driveline: DrivelineParameters


def vehicle_path(name: str) -> Path:
    """Return the file behind ``name``: a path, or the name of a shipped vehicle.

    Raises:
        InputError: neither exists.
    """
    return shipped_or_path(name, folder("vehicles"), "--vehicle")


def shipped_or_path(name: str, place: Path, option: str) -> Path:
    """Return ``name`` as a path where it is one, else the shipped YAML file of that name.

    Raises:
        InputError: neither exists; ``option`` is blamed.
    """
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or len(path.parts) > 1 or path.is_file():
        return path
    known = sorted(file.stem for file in place.glob("*.yaml"))
    if name not in known:
        hint = did_you_mean(name, known) or f"shipped: {', '.join(known)}"
        raise InputError(option, "a file, or the name of a shipped one", f"'{name}'", hint)
    return place / f"{name}.yaml"


def load_vehicle(name: str = DEFAULT) -> Vehicle:
    """Return the vehicle ``name``, a path or a shipped vehicle.

    Raises:
        InputError: there is none, or it cannot be used.
    """
    path = vehicle_path(name)
    file = config.load(path, VehicleFile)
    return Vehicle(file.name, file.provenance, driveline_parameters(file.driveline, str(path)))


def load_driveline(name: str = DEFAULT) -> DrivelineParameters:
    """Return the driveline's parameters of the vehicle ``name``, as :func:`load_vehicle` does."""
    return load_vehicle(name).driveline


def print_provenance(provenance: str) -> None:
    """Print where the parameters come from; no answer is shown without it."""
    print(textwrap.fill(f"Parameters: {provenance}", 100))
