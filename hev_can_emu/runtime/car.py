"""The car of a run: a plant of the chosen fidelity and how it starts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant import powertrain
from hev_can_emu.plant.start import Start
from hev_can_emu.runtime.kept import kept
from hev_can_emu.runtime.setup import Setup, load_car, vehicle_path

if TYPE_CHECKING:
    from hev_can_emu.ecu.transmission_unit import TransmissionUnit
    from hev_can_emu.plant.detailed_parameters import Effects
    from hev_can_emu.plant.ledger import Ledger
    from hev_can_emu.plant.machines import Machines
    from hev_can_emu.plant.vehicle import DrivelineParameters
    from hev_can_emu.plant.vehicle_file import VehicleFile

# What builds plants is imported where one is built: most runs find theirs kept.
_CODE = "runtime.car"


class _Traits(NamedTuple):
    """What a vehicle file tells besides the plant; see :class:`Car`."""

    name: str
    provenance: str
    tyre_radius: float
    brake_max: float
    clutch_max: float
    force_max: float


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
        self.plant: Any
        self.unit: TransmissionUnit | None = None
        self._key = b""
        if setup.model == "detailed":
            from hev_can_emu.plant import detailed_layout

            traits = self._build(setup, effects)
            self.work = detailed_layout.WORK
        else:
            traits, self.plant = self._kept(setup)
            self.work = powertrain.WORK
        self.name, self.provenance = traits.name, traits.provenance
        self.tyre_radius = traits.tyre_radius
        self.brake_max = traits.brake_max
        self.clutch_max, self.force_max = traits.clutch_max, traits.force_max

    def _build(self, setup: Setup, effects: Effects | None) -> _Traits:
        from hev_can_emu.ecu.transmission_file import transmission_tuning
        from hev_can_emu.ecu.transmission_unit import build_unit
        from hev_can_emu.plant.detailed_assembly import build_detailed
        from hev_can_emu.plant.vehicle_file import finer_parameters

        parameters, machines, file, path = load_car(setup.vehicle)
        finer = finer_parameters(file, path)
        self.plant = build_detailed(parameters, machines, finer, effects)
        self.unit = build_unit(finer, transmission_tuning(file, path))
        return _traits(parameters, machines, file)

    def _kept(self, setup: Setup) -> tuple[_Traits, powertrain.Plant]:
        """Return a car with a simpler plant, which depends on the file's content and the choices alone."""
        path = vehicle_path(setup.vehicle)
        try:
            content = path.read_bytes()
        except OSError:
            content = b""  # told when it is read as YAML
        self._key = repr((setup.model, setup.reduction)).encode() + content

        def make() -> tuple[_Traits, powertrain.Plant]:
            from hev_can_emu.plant.assembly import build_plant, driveline_structure

            parameters, machines, file, _ = load_car(setup.vehicle)
            structure = driveline_structure(parameters, setup.model, setup.reduction)
            return _traits(parameters, machines, file), build_plant(parameters, machines, structure)

        return kept(_CODE, "plant", self._key, make)

    def start(
        self, begin: Start
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Return the float64 state, the int64 state and the truth at the start."""
        if self.unit is not None:
            from hev_can_emu.plant.detailed_assembly import start_detailed

            return start_detailed(self.plant, begin)

        def make() -> tuple[
            npt.NDArray[np.float64], npt.NDArray[np.int64], npt.NDArray[np.float64]
        ]:
            from hev_can_emu.plant.assembly import start_state

            return start_state(self.plant, begin)

        return kept(_CODE, "start", repr(begin).encode() + self._key, make)

    def ledger(self, x: npt.NDArray[np.float64], n: npt.NDArray[np.int64]) -> Ledger | None:
        """Return the energy ledger at a state; None for a model that keeps none."""
        if self.unit is None:
            return None
        from hev_can_emu.plant.detailed_assembly import read_ledger

        return read_ledger(self.plant, x, n)


def _traits(parameters: DrivelineParameters, machines: Machines, file: VehicleFile) -> _Traits:
    return _Traits(
        name=file.name,
        provenance=file.provenance,
        tyre_radius=parameters.tyre_radius,
        brake_max=machines.brakes.max_torque,
        clutch_max=machines.clutch.max_capacity,
        force_max=machines.synchronizer.max_force,
    )
