"""What the emulated units report: from the plant's truth to status ports."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports
from hev_can_emu.jit import inlined_kernel, kernel
from hev_can_emu.moves import move
from hev_can_emu.plant import powertrain as plant
from hev_can_emu.plant.columns import filled_up

Array = npt.NDArray[np.float64]

CLUTCH_OPEN, CLUTCH_SLIPPING, CLUTCH_LOCKED = 0, 1, 2
MOTOR_INIT, MOTOR_STANDBY, MOTOR_TORQUE, MOTOR_SPEED = 0, 1, 2, 3

#: Straight copies, status port and truth.  The two vectors have these at the same places, so that one stretch
#: of the truth is moved; what lies between them is no copy and written after.
COPIES: tuple[tuple[int, int], ...] = (
    (ports.S_ENGINE_SPEED, plant.Y_ENGINE_SPEED),
    (ports.S_ENGINE_TORQUE, plant.Y_ENGINE_TORQUE),
    (ports.S_ENGINE_TORQUE_SETPOINT, plant.Y_ENGINE_SETPOINT),
    (ports.S_ENGINE_TORQUE_MAX, plant.Y_ENGINE_TORQUE_MAX),
    (ports.S_ENGINE_TORQUE_MIN, plant.Y_ENGINE_TORQUE_MIN),
    (ports.S_ENGINE_STATE, plant.Y_ENGINE_PHASE),
    (ports.S_ENGINE_LIMIT_REASON, plant.Y_ENGINE_REASON),
    (ports.S_ENGINE_COOLANT_TEMPERATURE, plant.Y_COOLANT_TEMPERATURE),
    (ports.S_EM1_SPEED, plant.Y_EM1_SPEED),
    (ports.S_EM1_TORQUE, plant.Y_EM1_TORQUE),
    (ports.S_EM1_TORQUE_SETPOINT, plant.Y_EM1_SETPOINT),
    (ports.S_EM1_TORQUE_MAX, plant.Y_EM1_TORQUE_MAX),
    (ports.S_EM1_TORQUE_MIN, plant.Y_EM1_TORQUE_MIN),
    (ports.S_EM1_LIMIT_REASON, plant.Y_EM1_REASON),
    (ports.S_EM1_DC_POWER, plant.Y_EM1_POWER),
    (ports.S_EM1_DC_VOLTAGE, plant.Y_LINK_VOLTAGE),
    (ports.S_EM1_TEMPERATURE, plant.Y_EM1_WINDING_TEMPERATURE),
    (ports.S_EM1_INVERTER_TEMPERATURE, plant.Y_EM1_INVERTER_TEMPERATURE),
    (ports.S_EM2_SPEED, plant.Y_EM2_SPEED),
    (ports.S_EM2_TORQUE, plant.Y_EM2_TORQUE),
    (ports.S_EM2_TORQUE_SETPOINT, plant.Y_EM2_SETPOINT),
    (ports.S_EM2_TORQUE_MAX, plant.Y_EM2_TORQUE_MAX),
    (ports.S_EM2_TORQUE_MIN, plant.Y_EM2_TORQUE_MIN),
    (ports.S_EM2_LIMIT_REASON, plant.Y_EM2_REASON),
    (ports.S_EM2_DC_POWER, plant.Y_EM2_POWER),
    (ports.S_EM2_TEMPERATURE, plant.Y_EM2_WINDING_TEMPERATURE),
    (ports.S_EM2_INVERTER_TEMPERATURE, plant.Y_EM2_INVERTER_TEMPERATURE),
    (ports.S_CLUTCH_CAPACITY, plant.Y_CLUTCH_CAPACITY),
    (ports.S_CLUTCH_CAPACITY_SETPOINT, plant.Y_CLUTCH_SETPOINT),
    (ports.S_CLUTCH_TORQUE, plant.Y_CLUTCH_TORQUE),
    (ports.S_CLUTCH_SLIP, plant.Y_CLUTCH_SLIP),
    (ports.S_CLUTCH_TEMPERATURE, plant.Y_CLUTCH_TEMPERATURE),
    (ports.S_CLUTCH_LIMIT_REASON, plant.Y_CLUTCH_REASON),
    (ports.S_GEAR, plant.Y_GEAR),
    (ports.S_SYNCHRONIZER_STATE, plant.Y_SYNC_PHASE),
    (ports.S_SLEEVE_POSITION, plant.Y_SLEEVE_POSITION),
    (ports.S_SHIFT_FORCE, plant.Y_SHIFT_FORCE),
    (ports.S_SYNCHRONIZER_SLIP, plant.Y_SYNC_SLIP),
    (ports.S_VEHICLE_SPEED, plant.Y_VEHICLE_SPEED),
    (ports.S_LONGITUDINAL_ACCELERATION, plant.Y_ACCELERATION),
    (ports.S_LONGITUDINAL_ACCELERATION_SENSOR, plant.Y_ACCELEROMETER),
    (ports.S_BRAKE_TORQUE, plant.Y_BRAKE_TORQUE),
    (ports.S_BRAKE_TORQUE_SETPOINT, plant.Y_BRAKE_SETPOINT),
    (ports.S_BRAKE_LIMIT_REASON, plant.Y_BRAKE_REASON),
    (ports.S_STANDSTILL, plant.Y_BODY_HELD),
    (ports.S_STATE_OF_CHARGE, plant.Y_STATE_OF_CHARGE),
    (ports.S_BATTERY_VOLTAGE, plant.Y_BATTERY_VOLTAGE),
    (ports.S_BATTERY_CURRENT, plant.Y_BATTERY_CURRENT),
    (ports.S_BATTERY_TEMPERATURE, plant.Y_BATTERY_TEMPERATURE),
    (ports.S_CONTACTOR_STATE, plant.Y_CONTACTOR_PHASE),
    (ports.S_CHARGE_POWER_LIMIT, plant.Y_CHARGE_LIMIT),
    (ports.S_DISCHARGE_POWER_LIMIT, plant.Y_DISCHARGE_LIMIT),
    (ports.S_BATTERY_LIMIT_REASON, plant.Y_BATTERY_REASON),
    (ports.S_ROAD_GRADE_ACTUAL, plant.Y_GRADE),
    (ports.S_AMBIENT_TEMPERATURE_ACTUAL, plant.Y_AMBIENT),
)
# Echoes: status port, request port, as received.
_ECHOES: tuple[tuple[int, int], ...] = (
    (ports.S_ENGINE_TORQUE_ECHO, ports.ENGINE_TORQUE_REQUEST),
    (ports.S_ENGINE_RUN_ECHO, ports.ENGINE_RUN_REQUEST),
    (ports.S_EM1_TORQUE_ECHO, ports.EM1_TORQUE_REQUEST),
    (ports.S_EM1_SPEED_ECHO, ports.EM1_SPEED_REQUEST),
    (ports.S_EM1_MODE_ECHO, ports.EM1_CONTROL_MODE),
    (ports.S_EM2_TORQUE_ECHO, ports.EM2_TORQUE_REQUEST),
    (ports.S_EM2_SPEED_ECHO, ports.EM2_SPEED_REQUEST),
    (ports.S_EM2_MODE_ECHO, ports.EM2_CONTROL_MODE),
    (ports.S_CLUTCH_CAPACITY_ECHO, ports.CLUTCH_CAPACITY_REQUEST),
    (ports.S_GEAR_ECHO, ports.GEAR_REQUEST),
    (ports.S_SHIFT_FORCE_ECHO, ports.SHIFT_FORCE_REQUEST),
    (ports.S_BRAKE_TORQUE_ECHO, ports.BRAKE_TORQUE_REQUEST),
    (ports.S_CONTACTOR_ECHO, ports.CONTACTOR_REQUEST),
    (ports.S_DRIVER_ACCELERATOR, ports.ACCELERATOR),
    (ports.S_DRIVER_BRAKE, ports.BRAKE_PEDAL),
    (ports.S_DRIVER_SELECTOR, ports.SELECTOR),
    (ports.S_DRIVER_IGNITION, ports.IGNITION),
)
# A lost request is the reason that counts: limit reason, request status.
_LOST: tuple[tuple[int, int], ...] = (
    (ports.S_ENGINE_LIMIT_REASON, ports.S_ENGINE_REQUEST_STATUS),
    (ports.S_EM1_LIMIT_REASON, ports.S_EM1_REQUEST_STATUS),
    (ports.S_EM2_LIMIT_REASON, ports.S_EM2_REQUEST_STATUS),
    (ports.S_CLUTCH_LIMIT_REASON, ports.S_CLUTCH_REQUEST_STATUS),
    (ports.S_SYNCHRONIZER_LIMIT_REASON, ports.S_SYNCHRONIZER_REQUEST_STATUS),
    (ports.S_BRAKE_LIMIT_REASON, ports.S_BRAKE_REQUEST_STATUS),
)
# What limits a request, before its machine does: limit reason, request port.
_LIMITED: tuple[tuple[int, int], ...] = (
    (ports.S_ENGINE_LIMIT_REASON, ports.ENGINE_TORQUE_REQUEST),
    (ports.S_EM1_LIMIT_REASON, ports.EM1_TORQUE_REQUEST),
    (ports.S_EM1_LIMIT_REASON, ports.EM1_SPEED_REQUEST),
    (ports.S_EM2_LIMIT_REASON, ports.EM2_TORQUE_REQUEST),
    (ports.S_EM2_LIMIT_REASON, ports.EM2_SPEED_REQUEST),
    (ports.S_CLUTCH_LIMIT_REASON, ports.CLUTCH_CAPACITY_REQUEST),
    (ports.S_SYNCHRONIZER_LIMIT_REASON, ports.SHIFT_FORCE_REQUEST),
    (ports.S_BRAKE_LIMIT_REASON, ports.BRAKE_TORQUE_REQUEST),
)
_COPIED = filled_up(1 + max(place for place, _ in COPIES))  # whole vectors
ECHOES = np.array(_ECHOES, dtype=np.int64)
LOST_REASONS = np.array(_LOST, dtype=np.int64)
LIMITED_REASONS = np.array(_LIMITED, dtype=np.int64)


@kernel
def driving_mode(clutch_state: int, gear: float) -> int:
    """Return the MODE_* code; transition while the clutch slips or the sleeve is between gears."""
    if clutch_state == CLUTCH_SLIPPING or gear > 2.0:
        return ports.MODE_TRANSITION
    locked = clutch_state == CLUTCH_LOCKED
    if gear == 0.0:
        return ports.MODE_SERIES if locked else ports.MODE_ELECTRIC_NEUTRAL
    if gear == 1.0:
        return ports.MODE_PARALLEL_G1 if locked else ports.MODE_ELECTRIC_G1
    return ports.MODE_PARALLEL_G2 if locked else ports.MODE_ELECTRIC_G2


@kernel
def _motor_state(mode: float, connected: bool) -> float:
    """Return MCU's state: the control mode while high voltage is there, else standby."""
    if mode in (ports.CONTROL_FREEWHEEL, ports.CONTROL_ASC):
        return mode + 1.0
    if mode in (ports.CONTROL_TORQUE, ports.CONTROL_SPEED) and connected:
        return mode + 1.0
    return float(MOTOR_STANDBY)


