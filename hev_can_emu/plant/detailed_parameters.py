"""What the detailed plant is made of beside the simple machines, and which of its effects are on."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from hev_can_emu.errors import InputError
from hev_can_emu.plant import checks
from hev_can_emu.plant.combustion_map import CombustionParameters
from hev_can_emu.plant.dc_link import DcLinkParameters
from hev_can_emu.plant.electric_drive import DriveParameters
from hev_can_emu.plant.geared import RearAxle
from hev_can_emu.plant.hydraulic_parameters import HydraulicsParameters
from hev_can_emu.plant.sleeve_parameters import SleeveParameters
from hev_can_emu.plant.tyre import TyreSlipParameters
from hev_can_emu.plant.wet_clutch import WetClutchParameters


class TransmissionParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What remains of the transmission; SI units.

    Attributes:
        clutch_wear: of C1's friction curves, 0 fresh to 1 aged.
        clutch_cooling: oil through its plates, m^3/s.
    """

    clutch_wear: float
    clutch_cooling: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.fraction(where, self, "clutch_wear")
        checks.not_negative(where, self, "clutch_cooling")


class DetailedParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The machines that the detailed plant models finer; all else is as for the simple models.

    Attributes:
        tyre_slip: None for tyres that do not slip.
    """

    engine: CombustionParameters
    em1: DriveParameters
    em2: DriveParameters
    dc_link: DcLinkParameters
    hydraulics: HydraulicsParameters
    clutch: WetClutchParameters
    sleeve: SleeveParameters
    transmission: TransmissionParameters
    rear_axle: RearAxle
    tyre_slip: TyreSlipParameters | None = None


class Effects(msgspec.Struct, frozen=True, kw_only=True):
    """Effects that may be left out, for comparison with simpler models; by default all are on.

    Attributes:
        pistons: the inertial torque of the cylinders.
        ripple: firing pulses of the gas torque, where the car's parameters have them.
        dog_play: play of the engaged dogs; without it they hold like a lock.
        rear_wheels: an inertia of their own; without them they are part of the body.
        mesh_play: whole play of meshes by the branch's name (``kg1``, at most two), m.
        damper_work: book the heat of every damper.
        step_ns: the inner step, ns; a part of 1 ms of which the drives' control period is a multiple.
        wear: of C1's friction curves, 0 fresh to 1 aged; None as the car says.
    """

    pistons: bool = True
    ripple: bool = False
    dog_play: bool = True
    rear_wheels: bool = True
    mesh_play: Mapping[str, float] = {}
    damper_work: bool = True
    step_ns: int = 50_000
    wear: float | None = None

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first choice that cannot be."""
        if self.step_ns <= 0 or 1_000_000 % self.step_ns:
            raise InputError(f"{where}.step_ns", "a whole part of 1 ms", f"{self.step_ns}")
        if len(self.mesh_play) > 2:
            raise InputError(f"{where}.mesh_play", "at most two meshes", f"{len(self.mesh_play)}")
        if self.wear is not None and not 0.0 <= self.wear <= 1.0:
            raise InputError(f"{where}.wear", "a number from 0 to 1", f"{self.wear:g}")
