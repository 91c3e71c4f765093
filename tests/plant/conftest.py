"""The default car, read once."""

from __future__ import annotations

import pytest

from hev_can_emu import config
from hev_can_emu.plant.machines import Machines
from hev_can_emu.plant.vehicle import DrivelineParameters
from hev_can_emu.plant.vehicle_file import VehicleFile, driveline_parameters, machine_parameters
from hev_can_emu.resources import folder


@pytest.fixture(scope="session")
def vehicle_file() -> VehicleFile:
    return config.load(folder("vehicles") / "dai2024.yaml", VehicleFile)


@pytest.fixture(scope="session")
def driveline_values(vehicle_file: VehicleFile) -> DrivelineParameters:
    return driveline_parameters(vehicle_file.driveline, "dai2024")


@pytest.fixture(scope="session")
def machine_values(vehicle_file: VehicleFile) -> Machines:
    return machine_parameters(vehicle_file, "dai2024")
