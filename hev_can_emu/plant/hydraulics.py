"""The high-pressure circuit: pump, accumulator, relief, three valves, clutch and shift cylinders.

Storage is pressure over excess volume ``p(w)`` (linear or of two straight pieces), flow is volume:
energy is ``integral of p dw``, throttling takes ``q*(p1 - p2)``, a piston ``p*A*dx``.  Orifices:
``q = Cd*a*sqrt(2/rho)*dp/(dp^2 + dp_lam^2)^(1/4)``, turbulent far from zero, linear near it.

Each step solves all pressures at its *end* (implicit Euler; order 1, L-stable) with the orifices as
conductances that follow the pressures in a fixed number of passes: no chamber is too small for it
and no pressure overshoots.  Volumes are moved by flows that leave one place and enter another, so their
sum keeps to rounding.  What implicit Euler takes from each storage has a closed form, is never
negative, and is told as the in-step loss (it vanishes with dt).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant.hydraulic_parameters import (
    N_VALVE,
    P_ACCUMULATOR,
    P_CLUTCH_AREA,
    P_CLUTCH_COMPLIANCE,
    P_DT,
    P_KISS,
    P_LAMINAR_SQUARE,
    P_LINE,
    P_MAKE_UP,
    P_PACK,
    P_PRECHARGE,
    P_PRELOAD,
    P_PUMP_DISPLACEMENT,
    P_PUMP_FRICTION,
    P_PUMP_KEEP,
    P_PUMP_LEAK,
    P_PUMP_SPEED,
    P_RELIEF_OPEN,
    P_RELIEF_SLOPE,
    P_SEAL_RATE,
    P_SHIFT_AREA,
    P_SHIFT_COMPLIANCE,
    P_SPRING,
    P_VALVES,
    V_CURRENT,
    V_FLOW,
    V_LEAK,
    V_SPOOL,
    V_UNDERLAP,
)

# Layout of the state: excess volume of supply, clutch chamber and both shift chambers, m^3; clutch
# piston, m; sleeve position last seen, m; pump speed, rad/s; oil in the tank beyond its first content,
# m^3; three spools (share of the stroke, -1 tank to +1 supply) and their velocities, 1/s.
X_SUPPLY, X_CLUTCH, X_SHIFT1, X_SHIFT2 = 0, 1, 2, 3
X_PISTON, X_SLEEVE, X_PUMP, X_TANK = 4, 5, 6, 7
X_SPOOL = 8
X_SPEED = 14  # of the clutch piston over the last step, m/s
N_STATE = 15

# Layout of the output.  From OUT_PUMP_WORK on: J in this step; see the functions below for signs.
OUT_SUPPLY, OUT_CLUTCH, OUT_SHIFT1, OUT_SHIFT2 = 0, 1, 2, 3  # gauge pressures, Pa
OUT_PISTON, OUT_PACK_FORCE = 4, 5  # m, N
OUT_SHIFT_FORCE, OUT_SHIFT_STIFFNESS = 6, 7  # N, positive towards G1; N/m
OUT_PUMP_WORK, OUT_PUMP_LOSS, OUT_RELIEF_LOSS = 8, 9, 10
OUT_VALVE_LOSS = 11  # clutch valve, then the two shift valves
OUT_SEAL_LOSS, OUT_STOP_LOSS, OUT_STEP_LOSS = 14, 15, 16
OUT_SLEEVE_WORK, OUT_SLEEVE_LAG = 17, 18
N_OUT = 19

PASSES = 2
"""How often the orifices' conductances are brought up to date within a step."""

PARTS = 8
"""Of a step in which clutch piston or valve move, where :func:`hydraulics_in_parts` is asked."""

STILL, CALM = 2e-4, 1.0
"""A clutch piston below the first, m/s, and a spool below the second, 1/s, count as at rest."""


@kernel
def orifice_conductance(flow_factor: float, drop: float, laminar_square: float) -> float:
    """Return flow over pressure drop, m^3/(s Pa); ``flow_factor`` is ``Cd*a*sqrt(2/rho)``."""
    square = drop * drop + laminar_square
    return flow_factor / math.sqrt(math.sqrt(square))


