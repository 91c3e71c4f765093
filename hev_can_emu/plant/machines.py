"""All machines of a car as one record, and their section of the vehicle file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from hev_can_emu.plant.battery import BatteryParameters
from hev_can_emu.plant.brakes import BrakeParameters
from hev_can_emu.plant.clutch import ClutchParameters, ShortCircuitParameters
from hev_can_emu.plant.contactors import ContactorParameters
from hev_can_emu.plant.engine import EngineParameters
from hev_can_emu.plant.motor import MotorParameters
from hev_can_emu.plant.record_file import file_type, from_file, validate
from hev_can_emu.plant.road import RoadParameters
from hev_can_emu.plant.speed_control import SpeedControlParameters
from hev_can_emu.plant.synchronizer import SynchronizerParameters
from hev_can_emu.plant.thermal import ThermalNode, ThermalParameters
from hev_can_emu.plant.torque_source import TorqueSourceParameters


class ElectricMachine(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """EM1 or EM2 with what belongs to it."""

    motor: MotorParameters
    speed_control: SpeedControlParameters
    thermal: ThermalParameters
    short_circuit: ShortCircuitParameters


class Machines(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Everything of the plant but the driveline's inertias and branches."""

    engine: EngineParameters
    engine_coolant: ThermalNode
    em1: ElectricMachine
    em2: ElectricMachine
    clutch: ClutchParameters
    synchronizer: SynchronizerParameters
    battery: BatteryParameters
    contactors: ContactorParameters
    brakes: BrakeParameters
    road: RoadParameters


_TORQUE, _SPEED, _TIME, _PURE, _KELVIN = "N m", "rad/s", "s", "1", "K"
UNITS: dict[type, dict[str, str]] = {
    TorqueSourceParameters: {
        "delay": _TIME, "slew_rate": "N m/s", "time_constant": _TIME, "off_slew_rate": "N m/s",
    },
    EngineParameters: {
        "speed": _SPEED, "full_load": _TORQUE, "drag": _TORQUE, "drag_fade_speed": _SPEED,
        "crank_speed": _SPEED, "stall_speed": _SPEED, "idle_speed": _SPEED,
        "idle_gain": "N m s/rad", "idle_integral_gain": "N m/rad", "idle_torque_max": _TORQUE,
        "fade_speed": _SPEED, "max_speed": _SPEED, "cut_speed": _SPEED, "resume_speed": _SPEED,
        "coolant_heat_ratio": _PURE,
    },
    MotorParameters: {
        "peak_torque": _TORQUE, "peak_power": "W", "nominal_voltage": "V", "voltage_min": "V",
        "voltage_full": "V", "fade_speed": _SPEED, "max_speed": _SPEED, "winding_derate": _KELVIN,
        "winding_max": _KELVIN, "inverter_derate": _KELVIN, "inverter_max": _KELVIN,
        "loss_constant": "W", "loss_speed": "W s/rad", "loss_speed_square": "W s^2/rad^2",
        "loss_torque_square": "W/(N^2 m^2)", "loss_cross": _PURE, "inverter_share": _PURE,
    },
    SpeedControlParameters: {
        "inertia": "kg m^2", "bandwidth": _SPEED, "damping": _PURE, "setpoint_weight": _PURE,
    },
    ThermalNode: {"capacity": "J/K", "resistance": "K/W"},
    ShortCircuitParameters: {"peak_torque": _TORQUE, "speed": _SPEED},
    ClutchParameters: {"max_capacity": _TORQUE, "static_ratio": _PURE},
    SynchronizerParameters: {
        "max_force": "N", "force_time_constant": _TIME, "least_force": "N",
        "centring_force": "N", "damping": "N s/m", "max_velocity": "m/s", "blocking_position": "m",
        "dog_position": "m", "end_position": "m", "cone_friction": _PURE, "cone_radius": "m",
        "cone_angle": "rad", "cones_g1": _PURE, "cones_g2": _PURE, "index_time": _TIME,
        "timeout": _TIME, "lost_force_time": _TIME, "free_flight_share": _PURE,
        "dog_slip": _SPEED, "dog_friction": _PURE, "dog_radius": "m",
    },
    BatteryParameters: {
        "capacity": "A s", "soc": _PURE, "open_circuit_voltage": "V", "temperature": _KELVIN,
        "resistance": "Ohm", "discharge_power": "W", "charge_power": "W", "voltage_min": "V",
        "voltage_max": "V", "heat_capacity": "J/K", "heat_resistance": "K/W",
        "auxiliary_power": "W",
    },
    ContactorParameters: {
        "precharge_resistance": "Ohm", "discharge_resistance": "Ohm", "link_capacitance": "F",
        "precharge_share": _PURE, "precharge_timeout": _TIME, "opening_time": _TIME,
    },
    BrakeParameters: {"max_torque": _TORQUE, "front_share": _PURE},
    RoadParameters: {
        "rolling_coefficient": _PURE, "rolling_speed_square": "s^2/m^2", "drag_area": "m^2",
        "air_density": "kg/m^3",
    },
}  # fmt: skip


if TYPE_CHECKING:
    MachinesFile = Any
else:
    MachinesFile = file_type(Machines)


def machines_parameters(file: MachinesFile, where: str) -> Machines:
    """Return the machines' records in SI, checked; ``where`` is the path of the section."""
    machines: Machines = from_file(Machines, file, UNITS, where)
    validate(machines, where)
    return machines
