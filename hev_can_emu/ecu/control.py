"""What the emulated units make of their requests: from request ports to the plant's commands.

One kernel, a section per unit.  A request that was never received leaves its unit in its safe state; one
that is lost has been replaced by supervision before it comes here.  Units act once they have booted, and
while the ignition is on.  A unit that is external does nothing here: the plant follows what it reports, and
where it reports nothing, its machine is passive.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports
from hev_can_emu.jit import inlined_kernel, kernel
from hev_can_emu.plant import powertrain as plant

Array = npt.NDArray[np.float64]

IGNITION_ON = 2

BOOT_TICKS = 100  #: from ignition on to a unit that acts and reports, in ticks of 1 ms
AFTERRUN_TICKS = 500  #: from ignition off to a unit asleep

# State of the units beside the plant's.
CONTACTORS_WANTED = 0  # what the BMS holds while no request tells it otherwise
UP_TICKS = 1  # since ignition on, at most one beyond BOOT_TICKS
DOWN_TICKS = 2  # since ignition off, at most one beyond AFTERRUN_TICKS
N_STATE = 3

# Phases in which the sleeve is on its way.
_SHIFTING = np.zeros(16, dtype=np.uint8)
_SHIFTING[
    [
        ports.SYNC_TRAVEL,
        ports.SYNC_SYNCHRONISING,
        ports.SYNC_INDEX,
        ports.SYNC_GRATING,
        ports.SYNC_TOOTH_ON_TOOTH,
        ports.SYNC_DISENGAGING,
    ]
] = 1


@kernel
def or_zero(value: float) -> float:
    """Return ``value``, or 0 where it is not available."""
    return 0.0 if math.isnan(value) else value


@kernel
def start_units(state: Array, ready: bool) -> None:
    """Set the units' state, shape (N_STATE,): booted with the contactors closed, or asleep."""
    state[CONTACTORS_WANTED] = 1.0 if ready else 0.0
    state[UP_TICKS] = BOOT_TICKS + 1.0 if ready else 0.0
    state[DOWN_TICKS] = 0.0 if ready else AFTERRUN_TICKS + 1.0


@kernel
def _is_up(state: Array, ignition: bool) -> bool:
    """Count the ticks since the ignition was switched; return whether the units act."""
    if ignition:
        if state[DOWN_TICKS] > AFTERRUN_TICKS:
            state[UP_TICKS] = 0.0
        state[DOWN_TICKS] = 0.0
        state[UP_TICKS] = min(state[UP_TICKS] + 1.0, BOOT_TICKS + 1.0)
        return bool(state[UP_TICKS] > BOOT_TICKS)
    state[DOWN_TICKS] = min(state[DOWN_TICKS] + 1.0, AFTERRUN_TICKS + 1.0)
    return False


@kernel
def _is_external(request: Array, share: Array, port: int) -> bool:
    """Whether a real unit answers for this ``external_*`` port, now or before it fell silent."""
    return not math.isnan(request[port]) or share[port] < 1.0


@kernel
def _motor(
    request: Array,
    share: Array,
    base: int,
    command: Array,
    command_base: int,
    lower: float,
    upper: float,
    active: bool,
) -> bool:
    """MCU: mode and set values; torque bounds shrink while the request ramps down.

    Returns:
        Whether the commands follow from the request alone.
    """
    mode = or_zero(request[base + 1])
    factor = share[base]
    low, high = request[base + 3], request[base + 4]
    if 0.0 <= factor < 1.0:
        low = factor * (lower if math.isnan(low) else low)
        high = factor * (upper if math.isnan(high) else high)
        # A short circuit brakes whatever the request: it ends with the ramp.
        if factor == 0.0 and mode == ports.CONTROL_ASC:
            mode = float(ports.CONTROL_OFF)
    command[command_base] = mode if active else float(ports.CONTROL_OFF)
    command[command_base + 1] = or_zero(request[base])
    command[command_base + 2] = request[base + 2]
    command[command_base + 3] = low
    command[command_base + 4] = high
    return not 0.0 <= factor < 1.0


@kernel
def _shift(request: Array, share: Array, truth: Array, active: bool, command: Array) -> bool:
    """TCU: a lost request leaves the sleeve where it is, but gives up a shift under way.

    Returns:
        Whether the command follows from the request alone.
    """
    steady = True
    gear, force = request[ports.GEAR_REQUEST], or_zero(request[ports.SHIFT_FORCE_REQUEST])
    if _is_external(request, share, ports.EXTERNAL_GEAR):
        gear, force = math.nan, 0.0
    elif share[ports.GEAR_REQUEST] != 1.0 or math.isnan(gear) or not active:
        steady = False
        gear = math.nan
        if _SHIFTING[int(truth[plant.Y_SYNC_PHASE])] == 1:
            gear = 0.0
        else:
            force = 0.0
    command[plant.U_GEAR] = gear
    command[plant.U_SHIFT_FORCE] = force
    return steady


