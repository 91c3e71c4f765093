"""The vehicle file's section ``detailed``: units of its values, and its way into records."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hev_can_emu.plant.combustion_map import CombustionParameters
from hev_can_emu.plant.crank import CrankParameters
from hev_can_emu.plant.current_control import CurrentControlParameters
from hev_can_emu.plant.dc_link import DcLinkParameters
from hev_can_emu.plant.detailed_parameters import DetailedParameters, TransmissionParameters
from hev_can_emu.plant.electric_drive import DriveParameters
from hev_can_emu.plant.gas_pulses import GasPulseParameters
from hev_can_emu.plant.geared import RearAxle
from hev_can_emu.plant.hydraulic_parameters import (
    ClutchCylinderParameters,
    OilParameters,
    ShiftCylinderParameters,
    SupplyParameters,
    ValveParameters,
)
from hev_can_emu.plant.inverter import InverterParameters
from hev_can_emu.plant.pmsm import PmsmParameters
from hev_can_emu.plant.record_file import file_type, from_file, validate
from hev_can_emu.plant.sleeve_parameters import SleeveParameters
from hev_can_emu.plant.torque_map import TorqueMapParameters
from hev_can_emu.plant.tyre import TyreSlipParameters
from hev_can_emu.plant.wet_clutch import FrictionParameters, WetClutchParameters

_TORQUE, _SPEED, _TIME, _PURE, _KELVIN, _LENGTH = "N m", "rad/s", "s", "1", "K", "m"
_PASCAL, _VOLT, _AMPERE, _OHM, _FORCE, _ANGLE = "Pa", "V", "A", "Ohm", "N", "rad"
UNITS: dict[type, dict[str, str]] = {
    CrankParameters: {
        "reciprocating_mass": "kg", "radius": _LENGTH, "rod_length": _LENGTH,
    },
    GasPulseParameters: {
        "bore": _LENGTH, "compression_ratio": _PURE, "exponent": _PURE, "burn_start": _ANGLE,
        "burn_duration": _ANGLE, "closed_pressure": _PASCAL, "leak_speed": _SPEED,
    },
    CombustionParameters: {
        "speed": _SPEED, "load": _PURE, "torque": _TORQUE, "drag": _TORQUE, "efficiency": _PURE,
        "drag_fade_speed": _SPEED, "breakaway": _TORQUE, "crank_speed": _SPEED, "stall_speed": _SPEED,
        "idle_speed": _SPEED, "idle_gain": "N m s/rad", "idle_integral_gain": "N m/rad",
        "idle_torque_max": _TORQUE, "fade_speed": _SPEED, "max_speed": _SPEED,
        "cut_speed": _SPEED, "resume_speed": _SPEED, "intake_angle": _ANGLE,
        "intake_time_max": _TIME, "heating_value": "J/kg", "wall_share": _PURE,
    },
    PmsmParameters: {
        "pole_pairs": _PURE, "flux": "Wb", "inductance_d": "H", "inductance_q": "H",
        "resistance": _OHM, "copper_coefficient": "1/K", "copper_reference": _KELVIN,
        "hysteresis": "W s/Wb^2", "eddy": "W s^2/Wb^2", "drag": _TORQUE, "windage": "N m s^2",
    },
    InverterParameters: {
        "voltage_rms": _VOLT, "overmodulation": _PURE, "fixed_loss": "W",
        "device_voltage": _VOLT, "device_resistance": _OHM, "switching_energy": "J/(V A)",
        "switching_frequency": "Hz",
    },
    CurrentControlParameters: {"period": _TIME, "bandwidth": _SPEED},
    TorqueMapParameters: {
        "current_rms": _AMPERE, "voltage_margin": _PURE, "voltage_min": _VOLT,
        "voltage_full": _VOLT, "fade_speed": _SPEED, "max_speed": _SPEED,
        "winding_derate": _KELVIN, "winding_max": _KELVIN, "inverter_derate": _KELVIN,
        "inverter_max": _KELVIN,
    },
    DriveParameters: {"slew_rate": "N m/s", "compensate_drag": _PURE},
    DcLinkParameters: {
        "capacitance": "F", "precharge_resistance": _OHM, "discharge_resistance": _OHM,
        "bleed_resistance": _OHM,
    },
    OilParameters: {
        "density": "kg/m^3", "bulk_modulus": _PASCAL, "discharge_coefficient": _PURE,
        "laminar_pressure": _PASCAL,
    },
    SupplyParameters: {
        "displacement": "m^3/rad", "speed": _SPEED, "time_constant": _TIME,
        "leak": "m^3/(s Pa)", "friction": "N m s/rad", "relief_pressure": _PASCAL,
        "relief_slope": "m^3/(s Pa)", "line_volume": "m^3", "precharge": _PASCAL,
        "accumulator_compliance": "m^3/Pa",
    },
    ValveParameters: {
        "area": "m^2", "underlap": _PURE, "leak": "m^3/(s Pa)", "full_current": _AMPERE,
        "natural_frequency": _SPEED, "damping": _PURE,
    },
    ClutchCylinderParameters: {
        "area": "m^2", "volume": "m^3", "preload": _FORCE, "spring": "N/m",
        "kiss_travel": _LENGTH, "pack": "N/m", "seal_damping": "N s/m",
    },
    ShiftCylinderParameters: {
        "area1": "m^2", "area2": "m^2", "volume1": "m^3", "volume2": "m^3",
        "make_up_area": "m^2",
    },
    FrictionParameters: {
        "speed": "m/s", "fresh": _PURE, "aged": _PURE, "static_fresh": _PURE,
        "static_aged": _PURE, "pressure": _PASCAL, "pressure_factor": _PURE,
        "temperature": _KELVIN, "temperature_factor": _PURE,
    },
    WetClutchParameters: {
        "surfaces": _PURE, "outer_radius": _LENGTH, "inner_radius": _LENGTH,
        "groove_share": _PURE, "kiss_travel": _LENGTH, "least_gap": _LENGTH,
        "viscosity": "Pa s", "viscosity_temperature": _KELVIN, "viscosity_slope": "1/K",
        "expulsion_slip": _SPEED, "film_pressure": _PASCAL, "heat_capacity": "J/K",
        "oil_heat": "J/(m^3 K)", "still_cooling": "W/K",
    },
    SleeveParameters: {
        "mass": "kg", "damping": "N s/m", "guide_friction": _FORCE, "neutral_force": _FORCE,
        "neutral_width": _LENGTH, "engaged_force": _FORCE, "engaged_width": _LENGTH,
        "strut_force": _FORCE, "strut_position": _LENGTH, "blocking_position": _LENGTH,
        "dog_position": _LENGTH, "chamfer_depth": _LENGTH, "least_overlap": _LENGTH,
        "end_position": _LENGTH, "cone_friction": _PURE, "cone_radius": _LENGTH,
        "cone_angle": _ANGLE, "cones_g1": _PURE, "cones_g2": _PURE, "ring_chamfer_angle": _ANGLE,
        "chamfer_friction": _PURE, "index_time": _TIME, "index_force": _FORCE,
        "flight_share": _PURE, "dog_teeth": _PURE, "dog_radius": _LENGTH,
        "half_clearance": _ANGLE, "dog_slip": _SPEED, "dog_friction": _PURE,
        "ratchet_share": _PURE, "ratchet_speed": "m/s",
    },
    TransmissionParameters: {
        "clutch_wear": _PURE, "clutch_cooling": "m^3/s",
    },
    RearAxle: {"inertia": "kg m^2", "stiffness": "N m/rad", "damping": "N m s/rad"},
    DetailedParameters: {"mesh_play": _LENGTH},
    TyreSlipParameters: {"slip_stiffness": _PURE, "friction": _PURE, "front_load": _PURE},
}  # fmt: skip


if TYPE_CHECKING:
    DetailedFile = Any
else:
    DetailedFile = file_type(DetailedParameters)


def detailed_parameters(file: DetailedFile, where: str) -> DetailedParameters:
    """Return the finer machines' records in SI, checked; ``where`` is the path of the section."""
    found: DetailedParameters = from_file(DetailedParameters, file, UNITS, where)
    validate(found, where)
    found.check_options(where)
    return found
