"""The sleeve on the dogs' chamfers: how far they let it go, what they press with, how they throw it."""

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
    X_GRATING,
    X_POSITION,
    X_PRESS,
    X_TORQUE,
    X_VELOCITY,
)
from hev_can_emu.plant.sleeve_motion import (
    dry_friction,
    elastic_change,
    mean_pull,
    past_ring,
)
from hev_can_emu.plant.sleeve_parameters import (
    P_DAMPING,
    P_DT,
    P_EASE,
    P_END,
    P_HALF,
    P_MASS,
    P_PITCH,
    P_RATCHET,
    P_RATCHET_MAX,
    P_SLOPE,
    P_TIP,
)

Array = NDArray[np.float64]


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
def chamfer_press(
    p: Array, s: float, v: float, way: float, new: float, push: float, stiffness: float
) -> float:
    """Return what chamfers press with that take the sleeve along a way and to a speed in one step, N."""
    dt = p[P_DT]
    mean = push - 0.5 * stiffness * way
    outward = way >= 0.0
    dry = dry_friction(p, s, outward, 0.0)
    rest = past_ring(p, s, outward, mean) * mean - mean_pull(p, s, way)
    rest += -dry if outward else dry
    return float(rest - p[P_DAMPING] * way / dt - p[P_MASS] * (new - v) / dt)


@kernel
def press_next(
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
    left = past_ring(p, s, True, mean)
    rest = left * mean - dry_friction(p, s, True, 0.0) - mean_pull(p, s, 0.0)
    rest -= p[P_DAMPING] * speed + m * drift
    return float(max(rest / (1.0 + p[P_EASE] * (m + 0.25 * left * stiffness * dt * dt)), 0.0))


@kernel
def with_chamfers(
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
    press = chamfer_press(p, s, v, way, speed, push, stiffness)
    mean = push - 0.5 * stiffness * way
    outward = way >= 0.0
    out[OUT_WORK] += mean * way
    out[OUT_ELASTIC] += elastic_change(p, s, limit)
    rubbing = (1.0 - past_ring(p, s, outward, mean)) * mean
    out[OUT_FRICTION_LOSS] += (dry_friction(p, s, outward, 0.0) + rubbing) * abs(way)
    out[OUT_DAMPING_LOSS] += p[P_DAMPING] * way / dt * way
    out[OUT_KINETIC] += 0.5 * m * (speed * speed - v * v)
    x[X_POSITION], x[X_VELOCITY] = side * limit, side * speed
    drift = (speed - v) / dt - p[P_EASE] * x[X_PRESS] if x[X_PRESS] > 0.0 else 0.0
    x[X_PRESS] = press_next(p, limit, speed, drift, mean, way, stiffness)
    # The mean of both speeds is not quite that of the way.
    return float(press * way - m * (speed - v) * (0.5 * (speed + v) - way / dt))


@kernel
def throw_back(p: Array, x: Array, side: float, slip: float, out: Array) -> float:
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
