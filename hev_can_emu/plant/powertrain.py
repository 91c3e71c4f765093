"""The whole plant for one control period: machines, battery, shift, brakes, road, driveline.

The plant reads a *command* vector (what the control units make of their requests), advances 1 ms and
writes a *truth* vector.  Both are SI; the constants below are their indices.  Machine torques are held
over the period; friction, lock and release happen inside it (:mod:`hev_can_emu.plant.driveline`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import inlined_kernel, kernel, small_kernel
from hev_can_emu.plant import (
    battery,
    brakes,
    contactors,
    driveline,
    engine,
    motor,
    power_allocation,
    road,
    speed_control,
    synchronizer,
    thermal,
    torque_source,
)
from hev_can_emu.plant.bank import Bank
from hev_can_emu.plant.motion import row_speed
from hev_can_emu.plant.structure import (
    BODY,
    C1,
    EM1,
    EM2,
    ENGINE,
    G1,
    G2,
    LEFT,
    N_PORTS,
    RIGHT,
    ROAD,
)

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# Commands.  The external ones are NaN unless an external control unit reports what its machine really
# does; valve currents and pump are for the detailed plant, which has hydraulics.
COMMANDS = (
    "engine_torque", "engine_run",
    "em1_mode", "em1_torque", "em1_speed", "em1_torque_min", "em1_torque_max",
    "em2_mode", "em2_torque", "em2_speed", "em2_torque_min", "em2_torque_max",
    "clutch_capacity", "gear", "shift_force", "brake_torque", "contactor", "grade", "ambient",
    "external_engine_torque", "external_em1_torque", "external_em2_torque",
    "external_clutch_capacity", "external_gear", "external_brake_torque",
    "external_battery_voltage", "external_discharge_power", "external_charge_power",
    "clutch_current", "shift_current1", "shift_current2", "pump",
)  # fmt: skip
(
    U_ENGINE_TORQUE, U_ENGINE_RUN,
    U_EM1_MODE, U_EM1_TORQUE, U_EM1_SPEED, U_EM1_TORQUE_MIN, U_EM1_TORQUE_MAX,
    U_EM2_MODE, U_EM2_TORQUE, U_EM2_SPEED, U_EM2_TORQUE_MIN, U_EM2_TORQUE_MAX,
    U_CLUTCH_CAPACITY, U_GEAR, U_SHIFT_FORCE, U_BRAKE_TORQUE, U_CONTACTOR, U_GRADE, U_AMBIENT,
    U_EXTERNAL_ENGINE_TORQUE, U_EXTERNAL_EM1_TORQUE, U_EXTERNAL_EM2_TORQUE,
    U_EXTERNAL_CLUTCH_CAPACITY, U_EXTERNAL_GEAR, U_EXTERNAL_BRAKE_TORQUE,
    U_EXTERNAL_BATTERY_VOLTAGE, U_EXTERNAL_DISCHARGE_POWER, U_EXTERNAL_CHARGE_POWER,
    U_CLUTCH_CURRENT, U_SHIFT_CURRENT1, U_SHIFT_CURRENT2, U_PUMP,
) = range(len(COMMANDS))  # fmt: skip

TRUTH = (
    "engine_speed", "engine_torque", "engine_setpoint", "engine_reason", "engine_torque_min",
    "engine_torque_max", "engine_phase", "coolant_temperature",
    "em1_speed", "em1_torque", "em1_setpoint", "em1_reason", "em1_torque_min", "em1_torque_max",
    "em1_power", "em1_winding_temperature", "em1_inverter_temperature",
    "em2_speed", "em2_torque", "em2_setpoint", "em2_reason", "em2_torque_min", "em2_torque_max",
    "em2_power", "em2_winding_temperature", "em2_inverter_temperature",
    "clutch_capacity", "clutch_setpoint", "clutch_reason", "clutch_torque", "clutch_slip", "clutch_held",
    "gear", "sync_phase", "sleeve_position", "shift_force", "sync_slip", "sync_torque",
    "wheel_left_speed", "wheel_right_speed", "body_speed", "vehicle_speed", "acceleration",
    "accelerometer", "brake_torque", "brake_setpoint", "brake_reason", "body_held",
    "state_of_charge", "battery_voltage", "battery_current", "battery_temperature",
    "battery_reason", "contactor_phase", "link_voltage", "discharge_limit", "charge_limit",
    "grade", "ambient", "energy_lost", "lock_row", "clutch_temperature", "wheel_rear_speed",
    # Of the detailed plant only; zero otherwise.
    "supply_pressure", "clutch_pressure", "shift_pressure1", "shift_pressure2", "fuel_flow",
    "em1_current_d", "em1_current_q", "em2_current_d", "em2_current_q", "crank_angle",
    "sleeve_zone", "dogs_held",
)  # fmt: skip
(
    Y_ENGINE_SPEED, Y_ENGINE_TORQUE, Y_ENGINE_SETPOINT, Y_ENGINE_REASON, Y_ENGINE_TORQUE_MIN,
    Y_ENGINE_TORQUE_MAX, Y_ENGINE_PHASE, Y_COOLANT_TEMPERATURE,
    Y_EM1_SPEED, Y_EM1_TORQUE, Y_EM1_SETPOINT, Y_EM1_REASON, Y_EM1_TORQUE_MIN, Y_EM1_TORQUE_MAX,
    Y_EM1_POWER, Y_EM1_WINDING_TEMPERATURE, Y_EM1_INVERTER_TEMPERATURE,
    Y_EM2_SPEED, Y_EM2_TORQUE, Y_EM2_SETPOINT, Y_EM2_REASON, Y_EM2_TORQUE_MIN, Y_EM2_TORQUE_MAX,
    Y_EM2_POWER, Y_EM2_WINDING_TEMPERATURE, Y_EM2_INVERTER_TEMPERATURE,
    Y_CLUTCH_CAPACITY, Y_CLUTCH_SETPOINT, Y_CLUTCH_REASON, Y_CLUTCH_TORQUE, Y_CLUTCH_SLIP,
    Y_CLUTCH_HELD,
    Y_GEAR, Y_SYNC_PHASE, Y_SLEEVE_POSITION, Y_SHIFT_FORCE, Y_SYNC_SLIP, Y_SYNC_TORQUE,
    Y_WHEEL_LEFT_SPEED, Y_WHEEL_RIGHT_SPEED, Y_BODY_SPEED, Y_VEHICLE_SPEED, Y_ACCELERATION,
    Y_ACCELEROMETER, Y_BRAKE_TORQUE, Y_BRAKE_SETPOINT, Y_BRAKE_REASON, Y_BODY_HELD,
    Y_STATE_OF_CHARGE, Y_BATTERY_VOLTAGE, Y_BATTERY_CURRENT, Y_BATTERY_TEMPERATURE,
    Y_BATTERY_REASON, Y_CONTACTOR_PHASE, Y_LINK_VOLTAGE, Y_DISCHARGE_LIMIT, Y_CHARGE_LIMIT,
    Y_GRADE, Y_AMBIENT, Y_ENERGY_LOST, Y_LOCK_ROW, Y_CLUTCH_TEMPERATURE, Y_WHEEL_REAR_SPEED,
    Y_SUPPLY_PRESSURE, Y_CLUTCH_PRESSURE, Y_SHIFT_PRESSURE1, Y_SHIFT_PRESSURE2, Y_FUEL_FLOW,
    Y_EM1_CURRENT_D, Y_EM1_CURRENT_Q, Y_EM2_CURRENT_D, Y_EM2_CURRENT_Q, Y_CRANK_ANGLE,
    Y_SLEEVE_ZONE, Y_DOGS_HELD,
) = range(len(TRUTH))  # fmt: skip

# Control modes of a motor.
OFF, TORQUE, SPEED, FREEWHEEL, SHORT_CIRCUIT = 0, 1, 2, 3, 4

# State: the machines' slices one after another, then the driveline's speeds and twists.
X_ENGINE = 0
X_EM1 = X_ENGINE + engine.N_STATE
X_EM2 = X_EM1 + motor.N_STATE
X_CONTROL1 = X_EM2 + motor.N_STATE
X_CONTROL2 = X_CONTROL1 + speed_control.N_STATE
X_BATTERY = X_CONTROL2 + speed_control.N_STATE
X_CONTACTORS = X_BATTERY + battery.N_STATE
X_THERMAL1 = X_CONTACTORS + contactors.N_STATE
X_THERMAL2 = X_THERMAL1 + thermal.N_STATE
X_COOLANT = X_THERMAL2 + thermal.N_STATE
X_BRAKES = X_COOLANT + 1
X_SYNC = X_BRAKES + brakes.N_STATE
X_CLUTCH = X_SYNC + synchronizer.N_STATE
X_LOST = X_CLUTCH + torque_source.N_STATE
X_DRIVELINE = X_LOST + 1

# Packed parameters of the clutch actuator and of what belongs to the car as a whole.
CLUTCH_MAX, CLUTCH_STATIC_RATIO = torque_source.N_PARAMETERS, torque_source.N_PARAMETERS + 1
CAR_TYRE_RADIUS = 0
CAR_SHORT_TORQUE1, CAR_SHORT_SPEED1, CAR_SHORT_TORQUE2, CAR_SHORT_SPEED2 = 1, 2, 3, 4

PERIOD = 1e-3  #: control period, s
PERIOD_NS = 1_000_000
W_TRIAL = 128
WORK = W_TRIAL + driveline.TRIAL  #: values of scratch that a step needs


class Plant(NamedTuple):
    """The plant's constants: the driveline's bank and each machine's packed parameters."""

    bank: Bank
    engine: Array
    em1: Array
    em2: Array
    control1: Array
    control2: Array
    battery: Array
    contactors: Array
    thermal1: Array
    thermal2: Array
    brakes: Array
    road: Array
    synchronizer: Array
    clutch: Array
    coolant: Array
    car: Array


