"""What direct power a drive takes in the steady state, and how much torque a power bound leaves.

For bounding requests by what the battery grants, ahead of the currents: the same references,
resistances and losses as in :mod:`.electric_drive`, without its transients.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import electric_drive as drive
from hev_can_emu.plant import inverter, pmsm, torque_map

_DRAG_ROUNDS = 2  # the iron's torque changes the flux that it depends on by little
_ROUNDS = 12
_CLOSE = 1e-6  # of the power that the whole torque takes


@kernel
def steady_power(
    p: NDArray[np.float64],
    torque: float,
    speed: float,
    link_voltage: float,
    winding_temperature: float,
) -> float:
    """Return the power from the DC link, W, that holds a torque; negative gives.

    Args:
        p: parameters of the drive, ``(electric_drive.N_PARAMETERS,)``.
        torque: as a request counts it, inside the published range, N m.
        speed: of the shaft, rad/s.
        link_voltage: V.
        winding_temperature: K.
    """
    legs = p[drive.P_INVERTER : drive.P_INVERTER + inverter.N_PARAMETERS]
    limits = p[drive.P_MAP : drive.P_MAP + torque_map.N_PARAMETERS]
    voltage = inverter.linear_voltage(legs, link_voltage)
    friction = pmsm.mechanical_drag(p, speed)
    factor = pmsm.iron_factor(p, speed)
    flux: float = p[pmsm.P_FLUX] * p[pmsm.P_FLUX]
    gap = torque
    i_d, i_q = 0.0, 0.0
    for _ in range(_DRAG_ROUNDS):
        gap = torque + p[drive.P_COMPENSATE] * (factor * flux + friction)
        i_d, i_q = torque_map.reference_currents(limits, gap, speed, voltage)
        flux = pmsm.flux_square(p, i_d, i_q)
    square = i_d * i_d + i_q * i_q
    copper = 1.5 * pmsm.phase_resistance(p, winding_temperature) * square
    loss = inverter.switching_loss(legs, math.sqrt(square), square, link_voltage)
    return gap * speed + copper + loss


@kernel
def torque_within_power(
    p: NDArray[np.float64],
    torque: float,
    least: float,
    most: float,
    speed: float,
    link_voltage: float,
    winding_temperature: float,
) -> float:
    """Return the greatest part of ``torque`` that keeps the drive's power between two bounds, W.

    0 where the losses of no torque alone pass the bound on that side.  By regula falsi (Illinois);
    other arguments as in :func:`steady_power`.
    """
    whole = steady_power(p, torque, speed, link_voltage, winding_temperature)
    if least <= whole <= most:
        return torque
    bound = most if whole > most else least
    idle = steady_power(p, 0.0, speed, link_voltage, winding_temperature)
    low, at_low = 0.0, idle - bound
    high, at_high = 1.0, whole - bound
    if at_low * at_high >= 0.0:
        return 0.0
    share, side = 0.0, 0
    for _ in range(_ROUNDS):
        share = (low * at_high - high * at_low) / (at_high - at_low)
        here = steady_power(p, share * torque, speed, link_voltage, winding_temperature) - bound
        if abs(here) <= _CLOSE * abs(whole - idle):
            break
        if here * at_low > 0.0:
            low, at_low = share, here
            if side < 0:
                at_high *= 0.5
            side = -1
        else:
            high, at_high = share, here
            if side > 0:
                at_low *= 0.5
            side = 1
    return share * torque