@kernel
def supply_pressure(p: NDArray[np.float64], volume: float) -> float:
    """Return the supply's pressure, Pa, with ``volume`` m^3 beyond its empty content."""
    charged: float = p[P_LINE] * p[P_PRECHARGE]
    if volume <= charged:
        return float(volume / p[P_LINE])
    return float(p[P_PRECHARGE] + (volume - charged) / p[P_ACCUMULATOR])


@kernel
def supply_volume(p: NDArray[np.float64], pressure: float) -> float:
    """Return the supply's excess volume at ``pressure``: the inverse of the above."""
    if pressure <= p[P_PRECHARGE]:
        return float(pressure * p[P_LINE])
    charged: float = p[P_LINE] * p[P_PRECHARGE]
    return float(charged + (pressure - p[P_PRECHARGE]) * p[P_ACCUMULATOR])


@kernel
def stored_energy(p: NDArray[np.float64], x: NDArray[np.float64]) -> float:
    """Return the energy in accumulator, chambers, return spring and clutch pack, J."""
    charged = p[P_LINE] * p[P_PRECHARGE]
    line = min(x[X_SUPPLY], charged)
    beyond = max(x[X_SUPPLY] - charged, 0.0)
    total: float = 0.5 * line * line / p[P_LINE]
    total += p[P_PRECHARGE] * beyond + 0.5 * beyond * beyond / p[P_ACCUMULATOR]
    total += 0.5 * x[X_CLUTCH] * x[X_CLUTCH] / p[P_CLUTCH_COMPLIANCE]
    for i in range(2):
        w = x[X_SHIFT1 + i]
        total += 0.5 * w * w / p[P_SHIFT_COMPLIANCE + i]
    s = x[X_PISTON]
    squeeze = max(s - p[P_KISS], 0.0)
    total += p[P_PRELOAD] * s + 0.5 * p[P_SPRING] * s * s + 0.5 * p[P_PACK] * squeeze * squeeze
    return total


@kernel
def pack_force(p: NDArray[np.float64], x: NDArray[np.float64]) -> float:
    """Return the force on the clutch pack, N."""
    return float(p[P_PACK] * max(x[X_PISTON] - p[P_KISS], 0.0))


@kernel
def hydraulics_start(p: NDArray[np.float64], x: NDArray[np.float64], pressure: float) -> None:
    """Set the state to rest: supply at ``pressure`` Pa, all else vented, no current."""
    for i in range(N_STATE):
        x[i] = 0.0
    x[X_SUPPLY] = supply_volume(p, pressure)
    for i in range(3):
        x[X_SPOOL + 2 * i] = -1.0


@kernel
def spool_target(p: NDArray[np.float64], valve: int, current: float) -> float:
    """Return where ``current`` A holds the spool of ``valve``: -1 (none) to +1 (full)."""
    if not current > 0.0:
        return -1.0
    return float(min(2.0 * current / p[P_VALVES + N_VALVE * valve + V_CURRENT] - 1.0, 1.0))


@kernel
def _move_spool(
    p: NDArray[np.float64], x: NDArray[np.float64], valve: int, current: float
) -> float:
    """Advance a spool exactly for a held current; return its position.  Its stops do not bounce."""
    target = spool_target(p, valve, current)
    a = P_VALVES + N_VALVE * valve + V_SPOOL
    at = X_SPOOL + 2 * valve
    error, velocity = x[at] - target, x[at + 1]
    position: float = target + p[a] * error + p[a + 1] * velocity
    velocity = p[a + 2] * error + p[a + 3] * velocity
    if position > 1.0:
        position = 1.0
        velocity = min(velocity, 0.0)
    elif position < -1.0:
        position = -1.0
        velocity = max(velocity, 0.0)
    x[at] = position
    x[at + 1] = velocity
    return position


@kernel
def _supply_edge(
    p: NDArray[np.float64], valve: int, spool: float, supply: float, chamber: float
) -> float:
    """Return the conductance from the supply to the chamber of ``valve``."""
    at = P_VALVES + N_VALVE * valve
    total: float = p[at + V_LEAK]
    share = spool + p[at + V_UNDERLAP]
    if share > 0.0:
        total += orifice_conductance(p[at + V_FLOW] * share, supply - chamber, p[P_LAMINAR_SQUARE])
    return total