@kernel
def _at_bound(command: Array, base: int, setpoint: float) -> bool:
    """Whether a motor in speed control is held back by a bound of its request."""
    if command[base] != ports.CONTROL_SPEED:
        return False
    return bool(setpoint == command[base + 3] or setpoint == command[base + 4])


@kernel
def supervision_limits(limited: Array, statuses: Array) -> bool:
    """Return whether supervision limits any request, or misses one that came before."""
    found = False
    for i in range(LIMITED_REASONS.shape[0]):
        found |= limited[LIMITED_REASONS[i, 1]] != 0.0
    for i in range(LOST_REASONS.shape[0]):
        found |= statuses[LOST_REASONS[i, 1]] > ports.REQUEST_NEVER
    return found


@kernel
def _tell_limits(limited: Array, statuses: Array) -> None:
    for i in range(LIMITED_REASONS.shape[0]):
        reason = limited[LIMITED_REASONS[i, 1]]
        if reason != 0.0 and statuses[LIMITED_REASONS[i, 0]] == ports.LIMIT_NONE:
            statuses[LIMITED_REASONS[i, 0]] = reason
    for i in range(LOST_REASONS.shape[0]):
        # A unit that was never asked is not limited by a lost request.
        if statuses[LOST_REASONS[i, 1]] > ports.REQUEST_NEVER:
            statuses[LOST_REASONS[i, 0]] = ports.LIMIT_REQUEST_LOST