@kernel
def state_size(bank: Bank) -> int:
    """Return the length of the plant's float64 state."""
    return int(X_DRIVELINE + bank.inertia.shape[0] + bank.stiffness.shape[1])


@inlined_kernel
def _motor_demand(
    mode: float,
    torque: float,
    reference: float,
    lower: float,
    upper: float,
    speed: float,
    acting: float,
    limits: Array,
    control: Array,
    x_control: Array,
    work: Array,
) -> float:
    """Return the torque that a motor's control unit asks of its current controller, N m."""
    low = limits[motor.LIM_TORQUE_MIN]
    high = limits[motor.LIM_TORQUE_MAX]
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
def short_circuit_torque(peak: float, at_speed: float, speed: float) -> float:
    """Return the braking torque of an actively short-circuited motor, N m.

    Steady state of a PMSM with equal inductances: ``2*T_peak*s/(1 + s^2)``, s = speed over the speed
    at which the reactance equals the resistance.
    """
    ratio = speed / at_speed
    return -2.0 * peak * ratio / (1.0 + ratio * ratio)


@inlined_kernel
def plant_step(
    plant: Plant,
    x: Array,
    n: Integers,
    u: Array,
    y: Array,
    work: Array,
    t_ns: int,
    events: npt.NDArray[np.void],
    n_events: int,
) -> int:
    """Advance one control period of 1 ms.

    Args:
        plant: constants.
        x: float64 state, shape (state_size,), changed in place.
        n: int64 state of the driveline, shape (driveline.N_INTEGERS,), changed in place.
        u: commands, shape (len(COMMANDS),).
        y: truth, shape (len(TRUTH),); on entry that of the last period, on return of this one.
        work: scratch, WORK values.
        t_ns: time at entry, ns.
        events: EVENT records of which ``n_events`` are taken.
        n_events: number taken on entry.

    Returns:
        Number of event records taken on return.
    """
    bank = plant.bank
    at, by = bank.speed_at, bank.speed_by
    drive = x[X_DRIVELINE:]
    ambient = u[U_AMBIENT] if not math.isnan(u[U_AMBIENT]) else 293.15
    grade = u[U_GRADE] if not math.isnan(u[U_GRADE]) else 0.0
    engine_speed = y[Y_ENGINE_SPEED]
    speed1, speed2 = y[Y_EM1_SPEED], y[Y_EM2_SPEED]

    # High voltage: contactors, then what the battery allows.
    x_battery = x[X_BATTERY : X_BATTERY + battery.N_STATE]
    battery_limits = work[0 : battery.N_LIM]
    battery.battery_limits(plant.battery, x_battery, battery_limits)
    x_contactors = x[X_CONTACTORS : X_CONTACTORS + contactors.N_STATE]
    was_closed = x_contactors[contactors.X_PHASE] == contactors.CLOSED
    source_voltage = y[Y_BATTERY_VOLTAGE] if was_closed else battery_limits[battery.LIM_OCV]
    contactors.contactor_step(plant.contactors, x_contactors, u[U_CONTACTOR], source_voltage, 0.0)
    phase = x_contactors[contactors.X_PHASE]
    connected = 1.0 if phase in (contactors.CLOSED, contactors.OPENING) else 0.0
    if not math.isnan(u[U_EXTERNAL_DISCHARGE_POWER]):
        battery_limits[battery.LIM_DISCHARGE] = u[U_EXTERNAL_DISCHARGE_POWER]
    if not math.isnan(u[U_EXTERNAL_CHARGE_POWER]):
        battery_limits[battery.LIM_CHARGE] = u[U_EXTERNAL_CHARGE_POWER]
    link = x_contactors[contactors.X_LINK_VOLTAGE]
    if not math.isnan(u[U_EXTERNAL_BATTERY_VOLTAGE]):
        link = u[U_EXTERNAL_BATTERY_VOLTAGE]
    discharge_limit = battery_limits[battery.LIM_DISCHARGE] * connected
    charge_limit = battery_limits[battery.LIM_CHARGE] * connected
    auxiliary = plant.battery[battery.P_AUXILIARY] * connected

    # EM1 and EM2: speed control, own limits, delay and lag; then what the battery grants both.
    winding1 = x[X_THERMAL1 + thermal.X_WINDING]
    inverter1 = x[X_THERMAL1 + thermal.X_INVERTER]
    winding2 = x[X_THERMAL2 + thermal.X_WINDING]
    inverter2 = x[X_THERMAL2 + thermal.X_INVERTER]
    out1 = work[16 : 16 + motor.N_OUT]
    out2 = work[32 : 32 + motor.N_OUT]
    limits1, limits2 = out1[torque_source.N_OUT :], out2[torque_source.N_OUT :]
    scratch = work[48:64]
    mode1, mode2 = u[U_EM1_MODE], u[U_EM2_MODE]
    # While the contactors open, the motors ramp down to zero: no load is torn off.
    closed = phase == contactors.CLOSED
    active1 = 1.0 if closed and mode1 in (TORQUE, SPEED) else 0.0
    active2 = 1.0 if closed and mode2 in (TORQUE, SPEED) else 0.0
    x_em1 = x[X_EM1 : X_EM1 + motor.N_STATE]
    x_em2 = x[X_EM2 : X_EM2 + motor.N_STATE]
    motor.motor_limits(plant.em1, speed1, link, winding1, inverter1, limits1)
    demand1 = _motor_demand(
        mode1 if active1 > 0.5 else float(OFF), u[U_EM1_TORQUE], u[U_EM1_SPEED],
        u[U_EM1_TORQUE_MIN], u[U_EM1_TORQUE_MAX], speed1, y[Y_EM1_TORQUE], limits1,
        plant.control1, x[X_CONTROL1 : X_CONTROL1 + speed_control.N_STATE], scratch,
    )  # fmt: skip
    motor.motor_limits(plant.em2, speed2, link, winding2, inverter2, limits2)
    demand2 = _motor_demand(
        mode2 if active2 > 0.5 else float(OFF), u[U_EM2_TORQUE], u[U_EM2_SPEED],
        u[U_EM2_TORQUE_MIN], u[U_EM2_TORQUE_MAX], speed2, y[Y_EM2_TORQUE], limits2,
        plant.control2, x[X_CONTROL2 : X_CONTROL2 + speed_control.N_STATE], scratch,
    )  # fmt: skip
    motor.motor_step_within(plant.em1, x_em1, demand1, active1, speed1, out1)
    motor.motor_step_within(plant.em2, x_em2, demand2, active2, speed2, out2)
    power_allocation.allocate(
        plant.em1, plant.em2, out1[torque_source.OUT_TORQUE], out2[torque_source.OUT_TORQUE],
        speed1, speed2, active1, active2, auxiliary, discharge_limit, charge_limit, scratch,
    )  # fmt: skip
    torque1 = scratch[power_allocation.OUT_TORQUE1]
    torque2 = scratch[power_allocation.OUT_TORQUE2]
    cut1 = scratch[power_allocation.OUT_CUT1]
    cut2 = scratch[power_allocation.OUT_CUT2]
    cut_reason = battery_limits[battery.LIM_REASON_DISCHARGE]
    if scratch[power_allocation.OUT_POWER] < 0.0:
        cut_reason = battery_limits[battery.LIM_REASON_CHARGE]
    if cut1 > 0.5:
        motor.motor_grant(plant.em1, x_em1, torque1, speed1, active1, cut_reason, out1)
    if cut2 > 0.5:
        motor.motor_grant(plant.em2, x_em2, torque2, speed2, active2, cut_reason, out2)
    if mode1 == SHORT_CIRCUIT:
        torque1 = short_circuit_torque(
            plant.car[CAR_SHORT_TORQUE1], plant.car[CAR_SHORT_SPEED1], speed1
        )
    if mode2 == SHORT_CIRCUIT:
        torque2 = short_circuit_torque(
            plant.car[CAR_SHORT_TORQUE2], plant.car[CAR_SHORT_SPEED2], speed2
        )
    shorted1 = mode1 == SHORT_CIRCUIT
    shorted2 = mode2 == SHORT_CIRCUIT
    if not math.isnan(u[U_EXTERNAL_EM1_TORQUE]):
        torque1 = u[U_EXTERNAL_EM1_TORQUE]
        active1 = 1.0
        shorted1 = False
    if not math.isnan(u[U_EXTERNAL_EM2_TORQUE]):
        torque2 = u[U_EXTERNAL_EM2_TORQUE]
        active2 = 1.0
        shorted2 = False
    motor.motor_power(plant.em1, torque1, speed1, active1, out1)
    motor.motor_power(plant.em2, torque2, speed2, active2, out2)
    if shorted1:  # braking power becomes heat in the machine, none reaches the DC link
        out1[motor.OUT_WINDING_LOSS] = -torque1 * speed1
        out1[motor.OUT_DC_POWER] = 0.0
    if shorted2:
        out2[motor.OUT_WINDING_LOSS] = -torque2 * speed2
        out2[motor.OUT_DC_POWER] = 0.0

    # Engine, clutch capacity, brakes, road.
    engine_out = work[64 : 64 + engine.N_OUT]
    engine.engine_step(
        plant.engine, x[X_ENGINE : X_ENGINE + engine.N_STATE], u[U_ENGINE_TORQUE],
        u[U_ENGINE_RUN], 1.0, engine_speed, engine_out,
    )  # fmt: skip
    engine_torque = engine_out[torque_source.OUT_TORQUE]
    if not math.isnan(u[U_EXTERNAL_ENGINE_TORQUE]):
        engine_torque = u[U_EXTERNAL_ENGINE_TORQUE]
    clutch_out = work[76:80]
    torque_source.torque_source_step(
        plant.clutch, x[X_CLUTCH : X_CLUTCH + torque_source.N_STATE], u[U_CLUTCH_CAPACITY], 1.0,
        0.0, plant.clutch[CLUTCH_MAX], float(torque_source.LIMIT_PEAK),
        float(torque_source.LIMIT_PEAK), clutch_out,
    )  # fmt: skip
    capacity = clutch_out[torque_source.OUT_TORQUE]
    if capacity < 0.05 and not u[U_CLUTCH_CAPACITY] > 0.0:
        capacity = 0.0  # the plates are apart
        torque_source.torque_source_hold(x[X_CLUTCH : X_CLUTCH + torque_source.N_STATE], 0.0)
    if not math.isnan(u[U_EXTERNAL_CLUTCH_CAPACITY]):
        capacity = max(u[U_EXTERNAL_CLUTCH_CAPACITY], 0.0)
    brake_out = work[80 : 80 + brakes.N_OUT]
    brakes.brake_step(
        plant.brakes, x[X_BRAKES : X_BRAKES + brakes.N_STATE], u[U_BRAKE_TORQUE], 1.0, brake_out
    )
    if not math.isnan(u[U_EXTERNAL_BRAKE_TORQUE]):
        total = max(u[U_EXTERNAL_BRAKE_TORQUE], 0.0)
        share = plant.brakes[brakes.P_FRONT_SHARE]
        brake_out[torque_source.OUT_TORQUE] = total
        brake_out[brakes.OUT_FL] = brake_out[brakes.OUT_FR] = 0.5 * share * total
        brake_out[brakes.OUT_RL] = brake_out[brakes.OUT_RR] = 0.5 * (1.0 - share) * total
    road_out = work[88 : 88 + road.N_OUT]
    road.road_load(plant.road, y[Y_VEHICLE_SPEED], grade, 0.0, road_out)

    # Shift: the driveline says whether the cone sticks, the sleeve says what the cone can carry.
    gear_request, force_request = u[U_GEAR], u[U_SHIFT_FORCE]
    if not math.isnan(u[U_EXTERNAL_GEAR]):
        gear_request = u[U_EXTERNAL_GEAR]
        force_request = plant.synchronizer[synchronizer.P_MAX_FORCE]
    sync_out = work[48 : 48 + synchronizer.N_OUT]
    synchronizer.synchronizer_step(
        plant.synchronizer, x[X_SYNC : X_SYNC + synchronizer.N_STATE], gear_request, force_request,
        row_speed(at, by, drive, N_PORTS + G1), row_speed(at, by, drive, N_PORTS + G2),
        float(n[driveline.HELD + G1]), float(n[driveline.HELD + G2]), y[Y_SYNC_TORQUE], sync_out,
    )  # fmt: skip

    locks = bank.speed_at.shape[0] - N_PORTS
    kinetic = work[96 : 96 + locks]
    static = work[104 : 104 + locks]
    kinetic[C1] = capacity
    static[C1] = capacity * plant.clutch[CLUTCH_STATIC_RATIO]
    _gear_lock(
        G1, sync_out[synchronizer.OUT_CONE1], sync_out[synchronizer.OUT_DOG1], kinetic, static
    )
    _gear_lock(
        G2, sync_out[synchronizer.OUT_CONE2], sync_out[synchronizer.OUT_DOG2], kinetic, static
    )
    kinetic[LEFT] = static[LEFT] = brake_out[brakes.OUT_FL]
    kinetic[RIGHT] = static[RIGHT] = brake_out[brakes.OUT_FR]
    rolling = road_out[road.OUT_ROLLING_CAPACITY]
    kinetic[BODY] = static[BODY] = rolling + brake_out[brakes.OUT_RL] + brake_out[brakes.OUT_RR]

    forces = work[112 : 112 + N_PORTS + locks]
    forces[ENGINE], forces[EM1], forces[EM2] = engine_torque, torque1, torque2
    forces[ROAD] = road_out[road.OUT_BODY_TORQUE]
    n_events = driveline.step(
        bank, drive, n, forces, kinetic, static, x[X_LOST : X_LOST + 1], work[W_TRIAL:], t_ns,
        PERIOD_NS, events, n_events,
    )  # fmt: skip

    # Battery and temperatures, with the power that the machines took.
    load = out1[motor.OUT_DC_POWER] + out2[motor.OUT_DC_POWER] + auxiliary
    battery.battery_step(
        plant.battery, x_battery, load * connected, connected, ambient, battery_limits, scratch
    )
    battery_voltage = scratch[battery.OUT_VOLTAGE]
    y[Y_BATTERY_CURRENT] = scratch[battery.OUT_CURRENT]
    y[Y_BATTERY_REASON] = scratch[battery.OUT_REASON]
    if not math.isnan(u[U_EXTERNAL_BATTERY_VOLTAGE]):
        battery_voltage = u[U_EXTERNAL_BATTERY_VOLTAGE]
    if connected > 0.5:
        x_contactors[contactors.X_LINK_VOLTAGE] = battery_voltage
    thermal.thermal_step(
        plant.thermal1, x[X_THERMAL1 : X_THERMAL1 + thermal.N_STATE],
        out1[motor.OUT_WINDING_LOSS], out1[motor.OUT_INVERTER_LOSS], ambient,
    )  # fmt: skip
    thermal.thermal_step(
        plant.thermal2, x[X_THERMAL2 : X_THERMAL2 + thermal.N_STATE],
        out2[motor.OUT_WINDING_LOSS], out2[motor.OUT_INVERTER_LOSS], ambient,
    )  # fmt: skip
    x[X_COOLANT] = thermal.node_step(
        plant.coolant, 0, x[X_COOLANT], engine_out[engine.OUT_HEAT], ambient
    )

    # Truth.
    y[Y_ENGINE_TORQUE] = engine_torque
    y[Y_ENGINE_SETPOINT] = engine_out[torque_source.OUT_SETPOINT]
    y[Y_ENGINE_REASON] = engine_out[torque_source.OUT_REASON]
    y[Y_ENGINE_TORQUE_MIN] = engine_out[engine.OUT_TORQUE_MIN]
    y[Y_ENGINE_TORQUE_MAX] = engine_out[engine.OUT_TORQUE_MAX]
    y[Y_ENGINE_PHASE] = engine_out[engine.OUT_PHASE]
    y[Y_EM1_TORQUE], y[Y_EM2_TORQUE] = torque1, torque2
    y[Y_EM1_SETPOINT] = out1[torque_source.OUT_SETPOINT]
    y[Y_EM2_SETPOINT] = out2[torque_source.OUT_SETPOINT]
    y[Y_EM1_REASON], y[Y_EM2_REASON] = (
        out1[torque_source.OUT_REASON],
        out2[torque_source.OUT_REASON],
    )
    y[Y_EM1_POWER], y[Y_EM2_POWER] = out1[motor.OUT_DC_POWER], out2[motor.OUT_DC_POWER]
    # Published: the own envelope, narrowed to what the battery allows beside the other loads.
    other1, other2 = load - out1[motor.OUT_DC_POWER], load - out2[motor.OUT_DC_POWER]
    scratch[0], scratch[1] = out1[motor.OUT_TORQUE_MIN], out1[motor.OUT_TORQUE_MAX]
    power_allocation.power_torque_range(
        plant.em1, speed1, other1, discharge_limit, charge_limit, scratch
    )
    y[Y_EM1_TORQUE_MIN], y[Y_EM1_TORQUE_MAX] = scratch[0], scratch[1]
    scratch[0], scratch[1] = out2[motor.OUT_TORQUE_MIN], out2[motor.OUT_TORQUE_MAX]
    power_allocation.power_torque_range(
        plant.em2, speed2, other2, discharge_limit, charge_limit, scratch
    )
    y[Y_EM2_TORQUE_MIN], y[Y_EM2_TORQUE_MAX] = scratch[0], scratch[1]
    y[Y_CLUTCH_CAPACITY] = capacity
    y[Y_CLUTCH_SETPOINT] = clutch_out[torque_source.OUT_SETPOINT]
    y[Y_CLUTCH_REASON] = clutch_out[torque_source.OUT_REASON]
    y[Y_BRAKE_TORQUE] = brake_out[torque_source.OUT_TORQUE]
    y[Y_BRAKE_SETPOINT] = brake_out[torque_source.OUT_SETPOINT]
    y[Y_BRAKE_REASON] = brake_out[torque_source.OUT_REASON]
    y[Y_DISCHARGE_LIMIT], y[Y_CHARGE_LIMIT] = discharge_limit, charge_limit
    y[Y_BATTERY_VOLTAGE] = battery_voltage
    y[Y_CONTACTOR_PHASE] = phase
    y[Y_LINK_VOLTAGE] = x_contactors[contactors.X_LINK_VOLTAGE]
    y[Y_GRADE], y[Y_AMBIENT] = grade, ambient
    observe(plant, x, n, forces, y, work[W_TRIAL:])
    return n_events


