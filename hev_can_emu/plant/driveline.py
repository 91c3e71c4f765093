"""The driveline's compiled step: exact motion between events, dry friction that truly sticks.

Each lock (C1, sleeve on G1 or G2, brakes, body at rest) either slides, with its kinetic capacity against
the slip, or holds, which is a configuration of its own: merged inertias, no creep.  A slide ends where
the slip crosses zero and the torque needed to hold is within the static capacity; a hold ends where
that torque exceeds it.  Both instants are located on a ladder of halved steps down to
``period / 2**levels`` (1 us for 1 ms), always on the same absolute grid, so that splitting a run
between steps changes no bit.

The detailed plant hands :class:`.teeth.Extras` in: then the pistons' torque, dogs and meshes with play and
the books of travel and heat belong to the step as well.  Without them that code is compiled away.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import inlined_kernel, kernel, small_kernel
from hev_can_emu.moves import fill, move, same
from hev_can_emu.plant import teeth
from hev_can_emu.plant.bank import Bank
from hev_can_emu.plant.contact import any_dogs_meet, any_mesh_changes, let_dogs_in, settle_teeth
from hev_can_emu.plant.crank import crank_torque, wrap
from hev_can_emu.plant.holding import (
    HELD,
    LOCKED,
    MESH,
    N_INTEGERS,
    PARTED,
    RELEASED,
    REVERSED,
    ROW,
    SIDE,
    SIGN,
    TOUCHED,
    UNRESOLVED,
    any_overloaded,
    overloaded,
    record,
    release,
    set_row,
    slide,
    try_to_hold,
)
from hev_can_emu.plant.motion import all_rows, combine, combine_few, held_torque, row_speed
from hev_can_emu.plant.structure import ENGINE, G1, G2, N_PORTS
from hev_can_emu.plant.teeth import Extras

__all__ = [
    "HELD", "LOCKED", "MESH", "N_INTEGERS", "PARTED", "RELEASED", "REVERSED", "ROW", "SIGN", "TOUCHED",
    "energy", "friction_torque", "held_torque", "lock_torque", "look", "row_speed", "set_row", "step",
]  # fmt: skip

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Events = npt.NDArray[np.void]

MAX_EVENTS_PER_STEP = 24
MAX_COLUMNS = 48  # states and inputs of a driveline, filled up
SPEEDS = MAX_COLUMNS  #: places in what :func:`look` sees
CARRIED = SPEEDS + 16
AFTER = CARRIED + 8  #: the states whose speeds these are, then what a trial step makes besides
N_SEEN = AFTER + MAX_COLUMNS
TRIAL = MAX_COLUMNS + 160  #: values of scratch that a step needs

_STILL = 1e-12  # rad/s: slip that counts as none


@kernel
def _pistons(
    crank: Array,
    flow: Array,
    at: Integers,
    by: Array,
    books: Array,
    row: int,
    level: int,
    x: Array,
    nx: int,
    length: float,
    trial: Array,
) -> float:
    """Add the pistons' inertial torque to a trial step; return it, N m."""
    column = nx + ENGINE
    end_gain = 0.0
    for i in range(at.shape[1]):
        end_gain += by[ENGINE, i] * flow[row, level, column, at[ENGINE, i]]
    torque = crank_torque(
        crank, books[teeth.ANGLE], row_speed(at, by, x, ENGINE), row_speed(at, by, trial, ENGINE),
        trial[nx + ENGINE], end_gain, flow[row, level, column, nx + ENGINE], length,
        books[teeth.THROTTLE],
    )  # fmt: skip
    for i in range(flow.shape[3]):
        trial[i] += flow[row, level, column, i] * torque
    return torque


@kernel
def _book(u: Array, nx: int, locks: int, pistons: float, after: Array, books: Array) -> None:
    """Enter an accepted step: travel, gaps, crank angle, heat of slides, work of chamfers."""
    for i in range(N_PORTS):
        books[teeth.TRAVEL + i] += after[nx + i]
    for lock in range(locks):
        way = after[nx + N_PORTS + lock]
        books[teeth.TRAVEL + N_PORTS + lock] += way
        books[teeth.FRICTION + lock] -= u[N_PORTS + lock] * way
    for gear in range(2):
        way = after[nx + N_PORTS + G1 + gear]
        work = books[teeth.PAIR + gear] * way
        books[teeth.PAIR_WORK] += work
        books[teeth.FRICTION + G1 + gear] += work
        if books[teeth.HALF + gear] > 0.0:
            books[teeth.GAP + gear] += way
    turned = after[nx + ENGINE]
    books[teeth.ANGLE] = wrap(books[teeth.ANGLE] + turned)
    books[teeth.CRANK_WORK] += pistons * turned


