"""The sleeve in the driveline: what it sees of it, what it makes its two locks carry, the angles between.

Per inner step: :func:`move_sleeve` under the cylinder's force, then the hydraulics with the sleeve's new
place, then the driveline, then :func:`turn_gears`.

The cylinder's force within the coming step is foreseen: its oil is as stiff as it was, and what flows in
raises the force as it did in the step before.  So a moving sleeve feels what it will have felt, and oil
locked in neither gains nor loses energy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import sleeve, teeth
from hev_can_emu.plant.holding import HELD
from hev_can_emu.plant.sleeve_motion import elastic_change
from hev_can_emu.plant.sleeve_parameters import P_HALF, P_MASS, P_PITCH
from hev_can_emu.plant.structure import G1, N_PORTS

# Layout of the state: the sleeve's own, its angle against each gear, rad, within half a pitch, the
# cylinder's force N and the sleeve's place m when the step before began, its force N and stiffness N/m now
# (kept here from tick to tick by the plant).
X_ANGLE = sleeve.N_STATE
X_FORCE, X_PLACE = X_ANGLE + 2, X_ANGLE + 3
X_GIVEN, X_STIFFNESS = X_ANGLE + 4, X_ANGLE + 5
N_STATE = X_ANGLE + 6

RIGID = 1e4  # N m; takes the last slip at once where dogs have no play

# Layout of the booked losses, J: damping, dry friction, blows, lag of the chamfers, lag of the cylinder.
J_DAMPING, J_FRICTION, J_STOP, J_TOOTH_LAG, J_CYLINDER_LAG = 0, 1, 2, 3, 4
N_LOSS = 5


@kernel
def start_sleeve(p: NDArray[np.float64], x: NDArray[np.float64], position: float) -> None:
    """Set the state, ``(N_STATE,)``, to rest at ``position`` m, teeth in the middle of their gaps."""
    for i in range(N_STATE):
        x[i] = 0.0
    x[sleeve.X_POSITION] = position
    x[X_PLACE] = position
    x[sleeve.X_RING] = 1.0 if position != 0.0 else 0.0


@kernel
def foreseen_force(x: NDArray[np.float64], force: float, stiffness: float) -> float:
    """Return the cylinder's mean force over the coming step for a sleeve that stands, N.

    Half of what oil flowing in and out adds over a step is in it; that is taken from the step before.
    """
    place = x[sleeve.X_POSITION]
    flown = force - x[X_FORCE] + stiffness * (place - x[X_PLACE])
    x[X_FORCE], x[X_PLACE] = force, place
    return float(force + 0.5 * flown)


@kernel
def move_sleeve(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    force: float,
    stiffness: float,
    slip1: float,
    slip2: float,
    torque1: float,
    torque2: float,
    play: bool,
    state: NDArray[np.int64],
    books: NDArray[np.float64],
    kinetic: NDArray[np.float64],
    static: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Move the sleeve and enter what follows for the locks of G1 and G2.

    Args:
        p: parameters of :mod:`hev_can_emu.plant.sleeve_parameters`.
        x: state, ``(N_STATE,)``, changed in place.
        force, stiffness: of the cylinder now, N and N/m, as the hydraulics tell them.
        slip1, slip2: at both locks, rad/s.
        torque1, torque2: that both locks carry, N m, as it acts on the sleeve.
        play: whether engaged dogs have play; else they hold like a lock.
        state: of the driveline, read.
        books: of the driveline (:mod:`hev_can_emu.plant.teeth`): play, place in it, chamfers' torque.
        kinetic, static: capacities of the driveline's locks, N m; those of both gears are written.
        out: ``(sleeve.N_OUT,)``.
    """
    push = foreseen_force(x, force, stiffness)
    sleeve.sleeve_step(
        p, x, push, stiffness, slip1, slip2, x[X_ANGLE], x[X_ANGLE + 1],
        float(state[HELD + G1]), float(state[HELD + G1 + 1]), torque1, torque2, out,
    )  # fmt: skip
    for gear in range(2):
        lock = G1 + gear
        books[teeth.PAIR + gear] = out[sleeve.OUT_CHAMFER1 + gear]
        if out[sleeve.OUT_DOG1 + gear] > 0.5:
            static[lock] = np.inf
            if play:
                kinetic[lock] = 0.0
                if books[teeth.HALF + gear] == 0.0:
                    # At the start in gear there is no gap to come from: the middle.
                    books[teeth.GAP + gear] = out[sleeve.OUT_GAP1 + gear]
                books[teeth.HALF + gear] = p[P_HALF]
            else:
                kinetic[lock] = RIGID
        else:
            books[teeth.HALF + gear] = 0.0
            capacity = out[sleeve.OUT_CONE1 + gear] + out[sleeve.OUT_DRAG1 + gear]
            kinetic[lock] = static[lock] = capacity


@kernel
def turn_gears(p: NDArray[np.float64], x: NDArray[np.float64], books: NDArray[np.float64]) -> None:
    """Turn sleeve and gears against each other by what the driveline has just travelled."""
    for gear in range(2):
        if books[teeth.HALF + gear] > 0.0:
            x[X_ANGLE + gear] = books[teeth.GAP + gear]
        else:
            way = books[teeth.TRAVEL + N_PORTS + G1 + gear]
            if way != 0.0:
                x[X_ANGLE + gear] = sleeve.wrap_pitch(x[X_ANGLE + gear] + way, p[P_PITCH])


@kernel
def book_sleeve(
    out: NDArray[np.float64], cylinder_work: float, losses: NDArray[np.float64]
) -> None:
    """Add a step's losses, J, to ``losses``, ``(N_LOSS,)``.

    ``cylinder_work`` is what the hydraulics gave over this step: its force at the end times the way.
    What the chamfers give to the driveline is in its own books.
    """
    losses[J_DAMPING] += out[sleeve.OUT_DAMPING_LOSS]
    losses[J_FRICTION] += out[sleeve.OUT_FRICTION_LOSS]
    losses[J_STOP] += out[sleeve.OUT_STOP_LOSS]
    losses[J_TOOTH_LAG] += out[sleeve.OUT_TOOTH_LAG]
    losses[J_CYLINDER_LAG] += cylinder_work - out[sleeve.OUT_WORK]


@kernel
def sleeve_energy(p: NDArray[np.float64], x: NDArray[np.float64]) -> float:
    """Return the sleeve's kinetic and its notches' elastic energy, J."""
    v = x[sleeve.X_VELOCITY]
    return float(0.5 * p[P_MASS] * v * v + elastic_change(p, 0.0, x[sleeve.X_POSITION]))
