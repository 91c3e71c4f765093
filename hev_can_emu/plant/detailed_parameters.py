"""What the detailed plant is made of beside the simple machines, and which of its effects are on."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.plant import checks
from hev_can_emu.plant.combustion_map import CombustionParameters
from hev_can_emu.plant.dc_link import DcLinkParameters
from hev_can_emu.plant.electric_drive import DriveParameters
from hev_can_emu.plant.geared import RearAxle
from hev_can_emu.plant.holding import MAX_MESHES
from hev_can_emu.plant.hydraulic_parameters import HydraulicsParameters
from hev_can_emu.plant.sleeve_parameters import SleeveParameters
from hev_can_emu.plant.tyre import TyreSlipParameters
from hev_can_emu.plant.vehicle import MESHES
from hev_can_emu.plant.wet_clutch import WetClutchParameters

MESH_NAMES = tuple(f"k{name}" for name in MESHES)
MOST_PLAY = 5e-3  #: of a mesh, m


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
        firing_ripple: whether the engine's ``pulses`` act.
        mesh_play: whole play of meshes by their stiffness's name, :func:`check_mesh_play`, m.
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
    firing_ripple: bool = False
    mesh_play: Mapping[str, float] = {}

    def check_options(self, where: str) -> None:
        """Raise :class:`InputError` for a ripple without its pulses, or a play that cannot be."""
        check_mesh_play(self.mesh_play, f"{where}.mesh_play")
        if self.firing_ripple and self.engine.pulses is None:
            raise InputError(
                f"{where}.firing_ripple", "false, or the engine's pulses", "true without them"
            )


def check_mesh_play(given: Mapping[str, float], where: str) -> None:
    """Raise :class:`InputError` unless at most two meshes (``kg1``) have a play that teeth can have, m."""
    for name, play in given.items():
        if name not in MESH_NAMES:
            expected = f"one of {', '.join(MESH_NAMES)}"
            raise InputError(where, expected, f"'{name}'", did_you_mean(name, MESH_NAMES))
        if not 0.0 < play <= MOST_PLAY:
            expected = f"a play above 0, up to {1e3 * MOST_PLAY:g} mm"
            raise InputError(f"{where}.{name}", expected, f"{1e3 * play:g} mm")
    if len(given) > MAX_MESHES:
        raise InputError(where, f"at most {MAX_MESHES} meshes", f"{len(given)}")


class Effects(msgspec.Struct, frozen=True, kw_only=True):
    """Effects that may be left out, for comparison with simpler models; by default as the car says.

    Attributes:
        pistons: the inertial torque of the cylinders.
        firing_ripple: firing pulses of the gas torque; None as the car says.
        dog_play: play of the engaged dogs; without it they hold like a lock.
        rear_wheels: an inertia of their own; without them they are part of the body.
        tyre_slip: where the car has it.
        mesh_play: as :func:`check_mesh_play` takes it; None as the car says.
        damper_work: book the heat of every damper.
        step_ns: the inner step, ns; a part of 1 ms of which the drives' control period is a multiple.
        wear: of C1's friction curves, 0 fresh to 1 aged; None as the car says.
    """

    pistons: bool = True
    firing_ripple: bool | None = None
    dog_play: bool = True
    rear_wheels: bool = True
    tyre_slip: bool = True
    mesh_play: Mapping[str, float] | None = None
    damper_work: bool = True
    step_ns: int = 50_000
    wear: float | None = None

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first choice that cannot be."""
        if self.step_ns <= 0 or 1_000_000 % self.step_ns:
            raise InputError(f"{where}.step_ns", "a whole part of 1 ms", f"{self.step_ns}")
        check_mesh_play(self.mesh_play or {}, f"{where}.mesh_play")
        if self.wear is not None and not 0.0 <= self.wear <= 1.0:
            raise InputError(f"{where}.wear", "a number from 0 to 1", f"{self.wear:g}")
