"""The TCU's tuning as the vehicle file holds it, beside what the plant reads of that file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from hev_can_emu.ecu.hydraulic_control import HydraulicControlParameters
from hev_can_emu.ecu.shift_control import ShiftControlParameters
from hev_can_emu.plant.record_file import file_type, from_file, validate
from hev_can_emu.plant.vehicle_file import VehicleFile

_TIME, _FORCE, _PRESSURE, _SPEED, _PURE = "s", "N", "Pa", "m/s", "1"


class TransmissionTuning(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Both controls of the TCU; what is left out is as in the default car."""

    hydraulics: HydraulicControlParameters = HydraulicControlParameters()
    shift: ShiftControlParameters = ShiftControlParameters()


UNITS: dict[type, dict[str, str]] = {
    HydraulicControlParameters: {
        "bandwidth": "rad/s", "integral_time": _TIME, "integral_share": _PURE,
        "fill_share": _PURE, "touch_time": _TIME, "touch_margin": _PRESSURE,
        "least_capacity": "N m", "pressure_share": _PURE, "shift_bandwidth": "rad/s",
        "least_force": _FORCE, "standing_speed": _SPEED, "speed_time": _TIME,
        "pump_on": _PRESSURE, "pump_off": _PRESSURE,
    },
    ShiftControlParameters: {
        "max_force": _FORCE, "least_force": _FORCE, "travel_force": _FORCE, "dog_force": _FORCE,
        "holding_force": _FORCE, "holding_time": _TIME, "centring_force": _FORCE,
        "centring_stiffness": "N/m", "centring_damping": "N s/m", "centre_band": "m",
        "speed_time": _TIME, "timeout": _TIME, "lost_force_time": _TIME, "still_time": _TIME,
        "still_speed": _SPEED,
    },
}  # fmt: skip


if TYPE_CHECKING:
    TransmissionFile = Any
else:
    TransmissionFile = file_type(TransmissionTuning)


class CarFile(VehicleFile, frozen=True, forbid_unknown_fields=True):
    """A vehicle file with its control units."""

    transmission_unit: TransmissionFile | None = None


def transmission_tuning(file: CarFile, where: str) -> TransmissionTuning:
    """Return the TCU's tuning in SI, checked; ``where`` names the file in errors."""
    if file.transmission_unit is None:
        return TransmissionTuning()
    place = f"{where}: $.transmission_unit"
    found: TransmissionTuning = from_file(TransmissionTuning, file.transmission_unit, UNITS, place)
    validate(found, place)
    return found
