"""What a unit does with a lost request: hold, ramp to zero, substitute, open the clutch, limp home."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports
from hev_can_emu.ecu.rules import Rules
from hev_can_emu.ecu.ties import (
    REACT_HOLD,
    REACT_LIMP_HOME,
    REACT_OPEN_CLUTCH,
    REACT_SUBSTITUTE,
    ResolvedBindings,
)
from hev_can_emu.jit import kernel

Array = npt.NDArray[np.float64]

GOOD = 1.0  #: share of a port whose message is good, or not watched
GONE = 0.0  #: share of a port ramped down to zero, or of an external unit that reports nothing
HELD = -1.0  #: share of a port whose message is lost and whose unit acts on something in its stead

_DRIVE = 3.0  # the selector's code of D
_FADE = 0.1  # limp home: share of the speed over which torque fades


@kernel
def _limp(rules: Rules, message: int, effective: Array, statuses: Array) -> float:
    """Return the torque that the driver gets in limp home, N m."""
    pedal, speed = effective[ports.ACCELERATOR], statuses[ports.S_VEHICLE_SPEED]
    if effective[ports.SELECTOR] != _DRIVE or math.isnan(pedal) or math.isnan(speed):
        return 0.0
    most = rules.limp_speed[message]
    left = (most - abs(speed)) / max(_FADE * most, 1e-3)
    torque: float = pedal * rules.limp_torque[message] * min(max(left, 0.0), 1.0)
    return torque


@kernel
def react(
    ties: ResolvedBindings,
    rules: Rules,
    message: int,
    kept: Array,
    effective: Array,
    share: Array,
    statuses: Array,
    gone_ns: int,
) -> float:
    """Write what the ports of a lost message are to be; see :func:`hev_can_emu.ecu.supervision.watch`.

    Args:
        gone_ns: time since the loss.

    Returns:
        The share that is to be left of the clutch's capacity.
    """
    reaction, ramp_ns = ties.reaction[message], ties.ramp_ns[message]
    keep = GONE
    if ramp_ns > 0:
        keep = max(GONE, GOOD - gone_ns / ramp_ns)
    for i in range(ties.cover_start[message], ties.cover_start[message + 1]):
        port = ties.cover_port[i]
        target = kept[port]
        told = HELD
        if reaction == REACT_SUBSTITUTE:
            if not math.isnan(rules.substitute[port]):
                target = rules.substitute[port]
        elif reaction == REACT_LIMP_HOME:
            if port in (
                ports.ENGINE_TORQUE_REQUEST, ports.EM1_TORQUE_REQUEST, ports.EM2_TORQUE_REQUEST,
            ):  # fmt: skip
                target = _limp(rules, message, effective, statuses)
            if port in (ports.EM1_TORQUE_REQUEST, ports.EM2_TORQUE_REQUEST):
                effective[port + 1] = float(ports.CONTROL_TORQUE)
        elif reaction != REACT_HOLD:
            target = 0.0
            told = keep
        effective[port] = (
            kept[port] if target == kept[port] else target + (kept[port] - target) * keep
        )
        share[port] = told
    return keep if reaction == REACT_OPEN_CLUTCH else GOOD


@kernel
def open_clutch(effective: Array, share: Array, left: float) -> None:
    """Leave a share of the clutch's capacity, whatever message asks for it."""
    port = ports.CLUTCH_CAPACITY_REQUEST
    if share[port] == GOOD:
        effective[port] *= left
        share[port] = left
