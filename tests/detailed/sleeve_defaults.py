"""A sleeve and its shift control plausible for the default car; none of it is published."""

from __future__ import annotations

import math

from hev_can_emu.ecu.shift_control import ShiftControlParameters
from hev_can_emu.plant.sleeve_parameters import SleeveParameters

SLEEVE = SleeveParameters(
    mass=0.8,
    damping=150.0,
    guide_friction=15.0,
    neutral_force=60.0,
    neutral_width=1.5e-3,
    engaged_force=80.0,
    engaged_width=1.5e-3,
    strut_force=90.0,
    strut_position=1.8e-3,
    blocking_position=3.0e-3,
    dog_position=6.0e-3,
    chamfer_depth=1.3e-3,
    least_overlap=1.0e-3,
    end_position=9.0e-3,
    cone_friction=0.1,
    cone_radius=0.035,
    cone_angle=math.radians(7.0),
    cones_g1=2.0,
    cones_g2=1.0,
    ring_chamfer_angle=math.radians(55.0),
    chamfer_friction=0.1,
    index_time=0.008,
    index_force=800.0,
    flight_share=0.1,
    dog_teeth=48,
    dog_radius=0.038,
    half_clearance=0.006,
    dog_slip=2.0,
    dog_friction=0.15,
    ratchet_share=0.1,
    ratchet_speed=0.5,
)
SHIFT_CONTROL = ShiftControlParameters()