@small_kernel
def _join(x: Array, u: Array, nx: int, z: Array) -> None:
    """``z = [x; u]``, filled up with zeros."""
    known = nx + u.shape[0]
    move(x, 0, z, 0, nx)
    move(u, 0, z, nx, u.shape[0])
    fill(z, known, z.shape[0] - known, 0.0)


@small_kernel
def _see_speeds(bank: Bank, x: Array, nx: int, seen: Array) -> None:
    """Write the speeds of ``x`` into ``seen``, unless they are there since the last look or step."""
    if same(x, 0, seen, AFTER, nx):
        return
    move(x, 0, seen, AFTER, nx)
    all_rows(bank.speeds, x, seen[SPEEDS:])


@inlined_kernel
def step(
    bank: Bank,
    x: Array,
    state: Integers,
    u: Array,
    kinetic: Array,
    static: Array,
    books: Array,
    trial: Array,
    t_ns: int,
    period_ns: int,
    events: Events,
    n_events: int,
    extras: Extras | None = None,
) -> int:
    """Advance one period; port torques and capacities are constant over it.

    Args:
        bank: propagators.
        x: shape (nx,), speeds then twists; advanced in place.
        state: shape (N_INTEGERS,), holds, signs, configuration; advanced in place.
        u: shape (nu,), N m: the four port torques on entry; friction torques are filled in.
        kinetic: shape (m,), sliding capacity of each lock, N m.
        static: shape (m,), holding capacity; infinite for engaged dogs.
        books: shape (1,), J, grows by the energy dropped at locks; with extras (teeth.N_BOOKS,).
        trial: scratch, shape (TRIAL,).
        t_ns: time at entry, ns.
        period_ns: length of the step, ns.
        events: EVENT records; ``n_events`` of them are taken.
        n_events: number of event records on entry.
        extras: of the detailed driveline, or None.

    Returns:
        The number of event records on return.
    """
    flow, held, at, by = bank.flow, bank.held_torque, bank.speed_at, bank.speed_by
    nx, nu = held.shape[2] - u.shape[0], u.shape[0]
    m = nu - N_PORTS
    levels = bank.levels
    units = 1 << levels
    nz, count = flow.shape[2], flow.shape[3]
    rows = bank.speeds.shape[1]
    z, speeds = trial[:nz], trial[SPEEDS : SPEEDS + rows]
    after, rest = trial[AFTER : AFTER + count], trial[AFTER + count :]
    torques, rates = rest[:rows], rest[rows:]
    pistons = 0.0
    engine_torque = u[ENGINE]
    toothed = extras is not None
    if extras is not None:
        for i in range(N_PORTS + m):
            books[teeth.TRAVEL + i] = 0.0
        for gear in (G1, G2):
            if state[SIDE + gear - G1] != 0 or books[teeth.HALF + gear - G1] > 0.0:
                let_dogs_in(bank, x, state, extras, books)
    # Frictions of the sliding locks first: what a held one carries depends on them.
    _see_speeds(bank, x, nx, trial)
    still = False
    for lock in range(m):
        u[N_PORTS + lock] = 0.0
        if state[HELD + lock] == 0:
            if kinetic[lock] > 0.0:
                speed = speeds[N_PORTS + lock]
                if abs(speed) < _STILL:
                    still = True
                if speed > 0.0:
                    state[SIGN + lock] = 1
                elif speed < 0.0:
                    state[SIGN + lock] = -1
            slide(state, u, kinetic, books, lock, toothed)
    if still:
        for lock in range(m):
            if (
                state[HELD + lock] == 0
                and kinetic[lock] > 0.0
                and abs(row_speed(at, by, x, N_PORTS + lock)) < _STILL
            ):
                if try_to_hold(bank, x, state, u, static, lock, books, extras):
                    n_events = record(state, t_ns, LOCKED, lock, 0.0, events, n_events)
                else:
                    slide(state, u, kinetic, books, lock, toothed)
    holding = False
    for lock in range(m):
        if state[HELD + lock] == 1:
            holding = True
    _join(x, u, nx, z)
    joined = True
    if holding:
        combine_few(bank.held_columns, bank.held_places, bank.held_counts, state[ROW], z, torques)
        if any_overloaded(torques, state, static, books, m, toothed):
            joined = False
            for lock in range(m):
                if state[HELD + lock] == 1 and overloaded(
                    held, x, u, state, static, books, lock, toothed
                ):
                    n_events = release(
                        bank, x, state, u, kinetic, static, books, lock, extras, t_ns, events,
                        n_events,
                    )  # fmt: skip

    position = 0
    happened = 0
    level = levels
    while position < units:
        while (position & ((1 << level) - 1)) != 0 or position + (1 << level) > units:
            level -= 1
        row = state[ROW]
        if not joined:
            _join(x, u, nx, z)
        joined = False
        combine(flow, row, level, z, after)
        length = 0.0
        if extras is not None:
            length = bank.period * (1 << level) / units
            if extras.crank.shape[0] > 0:
                pistons = _pistons(
                    extras.crank, flow, at, by, books, row, level, x, nx, length, after
                )
                u[ENGINE] = engine_torque + pistons
        eventful = False
        all_rows(bank.speeds, after, speeds)
        holding = False
        for lock in range(m):
            if state[HELD + lock] == 1:
                holding = True
            elif kinetic[lock] > 0.0 and speeds[N_PORTS + lock] * state[SIGN + lock] < -_STILL:
                eventful = True
        if holding:
            _join(after, u, nx, z)
            combine_few(bank.held_columns, bank.held_places, bank.held_counts, row, z, torques)
            if any_overloaded(torques, state, static, books, m, toothed):
                eventful = True
        if extras is not None:
            if any_dogs_meet(at, by, after, nx, state, books):
                eventful = True
            if extras.mesh.shape[0] > 0 and any_mesh_changes(after, state, extras):
                eventful = True
        if eventful and happened < MAX_EVENTS_PER_STEP and level > 0:
            level -= 1
            u[ENGINE] = engine_torque
            continue
        if extras is not None:
            _book(u, nx, m, pistons, after, books)
            if extras.middle > 0:
                branches = extras.rates.shape[1]
                first, last = rates[:branches], rates[branches : 2 * branches]
                all_rows(extras.rates, x, first)
                all_rows(extras.rates, after, last)
                teeth.book_dampers(
                    extras.damping, length, first, after[extras.middle :], last, books
                )
            u[ENGINE] = engine_torque
        move(after, 0, x, 0, nx)
        position += 1 << level
        level = levels
        if not eventful:
            continue
        if happened >= MAX_EVENTS_PER_STEP:
            if happened == MAX_EVENTS_PER_STEP:
                state[UNRESOLVED] += 1
                happened += 1
            continue
        happened += 1
        now = t_ns + (position * period_ns) // units
        for lock in range(m):
            if (
                state[HELD + lock] == 0
                and kinetic[lock] > 0.0
                and row_speed(at, by, x, N_PORTS + lock) * state[SIGN + lock] < -_STILL
            ):
                if try_to_hold(bank, x, state, u, static, lock, books, extras):
                    n_events = record(state, now, LOCKED, lock, 0.0, events, n_events)
                else:
                    slide(state, u, kinetic, books, lock, toothed)
                    if static[lock] > 0.0:
                        n_events = record(state, now, REVERSED, lock, 0.0, events, n_events)
        if extras is not None:
            n_events = settle_teeth(bank, x, state, books, extras, now, events, n_events)
        for lock in range(m):
            if state[HELD + lock] == 1 and overloaded(
                held, x, u, state, static, books, lock, toothed
            ):
                n_events = release(
                    bank, x, state, u, kinetic, static, books, lock, extras, now, events, n_events
                )
    return n_events