@kernel
def _tank_edge(p: NDArray[np.float64], valve: int, spool: float, chamber: float) -> float:
    """Return the conductance from the chamber to the tank; a make-up valve opens in suction."""
    at = P_VALVES + N_VALVE * valve
    total: float = p[at + V_LEAK]
    share = p[at + V_UNDERLAP] - spool
    flow = p[at + V_FLOW] * share if share > 0.0 else 0.0
    if chamber < 0.0:
        flow += p[P_MAKE_UP]
    if flow > 0.0:
        total += orifice_conductance(flow, chamber, p[P_LAMINAR_SQUARE])
    return total


@kernel
def _clear_energies(out: NDArray[np.float64]) -> None:
    for i in range(OUT_PUMP_WORK, N_OUT):
        out[i] = 0.0


@kernel
def hydraulics_in_parts(
    p: NDArray[np.float64],
    fine: NDArray[np.float64],
    x: NDArray[np.float64],
    current_clutch: float,
    current_shift1: float,
    current_shift2: float,
    pump_on: float,
    sleeve_position: float,
    out: NDArray[np.float64],
) -> int:
    """As :func:`hydraulics_step`, in :data:`PARTS` while clutch piston or valve move; return how many.

    ``fine`` are the parameters for a step that is so much shorter.  The sleeve moves evenly.
    """
    parts, each = 1, p
    if abs(x[X_SPEED]) >= STILL or abs(x[X_SPOOL + 1]) >= CALM:
        parts, each = PARTS, fine
    _clear_energies(out)
    away = sleeve_position - x[X_SLEEVE]
    for part in range(parts):
        place = sleeve_position - away * (parts - 1 - part) / parts
        _advance(
            each, x, current_clutch, current_shift1, current_shift2, pump_on, place, parts, out
        )
    return parts


