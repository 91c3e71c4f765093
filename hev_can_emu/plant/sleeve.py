"""The sleeve between G1 and G2 as a mass: detents, struts, blocking rings, chamfered dogs, stops.

On its way to a gear the sleeve leaves the notch at the centre, presses the ring through the struts
(presynchronisation), stands on the ring's chamfers (blocked), and passes once the ring has been turned
out of the way.  After a free flight the dogs meet: their chamfers turn sleeve and gear to each other (or
stand, tooth on tooth) or, where they slip too fast, throw the sleeve back (grating).  Behind them
lie the play, a notch and the end stop.  The driveline decides whether sleeve and gear slip or hold.

Between obstacles the motion is that of :mod:`hev_can_emu.plant.sleeve_motion`; stops and reversals are met
within the step, blows are plastic.  While chamfers press, the sleeve goes where they go; what they press with
goes to the driveline for its next step, and what this order costs in energy is told as the lag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant.sleeve_dogs import (
    chamfer_limit,
    chamfer_press,
    press_next,
    throw_back,
    with_chamfers,
    wrap_pitch,
)
from hev_can_emu.plant.sleeve_layout import (
    BLOCKED,
    CENTRE,
    ENGAGED,
    ENTERING,
    FLIGHT,
    FREE,
    GRATING,
    INDEXING,
    N_OUT,
    N_STATE,
    OUT_CHAMFER1,
    OUT_CHAMFER2,
    OUT_CONE1,
    OUT_DAMPING_LOSS,
    OUT_DOG1,
    OUT_DRAG1,
    OUT_ELASTIC,
    OUT_FRICTION_LOSS,
    OUT_GAP1,
    OUT_GAP2,
    OUT_KINETIC,
    OUT_POSITION,
    OUT_RING_FORCE,
    OUT_STOP_LOSS,
    OUT_TOOTH_LAG,
    OUT_TOOTH_WORK,
    OUT_VELOCITY,
    OUT_WORK,
    OUT_ZONE,
    PRESYNC,
    STOP,
    TOOTH_ON_TOOTH,
    X_ANGLE,
    X_BLOCKING_SIGN,
    X_GRATING,
    X_POSITION,
    X_PRESS,
    X_RING,
    X_TORQUE,
    X_VELOCITY,
    X_ZONE,
)
from hev_can_emu.plant.sleeve_motion import (
    dry_friction,
    move_between,
    past_ring,
    pull,
    strut_force,
    way_in_time,
)
from hev_can_emu.plant.sleeve_parameters import (
    P_BLOCKING,
    P_CONE1,
    P_DOG_HOLD,
    P_DOG_SLIP,
    P_DOGS,
    P_DT,
    P_END,
    P_ENGAGED_FORCE,
    P_ENGAGED_WIDTH,
    P_FACE_DRAG,
    P_FLIGHT_SHARE,
    P_GRATING_DRAG,
    P_GUIDE_FRICTION,
    P_HALF,
    P_INDEX_LEVER,
    P_INDEX_RATE,
    P_MASS,
    P_NEUTRAL_FORCE,
    P_NEUTRAL_WIDTH,
    P_OVERLAP,
    P_PITCH,
    P_RATCHET,
    P_RATCHET_MAX,
    P_SLOPE,
    P_STRUT,
    P_STRUT_FORCE,
    P_TIP,
)

__all__ = [
    "BLOCKED", "CENTRE", "ENGAGED", "ENTERING", "FLIGHT", "FREE", "GRATING", "INDEXING", "N_OUT",
    "N_STATE", "OUT_CHAMFER1", "OUT_CHAMFER2", "OUT_CONE1", "OUT_DAMPING_LOSS", "OUT_DOG1", "OUT_DRAG1",
    "OUT_ELASTIC", "OUT_FRICTION_LOSS", "OUT_GAP1", "OUT_KINETIC", "OUT_POSITION", "OUT_RING_FORCE",
    "OUT_STOP_LOSS", "OUT_TOOTH_LAG", "OUT_TOOTH_WORK", "OUT_VELOCITY", "OUT_WORK", "OUT_ZONE",
    "PRESYNC", "STOP", "TOOTH_ON_TOOTH", "X_POSITION", "X_RING", "X_VELOCITY", "X_ZONE", "sleeve_step",
    "wrap_pitch",
]  # fmt: skip

Array = NDArray[np.float64]


@kernel
def _turn_ring(
    p: Array, x: Array, side: float, push: float, slip: float, held: float, torque: float
) -> float:
    """Let the cone's torque keep the ring in the sleeve's way, or the chamfers turn it out of it.

    Return the time of the step that is left once it no longer stands in the way, s.
    """
    s = side * x[X_POSITION]
    if s < p[P_BLOCKING]:
        x[X_RING] = 0.0
        if s > p[P_STRUT] and slip != 0.0:
            x[X_BLOCKING_SIGN] = -1.0 if slip > 0.0 else 1.0
    elif s == p[P_BLOCKING]:
        if held < 0.5:
            x[X_RING] = 0.0
            if slip != 0.0:
                x[X_BLOCKING_SIGN] = -1.0 if slip > 0.0 else 1.0
        elif push > 0.0:
            # What the cone carries in the direction that blocks works against the chamfers.
            net = push - torque * x[X_BLOCKING_SIGN] / p[P_INDEX_LEVER]
            if net > 0.0:
                missing = (1.0 - x[X_RING]) / (p[P_INDEX_RATE] * net)
                if missing <= p[P_DT]:
                    x[X_RING] = 1.0
                    return float(p[P_DT] - missing)
                x[X_RING] += p[P_DT] * p[P_INDEX_RATE] * net
    return float(p[P_DT])


@kernel
def _zone(p: Array, x: Array, s: float) -> int:
    """Return where the sleeve is."""
    if s <= p[P_STRUT]:
        return CENTRE if s <= p[P_NEUTRAL_WIDTH] else FREE
    if s < p[P_BLOCKING]:
        return PRESYNC
    if x[X_GRATING] > 0.5:
        return GRATING
    if s == p[P_BLOCKING] and x[X_RING] < 1.0:
        return INDEXING if x[X_RING] > 0.0 else BLOCKED
    if s <= p[P_DOGS]:
        return TOOTH_ON_TOOTH if x[X_PRESS] > 0.0 else FLIGHT
    if s >= p[P_END]:
        return STOP
    return ENGAGED if s - p[P_DOGS] >= p[P_OVERLAP] else ENTERING


@kernel
def _tell(
    p: Array, x: Array, push: float, way: float, share: float, before: float, out: Array
) -> None:
    """Write what the driveline has to know of the gear on whose side the sleeve stands.

    ``push`` is the mean over this step, ``way`` that of the sleeve in it, outward; for a ``share`` of
    the step the ring was still pressed by ``before`` N.
    """
    position = x[X_POSITION]
    s = abs(position)
    gear = 0 if position > 0.0 else 1
    ring = 0.0
    if s <= p[P_DOGS]:
        if s < p[P_BLOCKING]:
            ring = strut_force(p, s - 0.5 * way)
        elif s == p[P_BLOCKING] and x[X_RING] < 1.0:
            ring = max(push - p[P_GUIDE_FRICTION], 0.0)
        else:
            ring = p[P_FLIGHT_SHARE] * max(push, 0.0)
        ring += share * (before - ring)
        drag = p[P_FACE_DRAG] * x[X_PRESS]
        if x[X_GRATING] > 0.5:
            drag += p[P_GRATING_DRAG] * max(push, 0.0)
        out[OUT_CONE1 + gear] = p[P_CONE1 + gear] * ring
        out[OUT_DRAG1 + gear] = drag
        out[OUT_CHAMFER1 + gear] = x[X_TORQUE]
    else:
        out[OUT_DOG1 + gear] = 1.0
    zone = _zone(p, x, s)
    x[X_ZONE] = zone
    out[OUT_POSITION], out[OUT_VELOCITY] = position, x[X_VELOCITY]
    out[OUT_ZONE], out[OUT_RING_FORCE] = zone, ring


@kernel
def sleeve_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    force: float,
    stiffness: float,
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
        force: of the cylinder on the sleeve at the start of the step, N, positive towards G1.
        stiffness: by which it falls with the sleeve's travel within the step, N/m; 0: it is held.
        slip1, slip2: speed of the sleeve minus that of each gear, rad/s.
        angle1, angle2: the same of the angles, rad, whole pitches do not count; 0 where a tooth stands
            in the middle of its gap.  Not looked at while that gear's dogs overlap.
        held1, held2: 1 where the driveline holds sleeve and gear.
        torque1, torque2: that the lock of sleeve and gear carries, N m, as it acts on the sleeve.
        out: ``(N_OUT,)``.  Capacities are to be added per lock (cone and drag); the chamfer torque acts
            on the sleeve and, reversed, on the gear, also while they are held.  The gap is valid in the
            step in which the dog flag rises.  Energies: work of the force; change of kinetic and of elastic
            energy; heat of damping, of dry friction, of blows; work of the chamfer torque told in the
            step before on the sleeve (the negative of what it did in the driveline); lag: what the
            sleeve's own motion gave to the chamfers, less what the driveline got.
            ``OUT_WORK + OUT_TOOTH_WORK`` is the sum of the rest.
    """
    out[:] = 0.0
    start = x[X_POSITION]
    side = 1.0
    slip, angle, held, torque = slip1, angle1, held1, torque1
    if start < 0.0:
        side = -1.0
        slip, angle, held, torque = slip2, angle2, held2, torque2
    s = side * start
    push = side * force
    blocking = p[P_BLOCKING]
    if x[X_VELOCITY] == 0.0 and x[X_TORQUE] == 0.0 and (s < blocking or s > p[P_DOGS]):
        # Most of the time it rests.  No call takes an array here: each would cost as much as all of this.
        struts = pull(p[P_STRUT_FORCE], p[P_STRUT], blocking - p[P_STRUT], s)
        width = p[P_ENGAGED_WIDTH]
        net = push - struts - pull(p[P_NEUTRAL_FORCE], 0.0, p[P_NEUTRAL_WIDTH], s)
        net += pull(p[P_ENGAGED_FORCE], p[P_END] - width, width, s)
        dry = p[P_GUIDE_FRICTION]
        if s > p[P_DOGS]:
            dry += p[P_DOG_HOLD] * abs(torque)
        if abs(net) <= dry or (s >= p[P_END] and net > 0.0):
            gear = 0 if start > 0.0 else 1
            if s > p[P_DOGS]:
                zone = STOP if s >= p[P_END] else ENGAGED
                if s - p[P_DOGS] < p[P_OVERLAP]:
                    zone = ENTERING
                out[OUT_DOG1 + gear] = 1.0
            else:
                zone = CENTRE if s <= p[P_NEUTRAL_WIDTH] else FREE
                x[X_RING] = x[X_GRATING] = 0.0
                if s > p[P_STRUT]:
                    zone = PRESYNC
                    if slip != 0.0:
                        x[X_BLOCKING_SIGN] = -1.0 if slip > 0.0 else 1.0
                    out[OUT_CONE1 + gear] = p[P_CONE1 + gear] * struts
                    out[OUT_RING_FORCE] = struts
            x[X_ZONE] = zone
            out[OUT_POSITION], out[OUT_ZONE] = start, zone
            return
    outside = s <= p[P_DOGS]
    place, told, given = 0.0, 0.0, 0.0
    if outside:
        place = wrap_pitch(angle, p[P_PITCH])
        told = x[X_TORQUE] * wrap_pitch(place - x[X_ANGLE], p[P_PITCH])
        x[X_ANGLE] = place
    x[X_TORQUE] = 0.0
    left = _turn_ring(p, x, side, push - p[P_GUIDE_FRICTION], slip, held, torque)
    fast = abs(slip) > p[P_DOG_SLIP]

    # Obstacles: the other gear's ring never lets the sleeve pass from this side of the centre.
    limit = p[P_END]
    dogs_meet = False
    if outside:
        if s <= blocking and x[X_RING] < 1.0:
            limit = blocking
        else:
            limit = p[P_TIP] if fast and s <= p[P_TIP] else chamfer_limit(p, place)
            dogs_meet = limit < p[P_END]
    pressed = False
    speed = abs(x[X_VELOCITY])
    away = p[P_SLOPE] * (-slip if place > 0.0 else slip)  # speed at which the chamfers give way
    if fast and s <= p[P_TIP]:
        away = 0.0
    if dogs_meet:
        v = side * x[X_VELOCITY]
        if x[X_PRESS] > 0.0:
            pressed = chamfer_press(p, s, v, limit - s, away, push, stiffness) >= 0.0
        elif limit < s:
            dry = dry_friction(p, s, v >= 0.0, 0.0)
            part = past_ring(p, s, v >= 0.0, push)
            drive = part * push - (dry if v >= 0.0 else -dry)
            pressed = s + way_in_time(p, s, v, drive, part * stiffness, p[P_DT]) >= limit
    if pressed:
        given = with_chamfers(p, x, side, limit, away, push, stiffness, out)
        if fast and limit <= s:
            x[X_GRATING] = 1.0
            # Chamfers that come on push it before them; otherwise it is thrown.
            if -away < min(p[P_RATCHET] * abs(slip), p[P_RATCHET_MAX]):
                given -= throw_back(p, x, side, slip, out)
    else:
        x[X_PRESS] = 0.0
        low, high = -blocking, limit
        if side < 0.0:
            low, high = -limit, blocking
        struck = move_between(p, x, low, high, force, stiffness, abs(torque), left, out)
        if dogs_meet and side * x[X_POSITION] == limit:
            if fast and struck > 0.0:
                given -= throw_back(p, x, side, slip, out)
            else:
                # Chamfers that give way take it along.
                kept = min(max(away, 0.0), struck)
                kept_energy = 0.5 * p[P_MASS] * kept * kept
                out[OUT_STOP_LOSS] -= kept_energy
                out[OUT_KINETIC] += kept_energy
                x[X_VELOCITY] = side * kept
                now = push - side * stiffness * (x[X_POSITION] - start)
                x[X_PRESS] = press_next(p, limit, kept, 0.0, now, 0.0, stiffness)
    s = side * x[X_POSITION]
    # The ring feels the mean of what acted over this step; where it begins or ceases to block, each
    # force for its part of it.
    way = s - side * start
    share = before = 0.0
    if left < p[P_DT]:
        share, before = 1.0 - left / p[P_DT], max(push - p[P_GUIDE_FRICTION], 0.0)
    elif s == blocking and x[X_RING] < 1.0 and way > 0.0:
        share, before = way / max(speed * p[P_DT], way), strut_force(p, s - 0.5 * way)
        push -= 0.5 * stiffness * way
    push -= 0.5 * stiffness * way
    if not fast or push <= 0.0 or s > p[P_DOGS] or s < blocking:
        x[X_GRATING] = 0.0
    if outside and s > p[P_DOGS]:
        out[OUT_GAP1 if side > 0.0 else OUT_GAP2] = min(max(place, -p[P_HALF]), p[P_HALF])
        x[X_PRESS] = 0.0
    if x[X_PRESS] > 0.0:
        # Where the flank ends within the coming step, it presses for that part of it only.
        room, turning = (abs(place) - p[P_HALF]) * p[P_SLOPE], away * p[P_DT]
        if turning > room:
            x[X_PRESS] *= room / turning
        x[X_TORQUE] = -p[P_SLOPE] * x[X_PRESS] if place > 0.0 else p[P_SLOPE] * x[X_PRESS]
    out[OUT_TOOTH_WORK] = -told
    out[OUT_TOOTH_LAG] = given - told
    _tell(p, x, push if x[X_POSITION] * side >= 0.0 else -push, way, share, before, out)