@inlined_kernel
def statuses_from_truth(
    truth: Array,
    command: Array,
    request: Array,
    limited: Array,
    tyre_radius: float,
    model: int,
    failed: int,
    refused: int,
    fresh: bool,
    limits: bool,
    statuses: Array,
) -> None:
    """Fill the status ports from truth, commands and the requests as received.

    Args:
        truth: shape (len(plant.TRUTH),).
        command: shape (len(plant.COMMANDS),).
        request: request ports as received.
        limited: per request port the LIMIT_* code with which supervision limits it, 0 for none.
        tyre_radius: m.
        model: 0 4dof, 1 16dof, 2 detailed.
        failed: supervised messages that are not good.
        refused: frames refused so far.
        fresh: whether requests may differ from those of the last call.
        limits: whether supervision limits a request or misses one, see :func:`supervision_limits`.
        statuses: out; the REQUEST_* codes are there already.
    """
    move(truth, 0, statuses, 0, _COPIED)
    statuses[ports.S_EM2_DC_VOLTAGE] = truth[plant.Y_LINK_VOLTAGE]
    if fresh:
        for i in range(ECHOES.shape[0]):
            statuses[ECHOES[i, 0]] = request[ECHOES[i, 1]]
    statuses[ports.S_WHEEL_SPEED_FL] = truth[plant.Y_WHEEL_LEFT_SPEED] * tyre_radius
    statuses[ports.S_WHEEL_SPEED_FR] = truth[plant.Y_WHEEL_RIGHT_SPEED] * tyre_radius
    link = truth[plant.Y_LINK_VOLTAGE]
    statuses[ports.S_EM1_DC_CURRENT] = truth[plant.Y_EM1_POWER] / link if link > 1.0 else 0.0
    statuses[ports.S_EM2_DC_CURRENT] = truth[plant.Y_EM2_POWER] / link if link > 1.0 else 0.0
    rear = truth[plant.Y_WHEEL_REAR_SPEED] * tyre_radius
    statuses[ports.S_WHEEL_SPEED_RL] = statuses[ports.S_WHEEL_SPEED_RR] = rear
    connected = truth[plant.Y_CONTACTOR_PHASE] in (2.0, 3.0)
    statuses[ports.S_EM1_STATE] = _motor_state(command[plant.U_EM1_MODE], connected)
    statuses[ports.S_EM2_STATE] = _motor_state(command[plant.U_EM2_MODE], connected)
    for reason, base, setpoint, state, asked in (
        (
            ports.S_EM1_LIMIT_REASON, plant.U_EM1_MODE, ports.S_EM1_TORQUE_SETPOINT,
            ports.S_EM1_STATE, ports.EM1_TORQUE_REQUEST,
        ),
        (
            ports.S_EM2_LIMIT_REASON, plant.U_EM2_MODE, ports.S_EM2_TORQUE_SETPOINT,
            ports.S_EM2_STATE, ports.EM2_TORQUE_REQUEST,
        ),
    ):  # fmt: skip
        if statuses[reason] != ports.LIMIT_NONE:
            continue
        if _at_bound(command, base, statuses[setpoint]):
            statuses[reason] = ports.LIMIT_TORQUE_BOUND
        elif statuses[state] not in (MOTOR_TORQUE, MOTOR_SPEED) and abs(request[asked]) > 0.0:
            statuses[reason] = ports.LIMIT_DISABLED
    clutch = CLUTCH_OPEN
    if truth[plant.Y_CLUTCH_HELD] > 0.5:
        clutch = CLUTCH_LOCKED
    elif truth[plant.Y_CLUTCH_CAPACITY] > 0.0:
        clutch = CLUTCH_SLIPPING
    statuses[ports.S_CLUTCH_STATE] = clutch
    phase = truth[plant.Y_SYNC_PHASE]
    shift_reason = float(ports.LIMIT_NONE)
    if phase == ports.SYNC_ABORTED:
        shift_reason = float(ports.LIMIT_SYNC_TIMEOUT)
    elif phase == ports.SYNC_BLOCKED_BY_TORQUE:
        shift_reason = float(ports.LIMIT_TORQUE_ON_DOGS)
    statuses[ports.S_SYNCHRONIZER_LIMIT_REASON] = shift_reason
    if limits:
        _tell_limits(limited, statuses)

    statuses[ports.S_DRIVING_MODE] = driving_mode(clutch, truth[plant.Y_GEAR])
    statuses[ports.S_FAULTS_ACTIVE] = 0.0
    statuses[ports.S_REQUESTS_FAILED] = failed
    statuses[ports.S_REJECTED_FRAMES] = refused % 65536
    statuses[ports.S_PLANT_MODEL] = model
