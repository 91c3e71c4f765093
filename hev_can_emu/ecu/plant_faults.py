"""Faults of actuators, machines, valves and sensors, between the units and what they control.

Two kernels around the units' reporting: one changes the *commands* that the plant gets, so every model of
the plant takes part; the other changes what is *reported*: states and reasons, what is
available, measured values.  A unit knows when its machine is derated, tripped, short-circuited or
without its speed sensor, and says so; of a stuck, slow or leaking actuator it knows nothing, and its
set value goes on showing what it wants.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import fault_table as table
from hev_can_emu.ecu import ports
from hev_can_emu.ecu.fault_rows import ACTUATORS, CODES, MACHINES, VALVES
from hev_can_emu.ecu.fault_table import FaultTable
from hev_can_emu.jit import inner_kernel, kernel
from hev_can_emu.plant import powertrain as plant

Array = npt.NDArray[np.float64]

_STUCK, _SLOW = CODES["actuator_stuck"], CODES["actuator_slow"]
_SENSOR = CODES["sensor_failure"]
_DERATED, _TRIPPED = CODES["machine_derated"], CODES["machine_tripped"]
_SHORTED, _LEAK, _VALVE = (
    CODES["machine_short_circuit"], CODES["clutch_leak"], CODES["valve_stuck"],
)  # fmt: skip

ENGINE, EM1, EM2 = (MACHINES.index(name) for name in ("engine", "em1", "em2"))
_A_ENGINE, _A_EM1, _A_EM2, _A_CLUTCH, _A_SHIFT, _A_BRAKE, _A_CONTACTORS = (
    ACTUATORS.index(name)
    for name in ("engine", "em1", "em2", "clutch", "shift", "brake", "contactors")
)
_V_CLUTCH, _V_G1, _V_G2 = (VALVES.index(name) for name in ("clutch", "g1", "g2"))

# The command through which each actuator gets its value, and for motors its set speed and mode.
_COMMAND = np.zeros(len(ACTUATORS), dtype=np.int64)
_COMMAND[[_A_ENGINE, _A_EM1, _A_EM2]] = (
    plant.U_ENGINE_TORQUE,
    plant.U_EM1_TORQUE,
    plant.U_EM2_TORQUE,
)
_COMMAND[[_A_CLUTCH, _A_SHIFT]] = plant.U_CLUTCH_CAPACITY, plant.U_SHIFT_FORCE
_COMMAND[[_A_BRAKE, _A_CONTACTORS]] = plant.U_BRAKE_TORQUE, plant.U_CONTACTOR

# What each actuator gives now.
_TRUTH = np.zeros(len(ACTUATORS), dtype=np.int64)
_TRUTH[[_A_ENGINE, _A_EM1, _A_EM2]] = plant.Y_ENGINE_TORQUE, plant.Y_EM1_TORQUE, plant.Y_EM2_TORQUE
_TRUTH[[_A_CLUTCH, _A_SHIFT]] = plant.Y_CLUTCH_CAPACITY, plant.Y_SHIFT_FORCE
_TRUTH[[_A_BRAKE, _A_CONTACTORS]] = plant.Y_BRAKE_TORQUE, plant.Y_CONTACTOR_PHASE
_CLOSED = 2.0  # phase of the contactors

# What the units know of their machines: per machine the share of torque left, and a condition.
SHARE, CONDITION, LIMITED = 0, 3, 6
CLUTCH_WANTED, BRAKE_WANTED = 9, 10  # what the units command, faults apart; NaN without a fault
N_HEALTH = 11

NARROWED, CUT = 1.0, 2.0  # how far a derated machine is limited: its bounds, or its torque
SOUND, TRIPPED, SHORTED = 0.0, 1.0, 2.0  #: conditions of a machine

_REASON = np.array(
    [ports.S_ENGINE_LIMIT_REASON, ports.S_EM1_LIMIT_REASON, ports.S_EM2_LIMIT_REASON]
)
_STATE = np.array([ports.S_ENGINE_STATE, ports.S_EM1_STATE, ports.S_EM2_STATE])
_FAULT_STATE = np.array([4.0, 6.0, 6.0])
_AVAILABLE = np.array([ports.S_ENGINE_TORQUE_MAX, ports.S_EM1_TORQUE_MAX, ports.S_EM2_TORQUE_MAX])
_LEAST = np.array([ports.S_ENGINE_TORQUE_MIN, ports.S_EM1_TORQUE_MIN, ports.S_EM2_TORQUE_MIN])


@inner_kernel
def _net_force(command: Array, position: float, valve1: float, valve2: float, most: float) -> None:
    """Turn stuck shift valves (opening, NaN: as commanded) into the gear and force that they give."""
    gear, force = command[plant.U_GEAR], command[plant.U_SHIFT_FORCE]
    signed = 0.0
    if gear == 1.0 or (gear == 0.0 and position < 0.0):
        signed = force
    elif gear == 2.0 or (gear == 0.0 and position > 0.0):
        signed = -force
    towards1 = max(signed, 0.0) if math.isnan(valve1) else valve1 * most
    towards2 = max(-signed, 0.0) if math.isnan(valve2) else valve2 * most
    net = towards1 - towards2
    command[plant.U_SHIFT_FORCE] = abs(net)
    if net * signed <= 0.0:
        # Not where the unit wants the sleeve, but where the pressure pushes it.
        command[plant.U_GEAR] = math.nan if net == 0.0 else (1.0 if net > 0.0 else 2.0)


@inner_kernel
def _move_slowly(
    faults: FaultTable, slot: int, command: Array, u: int, now: float, speed: float
) -> None:
    """Let a command, and in speed control (``speed`` not NaN) the set speed, follow with a lag."""
    whole, real = faults.whole, faults.real
    speed_control = not math.isnan(speed)
    keep = real[slot, table.VALUE]
    value = 0.0 if math.isnan(command[u]) else command[u]
    reference = command[u + 1] if speed_control else 0.0
    if whole[slot, table.LATCHED] == 0:
        whole[slot, table.LATCHED] = 1
        real[slot, table.MEMORY] = now
        real[slot, table.LATCH] = speed
    real[slot, table.MEMORY] = value + (real[slot, table.MEMORY] - value) * keep
    command[u] = real[slot, table.MEMORY]
    if speed_control:
        last = speed if math.isnan(real[slot, table.LATCH]) else real[slot, table.LATCH]
        real[slot, table.LATCH] = reference + (last - reference) * keep
        command[u + 1] = real[slot, table.LATCH]
    if u == plant.U_CONTACTOR:
        command[u] = 1.0 if command[u] >= 0.5 else 0.0


@inner_kernel
def _act(faults: FaultTable, slot: int, actuator: int, command: Array, truth: Array) -> None:
    """Let a stuck or slow actuator have its way, starting from what it gives now."""
    whole, real = faults.whole, faults.real
    u = _COMMAND[actuator]
    motor = actuator in (_A_EM1, _A_EM2)
    now = truth[_TRUTH[actuator]]
    if actuator == _A_CONTACTORS:
        now = 1.0 if now == _CLOSED else 0.0
    elif actuator == _A_SHIFT:
        now = abs(now)
    if whole[slot, table.KIND] == _SLOW:
        speed = math.nan
        if motor and command[u - 1] == plant.SPEED:
            speed = truth[plant.Y_EM1_SPEED if actuator == _A_EM1 else plant.Y_EM2_SPEED]
        _move_slowly(faults, slot, command, u, now, speed)
        return
    if whole[slot, table.LATCHED] == 0:
        whole[slot, table.LATCHED] = 1
        given = real[slot, table.VALUE]
        real[slot, table.LATCH] = now if math.isnan(given) else given
    command[u] = real[slot, table.LATCH]
    if actuator == _A_SHIFT and math.isnan(real[slot, table.VALUE]):
        command[plant.U_GEAR], command[u] = math.nan, 0.0
    if motor:
        command[u - 1] = plant.TORQUE


@inner_kernel
def _derate(command: Array, truth: Array, health: Array) -> None:
    """Hold the commands of derated machines within their share, and switch the broken ones."""
    if health[CONDITION + ENGINE] == TRIPPED:
        command[plant.U_ENGINE_RUN] = 0.0
    most = health[SHARE + ENGINE] * truth[plant.Y_ENGINE_TORQUE_MAX]
    if health[SHARE + ENGINE] < 1.0 and command[plant.U_ENGINE_TORQUE] > most:
        command[plant.U_ENGINE_TORQUE] = most
        health[LIMITED + ENGINE] = CUT
    for machine, mode, lower, upper in (
        (EM1, plant.U_EM1_MODE, plant.Y_EM1_TORQUE_MIN, plant.Y_EM1_TORQUE_MAX),
        (EM2, plant.U_EM2_MODE, plant.Y_EM2_TORQUE_MIN, plant.Y_EM2_TORQUE_MAX),
    ):
        share = health[SHARE + machine]
        if health[CONDITION + machine] == TRIPPED:
            command[mode] = plant.OFF
        elif health[CONDITION + machine] == SHORTED:
            command[mode] = plant.SHORT_CIRCUIT
        elif share < 1.0:
            low, high = share * truth[lower], share * truth[upper]
            torque = min(max(command[mode + 1], low), high)
            if command[mode] == plant.TORQUE and torque != command[mode + 1]:
                command[mode + 1] = torque
                health[LIMITED + machine] = CUT
            if not command[mode + 3] >= low:
                command[mode + 3] = low
                health[LIMITED + machine] = max(health[LIMITED + machine], NARROWED)
            if not command[mode + 4] <= high:
                command[mode + 4] = high
                health[LIMITED + machine] = max(health[LIMITED + machine], NARROWED)


@kernel
def fault_commands(
    faults: FaultTable,
    command: Array,
    truth: Array,
    clutch_max: float,
    force_max: float,
    health: Array,
) -> None:
    """Change the plant's commands as the active faults do.

    Args:
        faults: the table.
        command: shape (len(plant.COMMANDS),), as the units want it; changed in place.
        truth: the plant's truth of the last period.
        clutch_max: greatest capacity of C1, N m.
        force_max: greatest force on the sleeve, N.
        health: out, shape (N_HEALTH,), for :func:`fault_statuses`.
    """
    whole, real = faults.whole, faults.real
    for machine in range(3):
        health[SHARE + machine] = 1.0
        health[CONDITION + machine] = SOUND
        health[LIMITED + machine] = 0.0
    clutch, brake = command[plant.U_CLUTCH_CAPACITY], command[plant.U_BRAKE_TORQUE]
    valve1, valve2 = math.nan, math.nan
    for slot in range(whole.shape[0]):
        if whole[slot, table.STATE] != table.ACTIVE:
            continue
        kind, target, value = (
            whole[slot, table.KIND], whole[slot, table.TARGET], real[slot, table.VALUE],
        )  # fmt: skip
        if kind in (_STUCK, _SLOW):
            _act(faults, slot, target, command, truth)
        elif kind == _DERATED:
            health[SHARE + target] = min(health[SHARE + target], value)
        elif kind == _TRIPPED:
            health[CONDITION + target] = TRIPPED
            health[SHARE + target] = 0.0
        elif kind == _SHORTED:
            health[CONDITION + target] = SHORTED
            health[SHARE + target] = 0.0
        elif kind == _LEAK:
            command[plant.U_CLUTCH_CAPACITY] *= 1.0 - value
        elif kind == _VALVE and target == _V_CLUTCH:
            command[plant.U_CLUTCH_CAPACITY] = value * clutch_max
        elif kind == _VALVE and target == _V_G1:
            valve1 = value
        elif kind == _VALVE:
            valve2 = value
        elif kind == _SENSOR and whole[slot, table.NUMBER] == 1:
            # Without the rotor's position no pulses.
            if target == ports.S_EM1_SPEED:
                health[CONDITION + EM1], health[SHARE + EM1] = TRIPPED, 0.0
            elif target == ports.S_EM2_SPEED:
                health[CONDITION + EM2], health[SHARE + EM2] = TRIPPED, 0.0
            continue
        else:
            continue
        whole[slot, table.HITS] += 1
    if not (math.isnan(valve1) and math.isnan(valve2)):
        _net_force(command, truth[plant.Y_SLEEVE_POSITION], valve1, valve2, force_max)
    _derate(command, truth, health)
    health[CLUTCH_WANTED] = health[BRAKE_WANTED] = math.nan
    if clutch != command[plant.U_CLUTCH_CAPACITY]:
        health[CLUTCH_WANTED] = clutch
    if brake != command[plant.U_BRAKE_TORQUE]:
        health[BRAKE_WANTED] = brake


@kernel
def fault_statuses(faults: FaultTable, health: Array, statuses: Array) -> None:
    """Change what is reported as the active faults do; ``health`` is of :func:`fault_commands`.

    Call it after measuring: a failed sensor's value is what the unit takes for measured.
    """
    whole, real = faults.whole, faults.real
    active = 0
    for machine in range(3):
        told = statuses[_REASON[machine]]
        narrowed = health[LIMITED + machine] == NARROWED and told == ports.LIMIT_TORQUE_BOUND
        if (
            health[CONDITION + machine] != SOUND or health[LIMITED + machine] == CUT or narrowed
        ) and told != ports.LIMIT_REQUEST_LOST:
            statuses[_REASON[machine]] = ports.LIMIT_FAULT
        if health[CONDITION + machine] == TRIPPED:
            statuses[_STATE[machine]] = _FAULT_STATE[machine]
        share = health[SHARE + machine]
        if share < 1.0:
            statuses[_AVAILABLE[machine]] = max(statuses[_AVAILABLE[machine]], 0.0) * share
            if machine != ENGINE:
                statuses[_LEAST[machine]] *= share
    if not math.isnan(health[CLUTCH_WANTED]):
        statuses[ports.S_CLUTCH_CAPACITY_SETPOINT] = health[CLUTCH_WANTED]
    if not math.isnan(health[BRAKE_WANTED]):
        statuses[ports.S_BRAKE_TORQUE_SETPOINT] = health[BRAKE_WANTED]
    for slot in range(whole.shape[0]):
        if whole[slot, table.STATE] != table.ACTIVE:
            continue
        active += 1
        if whole[slot, table.KIND] != _SENSOR:
            continue
        port = whole[slot, table.TARGET]
        whole[slot, table.HITS] += 1
        if whole[slot, table.NUMBER] == 1:
            statuses[port] = math.nan
        else:
            if whole[slot, table.LATCHED] == 0:
                whole[slot, table.LATCHED] = 1
                real[slot, table.LATCH] = statuses[port]
            statuses[port] = real[slot, table.LATCH]
    statuses[ports.S_FAULTS_ACTIVE] = active
