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

import math

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant.sleeve_motion import (
    elastic_change,
    mean_pull,
    notch_force,
    pull,
    speed_over_way,
    strut_force,
    way_in_time,
    way_to_rest,
)
from hev_can_emu.plant.sleeve_parameters import (
    P_BLOCKING,
    P_CONE1,
    P_DAMPING,
    P_DOG_HOLD,
    P_DOG_SLIP,
    P_DOGS,
    P_DT,
    P_EASE,
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

Array = NDArray[np.float64]

# Where the sleeve is.
CENTRE, FREE, PRESYNC, BLOCKED, INDEXING, FLIGHT = 0, 1, 2, 3, 4, 5
TOOTH_ON_TOOTH, GRATING, ENTERING, ENGAGED, STOP = 6, 7, 8, 9, 10

# Layout of the state: position m and velocity m/s, positive towards G1; how far the ring has turned out
# of the way (1: the sleeve may pass); 1 while the dogs grate; zone; sign of the torque on the sleeve that
# keeps the ring blocking; what the chamfers press with, N, and their torque on the sleeve, N m, as told;
# angle last seen, rad.
X_POSITION, X_VELOCITY, X_RING, X_GRATING, X_ZONE = 0, 1, 2, 3, 4
X_BLOCKING_SIGN, X_PRESS, X_TORQUE, X_ANGLE = 5, 6, 7, 8
N_STATE = 9

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
OUT_TOOTH_WORK, OUT_TOOTH_LAG = 20, 21
N_OUT = 22

_SEGMENTS = 8  # moves between obstacles in one step
_REST = 1e-9  # of the step: less is none left


@kernel
def wrap_pitch(angle: float, pitch: float) -> float:
    """Return the angle from the middle of the nearest gap, rad, within half a pitch."""
    return float(angle - pitch * math.floor(angle / pitch + 0.5))


@kernel
def chamfer_limit(p: Array, place: float) -> float:
    """Return how far the dogs let the sleeve travel at ``place`` rad off the middle of a gap, m."""
    if abs(place) <= p[P_HALF]:
        return float(p[P_END])
    return float(p[P_TIP] + (0.5 * p[P_PITCH] - abs(place)) * p[P_SLOPE])


@kernel
def _friction(p: Array, s: float, outward: bool, dogs: float) -> float:
    """Return the dry friction at travel ``s``, N: of the guide, and of flanks that carry ``dogs`` N m."""
    dry: float = p[P_GUIDE_FRICTION]
    if s > p[P_DOGS] or (s == p[P_DOGS] and outward):
        dry += p[P_DOG_HOLD] * dogs
    return dry


@kernel
def _past_ring(p: Array, s: float, outward: bool, push: float) -> float:
    """Return the share of ``push``, N outward, that is left after rubbing past the ring, 1."""
    if push > 0.0 and outward and p[P_BLOCKING] <= s < p[P_DOGS]:
        return float(1.0 - p[P_FLIGHT_SHARE])
    return 1.0


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
def _chamfer_press(
    p: Array, s: float, v: float, way: float, new: float, push: float, stiffness: float
) -> float:
    """Return what chamfers press with that take the sleeve along a way and to a speed in one step, N."""
    dt = p[P_DT]
    mean = push - 0.5 * stiffness * way
    outward = way >= 0.0
    dry = _friction(p, s, outward, 0.0)
    rest = _past_ring(p, s, outward, mean) * mean - mean_pull(p, s, way)
    rest += -dry if outward else dry
    return float(rest - p[P_DAMPING] * way / dt - p[P_MASS] * (new - v) / dt)


@kernel
def _press_next(
    p: Array, s: float, speed: float, drift: float, push: float, way: float, stiffness: float
) -> float:
    """Return what to tell the driveline that the sleeve presses with in its next step, N.

    Solved with the answer of light parts within the step, so that neither the sleeve's mass nor the
    cylinder's oil is too stiff for it; heavier parts show in the drift, which makes up for it.  ``drift``
    is how the chamfers' speed would change without it, m/s^2; ``push`` the mean force over the ``way`` of
    this step, which oil that flows keeps up.
    """
    dt, m = p[P_DT], p[P_MASS]
    mean = push - 0.5 * stiffness * (dt * (speed + 0.5 * dt * drift) - way)
    left = _past_ring(p, s, True, mean)
    rest = left * mean - _friction(p, s, True, 0.0) - mean_pull(p, s, 0.0)
    rest -= p[P_DAMPING] * speed + m * drift
    return float(max(rest / (1.0 + p[P_EASE] * (m + 0.25 * left * stiffness * dt * dt)), 0.0))


@kernel
def _with_chamfers(
    p: Array,
    x: Array,
    side: float,
    limit: float,
    speed: float,
    push: float,
    stiffness: float,
    out: Array,
) -> float:
    """Go with the chamfers from the old place to ``limit`` at their ``speed``; return what they took, J."""
    s, v = side * x[X_POSITION], side * x[X_VELOCITY]
    m, dt = p[P_MASS], p[P_DT]
    way = limit - s
    press = _chamfer_press(p, s, v, way, speed, push, stiffness)
    mean = push - 0.5 * stiffness * way
    outward = way >= 0.0
    out[OUT_WORK] += mean * way
    out[OUT_ELASTIC] += elastic_change(p, s, limit)
    rubbing = (1.0 - _past_ring(p, s, outward, mean)) * mean
    out[OUT_FRICTION_LOSS] += (_friction(p, s, outward, 0.0) + rubbing) * abs(way)
    out[OUT_DAMPING_LOSS] += p[P_DAMPING] * way / dt * way
    out[OUT_KINETIC] += 0.5 * m * (speed * speed - v * v)
    x[X_POSITION], x[X_VELOCITY] = side * limit, side * speed
    drift = (speed - v) / dt - p[P_EASE] * x[X_PRESS] if x[X_PRESS] > 0.0 else 0.0
    x[X_PRESS] = _press_next(p, limit, speed, drift, mean, way, stiffness)
    # The mean of both speeds is not quite that of the way.
    return float(press * way - m * (speed - v) * (0.5 * (speed + v) - way / dt))


@kernel
def _move(
    p: Array,
    x: Array,
    low: float,
    high: float,
    force: float,
    stiffness: float,
    dogs: float,
    remaining: float,
    out: Array,
) -> float:
    """Move between two obstacles; return the greatest speed at which one further out was met, m/s."""
    position, velocity = x[X_POSITION], x[X_VELOCITY]
    start, m = position, p[P_MASS]
    struck = 0.0
    for _ in range(_SEGMENTS):
        push = force - stiffness * (position - start)
        net = push + notch_force(p, position)
        outward = velocity if velocity != 0.0 else net
        direction = 1.0 if outward > 0.0 else -1.0
        limit = high if direction > 0.0 else low
        if (position - limit) * direction >= 0.0:
            if velocity == 0.0:
                break
            out[OUT_STOP_LOSS] += 0.5 * m * velocity * velocity
            out[OUT_KINETIC] -= 0.5 * m * velocity * velocity
            struck = max(struck, abs(velocity))
            velocity = 0.0
            continue
        outward = position * direction >= 0.0
        s = abs(position)
        dry = _friction(p, s, outward, dogs)
        # Past the ring a share of the force rubs: of its mean over the way, as the force falls with it.
        left = _past_ring(p, s, outward, push * direction)
        if velocity == 0.0 and abs(net) <= dry + (1.0 - left) * abs(push):
            break
        # Where the dogs begin to overlap friction changes: a move ends there.
        edge = p[P_DOGS] * (1.0 if position > 0.0 else -1.0)
        if (edge - position) * direction > 0.0 and (limit - edge) * direction > 0.0:
            limit = edge
        time = remaining
        stops = False
        while True:
            drive, stiff = left * push - direction * dry, left * stiffness
            way = way_in_time(p, position, velocity, drive, stiff, time)
            if velocity != 0.0 and (2.0 * way / time - velocity) * direction <= 0.0:
                rest = way_to_rest(p, position, velocity, drive, stiff)
                if 2.0 * rest / velocity <= time:
                    way, stops, time = rest, True, 2.0 * rest / velocity
            if left == 1.0 or (push - 0.5 * stiffness * way) * direction >= 0.0:
                break
            left, stops, time = 1.0, False, remaining
        arrives = (position + way - limit) * direction >= 0.0
        if arrives:
            way, stops = limit - position, False
        if way == 0.0:
            break
        # The speed that goes with this way: energies are exact however well the way was found.
        mean = speed_over_way(p, position, velocity, drive, stiff, way)
        new = 2.0 * mean - velocity
        if arrives:
            time = way / mean
        force_over_way = push - 0.5 * stiffness * way
        out[OUT_WORK] += force_over_way * way
        out[OUT_ELASTIC] += elastic_change(p, position, position + way)
        out[OUT_FRICTION_LOSS] += dry * abs(way) + (1.0 - left) * force_over_way * way
        out[OUT_DAMPING_LOSS] += p[P_DAMPING] * mean * way
        if stops:
            out[OUT_STOP_LOSS] += 0.5 * m * new * new  # rounding
            new = 0.0
            out[OUT_KINETIC] -= 0.5 * m * velocity * velocity
        else:
            out[OUT_KINETIC] += 0.5 * m * (new * new - velocity * velocity)
        position = limit if arrives else position + way
        velocity = new
        remaining -= time
        if remaining <= _REST * p[P_DT]:
            break
    x[X_POSITION], x[X_VELOCITY] = position, velocity
    return struck


@kernel
def _throw_back(p: Array, x: Array, side: float, slip: float, out: Array) -> float:
    """Let dogs that slip throw the sleeve back; return the energy that takes from them, J.

    The driveline pays for it in its next step, by a torque against the slip.
    """
    old, speed = x[X_VELOCITY], min(p[P_RATCHET] * abs(slip), p[P_RATCHET_MAX])
    brought, taken = 0.5 * p[P_MASS] * old * old, 0.5 * p[P_MASS] * speed * speed
    out[OUT_STOP_LOSS] += brought
    out[OUT_KINETIC] += taken - brought
    x[X_VELOCITY] = -side * speed
    x[X_GRATING] = 1.0
    x[X_PRESS] = 0.0
    x[X_TORQUE] = -taken / (slip * p[P_DT])
    return float(taken)


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
            pressed = _chamfer_press(p, s, v, limit - s, away, push, stiffness) >= 0.0
        elif limit < s:
            dry = _friction(p, s, v >= 0.0, 0.0)
            part = _past_ring(p, s, v >= 0.0, push)
            drive = part * push - (dry if v >= 0.0 else -dry)
            pressed = s + way_in_time(p, s, v, drive, part * stiffness, p[P_DT]) >= limit
    if pressed:
        given = _with_chamfers(p, x, side, limit, away, push, stiffness, out)
        if fast and limit <= s:
            x[X_GRATING] = 1.0
            # Chamfers that come on push it before them; otherwise it is thrown.
            if -away < min(p[P_RATCHET] * abs(slip), p[P_RATCHET_MAX]):
                given -= _throw_back(p, x, side, slip, out)
    else:
        x[X_PRESS] = 0.0
        low, high = -blocking, limit
        if side < 0.0:
            low, high = -limit, blocking
        struck = _move(p, x, low, high, force, stiffness, abs(torque), left, out)
        if dogs_meet and side * x[X_POSITION] == limit:
            if fast and struck > 0.0:
                given -= _throw_back(p, x, side, slip, out)
            else:
                # Chamfers that give way take it along.
                kept = min(max(away, 0.0), struck)
                kept_energy = 0.5 * p[P_MASS] * kept * kept
                out[OUT_STOP_LOSS] -= kept_energy
                out[OUT_KINETIC] += kept_energy
                x[X_VELOCITY] = side * kept
                now = push - side * stiffness * (x[X_POSITION] - start)
                x[X_PRESS] = _press_next(p, limit, kept, 0.0, now, 0.0, stiffness)
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