@kernel
def _gear_lock(lock: int, cone: float, dog: float, kinetic: Array, static: Array) -> None:
    """Enter what sleeve and gear can carry: the cone's torque, or without bound once the dogs are in."""
    kinetic[lock] = cone
    static[lock] = cone
    if dog > 0.5:
        # The last slip (below what the dogs tolerate) is taken by a capacity that stops it at once.
        kinetic[lock] = 1e4
        static[lock] = np.inf


@small_kernel
def observe(plant: Plant, x: Array, n: Integers, forces: Array, y: Array, seen: Array) -> None:
    """Write into ``y`` what follows from the state: speeds, slips, held torques, temperatures.

    ``seen`` is scratch, shape (driveline.N_SEEN,).
    """
    driveline.look(plant.bank, x[X_DRIVELINE:], n, forces, seen)
    speeds, carried = seen[driveline.SPEEDS :], seen[driveline.CARRIED :]
    body = forces.shape[0] - N_PORTS
    radius = plant.car[CAR_TYRE_RADIUS]
    y[Y_ENGINE_SPEED] = speeds[ENGINE]
    y[Y_EM1_SPEED] = speeds[EM1]
    y[Y_EM2_SPEED] = speeds[EM2]
    y[Y_WHEEL_LEFT_SPEED] = speeds[N_PORTS + LEFT]
    y[Y_WHEEL_RIGHT_SPEED] = speeds[N_PORTS + RIGHT]
    y[Y_BODY_SPEED] = speeds[ROAD]
    y[Y_VEHICLE_SPEED] = y[Y_BODY_SPEED] * radius
    y[Y_ACCELERATION] = radius * carried[body]
    y[Y_ACCELEROMETER] = road.accelerometer(y[Y_ACCELERATION], y[Y_GRADE])
    y[Y_CLUTCH_TORQUE] = -carried[C1]
    y[Y_CLUTCH_SLIP] = speeds[N_PORTS + C1]
    y[Y_CLUTCH_HELD] = n[driveline.HELD + C1]
    target = x[X_SYNC + synchronizer.X_TARGET]
    sync = G2 if target == 2.0 else G1
    y[Y_SYNC_TORQUE] = -carried[sync]
    y[Y_SYNC_SLIP] = speeds[N_PORTS + sync] if target != 0.0 else 0.0
    y[Y_SYNC_PHASE] = x[X_SYNC + synchronizer.X_PHASE]
    y[Y_SLEEVE_POSITION] = x[X_SYNC + synchronizer.X_POSITION]
    y[Y_SHIFT_FORCE] = x[X_SYNC + synchronizer.X_FORCE]
    y[Y_GEAR] = float(synchronizer.BETWEEN)
    if y[Y_SYNC_PHASE] == synchronizer.ENGAGED:
        y[Y_GEAR] = target
    elif y[Y_SLEEVE_POSITION] == 0.0:
        y[Y_GEAR] = 0.0
    y[Y_BODY_HELD] = n[driveline.HELD + BODY]
    y[Y_STATE_OF_CHARGE] = x[X_BATTERY + battery.X_SOC]
    y[Y_BATTERY_TEMPERATURE] = x[X_BATTERY + battery.X_TEMPERATURE]
    y[Y_EM1_WINDING_TEMPERATURE] = x[X_THERMAL1 + thermal.X_WINDING]
    y[Y_EM1_INVERTER_TEMPERATURE] = x[X_THERMAL1 + thermal.X_INVERTER]
    y[Y_EM2_WINDING_TEMPERATURE] = x[X_THERMAL2 + thermal.X_WINDING]
    y[Y_EM2_INVERTER_TEMPERATURE] = x[X_THERMAL2 + thermal.X_INVERTER]
    y[Y_COOLANT_TEMPERATURE] = x[X_COOLANT]
    # No plates, no rear wheels at this fidelity: as warm as the coolant, as fast as the body.
    y[Y_CLUTCH_TEMPERATURE] = x[X_COOLANT]
    y[Y_WHEEL_REAR_SPEED] = y[Y_BODY_SPEED]
    y[Y_ENERGY_LOST] = x[X_LOST]
    y[Y_LOCK_ROW] = n[driveline.ROW]
