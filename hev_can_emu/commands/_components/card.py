"""What a component has to show, and the car whose component it is."""

from __future__ import annotations

from typing import NamedTuple

from hev_can_emu.ecu.transmission_file import TransmissionTuning
from hev_can_emu.plant.detailed_parameters import DetailedParameters
from hev_can_emu.plant.machines import Machines
from hev_can_emu.plant.vehicle import DrivelineParameters
from hev_can_emu.report.component_plot import Fact, Panel


class Car(NamedTuple):
    """All parameters of a vehicle file."""

    name: str
    driveline: DrivelineParameters
    machines: Machines
    detailed: DetailedParameters
    tuning: TransmissionTuning


class Card(NamedTuple):
    """A component's title, panels and facts."""

    title: str
    panels: list[Panel]
    facts: list[Fact]
    note: str = ""
