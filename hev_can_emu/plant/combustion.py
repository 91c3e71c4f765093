"""The detailed engine: charge, combustion torque, drag, fuel and heat, with its control unit.

Torque at the crankshaft after friction is ``combustion - drag (+ ripple)``; the pistons' inertial torque
comes from :mod:`hev_can_emu.plant.crank`.  Inputs and the first outputs are those of
:func:`hev_can_emu.plant.engine.engine_step`, as are its phases, so that either engine fits; the crank's
angle comes in addition.

The control unit turns the torque asked for into a load, the inverse of the map ``torque(speed, load)``.
The charge follows the load with a first-order lag in crank angle (the intake fills by strokes, not by
seconds), is caught at every half turn, burns over the half turn after the next catch, and gives the
torque of the map at the speed of that moment.  Without ignition there is none at once; without fuel
none from the charge being caught.  Fuel per angle is ``torque/(efficiency(speed)*heating value)``,
the Willans line: its offset is the drag.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import combustion_map as maps
from hev_can_emu.plant import engine
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.combustion_map import row_drag, row_load_torque, row_torque_load
from hev_can_emu.plant.engine_control import CRANKING, RUNNING, govern_idle, next_phase
from hev_can_emu.plant.gas_pulses import ATMOSPHERE, ripple
from hev_can_emu.plant.motor import fade
from hev_can_emu.plant.tables import bracket

# Layout of the state.
X_PHASE, X_FUEL_CUT, X_IDLE_INTEGRAL, X_CHARGE, X_CAUGHT, X_BURNING, X_HALF = 0, 1, 2, 3, 4, 5, 6
N_STATE = 7

# Layout of the output: the simple engine's, then these.
OUT_RIPPLE, OUT_CHARGE, OUT_FUEL_FLOW = engine.N_OUT, engine.N_OUT + 1, engine.N_OUT + 2
OUT_DRAG, OUT_EFFICIENCY = engine.N_OUT + 3, engine.N_OUT + 4
N_OUT = engine.N_OUT + 5

# Layout of the energies of one step, J, and the fuel, kg.
J_FUEL, J_COMBUSTION, J_WALL, J_EXHAUST, J_DRAG, J_RIPPLE, J_SHAFT, M_FUEL = 0, 1, 2, 3, 4, 5, 6, 7
N_ENERGY = 8

_TOLERANCE = 1e-6

REST_SPEED = 1.0
"""rad/s: a crank that turns slower than this is held by the friction of an engine at rest."""


@kernel
def combustion_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    torque_request: float,
    run_request: float,
    healthy: float,
    speed: float,
    angle: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one step: state machine, limits, idle governor, charge, combustion.

    Args:
        p: parameters of :meth:`.combustion_map.CombustionParameters.pack`.
        x: state, ``(N_STATE,)``, changed in place; all zero is an engine at rest, off.
        torque_request: at the crankshaft after friction, N m; NaN counts as 0.
        run_request: 0 or 1.
        healthy: 1; 0 forces the phase FAULT and switches ignition and fuel off.
        speed: of the crankshaft, rad/s.
        angle: of the crankshaft, rad, wrapped to one turn, 0 at a firing dead centre.
        out: ``(N_OUT,)``: torque after friction that acts over the step (ripple included) N m,
            setpoint N m, LIMIT_* code, torque min and max N m, phase, mean combustion torque N m, heat
            into the coolant W; ripple N m, charge 1, fuel flow kg/s, drag N m, efficiency 1.
    """
    if math.isnan(torque_request):
        torque_request = 0.0
    phase = next_phase(
        x[X_PHASE], run_request, healthy, speed, p[maps.P_CRANK_SPEED], p[maps.P_STALL_SPEED]
    )
    x[X_PHASE] = phase
    if speed >= p[maps.P_CUT_SPEED]:
        x[X_FUEL_CUT] = 1.0
    elif speed <= p[maps.P_RESUME_SPEED]:
        x[X_FUEL_CUT] = 0.0
    running = phase == RUNNING
    fuelled = running and x[X_FUEL_CUT] == 0.0

    # What is asked of combustion, between nothing (fuel cut) and full load.
    speeds, loads = int(p[maps.P_SPEEDS]), int(p[maps.P_LOADS])
    row, share = bracket(p, maps.P_TABLES, speeds, abs(speed))
    drag = row_drag(p, row, share, speed)
    turn_share = fade(speed, p[maps.P_FADE_SPEED], p[maps.P_MAX_SPEED])
    upper = maps.row_torque(p, row, share, loads - 1) * turn_share if running else 0.0
    wanted = max(torque_request + drag, 0.0)
    asked = wanted
    if fuelled:
        error = p[maps.P_IDLE_SPEED] - speed
        asked = govern_idle(
            x, X_IDLE_INTEGRAL, wanted, torque_request, error,
            p[maps.P_IDLE_DRAG] + p[maps.P_IDLE_GAIN] * error, p[maps.P_IDLE_INTEGRAL_STEP],
            p[maps.P_IDLE_KEEP], min(p[maps.P_IDLE_MAX], upper),
        )  # fmt: skip
    else:
        x[X_IDLE_INTEGRAL] = 0.0
        asked = p[maps.P_IDLE_DRAG] if phase == CRANKING else 0.0
    setpoint = min(asked, upper)

    # Charge: its lag is an angle, bounded in time; caught each half turn, burnt one half turn later.
    load = row_torque_load(p, row, share, setpoint if running else asked)
    lag = p[maps.P_INTAKE_ANGLE] / max(abs(speed), p[maps.P_INTAKE_ANGLE] / p[maps.P_INTAKE_TIME])
    charge = x[X_CHARGE]
    x[X_CHARGE] = load + (charge - load) * math.exp(-p[maps.P_STEP] / lag)
    half = 1.0 if angle >= math.pi else 0.0
    burnt, late = x[X_BURNING], 0.0
    if half != x[X_HALF]:
        # By what share of a step the dead centre is over already: the valves shut at that instant.
        if speed > 0.0:
            late = min((angle - half * math.pi) / (speed * p[maps.P_STEP]), 1.0)
        x[X_BURNING] = x[X_CAUGHT]
        x[X_CAUGHT] = 0.0
        if fuelled and setpoint > 0.0:
            x[X_CAUGHT] = max(charge - late * (x[X_CHARGE] - charge), 0.0)
        x[X_HALF] = half
    if not running:
        x[X_CAUGHT] = 0.0
        x[X_BURNING] = 0.0
    combustion = row_load_torque(p, row, share, x[X_BURNING])
    if late > 0.0 and running:
        # What burnt too long until now is made up for.
        more = combustion - row_load_torque(p, row, share, burnt)
        combustion = max(combustion + late * more, 0.0)

    pulse = 0.0
    if p[maps.P_PULSES] > 0.5:
        closed = p[maps.P_CLOSED_PRESSURE]
        pressure = closed + (ATMOSPHERE - closed) * x[X_CHARGE]
        sealed = min(abs(speed) / p[maps.P_LEAK_SPEED], 1.0)
        pulse = ripple(
            p, maps.P_RIPPLE, angle, speed * p[maps.P_STEP], sealed, pressure, combustion
        )

    efficiency = maps.row_value(p, 2, row, share)
    waste = combustion * (1.0 / efficiency - 1.0)
    out[source.OUT_TORQUE] = combustion - drag + pulse
    out[source.OUT_SETPOINT] = setpoint - drag
    out[engine.OUT_TORQUE_MIN] = -drag
    out[engine.OUT_TORQUE_MAX] = max(upper - drag, -drag)
    out[engine.OUT_PHASE] = phase
    out[engine.OUT_COMBUSTION] = combustion
    out[engine.OUT_HEAT] = (p[maps.P_WALL_SHARE] * waste + drag) * speed
    out[OUT_RIPPLE] = pulse
    out[OUT_CHARGE] = x[X_CHARGE]
    out[OUT_FUEL_FLOW] = combustion * max(speed, 0.0) / (efficiency * p[maps.P_HEATING_VALUE])
    out[OUT_DRAG] = drag
    out[OUT_EFFICIENCY] = efficiency

    reason = float(source.LIMIT_NONE)
    if abs(out[source.OUT_SETPOINT] - torque_request) > _TOLERANCE:
        if not running:
            reason = float(source.LIMIT_DISABLED)
        elif asked != wanted or (setpoint < asked and turn_share < 1.0):
            reason = float(source.LIMIT_SPEED)  # overspeed, or the idle governor
        else:
            reason = float(source.LIMIT_PEAK)
    out[source.OUT_REASON] = reason