@kernel
def hydraulics_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    current_clutch: float,
    current_shift1: float,
    current_shift2: float,
    pump_on: float,
    sleeve_position: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one inner step.

    The sleeve belongs to the synchronizer: it moves first, under the force of the step before, then its new
    position comes in here.  ``OUT_SLEEVE_LAG`` is what this order costs in energy.

    Args:
        p: parameters, ``(N_PARAMETERS,)`` of :mod:`hev_can_emu.plant.hydraulic_parameters`.
        x: state, ``(N_STATE,)``, changed in place; see :func:`hydraulics_start`.
        current_clutch, current_shift1, current_shift2: of the valves, A; NaN counts as 0.
        pump_on: 0 or 1.
        sleeve_position: at the end of this step, m, positive towards G1.
        out: ``(N_OUT,)``.  Pressures Pa (gauge), piston m, force on the clutch pack N, force on the
            sleeve N and how fast it falls with the sleeve's travel N/m; then J in this step: shaft work
            of the pump, its losses, losses in the relief valve, in each valve, in the seal, at the
            piston's stop, within the step; work done on the sleeve, and that less the work of the
            force told in the step before.
    """
    _clear_energies(out)
    _advance(p, x, current_clutch, current_shift1, current_shift2, pump_on, sleeve_position, 1, out)


@kernel
def _advance(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    current_clutch: float,
    current_shift1: float,
    current_shift2: float,
    pump_on: float,
    sleeve_position: float,
    parts: int,
    out: NDArray[np.float64],
) -> None:
    """Advance by ``p``'s step, one of so many equal parts; energies are added to ``out``."""
    dt = p[P_DT]
    area = p[P_CLUTCH_AREA]
    c0, c1, c2 = p[P_CLUTCH_COMPLIANCE], p[P_SHIFT_COMPLIANCE], p[P_SHIFT_COMPLIANCE + 1]
    area1, area2 = p[P_SHIFT_AREA], p[P_SHIFT_AREA + 1]
    y0 = _move_spool(p, x, 0, current_clutch)
    y1 = _move_spool(p, x, 1, current_shift1)
    y2 = _move_spool(p, x, 2, current_shift2)
    wanted = p[P_PUMP_SPEED] if pump_on > 0.5 else 0.0
    speed = wanted + (x[X_PUMP] - wanted) * p[P_PUMP_KEEP]
    x[X_PUMP] = speed

    w_supply = x[X_SUPPLY]
    old_supply = supply_pressure(p, w_supply)
    rate0, rate1, rate2 = 1.0 / c0, 1.0 / c1, 1.0 / c2
    old0, old1, old2 = x[X_CLUTCH] * rate0, x[X_SHIFT1] * rate1, x[X_SHIFT2] * rate2
    piston = x[X_PISTON]
    travel = sleeve_position - x[X_SLEEVE]
    delivery = p[P_PUMP_DISPLACEMENT] * speed
    charged = p[P_LINE] * p[P_PRECHARGE]

    # Pressures at the end: each chamber is affine in the supply's, so one division solves the supply.
    supply, pressure0, pressure1, pressure2 = old_supply, old0, old1, old2
    loose = p[P_SEAL_RATE] + p[P_SPRING]
    unloaded = p[P_SEAL_RATE] * piston - p[P_PRELOAD]
    in0 = in1 = in2 = back0 = back1 = back2 = pumped = relieved = 0.0
    for _ in range(PASSES):
        in0 = dt * _supply_edge(p, 0, y0, supply, pressure0)
        in1 = dt * _supply_edge(p, 1, y1, supply, pressure1)
        in2 = dt * _supply_edge(p, 2, y2, supply, pressure2)
        back0 = dt * _tank_edge(p, 0, y0, pressure0)
        back1 = dt * _tank_edge(p, 1, y1, pressure1)
        back2 = dt * _tank_edge(p, 2, y2, pressure2)
        # The piston without mass: seal_rate*(s - s_old) = A*p - preload - spring*s - pack.
        stiffness = loose
        free = unloaded
        give = area / stiffness
        position = (free + area * pressure0) / stiffness
        if position > p[P_KISS]:
            stiffness += p[P_PACK]
            free += p[P_PACK] * p[P_KISS]
            give = area / stiffness
        elif position <= 0.0:
            free = give = 0.0
        content0 = x[X_CLUTCH] + area * (piston - free / stiffness)
        content1 = x[X_SHIFT1] - area1 * travel
        content2 = x[X_SHIFT2] + area2 * travel
        d0 = 1.0 / (c0 + area * give + in0 + back0)
        d1 = 1.0 / (c1 + in1 + back1)
        d2 = 1.0 / (c2 + in2 + back2)
        compliance, content = p[P_LINE], w_supply
        if supply > p[P_PRECHARGE]:
            compliance = p[P_ACCUMULATOR]
            content += compliance * p[P_PRECHARGE] - charged
        leak = 0.0
        if delivery > p[P_PUMP_LEAK] * supply:
            leak = dt * p[P_PUMP_LEAK]
            content += dt * delivery
        relief = 0.0
        if supply > p[P_RELIEF_OPEN]:
            relief = dt * p[P_RELIEF_SLOPE]
            content += relief * p[P_RELIEF_OPEN]
        content += in0 * d0 * content0 + in1 * d1 * content1 + in2 * d2 * content2
        total = compliance + leak + relief
        total += in0 * (1.0 - in0 * d0) + in1 * (1.0 - in1 * d1) + in2 * (1.0 - in2 * d2)
        supply = content / total
        pressure0 = (content0 + in0 * supply) * d0
        pressure1 = (content1 + in1 * supply) * d1
        pressure2 = (content2 + in2 * supply) * d2
        pumped = dt * delivery - leak * supply if leak > 0.0 else 0.0
        relieved = relief * (supply - p[P_RELIEF_OPEN]) if relief > 0.0 else 0.0

    stiffness1 = area1 * area1 / (c1 + parts * (in1 + back1))
    stiffness2 = area2 * area2 / (c2 + parts * (in2 + back2))
    # Volumes moved: out of one place, into another.
    in0 *= supply - pressure0
    in1 *= supply - pressure1
    in2 *= supply - pressure2
    back0 *= pressure0
    back1 *= pressure1
    back2 *= pressure2
    pumped = max(pumped, 0.0)
    relieved = max(relieved, 0.0)
    x[X_SUPPLY] = w_supply + (pumped - relieved - in0 - in1 - in2)
    x[X_SHIFT1] += in1 - back1 - area1 * travel
    x[X_SHIFT2] += in2 - back2 + area2 * travel
    x[X_TANK] += back0 + back1 + back2 + relieved - pumped
    x[X_SLEEVE] = sleeve_position
    # Clutch chamber and piston once more, for the volume that really came: exact in every piece.
    content0 = x[X_CLUTCH] + area * piston + (in0 - back0)
    stiffness = loose + area * area * rate0
    free = unloaded + area * content0 * rate0
    position = free / stiffness
    if position > p[P_KISS]:
        position = (free + p[P_PACK] * p[P_KISS]) / (stiffness + p[P_PACK])
    position = max(position, 0.0)
    x[X_CLUTCH] = content0 - area * position
    x[X_PISTON] = position

    supply = supply_pressure(p, x[X_SUPPLY])
    pressure0, pressure1 = x[X_CLUTCH] * rate0, x[X_SHIFT1] * rate1
    pressure2 = x[X_SHIFT2] * rate2
    squeeze = max(position - p[P_KISS], 0.0)
    force = area1 * pressure1 - area2 * pressure2
    out[OUT_SUPPLY], out[OUT_CLUTCH] = supply, pressure0
    out[OUT_SHIFT1], out[OUT_SHIFT2] = pressure1, pressure2
    out[OUT_PISTON], out[OUT_PACK_FORCE] = position, p[P_PACK] * squeeze
    out[OUT_SHIFT_FORCE] = force
    # That of the whole step, as far as oil flows off meanwhile.
    out[OUT_SHIFT_STIFFNESS] = stiffness1 + stiffness2

    # Energies.  A stopped pump leaks inwardly what it still turns; its check valve is shut.
    at_pump = supply
    if pumped == 0.0:
        at_pump = min(delivery / p[P_PUMP_LEAK], supply) if p[P_PUMP_LEAK] > 0.0 else 0.0
    friction = dt * p[P_PUMP_FRICTION] * speed * speed
    out[OUT_PUMP_WORK] += dt * delivery * at_pump + friction
    out[OUT_PUMP_LOSS] += (dt * delivery - pumped) * at_pump + friction
    out[OUT_RELIEF_LOSS] += relieved * supply
    out[OUT_VALVE_LOSS] += in0 * (supply - pressure0) + back0 * pressure0
    out[OUT_VALVE_LOSS + 1] += in1 * (supply - pressure1) + back1 * pressure1
    out[OUT_VALVE_LOSS + 2] += in2 * (supply - pressure2) + back2 * pressure2
    moved = position - piston
    x[X_SPEED] = moved / dt
    out[OUT_SEAL_LOSS] += p[P_SEAL_RATE] * moved * moved
    if position == 0.0:
        push = p[P_PRELOAD] + p[P_SEAL_RATE] * moved - area * pressure0
        out[OUT_STOP_LOSS] += -push * moved
    was_line, was_beyond = min(w_supply, charged), max(w_supply - charged, 0.0)
    line, beyond = min(x[X_SUPPLY], charged), max(x[X_SUPPLY] - charged, 0.0)
    more, further = line - was_line, beyond - was_beyond
    within = 0.5 * more * more / p[P_LINE] + (line / p[P_LINE] - p[P_PRECHARGE]) * further
    within += (0.5 * further * further + beyond * more) / p[P_ACCUMULATOR]
    within += 0.5 * c0 * (pressure0 - old0) ** 2
    within += 0.5 * c1 * (pressure1 - old1) ** 2 + 0.5 * c2 * (pressure2 - old2) ** 2
    was_squeeze = max(piston - p[P_KISS], 0.0)
    within += 0.5 * p[P_SPRING] * moved * moved + 0.5 * p[P_PACK] * (squeeze - was_squeeze) ** 2
    within += p[P_PACK] * squeeze * (moved - (squeeze - was_squeeze))
    out[OUT_STEP_LOSS] += within
    out[OUT_SLEEVE_WORK] += force * travel
    out[OUT_SLEEVE_LAG] += (force - (area1 * old1 - area2 * old2)) * travel
