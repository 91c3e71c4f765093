"""Cutting the motors' torques to what the battery grants, exact to the watt, losses included.

With the torques of one group multiplied by a share s, the power of all loads is the parabola
``base + A*s + B*s^2``: A holds shaft power and cross losses, B the copper losses (never negative).
Too much discharge cuts those motors whose torque adds to the load, too much charge those whose torque
adds to the supply; the others keep theirs.  The greatest share that respects the limit has a closed
form, so the result is monotone in the limit and the same on every machine.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant.motor import (
    P_LOSS_CROSS,
    P_LOSS_TORQUE_SQUARE,
    idle_loss,
    torque_for_power,
)

# Layout of the output.
OUT_TORQUE1, OUT_TORQUE2, OUT_CUT1, OUT_CUT2, OUT_POWER, OUT_SHORTFALL = 0, 1, 2, 3, 4, 5
N_OUT = 6

_TOLERANCE = 1e-6  # W


@small_kernel
def _share_discharging(a: float, b: float, rest: float) -> float:
    """Return the greatest s in 0..1 with a*s + b*s^2 <= rest, or the s of least power if none."""
    square = a * a + 4.0 * b * rest
    if square <= 0.0:
        share = -a / (2.0 * b) if a < 0.0 else 0.0
    elif a >= 0.0:
        share = 2.0 * rest / (a + math.sqrt(square))
    else:
        share = (math.sqrt(square) - a) / (2.0 * b)
    return min(max(share, 0.0), 1.0)


@small_kernel
def _share_charging(a: float, b: float, rest: float) -> float:
    """Return the greatest s in 0..1 up to which a*s + b*s^2 >= rest, for a < 0 and rest <= 0."""
    square = a * a + 4.0 * b * rest
    share = 2.0 * rest / (a - math.sqrt(max(square, 0.0)))
    return min(max(share, 0.0), 1.0)


@small_kernel
def allocate(
    motor1: NDArray[np.float64],
    motor2: NDArray[np.float64],
    torque1: float,
    torque2: float,
    speed1: float,
    speed2: float,
    active1: float,
    active2: float,
    auxiliary_power: float,
    discharge_limit: float,
    charge_limit: float,
    out: NDArray[np.float64],
) -> None:
    """Cut two motors' torques so that all loads together stay within the battery's limits.

    Args:
        motor1, motor2: packed :class:`hev_can_emu.plant.motor.MotorParameters`.
        torque1, torque2: what they would give without the limit, N m.
        speed1, speed2: rad/s.
        active1, active2: 1 where the inverter switches (its idle loss counts).
        auxiliary_power: W.
        discharge_limit, charge_limit: W, both magnitudes.
        out: ``(N_OUT,)``: torques N m, 1 where each was cut, power of all loads after the cut W,
            shortfall W: what the loads exceed the discharge limit by even with the torques cut.
    """
    c1: float = motor1[P_LOSS_TORQUE_SQUARE]
    c2: float = motor2[P_LOSS_TORQUE_SQUARE]
    b1 = c1 * torque1 * torque1
    b2 = c2 * torque2 * torque2
    a1 = torque1 * speed1 + motor1[P_LOSS_CROSS] * abs(torque1 * speed1)
    a2 = torque2 * speed2 + motor2[P_LOSS_CROSS] * abs(torque2 * speed2)
    base = auxiliary_power
    if active1 > 0.5 or torque1 != 0.0:
        base += idle_loss(motor1, speed1)
    if active2 > 0.5 or torque2 != 0.0:
        base += idle_loss(motor2, speed2)
    total = base + a1 + b1 + a2 + b2
    share1 = 1.0
    share2 = 1.0
    if total > discharge_limit:
        cut1, cut2 = a1 + b1 > 0.0, a2 + b2 > 0.0
    elif total < -charge_limit:
        cut1, cut2 = a1 + b1 < 0.0, a2 + b2 < 0.0
    else:
        cut1, cut2 = False, False
    if cut1 or cut2:
        a, b, rest = 0.0, 0.0, -base
        if cut1:
            a += a1
            b += b1
        else:
            rest -= a1 + b1
        if cut2:
            a += a2
            b += b2
        else:
            rest -= a2 + b2
        if total > discharge_limit:
            share = _share_discharging(a, b, rest + discharge_limit)
        else:
            share = _share_charging(a, b, rest - charge_limit)
        if cut1:
            share1 = share
        if cut2:
            share2 = share
    out[OUT_TORQUE1] = torque1 * share1
    out[OUT_TORQUE2] = torque2 * share2
    out[OUT_CUT1] = 1.0 if cut1 else 0.0
    out[OUT_CUT2] = 1.0 if cut2 else 0.0
    power = base + a1 * share1 + b1 * share1 * share1 + a2 * share2 + b2 * share2 * share2
    out[OUT_POWER] = power
    shortfall = power - discharge_limit
    out[OUT_SHORTFALL] = shortfall if shortfall > _TOLERANCE else 0.0


@small_kernel
def power_torque_range(
    motor: NDArray[np.float64],
    speed: float,
    other_power: float,
    discharge_limit: float,
    charge_limit: float,
    limits: NDArray[np.float64],
) -> None:
    """Narrow a motor's torque range to what the battery allows beside the other loads.

    Args:
        motor: packed :class:`hev_can_emu.plant.motor.MotorParameters`.
        speed: rad/s.
        other_power: of all other loads, W, positive consumes.
        discharge_limit, charge_limit: W, magnitudes.
        limits: at least two values: torque min and max N m, narrowed in place, for publication.
    """
    most = discharge_limit - other_power
    least = -charge_limit - other_power
    if speed >= 0.0:
        limits[1] = min(limits[1], torque_for_power(motor, speed, most, 1.0))
        limits[0] = max(limits[0], _generating(motor, speed, most, least, -1.0))
    else:
        limits[0] = max(limits[0], torque_for_power(motor, speed, most, -1.0))
        limits[1] = min(limits[1], _generating(motor, speed, most, least, 1.0))


@small_kernel
def _generating(
    motor: NDArray[np.float64], speed: float, most: float, least: float, direction: float
) -> float:
    """Return the braking torque bound: by charging, else by what braking itself consumes."""
    slope: float = direction * speed + motor[P_LOSS_CROSS] * abs(speed)
    valley: float = idle_loss(motor, speed)
    if least > valley:
        return 0.0  # the other loads alone charge too much
    if slope < 0.0:
        valley -= slope * slope / (4.0 * motor[P_LOSS_TORQUE_SQUARE])
    if valley < least:
        return torque_for_power(motor, speed, least, direction)
    # Coming out of generation, braking takes power again: as deep as the battery stands it.
    return torque_for_power(motor, speed, max(most, idle_loss(motor, speed)), direction)