@kernel
def lock_torque(held: Array, x: Array, state: Integers, u: Array, lock: int) -> float:
    """As :func:`friction_torque`, for the bank's ``held_torque``."""
    if state[HELD + lock] == 1:
        return held_torque(held, x, u, state[ROW], lock)
    return float(u[N_PORTS + lock])


@kernel
def friction_torque(bank: Bank, x: Array, state: Integers, u: Array, lock: int) -> float:
    """Return the friction torque at a lock now, held or sliding, N m on its first side."""
    return lock_torque(bank.held_torque, x, state, u, lock)


@small_kernel
def look(bank: Bank, x: Array, state: Integers, u: Array, seen: Array) -> None:
    """Write what can be read off the driveline now.

    ``seen``, shape (N_SEEN,): from ``SPEEDS`` on the speeds at the ports and slips at the locks, rad/s;
    from ``CARRIED`` on each lock's friction torque, held or sliding, N m on its first side, then the body's
    angular acceleration, rad/s^2.  It may be the scratch of :func:`step`.
    """
    nu, nz = u.shape[0], bank.flow.shape[2]
    nx, locks = bank.held_torque.shape[2] - nu, nu - N_PORTS
    _join(x, u, nx, seen[:nz])
    _see_speeds(bank, x, nx, seen)
    combine_few(
        bank.held_columns, bank.held_places, bank.held_counts, state[ROW], seen, seen[CARRIED:]
    )
    for lock in range(locks):
        if state[HELD + lock] == 0:
            seen[CARRIED + lock] = u[N_PORTS + lock]


@kernel
def energy(bank: Bank, x: Array, state: Integers) -> float:
    """Return kinetic plus elastic energy, J; parted meshes count as if they touched."""
    n = bank.inertia.shape[0]
    q = bank.stiffness.shape[1]
    total = 0.0
    for i in range(n):
        total += 0.5 * bank.inertia[i] * x[i] * x[i]
    driving = state[ROW] % 6
    for i in range(q):
        for j in range(q):
            total += 0.5 * x[n + i] * bank.stiffness[driving, i, j] * x[n + j]
    return total
