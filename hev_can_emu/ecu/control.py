"""What the emulated units make of their requests: from request ports to the plant's commands.

One kernel, a section per unit.  A request that was never received leaves its unit in its safe state; one
that is lost has been replaced by supervision before it comes here.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports
from hev_can_emu.jit import kernel
from hev_can_emu.plant import powertrain as plant

Array = npt.NDArray[np.float64]

IGNITION_ON = 2

# State of the units beside the plant's.
CONTACTORS_WANTED = 0  # what the BMS holds while no request tells it otherwise
N_STATE = 1


@kernel
def or_zero(value: float) -> float:
    """Return ``value``, or 0 where it is not available."""
    return 0.0 if math.isnan(value) else value


@kernel
def _motor(
    request: Array,
    share: Array,
    base: int,
    command: Array,
    command_base: int,
    lower: float,
    upper: float,
    awake: bool,
) -> None:
    """MCU: mode and set values; torque bounds shrink while the request ramps down."""
    mode = or_zero(request[base + 1])
    factor = share[base]
    low, high = request[base + 3], request[base + 4]
    if factor < 1.0:
        low = factor * (lower if math.isnan(low) else low)
        high = factor * (upper if math.isnan(high) else high)
    command[command_base] = mode if awake else float(ports.CONTROL_OFF)
    command[command_base + 1] = or_zero(request[base])
    command[command_base + 2] = request[base + 2]
    command[command_base + 3] = low
    command[command_base + 4] = high


@kernel
def commands_from_requests(
    request: Array,
    share: Array,
    statuses: Array,
    truth: Array,
    brake_max: float,
    state: Array,
    command: Array,
) -> None:
    """Fill the plant's commands.

    Args:
        request: effective request ports.
        share: per request port, below 1 while a lost request ramps down.
        statuses: status ports, for the REQUEST_* codes of the messages.
        truth: the plant's truth of the last period.
        brake_max: brake torque that a fully pressed pedal gives when no request does, N m.
        state: shape (N_STATE,), changed in place.
        command: out, shape (len(plant.COMMANDS),).
    """
    ignition = or_zero(request[ports.IGNITION])
    awake = ignition >= IGNITION_ON

    # EMS
    run = or_zero(request[ports.ENGINE_RUN_REQUEST]) if awake else 0.0
    if statuses[ports.S_ENGINE_REQUEST_STATUS] == ports.REQUEST_NEVER:
        run = 0.0
    command[plant.U_ENGINE_RUN] = run
    command[plant.U_ENGINE_TORQUE] = or_zero(request[ports.ENGINE_TORQUE_REQUEST])

    # MCU1, MCU2
    _motor(
        request, share, ports.EM1_TORQUE_REQUEST, command, plant.U_EM1_MODE,
        truth[plant.Y_EM1_TORQUE_MIN], truth[plant.Y_EM1_TORQUE_MAX], awake,
    )  # fmt: skip
    _motor(
        request, share, ports.EM2_TORQUE_REQUEST, command, plant.U_EM2_MODE,
        truth[plant.Y_EM2_TORQUE_MIN], truth[plant.Y_EM2_TORQUE_MAX], awake,
    )  # fmt: skip

    # TCU: a lost shift request leaves the sleeve where it is.
    command[plant.U_CLUTCH_CAPACITY] = 0.0
    if awake:
        command[plant.U_CLUTCH_CAPACITY] = or_zero(request[ports.CLUTCH_CAPACITY_REQUEST])
    command[plant.U_GEAR] = request[ports.GEAR_REQUEST]
    command[plant.U_SHIFT_FORCE] = or_zero(request[ports.SHIFT_FORCE_REQUEST])
    if statuses[ports.S_SYNCHRONIZER_REQUEST_STATUS] != ports.REQUEST_OK or not awake:
        command[plant.U_GEAR] = np.nan
        command[plant.U_SHIFT_FORCE] = 0.0

    # ESC: the pedal works the brakes itself whenever no good request does.
    brake = or_zero(request[ports.BRAKE_TORQUE_REQUEST])
    if statuses[ports.S_BRAKE_REQUEST_STATUS] != ports.REQUEST_OK or not awake:
        brake = max(brake, or_zero(request[ports.BRAKE_PEDAL]) * brake_max)
    command[plant.U_BRAKE_TORQUE] = brake

    # BMS: opening contactors under load does harm, so a lost request changes nothing.
    if not math.isnan(request[ports.CONTACTOR_REQUEST]):
        state[CONTACTORS_WANTED] = request[ports.CONTACTOR_REQUEST]
    command[plant.U_CONTACTOR] = state[CONTACTORS_WANTED] if awake else 0.0

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
