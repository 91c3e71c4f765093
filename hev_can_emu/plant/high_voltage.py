"""Battery, contactors and what both drives may ask for: once per tick of the detailed plant."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.plant import battery, contactors, inverter, speed_control, torque_map
from hev_can_emu.plant import electric_drive as drive
from hev_can_emu.plant.drive_power import steady_power, torque_within_power

Array = npt.NDArray[np.float64]

# Control modes of a motor, as the commands have them.
OFF, TORQUE, SPEED, FREEWHEEL, SHORT_CIRCUIT = 0, 1, 2, 3, 4

_NEVER = 1e9  # W; no bound


@kernel
def gates_of(mode: float, phase: float) -> float:
    """Return what a drive's gates do in a control mode and phase of the contactors.

    While the contactors open, the drives end their torque under control: no load is torn off.
    """
    if mode == SHORT_CIRCUIT:
        return float(inverter.SHORT)
    if mode in (TORQUE, SPEED) and phase in (contactors.CLOSED, contactors.OPENING):
        return float(inverter.ACTIVE)
    return float(inverter.BLOCKED)


@kernel
def demand(
    mode: float,
    torque: float,
    reference: float,
    lower: float,
    upper: float,
    speed: float,
    acting: float,
    x_drive: Array,
    control: Array,
    x_control: Array,
    work: Array,
) -> float:
    """Return the torque that a drive's control unit asks of its current control, N m.

    Args:
        mode: TORQUE, SPEED or another.
        torque: request, N m.
        reference: set speed, rad/s.
        lower, upper: of the request, N m; NaN for none.
        speed: of the shaft, rad/s.
        acting: torque now, N m.
        x_drive: state of the drive, which holds its limits.
        control, x_control: of the speed control.
        work: scratch, at least ``speed_control.N_OUT``.
    """
    drag = x_drive[drive.X_DRAG]
    low = x_drive[drive.X_LIMITS + torque_map.LIM_TORQUE_MIN] - drag
    high = x_drive[drive.X_LIMITS + torque_map.LIM_TORQUE_MAX] - drag
    if not math.isnan(lower):
        low = max(low, lower)
    if not math.isnan(upper):
        high = min(high, upper)
    in_speed_control = 1.0 if mode == SPEED else 0.0
    speed_control.speed_control_step(
        control, x_control, in_speed_control, reference, speed, low, high, acting, 0.0, work
    )
    if mode == SPEED:
        return float(work[speed_control.OUT_REQUEST])
    if mode == TORQUE and not math.isnan(torque):
        return torque
    return 0.0


@kernel
def share_power(
    em1: Array,
    em2: Array,
    torque1: float,
    torque2: float,
    speed1: float,
    speed2: float,
    active1: bool,
    active2: bool,
    link_voltage: float,
    temperature1: float,
    temperature2: float,
    auxiliary: float,
    discharge: float,
    charge: float,
    out: Array,
) -> None:
    """Cut both torques so that the steady power of all loads stays within the battery's limits.

    A drive is cut when its power adds to the excess; both by the same share of their power.

    Args:
        em1, em2: packed drives.
        torque1, torque2: asked for, N m.
        speed1, speed2: rad/s.
        active1, active2: whether the inverters switch.
        link_voltage: V.
        temperature1, temperature2: of the windings, K.
        auxiliary: W.
        discharge, charge: limits, W, magnitudes.
        out: at least four values: torques N m, 1 where each was cut.
    """
    out[0], out[1], out[2], out[3] = torque1, torque2, 0.0, 0.0
    power1 = steady_power(em1, torque1, speed1, link_voltage, temperature1) if active1 else 0.0
    power2 = steady_power(em2, torque2, speed2, link_voltage, temperature2) if active2 else 0.0
    total = power1 + power2 + auxiliary
    if total > discharge:
        side, excess = 1.0, total - discharge
    elif total < -charge:
        side, excess = -1.0, -charge - total
    else:
        return
    guilty = max(side * power1, 0.0) + max(side * power2, 0.0)
    left = max(1.0 - excess / guilty, 0.0) if guilty > 0.0 else 0.0
    for index in range(2):
        p = em1 if index == 0 else em2
        power = power1 if index == 0 else power2
        torque = torque1 if index == 0 else torque2
        speed = speed1 if index == 0 else speed2
        temperature = temperature1 if index == 0 else temperature2
        if side * power <= 0.0 or torque == 0.0:
            continue
        most = left * power if side > 0.0 else _NEVER
        least = left * power if side < 0.0 else -_NEVER
        out[index] = torque_within_power(p, torque, least, most, speed, link_voltage, temperature)
        out[2 + index] = 1.0


@kernel
def refresh_bound(
    which: int,
    p: Array,
    x_drive: Array,
    speed: float,
    link_voltage: float,
    temperature: float,
    other: float,
    discharge: float,
    charge: float,
    bounds: Array,
) -> None:
    """Bring one published torque bound up to date: the drive's own, within the battery's power.

    Args:
        which: 0 the least, 1 the greatest torque.
        p, x_drive: of the drive.
        speed: rad/s.
        link_voltage: V.
        temperature: of the winding, K.
        other: power of the other loads, W.
        discharge, charge: limits, W, magnitudes.
        bounds: least and greatest torque, N m; one is changed.
    """
    at = torque_map.LIM_TORQUE_MIN if which == 0 else torque_map.LIM_TORQUE_MAX
    own = x_drive[drive.X_LIMITS + at] - x_drive[drive.X_DRAG]
    least, most = -charge - other, discharge - other
    bounds[which] = torque_within_power(p, own, least, most, speed, link_voltage, temperature)


@kernel
def switch_contactors(
    p: Array, x: Array, x_battery: Array, battery_p: Array, close: float, link: float, out: Array
) -> float:
    """Advance the contactors' sequence; return their phase; ``out`` gets the battery's limits."""
    battery.battery_limits(battery_p, x_battery, out)
    x[contactors.X_LINK_VOLTAGE] = link
    closed = x[contactors.X_PHASE] == contactors.CLOSED
    source = link if closed else out[battery.LIM_OCV]
    contactors.contactor_step(p, x, close, source, 0.0)
    x[contactors.X_LINK_VOLTAGE] = link  # the DC link of the inner step has its own
    return float(x[contactors.X_PHASE])
