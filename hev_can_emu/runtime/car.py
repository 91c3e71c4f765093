"""The car of a run: a plant of the chosen fidelity and how it starts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu.transmission_file import transmission_tuning
from hev_can_emu.ecu.transmission_unit import TransmissionUnit, build_unit
from hev_can_emu.plant import detailed_layout, powertrain
from hev_can_emu.plant.assembly import build_plant, driveline_structure, start_state
from hev_can_emu.plant.detailed_assembly import build_detailed, read_ledger, start_detailed
from hev_can_emu.plant.detailed_parameters import Effects
from hev_can_emu.plant.ledger import Ledger
from hev_can_emu.plant.start import Start
from hev_can_emu.plant.vehicle_file import finer_parameters
from hev_can_emu.runtime.kept import kept
from hev_can_emu.runtime.setup import Setup, load_car


class Car:
    """A car's plant with what starts it.

    Args:
        setup: names vehicle, model and reduction.
        effects: of the detailed plant; all by default.

    Attributes:
        plant: constants, ``powertrain.Plant`` or ``detailed_layout.DetailedPlant``.
        unit: the detailed plant's TCU, or None.
        work: values of scratch that a step needs.
        name, provenance: of the vehicle.
        tyre_radius: m.
        brake_max: N m, of a fully pressed pedal.
        clutch_max, force_max: greatest capacity of C1, N m, and shift force, N.

    Raises:
        InputError: the file cannot be used, or lacks what the model needs.
    """

    def __init__(self, setup: Setup, effects: Effects | None = None) -> None:
        parameters, machines, file, path = load_car(setup.vehicle)
        self.name, self.provenance = file.name, file.provenance
        self.tyre_radius = parameters.tyre_radius
        self.brake_max = machines.brakes.max_torque
        self.clutch_max = machines.clutch.max_capacity
        self.force_max = machines.synchronizer.max_force
        self.plant: Any
        self.unit: TransmissionUnit | None = None
        if setup.model == "detailed":
            finer = finer_parameters(file, path)
            self.plant = build_detailed(parameters, machines, finer, effects)
            self.unit = build_unit(finer, transmission_tuning(file, path))
            self.work = detailed_layout.WORK
        else:
            self._key = repr((setup.model, setup.reduction)).encode() + Path(path).read_bytes()

            def make() -> powertrain.Plant:
                structure = driveline_structure(parameters, setup.model, setup.reduction)
                return build_plant(parameters, machines, structure)

            self.plant = kept("plant.assembly", "plant", self._key, make)
            self.work = powertrain.WORK

    def start(
        self, begin: Start
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Return the float64 state, the int64 state and the truth at the start."""
        if self.unit is not None:
            return start_detailed(self.plant, begin)
        key = repr(begin).encode() + self._key
        return kept("plant.assembly", "start", key, lambda: start_state(self.plant, begin))

    def ledger(self, x: npt.NDArray[np.float64], n: npt.NDArray[np.int64]) -> Ledger | None:
        """Return the energy ledger at a state; None for a model that keeps none."""
        return None if self.unit is None else read_ledger(self.plant, x, n)
