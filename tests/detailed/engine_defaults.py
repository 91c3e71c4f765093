"""A detailed engine of the default car's ratings: plausible for a 1.5 l four-cylinder, not published."""

from __future__ import annotations

import math

from hev_can_emu.plant.combustion_map import CombustionParameters
from hev_can_emu.plant.crank import CrankParameters
from hev_can_emu.plant.gas_pulses import GasPulseParameters

ENGINE_INERTIA = 0.155797747  # Je of the default car, kg m^2


def rpm(*values: float) -> tuple[float, ...]:
    return tuple(round(value * math.pi / 30.0, 3) for value in values)


CRANK = CrankParameters(reciprocating_mass=0.42, radius=0.0424, rod_length=0.140)

PULSES = GasPulseParameters(
    bore=0.075,
    compression_ratio=10.5,
    exponent=1.32,
    burn_start=math.radians(-15.0),
    burn_duration=math.radians(52.0),
    closed_pressure=30e3,
    leak_speed=20.0,
)

# Full load after friction and drag, as the simple engine has them.
_FULL_LOAD = (70.0, 105.0, 130.0, 145.0, 150.0, 142.0, 120.0)
_DRAG = (14.0, 15.0, 16.0, 18.0, 21.0, 23.0, 26.0)
_LOAD = (0.0, 0.15, 0.4, 0.7, 1.0)
_SHARE = (
    0.0,
    0.11,
    0.37,
    0.69,
    1.0,
)  # of the greatest combustion torque: little charge burns worse

ENGINE = CombustionParameters(
    crank=CRANK,
    speed=rpm(500, 1000, 1500, 2500, 4000, 5000, 6000),
    load=_LOAD,
    torque=tuple(
        tuple(round((full + drag) * share, 3) for share in _SHARE)
        for full, drag in zip(_FULL_LOAD, _DRAG, strict=True)
    ),
    drag=_DRAG,
    efficiency=(0.36, 0.385, 0.395, 0.405, 0.40, 0.39, 0.375),
    drag_fade_speed=20.0,
    breakaway=20.0,
    crank_speed=42.0,
    stall_speed=31.0,
    idle_speed=89.0,
    idle_gain=0.7,
    idle_integral_gain=0.7,
    idle_torque_max=80.0,
    fade_speed=586.0,
    max_speed=628.0,
    cut_speed=649.0,
    resume_speed=618.0,
    intake_angle=5.0,
    intake_time_max=0.1,
    heating_value=42.7e6,
    wall_share=0.45,
)
