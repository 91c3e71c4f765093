"""How the sleeve moves between obstacles: notches, friction, the cylinder's stiffness, times of arrival.

A notch pulls with ``4*F*u*(1 - u)`` over its width, ``u`` from 0 to 1: two of them hold the sleeve (at the
centre and at each end), the struts' one is climbed on the way to the ring.  One move of length ``h`` is the
implicit midpoint rule, ``m*(v1 - v0)/h = F - k*dx/2 - c*dx/h - friction - dU/dx`` with
``dx = h*(v0 + v1)/2`` and the notches' mean force ``dU/dx`` over the way: exact in energy for any ``h``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant.sleeve_layout import (
    OUT_DAMPING_LOSS,
    OUT_ELASTIC,
    OUT_FRICTION_LOSS,
    OUT_KINETIC,
    OUT_STOP_LOSS,
    OUT_WORK,
    X_POSITION,
    X_VELOCITY,
)
from hev_can_emu.plant.sleeve_parameters import (
    P_BLOCKING,
    P_DAMPING,
    P_DOG_HOLD,
    P_DOGS,
    P_DT,
    P_END,
    P_ENGAGED_FORCE,
    P_ENGAGED_WIDTH,
    P_FLIGHT_SHARE,
    P_GUIDE_FRICTION,
    P_MASS,
    P_NEUTRAL_FORCE,
    P_NEUTRAL_WIDTH,
    P_STIFFNESS,
    P_STRUT,
    P_STRUT_FORCE,
)

Array = NDArray[np.float64]

_SEGMENTS = 8  # moves between obstacles in one step
_REST = 1e-9  # of the step: less is none left
_ROUNDS = 20  # four or five are enough; bounded so that a step always ends
_CLOSE = 1e-15


@kernel
def pull(force: float, begin: float, width: float, s: float) -> float:
    """Return the size of a notch's force at travel ``s``, N."""
    u = (s - begin) / width
    if u <= 0.0 or u >= 1.0:
        return 0.0
    return 4.0 * force * u * (1.0 - u)


@kernel
def _climb(force: float, begin: float, width: float, first: float, last: float) -> float:
    """Return the work against a notch from travel ``first`` to ``last``, J."""
    a = min(max((first - begin) / width, 0.0), 1.0)
    b = min(max((last - begin) / width, 0.0), 1.0)
    if a == b:
        return 0.0
    return 4.0 * force * width * (b - a) * (0.5 * (a + b) - (a * a + a * b + b * b) / 3.0)


@kernel
def strut_force(p: NDArray[np.float64], s: float) -> float:
    """Return what the struts press the ring with at travel ``s`` >= 0, N."""
    return pull(p[P_STRUT_FORCE], p[P_STRUT], p[P_BLOCKING] - p[P_STRUT], s)


@kernel
def notch_force(p: NDArray[np.float64], position: float) -> float:
    """Return the force of notches and struts on the sleeve, N, positive towards G1."""
    s = abs(position)
    inward = pull(p[P_NEUTRAL_FORCE], 0.0, p[P_NEUTRAL_WIDTH], s) + strut_force(p, s)
    width = p[P_ENGAGED_WIDTH]
    inward -= pull(p[P_ENGAGED_FORCE], p[P_END] - width, width, s)
    return -inward if position > 0.0 else inward


@kernel
def elastic_change(p: NDArray[np.float64], first: float, last: float) -> float:
    """Return how much more energy notches and struts hold at ``last`` than at ``first``, J."""
    a, b = abs(first), abs(last)
    total = _climb(p[P_NEUTRAL_FORCE], 0.0, p[P_NEUTRAL_WIDTH], a, b)
    total += _climb(p[P_STRUT_FORCE], p[P_STRUT], p[P_BLOCKING] - p[P_STRUT], a, b)
    width = p[P_ENGAGED_WIDTH]
    return total - _climb(p[P_ENGAGED_FORCE], p[P_END] - width, width, a, b)


@kernel
def mean_pull(p: NDArray[np.float64], position: float, way: float) -> float:
    """Return the mean force of notches and struts against a way, N: ``dU/dx``."""
    if way == 0.0:
        return -notch_force(p, position)
    return elastic_change(p, position, position + way) / way


@kernel
def way_in_time(
    p: NDArray[np.float64],
    position: float,
    velocity: float,
    force: float,
    stiffness: float,
    time: float,
) -> float:
    """Return the way in ``time`` s, m; ``force`` includes friction and falls by ``stiffness``."""
    impulse = 2.0 * p[P_MASS] / time
    slope = (impulse + p[P_DAMPING]) / time + 0.5 * stiffness
    drive = impulse * velocity + force
    way: float = (drive + notch_force(p, position)) / slope
    # Newton; where the notches' slope leads astray, the chord above it (it lies within P_STIFFNESS).
    steepest = 0.5 * p[P_STIFFNESS]
    for _ in range(_ROUNDS):
        pull_back = mean_pull(p, position, way)
        rate = 0.0
        if way != 0.0:
            rate = (-notch_force(p, position + way) - pull_back) / way
        if not -0.5 * slope < rate < steepest:
            rate = steepest
        change = (drive - slope * way - pull_back) / (slope + rate)
        way += change
        if abs(change) <= _CLOSE * abs(way):
            break
    return way


@kernel
def way_to_rest(
    p: NDArray[np.float64], position: float, velocity: float, force: float, stiffness: float
) -> float:
    """Return the way on which the sleeve comes to rest, m; infinite where it does not."""
    twice = p[P_MASS] * velocity * velocity
    side = 1.0 if velocity > 0.0 else -1.0
    drive = force - 0.5 * p[P_DAMPING] * velocity
    way = 0.0
    for _ in range(_ROUNDS):
        net = drive - mean_pull(p, position, way)
        root = math.sqrt(net * net + stiffness * twice)
        under = side * root - net
        if under * side <= 0.0:
            return side * math.inf
        new = twice / under
        change = new - way
        way = new
        if abs(change) <= _CLOSE * abs(way):
            break
    return way


@kernel
def speed_over_way(
    p: NDArray[np.float64],
    position: float,
    velocity: float,
    force: float,
    stiffness: float,
    way: float,
) -> float:
    """Return the mean speed over a given way, m/s."""
    net = force - 0.5 * stiffness * way - mean_pull(p, position, way)
    m = p[P_MASS]
    free = 2.0 * m * velocity - p[P_DAMPING] * way
    root = math.sqrt(max(free * free + 8.0 * m * net * way, 0.0))
    return float((free + (root if way > 0.0 else -root)) / (4.0 * m))


@kernel
def dry_friction(p: Array, s: float, outward: bool, dogs: float) -> float:
    """Return the dry friction at travel ``s``, N: of the guide, and of flanks that carry ``dogs`` N m."""
    dry: float = p[P_GUIDE_FRICTION]
    if s > p[P_DOGS] or (s == p[P_DOGS] and outward):
        dry += p[P_DOG_HOLD] * dogs
    return dry


@kernel
def past_ring(p: Array, s: float, outward: bool, push: float) -> float:
    """Return the share of ``push``, N outward, that is left after rubbing past the ring, 1."""
    if push > 0.0 and outward and p[P_BLOCKING] <= s < p[P_DOGS]:
        return float(1.0 - p[P_FLIGHT_SHARE])
    return 1.0


@kernel
def move_between(
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
        dry = dry_friction(p, s, outward, dogs)
        # Past the ring a share of the force rubs: of its mean over the way, as the force falls with it.
        left = past_ring(p, s, outward, push * direction)
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