@kernel
def friction_at_rest(
    p: NDArray[np.float64],
    speed: float,
    load: float,
    inertia: float,
    out: NDArray[np.float64],
) -> float:
    """Add the friction that holds a crank at rest; return the torque after friction, N m.

    It is what stops the crank by the end of the step, as far as the breakaway torque reaches, which is
    gone at :data:`REST_SPEED`: under an even load the crank then stands still and does not creep.

    Args:
        p: parameters of :meth:`.combustion_map.CombustionParameters.pack`.
        speed: of the crankshaft, rad/s, below :data:`REST_SPEED` in size.
        load: what the shaft behind the crank does to it, N m.
        inertia: of the crankshaft, kg m^2.
        out: of :func:`combustion_step`, ``(N_OUT,)``: torque and drag are changed.
    """
    most = p[maps.P_BREAKAWAY] * max(1.0 - abs(speed) / REST_SPEED, 0.0)
    wanted = -load - out[source.OUT_TORQUE] - inertia * speed / p[maps.P_STEP]
    held = min(max(wanted, -most), most)
    out[source.OUT_TORQUE] += held
    out[OUT_DRAG] -= held
    return float(out[source.OUT_TORQUE])


@kernel
def combustion_energy(
    p: NDArray[np.float64],
    out: NDArray[np.float64],
    travel: float,
    energy: NDArray[np.float64],
) -> None:
    """Write the energies of one step, each from its own torque over the angle really travelled.

    Two sums are zero to rounding: fuel less combustion work, wall and exhaust heat; and combustion
    work and ripple less drag and shaft work.

    Args:
        p: parameters of :meth:`.combustion_map.CombustionParameters.pack`.
        out: of :func:`combustion_step`, ``(N_OUT,)``.
        travel: of the crank over the step, from the driveline's motion, rad.
        energy: ``(N_ENERGY,)``: J from fuel, of combustion work, into the walls, into the exhaust, of
            drag (heat in the coolant), of ripple, of shaft work; fuel, kg.
    """
    combustion, efficiency = out[engine.OUT_COMBUSTION], out[OUT_EFFICIENCY]
    waste = (1.0 - efficiency) / efficiency * combustion * travel
    energy[J_FUEL] = combustion / efficiency * travel
    energy[J_COMBUSTION] = combustion * travel
    energy[J_WALL] = p[maps.P_WALL_SHARE] * waste
    energy[J_EXHAUST] = (1.0 - p[maps.P_WALL_SHARE]) * waste
    energy[J_DRAG] = out[OUT_DRAG] * travel
    energy[J_RIPPLE] = out[OUT_RIPPLE] * travel
    energy[J_SHAFT] = out[source.OUT_TORQUE] * travel
    energy[M_FUEL] = energy[J_FUEL] / p[maps.P_HEATING_VALUE]
