"""A hydraulic circuit and a wet clutch plausible for the default car; none of it is published."""

from __future__ import annotations

from hev_can_emu.ecu.hydraulic_control import HydraulicControlParameters
from hev_can_emu.plant.hydraulic_parameters import (
    ClutchCylinderParameters,
    HydraulicsParameters,
    OilParameters,
    ShiftCylinderParameters,
    SupplyParameters,
    ValveParameters,
)
from hev_can_emu.plant.wet_clutch import FrictionParameters, WetClutchParameters

OIL = OilParameters(
    density=840.0, bulk_modulus=8e8, discharge_coefficient=0.65, laminar_pressure=2e4
)
SUPPLY = SupplyParameters(
    displacement=2.4e-7,
    speed=262.0,
    time_constant=0.03,
    leak=2e-12,
    friction=5e-4,
    relief_pressure=6.5e6,
    relief_slope=5e-10,
    line_volume=2e-4,
    precharge=3e6,
    accumulator_compliance=6e-11,
)
CLUTCH_VALVE = ValveParameters(
    area=3e-6, underlap=0.03, leak=1e-14, full_current=1.2, natural_frequency=600.0, damping=0.9
)
SHIFT_VALVE = ValveParameters(
    area=1e-5, underlap=0.3, leak=1e-14, full_current=1.2, natural_frequency=600.0, damping=0.9
)
CLUTCH_CYLINDER = ClutchCylinderParameters(
    area=3.5e-3,
    volume=1.5e-5,
    preload=450.0,
    spring=1e5,
    kiss_travel=1.5e-3,
    pack=2e7,
    seal_damping=400.0,
)
SHIFT_CYLINDER = ShiftCylinderParameters(
    area1=8e-4, area2=8e-4, volume1=8e-6, volume2=8e-6, make_up_area=2.5e-5
)
HYDRAULICS = HydraulicsParameters(
    oil=OIL,
    supply=SUPPLY,
    clutch_valve=CLUTCH_VALVE,
    shift_valve=SHIFT_VALVE,
    clutch=CLUTCH_CYLINDER,
    shift=SHIFT_CYLINDER,
)

FRICTION = FrictionParameters(
    speed=(0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 25.0),
    fresh=(0.112, 0.118, 0.124, 0.127, 0.130, 0.133, 0.134, 0.130),
    aged=(0.142, 0.134, 0.124, 0.118, 0.113, 0.108, 0.105, 0.102),
    static_fresh=0.118,
    static_aged=0.150,
    pressure=(0.0, 5e5, 1e6, 2e6, 4e6),
    pressure_factor=(1.04, 1.0, 0.98, 0.95, 0.92),
    temperature=(253.15, 313.15, 363.15, 423.15, 523.15),
    temperature_factor=(1.12, 1.05, 1.0, 0.96, 0.88),
)
WET_CLUTCH = WetClutchParameters(
    friction=FRICTION,
    surfaces=8.0,
    outer_radius=0.090,
    inner_radius=0.070,
    groove_share=0.4,
    kiss_travel=CLUTCH_CYLINDER.kiss_travel,
    least_gap=4e-5,
    viscosity=7e-3,
    viscosity_temperature=353.15,
    viscosity_slope=0.025,
    expulsion_slip=150.0,
    film_pressure=2e4,
    heat_capacity=1500.0,
    oil_heat=0.7 * 840.0 * 2100.0,
    still_cooling=5.0,
)
CONTROL = HydraulicControlParameters()
