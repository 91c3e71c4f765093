"""The default car's machines as the tests use them: plausible for the class, not published anywhere."""

from __future__ import annotations

import math

from hev_can_emu.plant.battery import BatteryParameters
from hev_can_emu.plant.brakes import BrakeParameters
from hev_can_emu.plant.contactors import ContactorParameters
from hev_can_emu.plant.engine import EngineParameters
from hev_can_emu.plant.motor import MotorParameters
from hev_can_emu.plant.road import RoadParameters
from hev_can_emu.plant.speed_control import SpeedControlParameters
from hev_can_emu.plant.synchronizer import SynchronizerParameters
from hev_can_emu.plant.thermal import ThermalNode, ThermalParameters
from hev_can_emu.plant.torque_source import TorqueSourceParameters


def rpm(*values: float) -> tuple[float, ...]:
    return tuple(round(value * math.pi / 30.0, 3) for value in values)


ENGINE = EngineParameters(
    source=TorqueSourceParameters(
        delay=0.02, slew_rate=1500.0, time_constant=0.05, off_slew_rate=3000.0
    ),
    speed=rpm(500, 1000, 1500, 2500, 4000, 5000, 6000),
    full_load=(70.0, 105.0, 130.0, 145.0, 150.0, 142.0, 120.0),
    drag=(14.0, 15.0, 16.0, 18.0, 21.0, 23.0, 26.0),
    drag_fade_speed=20.0,
    crank_speed=42.0,
    stall_speed=31.0,
    idle_speed=89.0,
    idle_gain=0.8,
    idle_integral_gain=1.2,
    idle_torque_max=80.0,
    fade_speed=586.0,
    max_speed=628.0,
    cut_speed=649.0,
    resume_speed=618.0,
    coolant_heat_ratio=0.9,
)

EM1 = MotorParameters(
    source=TorqueSourceParameters(
        delay=0.001, slew_rate=20000.0, time_constant=0.003, off_slew_rate=10000.0
    ),
    peak_torque=130.0,
    peak_power=70e3,
    nominal_voltage=350.0,
    voltage_min=200.0,
    voltage_full=240.0,
    fade_speed=1204.0,
    max_speed=1256.0,
    winding_derate=413.15,
    winding_max=433.15,
    inverter_derate=358.15,
    inverter_max=373.15,
    loss_constant=80.0,
    loss_speed=0.4,
    loss_speed_square=4e-4,
    loss_torque_square=0.30,
    loss_cross=0.015,
    inverter_share=0.3,
)

EM2 = MotorParameters(
    source=TorqueSourceParameters(
        delay=0.001, slew_rate=20000.0, time_constant=0.003, off_slew_rate=10000.0
    ),
    peak_torque=230.0,
    peak_power=110e3,
    nominal_voltage=350.0,
    voltage_min=200.0,
    voltage_full=240.0,
    fade_speed=1414.0,
    max_speed=1466.0,
    winding_derate=413.15,
    winding_max=433.15,
    inverter_derate=358.15,
    inverter_max=373.15,
    loss_constant=100.0,
    loss_speed=0.5,
    loss_speed_square=5e-4,
    loss_torque_square=0.15,
    loss_cross=0.015,
    inverter_share=0.3,
)

BATTERY = BatteryParameters(
    capacity=185e3,
    soc=(0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0),
    open_circuit_voltage=(300.0, 328.0, 342.0, 350.0, 361.0, 380.0, 396.0),
    temperature=(253.15, 273.15, 298.15, 318.15, 333.15),
    resistance=(
        (0.42, 0.26, 0.15, 0.13, 0.13),
        (0.36, 0.22, 0.12, 0.11, 0.11),
        (0.31, 0.19, 0.10, 0.09, 0.09),
        (0.30, 0.18, 0.10, 0.09, 0.09),
        (0.30, 0.18, 0.10, 0.09, 0.09),
        (0.31, 0.19, 0.10, 0.09, 0.09),
        (0.32, 0.20, 0.11, 0.10, 0.10),
    ),
    discharge_power=(
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (15e3, 35e3, 60e3, 60e3, 0.0),
        (30e3, 60e3, 110e3, 110e3, 0.0),
        (35e3, 65e3, 120e3, 120e3, 0.0),
        (35e3, 65e3, 120e3, 120e3, 0.0),
        (35e3, 65e3, 120e3, 120e3, 0.0),
        (35e3, 65e3, 120e3, 120e3, 0.0),
    ),
    charge_power=(
        (5e3, 30e3, 75e3, 75e3, 0.0),
        (5e3, 30e3, 75e3, 75e3, 0.0),
        (5e3, 30e3, 75e3, 75e3, 0.0),
        (4e3, 28e3, 70e3, 70e3, 0.0),
        (3e3, 22e3, 60e3, 60e3, 0.0),
        (1e3, 8e3, 25e3, 25e3, 0.0),
        (0.0, 0.0, 0.0, 0.0, 0.0),
    ),
    voltage_min=250.0,
    voltage_max=410.0,
    heat_capacity=120e3,
    heat_resistance=0.02,
    auxiliary_power=500.0,
)

CONTACTORS = ContactorParameters(
    precharge_resistance=30.0,
    discharge_resistance=200.0,
    link_capacitance=1.2e-3,
    precharge_share=0.95,
    precharge_timeout=0.5,
    opening_time=0.05,
)

THERMAL_EM1 = ThermalParameters(
    winding=ThermalNode(capacity=5000.0, resistance=0.025),
    inverter=ThermalNode(capacity=800.0, resistance=0.02),
)
THERMAL_EM2 = ThermalParameters(
    winding=ThermalNode(capacity=7000.0, resistance=0.02),
    inverter=ThermalNode(capacity=1000.0, resistance=0.015),
)
# For the engine's coolant: a single node behind the thermostat.
THERMAL_ENGINE = ThermalNode(capacity=60e3, resistance=0.002)

BRAKES = BrakeParameters(
    source=TorqueSourceParameters(
        delay=0.01, slew_rate=40e3, time_constant=0.03, off_slew_rate=40e3
    ),
    max_torque=6500.0,
    front_share=0.65,
)

ROAD = RoadParameters(
    rolling_coefficient=0.009, rolling_speed_square=2e-6, drag_area=0.66, air_density=1.2041
)

SYNCHRONIZER = SynchronizerParameters(
    max_force=2000.0,
    force_time_constant=0.01,
    least_force=50.0,
    centring_force=200.0,
    damping=4000.0,
    max_velocity=0.3,
    blocking_position=0.003,
    dog_position=0.006,
    end_position=0.009,
    cone_friction=0.1,
    cone_radius=0.035,
    cone_angle=0.1222,
    cones_g1=2.0,
    cones_g2=1.0,
    index_time=0.01,
    timeout=1.0,
    lost_force_time=0.05,
    free_flight_share=0.2,
    dog_slip=2.0,
    dog_friction=0.25,
    dog_radius=0.038,
)

SPEED_CONTROL_EM1 = SpeedControlParameters(
    inertia=0.0417, bandwidth=30.0, damping=1.0, setpoint_weight=0.5
)
SPEED_CONTROL_EM2 = SpeedControlParameters(
    inertia=0.5, bandwidth=5.0, damping=2.0, setpoint_weight=0.5
)
