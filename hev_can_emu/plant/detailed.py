"""The detailed plant for one control period: the control units' tick, then inner steps on a fixed grid.

It reads the same commands and writes the same truth as :mod:`.powertrain`, and finer ones besides.  What
control units and actuators do at 1 ms (limits, speed control, contactors, brake actuator, temperatures)
happens once per tick; all else at each inner step (:mod:`.detailed_inner`).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel, small_kernel
from hev_can_emu.plant import (
    battery,
    brakes,
    combustion,
    contactors,
    crank,
    dc_link,
    driveline,
    engine,
    high_voltage,
    hydraulics,
    ledger,
    pmsm,
    road,
    shifting,
    sleeve,
    speed_control,
    teeth,
    thermal,
    tyre,
    wet_clutch,
)
from hev_can_emu.plant import detailed_inner as inner
from hev_can_emu.plant import detailed_layout as lay
from hev_can_emu.plant import electric_drive as drive
from hev_can_emu.plant import powertrain as port
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.detailed_layout import DetailedPlant
from hev_can_emu.plant.holding import HELD, ROW
from hev_can_emu.plant.motion import all_rows, row_speed
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
    REAR,
    RIGHT,
    ROAD,
)

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Events = npt.NDArray[np.void]

FLYWHEEL = 0  # the branch behind the crank


@small_kernel
def _before_the_steps(plant: DetailedPlant, x: Array, u: Array, y: Array, work: Array) -> None:
    """What control units and actuators decide for this tick, into the held values."""
    hold = work[lay.W_HOLD :]
    mean = work[lay.W_MEAN : lay.W_MEAN + 8]
    limits = work[lay.W_LIMITS : lay.W_LIMITS + battery.N_LIM]
    power = work[lay.W_POWER :]
    link = x[lay.X_LINK]
    speed1, speed2 = y[port.Y_EM1_SPEED], y[port.Y_EM2_SPEED]

    phase = high_voltage.switch_contactors(
        plant.contactors, x[lay.X_CONTACTORS : lay.X_LINK], x[lay.X_BATTERY : lay.X_CONTACTORS],
        plant.battery, u[port.U_CONTACTOR], link, limits,
    )  # fmt: skip
    connected = 1.0 if phase in (contactors.CLOSED, contactors.OPENING) else 0.0
    hold[lay.H_PHASE] = phase
    hold[lay.H_VOLTAGE] = limits[battery.LIM_OCV]
    hold[lay.H_RESISTANCE] = limits[battery.LIM_RESISTANCE]
    if not math.isnan(u[port.U_EXTERNAL_BATTERY_VOLTAGE]):
        hold[lay.H_VOLTAGE] = u[port.U_EXTERNAL_BATTERY_VOLTAGE]
        hold[lay.H_RESISTANCE] = 0.0
        link = x[lay.X_LINK] = hold[lay.H_VOLTAGE]
    if not math.isnan(u[port.U_EXTERNAL_DISCHARGE_POWER]):
        limits[battery.LIM_DISCHARGE] = u[port.U_EXTERNAL_DISCHARGE_POWER]
    if not math.isnan(u[port.U_EXTERNAL_CHARGE_POWER]):
        limits[battery.LIM_CHARGE] = u[port.U_EXTERNAL_CHARGE_POWER]
    discharge = limits[battery.LIM_DISCHARGE] * connected
    charge = limits[battery.LIM_CHARGE] * connected
    mean[lay.M_DISCHARGE], mean[lay.M_CHARGE] = discharge, charge
    hold[lay.H_AUXILIARY] = plant.battery[battery.P_AUXILIARY] * connected

    x1, x2 = x[lay.X_EM1 : lay.X_EM2], x[lay.X_EM2 : lay.X_CONTROL1]
    mode1, mode2 = u[port.U_EM1_MODE], u[port.U_EM2_MODE]
    hold[lay.H_GATES1] = high_voltage.gates_of(mode1, phase)
    hold[lay.H_GATES2] = high_voltage.gates_of(mode2, phase)
    hold[lay.H_EXTERNAL1] = u[port.U_EXTERNAL_EM1_TORQUE]
    hold[lay.H_EXTERNAL2] = u[port.U_EXTERNAL_EM2_TORQUE]
    active1 = hold[lay.H_GATES1] == drive.ACTIVE and math.isnan(hold[lay.H_EXTERNAL1])
    active2 = hold[lay.H_GATES2] == drive.ACTIVE and math.isnan(hold[lay.H_EXTERNAL2])
    closed = phase == contactors.CLOSED
    demand1 = high_voltage.demand(
        mode1 if active1 and closed else float(high_voltage.OFF), u[port.U_EM1_TORQUE],
        u[port.U_EM1_SPEED], u[port.U_EM1_TORQUE_MIN], u[port.U_EM1_TORQUE_MAX], speed1,
        y[port.Y_EM1_TORQUE], x1, plant.control1,
        x[lay.X_CONTROL1 : lay.X_CONTROL1 + speed_control.N_STATE], power,
    )  # fmt: skip
    demand2 = high_voltage.demand(
        mode2 if active2 and closed else float(high_voltage.OFF), u[port.U_EM2_TORQUE],
        u[port.U_EM2_SPEED], u[port.U_EM2_TORQUE_MIN], u[port.U_EM2_TORQUE_MAX], speed2,
        y[port.Y_EM2_TORQUE], x2, plant.control2,
        x[lay.X_CONTROL2 : lay.X_CONTROL2 + speed_control.N_STATE], power,
    )  # fmt: skip
    high_voltage.share_power(
        plant.em1, plant.em2, demand1, demand2, speed1, speed2, active1, active2, link,
        x[lay.X_THERMAL1], x[lay.X_THERMAL2], hold[lay.H_AUXILIARY], discharge, charge, power,
    )  # fmt: skip
    hold[lay.H_REQUEST1], hold[lay.H_REQUEST2] = power[0], power[1]
    mean[lay.M_CUT1], mean[lay.M_CUT2] = power[2], power[3]

    hold[lay.H_ENGINE], hold[lay.H_RUN] = u[port.U_ENGINE_TORQUE], u[port.U_ENGINE_RUN]
    hold[lay.H_CAPACITY] = u[port.U_EXTERNAL_CLUTCH_CAPACITY]
    brake_out = work[lay.W_BRAKES : lay.W_BRAKES + brakes.N_OUT]
    brakes.brake_step(
        plant.brakes, x[lay.X_BRAKES : lay.X_BRAKES + brakes.N_STATE], u[port.U_BRAKE_TORQUE], 1.0,
        brake_out,
    )  # fmt: skip
    if not math.isnan(u[port.U_EXTERNAL_BRAKE_TORQUE]):
        total = max(u[port.U_EXTERNAL_BRAKE_TORQUE], 0.0)
        share = plant.brakes[brakes.P_FRONT_SHARE]
        brake_out[source.OUT_TORQUE] = total
        brake_out[brakes.OUT_FL] = 0.5 * share * total
        brake_out[brakes.OUT_RL] = 0.5 * (1.0 - share) * total
    hold[lay.H_FRONT], hold[lay.H_REAR] = brake_out[brakes.OUT_FL], brake_out[brakes.OUT_RL]
    hold[lay.H_GRADE] = u[port.U_GRADE] if not math.isnan(u[port.U_GRADE]) else 0.0


@small_kernel
def _steps(
    plant: DetailedPlant,
    x: Array,
    n: Integers,
    u: Array,
    y: Array,
    work: Array,
    t_ns: int,
    events: Events,
    n_events: int,
) -> int:
    """The inner steps of one tick."""
    bank = plant.bank
    speed_columns = bank.speeds
    speeds = work[lay.W_SPEEDS : lay.W_TRIAL]
    extras, held = plant.extras, bank.held_torque
    step = 1e-9 * plant.step_ns
    drive_x = x[lay.X_DRIVELINE :]
    books = x[lay.X_BOOKS : lay.X_TYRES]
    x_engine = x[lay.X_ENGINE : lay.X_EM1]
    x1, x2 = x[lay.X_EM1 : lay.X_EM2], x[lay.X_EM2 : lay.X_CONTROL1]
    thermal1, thermal2 = x[lay.X_THERMAL1 : lay.X_THERMAL2], x[lay.X_THERMAL2 : lay.X_COOLANT]
    x_link = x[lay.X_LINK : lay.X_THERMAL1]
    x_oil, x_clutch = x[lay.X_OIL : lay.X_CLUTCH], x[lay.X_CLUTCH : lay.X_SYNC]
    p_engine, em1, em2, p_link = plant.engine, plant.em1, plant.em2, plant.link
    p_oil, p_clutch, p_road = plant.hydraulics, plant.clutch, plant.road
    p_sleeve, x_sync = plant.sleeve, x[lay.X_SYNC : lay.X_BOUNDS]
    sleeve_out = work[lay.W_SYNC : lay.W_BRAKES]
    play = plant.car[lay.CAR_PLAY] > 0.5
    hold = work[lay.W_HOLD :]
    tick = work[lay.W_TICK : lay.W_ENGINE]
    engine_out = work[lay.W_ENGINE : lay.W_ENERGY]
    energy = work[lay.W_ENERGY : lay.W_EM1]
    out1, out2 = work[lay.W_EM1 : lay.W_EM2], work[lay.W_EM2 : lay.W_LINK]
    link_out = work[lay.W_LINK : lay.W_CLUTCH]
    clutch_out, heat_out = work[lay.W_CLUTCH : lay.W_HEAT], work[lay.W_HEAT : lay.W_OIL]
    oil_out, road_out = work[lay.W_OIL : lay.W_SYNC], work[lay.W_ROAD : lay.W_LIMITS]
    locks = bank.speed_at.shape[0] - N_PORTS
    forces = work[lay.W_FORCES : lay.W_FORCES + N_PORTS + locks]
    kinetic = work[lay.W_KINETIC : lay.W_KINETIC + locks]
    static = work[lay.W_STATIC : lay.W_STATIC + locks]
    mean = work[lay.W_MEAN : lay.W_MEAN + 8]
    trial = work[lay.W_TRIAL : lay.W_TRIAL + driveline.TRIAL]
    radius = plant.car[lay.CAR_RADIUS]
    external = u[port.U_EXTERNAL_ENGINE_TORQUE]
    current0, current1, current2 = (
        u[port.U_CLUTCH_CURRENT], u[port.U_SHIFT_CURRENT1], u[port.U_SHIFT_CURRENT2],
    )  # fmt: skip
    pump = u[port.U_PUMP]
    cooling = plant.car[lay.CAR_COOLING]
    oil_temperature = x[lay.X_COOLANT]
    share = 1.0 / plant.steps
    oil_out[hydraulics.OUT_SHIFT_FORCE] = x_sync[shifting.X_GIVEN]
    oil_out[hydraulics.OUT_SHIFT_STIFFNESS] = x_sync[shifting.X_STIFFNESS]
    for k in range(plant.steps):
        all_rows(speed_columns, drive_x, speeds)
        speed, speed1, speed2 = speeds[ENGINE], speeds[EM1], speeds[EM2]
        forces[ENGINE] = inner.engine_torque(
            p_engine, x_engine, hold, external, speed, books[teeth.ANGLE], engine_out
        )
        if abs(speed) < combustion.REST_SPEED and math.isnan(external):
            forces[ENGINE] = combustion.friction_at_rest(
                p_engine, speed, -teeth.branch_torque(extras, bank.stiffness, drive_x, FLYWHEEL),
                bank.inertia[0], engine_out,
            )  # fmt: skip
        forces[EM1] = inner.machine_torque(
            em1, x1, hold[lay.H_REQUEST1], hold[lay.H_GATES1], hold[lay.H_EXTERNAL1], speed1,
            x_link[0], thermal1, out1,
        )  # fmt: skip
        forces[EM2] = inner.machine_torque(
            em2, x2, hold[lay.H_REQUEST2], hold[lay.H_GATES2], hold[lay.H_EXTERNAL2], speed2,
            x_link[0], thermal2, out2,
        )  # fmt: skip
        road.road_load(p_road, radius * speeds[ROAD], hold[lay.H_GRADE], 0.0, road_out)
        forces[ROAD] = road_out[road.OUT_BODY_TORQUE]
        inner.shift(
            held, speeds, p_sleeve, x_sync, oil_out, drive_x, n, forces, books, kinetic, static,
            play, sleeve_out,
        )  # fmt: skip
        force, piston = hydraulics.pack_force(p_oil, x_oil), x_oil[hydraulics.X_PISTON]
        parts = hydraulics.hydraulics_in_parts(
            p_oil, plant.fine_hydraulics, x_oil, current0, current1, current2, pump,
            x_sync[sleeve.X_POSITION], oil_out,
        )  # fmt: skip
        # What C1 can carry is held over the step: its middle, but the oil is half a part early.
        later = 0.5 - 0.5 / parts
        force += later * (oil_out[hydraulics.OUT_PACK_FORCE] - force)
        piston += later * (oil_out[hydraulics.OUT_PISTON] - piston)
        inner.capacities(
            p_clutch, x_clutch, force, piston, speeds[N_PORTS + C1], oil_temperature, hold, road_out,
            n, clutch_out, kinetic, static,
        )  # fmt: skip
        tyre.allow_for_creep(plant.tyres, x[lay.X_TYRES : lay.X_DRIVELINE], static)
        inner.book_oil(oil_out, tick)
        shifting.book_sleeve(
            sleeve_out, oil_out[hydraulics.OUT_SLEEVE_WORK], tick[ledger.L_SLEEVE :]
        )
        warm = books[teeth.FRICTION + C1]
        n_events = driveline.step(
            bank, drive_x, n, forces, kinetic, static, books, trial, t_ns + k * plant.step_ns,
            plant.step_ns, events, n_events, extras,
        )  # fmt: skip
        inner.slip_tyres(plant.tyres, extras.middle, x, n, work)
        shifting.turn_gears(p_sleeve, x_sync, books)
        inner.engine_energy(
            p_engine, engine_out, external, inner.turned(books, ENGINE), energy, tick, x
        )
        taken = inner.machine_energy(
            out1, hold[lay.H_GATES1], speed1, step, inner.turned(books, EM1), tick, ledger.L_EM1,
            ledger.L_EM1_SHAFT, ledger.L_EM1_DC,
        )  # fmt: skip
        taken += inner.machine_energy(
            out2, hold[lay.H_GATES2], speed2, step, inner.turned(books, EM2), tick, ledger.L_EM2,
            ledger.L_EM2_SHAFT, ledger.L_EM2_DC,
        )  # fmt: skip
        inner.book_road(road_out, inner.turned(books, ROAD), tick, x)
        inner.link_and_battery(p_link, x_link, hold, step, taken, link_out, tick, mean)
        wet_clutch.heat_step(
            p_clutch, x_clutch, books[teeth.FRICTION + C1] - warm, cooling, oil_temperature,
            heat_out,
        )  # fmt: skip
        mean[lay.M_ENGINE] += share * (
            engine_out[source.OUT_TORQUE] - engine_out[combustion.OUT_RIPPLE]
        )
        mean[lay.M_EM1] += share * out1[pmsm.OUT_TORQUE]
        mean[lay.M_EM2] += share * out2[pmsm.OUT_TORQUE]
    x_sync[shifting.X_GIVEN] = oil_out[hydraulics.OUT_SHIFT_FORCE]
    x_sync[shifting.X_STIFFNESS] = oil_out[hydraulics.OUT_SHIFT_STIFFNESS]
    return n_events


@small_kernel
def _after_the_steps(
    plant: DetailedPlant, x: Array, n: Integers, u: Array, y: Array, work: Array, t_ns: int
) -> None:
    """Temperatures, state of charge, ledger; then the truth."""
    ambient = u[port.U_AMBIENT] if not math.isnan(u[port.U_AMBIENT]) else 293.15
    hold = work[lay.W_HOLD :]
    tick = work[lay.W_TICK : lay.W_ENGINE]
    mean = work[lay.W_MEAN : lay.W_MEAN + 8]
    period = port.PERIOD
    per_second = 1.0 / period
    thermal.thermal_step(
        plant.thermal1, x[lay.X_THERMAL1 : lay.X_THERMAL2],
        (tick[ledger.L_EM1] + tick[ledger.L_EM1 + 1]) * per_second,
        tick[ledger.L_EM1 + 3] * per_second, ambient,
    )  # fmt: skip
    thermal.thermal_step(
        plant.thermal2, x[lay.X_THERMAL2 : lay.X_COOLANT],
        (tick[ledger.L_EM2] + tick[ledger.L_EM2 + 1]) * per_second,
        tick[ledger.L_EM2 + 3] * per_second, ambient,
    )  # fmt: skip
    x[lay.X_COOLANT] = thermal.node_step(
        plant.coolant, 0, x[lay.X_COOLANT],
        (tick[ledger.L_WALL] + tick[ledger.L_ENGINE_DRAG]) * per_second, ambient,
    )  # fmt: skip
    charge = mean[lay.M_CURRENT]
    x[lay.X_BATTERY + battery.X_SOC] -= charge / plant.battery[battery.P_CAPACITY]
    warm = tick[ledger.L_BATTERY_RESISTANCE] * per_second
    settled = ambient + warm * plant.battery[battery.P_HEAT_RESISTANCE]
    temperature = x[lay.X_BATTERY + battery.X_TEMPERATURE]
    x[lay.X_BATTERY + battery.X_TEMPERATURE] = (
        settled + (temperature - settled) * plant.battery[battery.P_HEAT_KEEP]
    )
    # What the driveline keeps itself since the start.
    books = x[lay.X_BOOKS : lay.X_TYRES]
    for i in range(ledger.N_TERMS):
        x[lay.X_LEDGER + i] += tick[i]
    locks = plant.bank.speed_at.shape[0] - N_PORTS
    for lock in range(locks):
        x[lay.X_LEDGER + ledger.L_FRICTION + lock] = books[teeth.FRICTION + lock]
    for branch in range(plant.extras.damping.shape[0]):
        x[lay.X_LEDGER + ledger.L_DAMPER + branch] = books[teeth.DAMPERS + branch]
    x[lay.X_LEDGER + ledger.L_LOCKS] = books[teeth.LOST]
    x[lay.X_LEDGER + ledger.L_DOGS] = books[teeth.LOST_DOGS]
    x[lay.X_LEDGER + ledger.L_MESHES] = books[teeth.LOST_MESH]

    engine_out = work[lay.W_ENGINE : lay.W_ENERGY]
    out1, out2 = work[lay.W_EM1 : lay.W_EM2], work[lay.W_EM2 : lay.W_LINK]
    limits = work[lay.W_LIMITS : lay.W_LIMITS + battery.N_LIM]
    y[port.Y_ENGINE_TORQUE] = mean[lay.M_ENGINE]
    y[port.Y_ENGINE_SETPOINT] = engine_out[source.OUT_SETPOINT]
    y[port.Y_ENGINE_REASON] = engine_out[source.OUT_REASON]
    y[port.Y_ENGINE_TORQUE_MIN] = engine_out[engine.OUT_TORQUE_MIN]
    y[port.Y_ENGINE_TORQUE_MAX] = engine_out[engine.OUT_TORQUE_MAX]
    y[port.Y_ENGINE_PHASE] = engine_out[engine.OUT_PHASE]
    y[port.Y_FUEL_FLOW] = engine_out[combustion.OUT_FUEL_FLOW]
    y[port.Y_EM1_TORQUE], y[port.Y_EM2_TORQUE] = mean[lay.M_EM1], mean[lay.M_EM2]
    y[port.Y_EM1_SETPOINT] = out1[drive.OUT_SETPOINT]
    y[port.Y_EM2_SETPOINT] = out2[drive.OUT_SETPOINT]
    reason = limits[battery.LIM_REASON_DISCHARGE]
    if tick[ledger.L_EM1_DC] + tick[ledger.L_EM2_DC] < 0.0:
        reason = limits[battery.LIM_REASON_CHARGE]
    y[port.Y_EM1_REASON] = reason if mean[lay.M_CUT1] > 0.5 else out1[drive.OUT_REASON]
    y[port.Y_EM2_REASON] = reason if mean[lay.M_CUT2] > 0.5 else out2[drive.OUT_REASON]
    power1, power2 = tick[ledger.L_EM1_DC] * per_second, tick[ledger.L_EM2_DC] * per_second
    y[port.Y_EM1_POWER], y[port.Y_EM2_POWER] = power1, power2
    x1, x2 = x[lay.X_EM1 : lay.X_EM2], x[lay.X_EM2 : lay.X_CONTROL1]
    y[port.Y_EM1_CURRENT_D], y[port.Y_EM1_CURRENT_Q] = x1[pmsm.X_ID], x1[pmsm.X_IQ]
    y[port.Y_EM2_CURRENT_D], y[port.Y_EM2_CURRENT_Q] = x2[pmsm.X_ID], x2[pmsm.X_IQ]
    discharge, charge_limit = mean[lay.M_DISCHARGE], mean[lay.M_CHARGE]
    # One published bound per tick: each is four ticks old at most.
    which = (t_ns // port.PERIOD_NS) % 4
    bounds = x[lay.X_BOUNDS : lay.X_FUEL]
    if which < 2:
        high_voltage.refresh_bound(
            which, plant.em1, x1, y[port.Y_EM1_SPEED], x[lay.X_LINK], x[lay.X_THERMAL1],
            power2 + hold[lay.H_AUXILIARY], discharge, charge_limit, bounds[0:2],
        )  # fmt: skip
    else:
        high_voltage.refresh_bound(
            which - 2, plant.em2, x2, y[port.Y_EM2_SPEED], x[lay.X_LINK], x[lay.X_THERMAL2],
            power1 + hold[lay.H_AUXILIARY], discharge, charge_limit, bounds[2:4],
        )  # fmt: skip
    y[port.Y_EM1_TORQUE_MIN], y[port.Y_EM1_TORQUE_MAX] = bounds[0], bounds[1]
    y[port.Y_EM2_TORQUE_MIN], y[port.Y_EM2_TORQUE_MAX] = bounds[2], bounds[3]

    y[port.Y_CLUTCH_CAPACITY] = work[lay.W_CLUTCH + wet_clutch.OUT_KINETIC]
    y[port.Y_CLUTCH_SETPOINT] = u[port.U_CLUTCH_CAPACITY]
    y[port.Y_CLUTCH_REASON] = 0.0
    brake_out = work[lay.W_BRAKES : lay.W_BRAKES + brakes.N_OUT]
    y[port.Y_BRAKE_TORQUE] = brake_out[source.OUT_TORQUE]
    y[port.Y_BRAKE_SETPOINT] = brake_out[source.OUT_SETPOINT]
    y[port.Y_BRAKE_REASON] = brake_out[source.OUT_REASON]
    y[port.Y_DISCHARGE_LIMIT], y[port.Y_CHARGE_LIMIT] = discharge, charge_limit
    y[port.Y_BATTERY_CURRENT] = -charge * per_second
    y[port.Y_BATTERY_VOLTAGE] = (
        limits[battery.LIM_OCV] - limits[battery.LIM_RESISTANCE] * charge * per_second
    )
    if not math.isnan(u[port.U_EXTERNAL_BATTERY_VOLTAGE]):
        y[port.Y_BATTERY_VOLTAGE] = u[port.U_EXTERNAL_BATTERY_VOLTAGE]
    y[port.Y_BATTERY_REASON] = reason if mean[lay.M_CUT1] + mean[lay.M_CUT2] > 0.5 else 0.0
    y[port.Y_CONTACTOR_PHASE] = hold[lay.H_PHASE]
    y[port.Y_GRADE], y[port.Y_AMBIENT] = hold[lay.H_GRADE], ambient
    locks = plant.bank.speed_at.shape[0] - N_PORTS
    observe(
        plant, x, n, work[lay.W_FORCES : lay.W_FORCES + N_PORTS + locks], y, work[lay.W_TRIAL :]
    )
    oil = work[lay.W_OIL : lay.W_SYNC]
    y[port.Y_SUPPLY_PRESSURE] = oil[hydraulics.OUT_SUPPLY]
    y[port.Y_CLUTCH_PRESSURE] = oil[hydraulics.OUT_CLUTCH]
    y[port.Y_SHIFT_PRESSURE1] = oil[hydraulics.OUT_SHIFT1]
    y[port.Y_SHIFT_PRESSURE2] = oil[hydraulics.OUT_SHIFT2]
    y[port.Y_SHIFT_FORCE] = oil[hydraulics.OUT_SHIFT_FORCE]


@small_kernel
def observe(
    plant: DetailedPlant, x: Array, n: Integers, forces: Array, y: Array, seen: Array
) -> None:
    """Write into ``y`` what follows from the state: speeds, slips, held torques, temperatures.

    ``seen`` is scratch, shape (driveline.N_SEEN,).
    """
    driveline.look(plant.bank, x[lay.X_DRIVELINE :], n, forces, seen)
    speeds, carried = seen[driveline.SPEEDS :], seen[driveline.CARRIED :]
    locks = forces.shape[0] - N_PORTS
    radius = plant.car[lay.CAR_RADIUS]
    y[port.Y_ENGINE_SPEED] = speeds[ENGINE]
    y[port.Y_EM1_SPEED] = speeds[EM1]
    y[port.Y_EM2_SPEED] = speeds[EM2]
    y[port.Y_WHEEL_LEFT_SPEED] = speeds[N_PORTS + LEFT]
    y[port.Y_WHEEL_RIGHT_SPEED] = speeds[N_PORTS + RIGHT]
    y[port.Y_BODY_SPEED] = speeds[ROAD]
    y[port.Y_WHEEL_REAR_SPEED] = y[port.Y_BODY_SPEED]
    if locks > REAR:
        y[port.Y_WHEEL_REAR_SPEED] = speeds[N_PORTS + REAR]
    y[port.Y_VEHICLE_SPEED] = y[port.Y_BODY_SPEED] * radius
    y[port.Y_ACCELERATION] = radius * carried[locks]
    y[port.Y_ACCELERATION] -= inner.creep_acceleration(plant.tyres, radius, x, n)
    y[port.Y_ACCELEROMETER] = road.accelerometer(y[port.Y_ACCELERATION], y[port.Y_GRADE])
    y[port.Y_CLUTCH_TORQUE] = -carried[C1]
    y[port.Y_CLUTCH_SLIP] = speeds[N_PORTS + C1]
    y[port.Y_CLUTCH_HELD] = n[HELD + C1]
    x_sync = x[lay.X_SYNC : lay.X_BOUNDS]
    position = x_sync[sleeve.X_POSITION]
    # The gear on whose side the sleeve stands; its phase and gear are told by the TCU.
    sync = G2 if position < 0.0 else G1
    y[port.Y_SYNC_TORQUE] = -carried[sync]
    y[port.Y_SYNC_SLIP] = speeds[N_PORTS + sync] if position != 0.0 else 0.0
    y[port.Y_SLEEVE_POSITION] = position
    y[port.Y_SLEEVE_ZONE] = x_sync[sleeve.X_ZONE]
    y[port.Y_DOGS_HELD] = float(n[HELD + G1] + n[HELD + G2])
    y[port.Y_BODY_HELD] = n[HELD + BODY]
    y[port.Y_LINK_VOLTAGE] = x[lay.X_LINK]
    y[port.Y_STATE_OF_CHARGE] = x[lay.X_BATTERY + battery.X_SOC]
    y[port.Y_BATTERY_TEMPERATURE] = x[lay.X_BATTERY + battery.X_TEMPERATURE]
    y[port.Y_EM1_WINDING_TEMPERATURE] = x[lay.X_THERMAL1 + thermal.X_WINDING]
    y[port.Y_EM1_INVERTER_TEMPERATURE] = x[lay.X_THERMAL1 + thermal.X_INVERTER]
    y[port.Y_EM2_WINDING_TEMPERATURE] = x[lay.X_THERMAL2 + thermal.X_WINDING]
    y[port.Y_EM2_INVERTER_TEMPERATURE] = x[lay.X_THERMAL2 + thermal.X_INVERTER]
    y[port.Y_COOLANT_TEMPERATURE] = x[lay.X_COOLANT]
    y[port.Y_CLUTCH_TEMPERATURE] = x[lay.X_CLUTCH]
    books = x[lay.X_BOOKS : lay.X_TYRES]
    y[port.Y_CRANK_ANGLE] = books[teeth.ANGLE]
    y[port.Y_ENERGY_LOST] = books[teeth.LOST] + books[teeth.LOST_DOGS] + books[teeth.LOST_MESH]
    y[port.Y_LOCK_ROW] = n[ROW]


@kernel
def detailed_step(
    plant: DetailedPlant,
    x: Array,
    n: Integers,
    u: Array,
    y: Array,
    work: Array,
    t_ns: int,
    events: Events,
    n_events: int,
) -> int:
    """Advance one control period of 1 ms; arguments as :func:`.powertrain.plant_step`.

    ``x`` has ``detailed_layout.state_size`` values, ``work`` ``detailed_layout.WORK``, of which nothing is
    kept from tick to tick.  Phase and gear of the shift are the TCU's to tell.
    """
    for i in range(lay.W_TICK, lay.W_ENGINE):
        work[i] = 0.0
    for i in range(lay.W_MEAN, lay.W_MEAN + 8):
        work[i] = 0.0
    _before_the_steps(plant, x, u, y, work)
    n_events = _steps(plant, x, n, u, y, work, t_ns, events, n_events)
    _after_the_steps(plant, x, n, u, y, work, t_ns)
    return n_events


@kernel
def stored_energies(plant: DetailedPlant, x: Array, n: Integers, out: Array) -> None:
    """Write what is stored now, ``(ledger.N_STORED,)``, J."""
    bank, extras = plant.bank, plant.extras
    drive_x = x[lay.X_DRIVELINE :]
    count = bank.inertia.shape[0]
    out[ledger.S_KINETIC] = 0.0
    for i in range(count):
        out[ledger.S_KINETIC] += 0.5 * bank.inertia[i] * drive_x[i] * drive_x[i]
    out[ledger.S_ELASTIC] = teeth.elastic_energy(
        extras, bank.stiffness[0], drive_x, n[driveline.MESH :]
    )
    out[ledger.S_PISTONS] = 0.0
    if extras.crank.shape[0] > 0:
        speed = row_speed(bank.speed_at, bank.speed_by, drive_x, ENGINE)
        out[ledger.S_PISTONS] = crank.reciprocating_energy(
            extras.crank, x[lay.X_BOOKS + teeth.ANGLE], speed
        )
    out[ledger.S_GAS], out[ledger.S_HEIGHT] = x[lay.X_GAS], x[lay.X_HEIGHT]
    out[ledger.S_EM1] = pmsm.magnetic_energy(
        plant.em1, x[lay.X_EM1 + pmsm.X_ID], x[lay.X_EM1 + pmsm.X_IQ]
    )
    out[ledger.S_EM2] = pmsm.magnetic_energy(
        plant.em2, x[lay.X_EM2 + pmsm.X_ID], x[lay.X_EM2 + pmsm.X_IQ]
    )
    link = x[lay.X_LINK]
    out[ledger.S_LINK] = 0.5 * plant.link[dc_link.P_CAPACITANCE] * link * link
    out[ledger.S_OIL] = hydraulics.stored_energy(plant.hydraulics, x[lay.X_OIL : lay.X_CLUTCH])
    out[ledger.S_SLEEVE] = shifting.sleeve_energy(plant.sleeve, x[lay.X_SYNC : lay.X_BOUNDS])