@inlined_kernel
def commands_from_requests(
    request: Array,
    share: Array,
    statuses: Array,
    truth: Array,
    brake_max: float,
    state: Array,
    command: Array,
) -> Any:
    """Fill the plant's commands; called once per tick.

    Args:
        request: effective request ports.
        share: per request port, as :func:`hev_can_emu.ecu.supervision.watch` writes it.
        statuses: status ports (of the last tick, but for the REQUEST_* codes).
        truth: the plant's truth of the last period.
        brake_max: brake torque that a fully pressed pedal gives when no request does, N m.
        state: shape (N_STATE,), changed in place.
        command: out, shape (len(plant.COMMANDS),).

    Returns:
        Whether the next tick's commands will be the same, should ``request`` and ``share`` be.
    """
    active = _is_up(state, or_zero(request[ports.IGNITION]) >= IGNITION_ON)
    steady = state[UP_TICKS] > BOOT_TICKS if active else state[DOWN_TICKS] > AFTERRUN_TICKS

    # EMS
    runs = active and not _is_external(request, share, ports.EXTERNAL_ENGINE_TORQUE)
    command[plant.U_ENGINE_RUN] = or_zero(request[ports.ENGINE_RUN_REQUEST]) if runs else 0.0
    command[plant.U_ENGINE_TORQUE] = or_zero(request[ports.ENGINE_TORQUE_REQUEST])

    # MCU1, MCU2
    steady &= _motor(
        request, share, ports.EM1_TORQUE_REQUEST, command, plant.U_EM1_MODE,
        truth[plant.Y_EM1_TORQUE_MIN], truth[plant.Y_EM1_TORQUE_MAX],
        active and not _is_external(request, share, ports.EXTERNAL_EM1_TORQUE),
    )  # fmt: skip
    steady &= _motor(
        request, share, ports.EM2_TORQUE_REQUEST, command, plant.U_EM2_MODE,
        truth[plant.Y_EM2_TORQUE_MIN], truth[plant.Y_EM2_TORQUE_MAX],
        active and not _is_external(request, share, ports.EXTERNAL_EM2_TORQUE),
    )  # fmt: skip

    # TCU
    clutch = or_zero(request[ports.CLUTCH_CAPACITY_REQUEST])
    if not active or _is_external(request, share, ports.EXTERNAL_CLUTCH_CAPACITY):
        clutch = 0.0
    command[plant.U_CLUTCH_CAPACITY] = clutch
    steady &= _shift(request, share, truth, active, command)

    # ESC: the pedal works the brakes itself whenever no good request does.
    brake = or_zero(request[ports.BRAKE_TORQUE_REQUEST])
    pedal = or_zero(request[ports.BRAKE_PEDAL]) * brake_max
    if _is_external(request, share, ports.EXTERNAL_BRAKE_TORQUE) or not active:
        brake = pedal
    elif share[ports.BRAKE_TORQUE_REQUEST] != 1.0 or math.isnan(
        request[ports.BRAKE_TORQUE_REQUEST]
    ):
        brake = max(brake, pedal)
    command[plant.U_BRAKE_TORQUE] = brake

    # BMS: opening contactors under load does harm, so a lost request changes nothing.
    contactors = request[ports.CONTACTOR_REQUEST]
    if not active:
        # What was asked for before the ignition was switched off does not hold after.
        state[CONTACTORS_WANTED] = 0.0
    elif share[ports.CONTACTOR_REQUEST] == 1.0 and not math.isnan(contactors):
        state[CONTACTORS_WANTED] = contactors
    command[plant.U_CONTACTOR] = state[CONTACTORS_WANTED]

    # VEH, and what external units report.
    command[plant.U_GRADE] = request[ports.ROAD_GRADE]
    command[plant.U_AMBIENT] = request[ports.AMBIENT_TEMPERATURE]
    command[plant.U_EXTERNAL_ENGINE_TORQUE] = request[ports.EXTERNAL_ENGINE_TORQUE]
    command[plant.U_EXTERNAL_EM1_TORQUE] = request[ports.EXTERNAL_EM1_TORQUE]
    command[plant.U_EXTERNAL_EM2_TORQUE] = request[ports.EXTERNAL_EM2_TORQUE]
    command[plant.U_EXTERNAL_CLUTCH_CAPACITY] = request[ports.EXTERNAL_CLUTCH_CAPACITY]
    command[plant.U_EXTERNAL_GEAR] = request[ports.EXTERNAL_GEAR]
    command[plant.U_EXTERNAL_BRAKE_TORQUE] = request[ports.EXTERNAL_BRAKE_TORQUE]
    command[plant.U_EXTERNAL_BATTERY_VOLTAGE] = request[ports.EXTERNAL_BATTERY_VOLTAGE]
    command[plant.U_EXTERNAL_DISCHARGE_POWER] = request[ports.EXTERNAL_DISCHARGE_POWER_LIMIT]
    command[plant.U_EXTERNAL_CHARGE_POWER] = request[ports.EXTERNAL_CHARGE_POWER_LIMIT]
    return steady
