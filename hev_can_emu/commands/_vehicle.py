"""Finds a vehicle file by name or path and reads its driveline."""

from __future__ import annotations

import textwrap
from typing import NamedTuple

from hev_can_emu import config
from hev_can_emu.ecu.transmission_file import CarFile
from hev_can_emu.plant.vehicle import DrivelineParameters
from hev_can_emu.plant.vehicle_file import driveline_parameters
from hev_can_emu.runtime.setup import vehicle_path

DEFAULT = "dai2024"


class Vehicle(NamedTuple):
    """A driveline with its name and where its numbers come from."""

    name: str
    provenance: str
    driveline: DrivelineParameters


def load_vehicle(name: str = DEFAULT) -> Vehicle:
    """Return the vehicle ``name``, a path or a shipped vehicle.

    Raises:
        InputError: there is none, or it cannot be used.
    """
    path = vehicle_path(name)
    file = config.load(path, CarFile)
    return Vehicle(file.name, file.provenance, driveline_parameters(file.driveline, str(path)))


def load_driveline(name: str = DEFAULT) -> DrivelineParameters:
    """Return the driveline's parameters of the vehicle ``name``, as :func:`load_vehicle` does."""
    return load_vehicle(name).driveline


def print_provenance(provenance: str) -> None:
    """Print where the parameters come from; no answer is shown without it."""
    print(textwrap.fill(f"Parameters: {provenance}", 100))
