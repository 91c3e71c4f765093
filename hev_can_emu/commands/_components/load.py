"""Reads a vehicle file as the car whose components are shown."""

from __future__ import annotations

from hev_can_emu.commands._components.card import Car
from hev_can_emu.ecu.transmission_file import transmission_tuning
from hev_can_emu.plant.vehicle_file import finer_parameters
from hev_can_emu.runtime import setup


def load_car(vehicle: str) -> Car:
    """Return all parameters of a vehicle, a path or a shipped name.

    Raises:
        InputError: there is none, or it lacks the machines or the detailed model.
    """
    driveline, machines, file, path = setup.load_car(vehicle)
    finer, tuning = finer_parameters(file, path), transmission_tuning(file, path)
    return Car(vehicle, driveline, machines, finer, tuning)
