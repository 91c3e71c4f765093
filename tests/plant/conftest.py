"""The default car, read once."""

from __future__ import annotations

import pytest

from hev_can_emu import config
from hev_can_emu.ecu.transmission_file import CarFile
from hev_can_emu.plant.machines import Machines
from hev_can_emu.plant.vehicle import DrivelineParameters
from hev_can_emu.plant.vehicle_file import driveline_parameters, machine_parameters
from hev_can_emu.resources import folder


@pytest.fixture(scope="session")
def vehicle_file() -> CarFile:
    return config.load(folder("vehicles") / "dai2024.yaml", CarFile)


@pytest.fixture(scope="session")
def driveline_values(vehicle_file: CarFile) -> DrivelineParameters:
    return driveline_parameters(vehicle_file.driveline, "dai2024")


@pytest.fixture(scope="session")
def machine_values(vehicle_file: CarFile) -> Machines:
    return machine_parameters(vehicle_file, "dai2024")
