"""The driveline's compiled step: exact motion between events, dry friction that truly sticks.

Each lock (C1, sleeve on G1 or G2, brakes, body at rest) either slides, with its kinetic capacity against
the slip, or holds, which is a configuration of its own: merged inertias, no creep.  A slide ends where
the slip crosses zero and the torque needed to hold is within the static capacity; a hold ends where
that torque exceeds it.  Both instants are located on a ladder of halved steps down to
``period / 2**levels`` (1 us for 1 ms), always on the same absolute grid, so that splitting a run
between steps changes no bit.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.plant.bank import Bank
from hev_can_emu.plant.events import note

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

N_LOCKS = 6
N_PORTS = 4
# Integer state of a driveline: whether each lock holds, the sign of each slide, then:
HELD = 0
SIGN = N_LOCKS
ROW = 2 * N_LOCKS  # index of the configuration
EVENTS = 2 * N_LOCKS + 1  # lock and release events since the start
UNRESOLVED = 2 * N_LOCKS + 2  # steps in which events came faster than the ladder resolves
N_INTEGERS = 2 * N_LOCKS + 3

MAX_EVENTS_PER_STEP = 24

LOCKED, RELEASED, REVERSED = 1, 2, 3  #: kinds of driveline events; ``value`` is the held torque


@kernel
def set_row(bank: Bank, x: Array, state: Integers, row: int) -> float:
    """Go to configuration ``row``: keep momentum and half-shaft torque; return the energy lost, J."""
    n = bank.inertia.shape[0]
    q = bank.stiffness.shape[1]
    old = state[ROW]
    lost = 0.0
    if row == old:
        return lost
    old_driving = old % 6
    new_driving = row % 6
    speeds = np.empty(n)
    for i in range(n):
        lost += 0.5 * bank.inertia[i] * x[i] * x[i]
        total = 0.0
        for j in range(n):
            total += bank.project[row, i, j] * x[j]
        speeds[i] = total
    for i in range(n):
        x[i] = speeds[i]
        lost -= 0.5 * bank.inertia[i] * x[i] * x[i]
    if old_driving != new_driving:
        twists = np.empty(q)
        for i in range(q):
            total = 0.0
            for j in range(q):
                lost += 0.5 * x[n + i] * bank.stiffness[old_driving, i, j] * x[n + j]
                total += bank.remap[old_driving, new_driving, i, j] * x[n + j]
            twists[i] = total
        for i in range(q):
            x[n + i] = twists[i]
        for i in range(q):
            for j in range(q):
                lost -= 0.5 * x[n + i] * bank.stiffness[new_driving, i, j] * x[n + j]
    state[ROW] = row
    return lost


@kernel
def row_of(state: Integers) -> int:
    """Return the configuration's row from the hold flags."""
    gear = 0
    if state[HELD + 1] == 1:
        gear = 1
    elif state[HELD + 2] == 1:
        gear = 2
    return int(
        state[HELD] + 2 * gear + 6 * state[HELD + 3] + 12 * state[HELD + 4] + 24 * state[HELD + 5]
    )


@kernel
def row_speed(rows: Array, x: Array, row: int) -> float:
    """Return ``rows[row] @ speeds``, rad/s: the slip at a lock, or the speed at a port.

    Takes the array rather than the bank: handing the whole bank on costs more than the sum.
    """
    total = 0.0
    for i in range(rows.shape[1]):
        total += rows[row, i] * x[i]
    return total


@kernel
def held_torque(rows: Array, x: Array, u: Array, row: int, lock: int) -> float:
    """Return the friction torque that a held lock carries, N m (on its first side).

    ``rows`` is the bank's ``held_torque``.
    """
    nx = rows.shape[2] - u.shape[0]
    total = 0.0
    for j in range(nx):
        total += rows[row, lock, j] * x[j]
    for j in range(u.shape[0]):
        total += rows[row, lock, nx + j] * u[j]
    return total


@kernel
def propagate(flow: Array, row: int, level: int, x: Array, u: Array, out: Array) -> None:
    """``out = F [x; u]``, one exact step of ``unit * 2**level``; ``flow`` is the bank's."""
    nx = flow.shape[3]
    for i in range(nx):
        out[i] = 0.0
    for j in range(nx):
        factor = x[j]
        for i in range(nx):
            out[i] += flow[row, level, j, i] * factor
    for j in range(u.shape[0]):
        factor = u[j]
        if factor != 0.0:
            for i in range(nx):
                out[i] += flow[row, level, nx + j, i] * factor


@kernel
def _try_to_hold(
    bank: Bank, x: Array, state: Integers, u: Array, static: Array, lock: int, lost: Array
) -> bool:
    """At zero slip: hold if the static capacity suffices, else slide on in the direction pushed."""
    gear_taken = (lock == 1 and state[HELD + 2] == 1) or (lock == 2 and state[HELD + 1] == 1)
    state[HELD + lock] = 1
    if gear_taken:
        state[HELD + lock] = 0
        return False
    candidate = row_of(state)
    n = bank.inertia.shape[0]
    nx = bank.flow.shape[3]
    before = np.empty(nx)
    for i in range(nx):
        before[i] = x[i]
    old = state[ROW]
    saved_friction = u[N_PORTS + lock]
    dropped = set_row(bank, x, state, candidate)
    u[N_PORTS + lock] = 0.0
    torque = held_torque(bank.held_torque, x, u, candidate, lock)
    if abs(torque) <= static[lock]:
        lost[0] += dropped
        return True
    state[HELD + lock] = 0
    # Not held: slip is exactly zero now and grows the way it is pushed.
    for i in range(n, nx):
        x[i] = before[i]
    state[ROW] = old
    u[N_PORTS + lock] = saved_friction
    state[SIGN + lock] = -1 if torque > 0.0 else 1
    return False


@kernel
def _release_overloaded(
    bank: Bank,
    x: Array,
    state: Integers,
    u: Array,
    kinetic: Array,
    static: Array,
    t_ns: int,
    events: npt.NDArray[np.void],
    n_events: int,
) -> int:
    """Release every held lock whose torque exceeds its static capacity."""
    for lock in range(N_LOCKS):
        if state[HELD + lock] == 0 or np.isinf(static[lock]):
            continue
        torque = held_torque(bank.held_torque, x, u, state[ROW], lock)
        if abs(torque) > static[lock] or static[lock] <= 0.0:
            state[HELD + lock] = 0
            state[SIGN + lock] = -1 if torque > 0.0 else 1
            set_row(bank, x, state, row_of(state))
            u[N_PORTS + lock] = -state[SIGN + lock] * kinetic[lock]
            n_events = _note(state, t_ns, RELEASED, lock, torque, events, n_events)
    return n_events


@kernel
def _note(
    state: Integers,
    t_ns: int,
    kind: int,
    lock: int,
    value: float,
    events: npt.NDArray[np.void],
    n_events: int,
) -> int:
    """Count an event and append its record."""
    state[EVENTS] += 1
    return note(events, n_events, t_ns, kind, lock, value)


@kernel
def step(
    bank: Bank,
    x: Array,
    state: Integers,
    u: Array,
    kinetic: Array,
    static: Array,
    lost: Array,
    t_ns: int,
    period_ns: int,
    events: npt.NDArray[np.void],
    n_events: int,
) -> int:
    """Advance one period; port torques and capacities are constant over it.

    Args:
        bank: propagators.
        x: shape (nx,), speeds then twists; advanced in place.
        state: shape (N_INTEGERS,), holds, signs, configuration; advanced in place.
        u: shape (10,), N m: the four port torques on entry; friction torques are filled in.
        kinetic: shape (6,), sliding capacity of each lock, N m.
        static: shape (6,), holding capacity; infinite for engaged dogs.
        lost: shape (1,), J, grows by the energy dropped at locks.
        t_ns: time at entry, ns.
        period_ns: length of the step, ns.
        events: EVENT records; ``n_events`` of them are taken.
        n_events: number of event records on entry.

    Returns:
        The number of event records on return.
    """
    nx = bank.flow.shape[3]
    levels = bank.levels
    units = 1 << levels
    trial = np.empty(nx)
    for lock in range(N_LOCKS):
        u[N_PORTS + lock] = 0.0
    # Frictions of the sliding locks first: what a held one carries depends on them.
    for lock in range(N_LOCKS):
        if state[HELD + lock] == 0 and kinetic[lock] > 0.0:
            speed = row_speed(bank.locks, x, lock)
            if speed > 0.0:
                state[SIGN + lock] = 1
            elif speed < 0.0:
                state[SIGN + lock] = -1
            u[N_PORTS + lock] = -state[SIGN + lock] * kinetic[lock]
    for lock in range(N_LOCKS):
        if (
            state[HELD + lock] == 0
            and kinetic[lock] > 0.0
            and abs(row_speed(bank.locks, x, lock)) < 1e-12
        ):
            if _try_to_hold(bank, x, state, u, static, lock, lost):
                n_events = _note(state, t_ns, LOCKED, lock, 0.0, events, n_events)
            else:
                u[N_PORTS + lock] = -state[SIGN + lock] * kinetic[lock]
    n_events = _release_overloaded(bank, x, state, u, kinetic, static, t_ns, events, n_events)

    position = 0
    happened = 0
    level = levels
    while position < units:
        while (position & ((1 << level) - 1)) != 0 or position + (1 << level) > units:
            level -= 1
        row = state[ROW]
        propagate(bank.flow, row, level, x, u, trial)
        crossing = -1
        overload = False
        for lock in range(N_LOCKS):
            if state[HELD + lock] == 1:
                if not np.isinf(static[lock]):
                    torque = held_torque(bank.held_torque, trial, u, row, lock)
                    if abs(torque) > static[lock]:
                        overload = True
            elif (
                kinetic[lock] > 0.0
                and row_speed(bank.locks, trial, lock) * state[SIGN + lock] < -1e-12
            ):
                crossing = lock
        eventful = crossing >= 0 or overload
        if eventful and happened < MAX_EVENTS_PER_STEP and level > 0:
            level -= 1
            continue
        for i in range(nx):
            x[i] = trial[i]
        position += 1 << level
        if not eventful:
            if level < levels:
                level = levels
            continue
        if happened >= MAX_EVENTS_PER_STEP:
            if happened == MAX_EVENTS_PER_STEP:
                state[UNRESOLVED] += 1
                happened += 1
            level = levels
            continue
        happened += 1
        now = t_ns + (position * period_ns) // units
        for lock in range(N_LOCKS):
            if (
                state[HELD + lock] == 0
                and kinetic[lock] > 0.0
                and row_speed(bank.locks, x, lock) * state[SIGN + lock] < -1e-12
            ):
                if _try_to_hold(bank, x, state, u, static, lock, lost):
                    n_events = _note(state, now, LOCKED, lock, 0.0, events, n_events)
                else:
                    u[N_PORTS + lock] = -state[SIGN + lock] * kinetic[lock]
                    n_events = _note(state, now, REVERSED, lock, 0.0, events, n_events)
        n_events = _release_overloaded(bank, x, state, u, kinetic, static, now, events, n_events)
        level = levels
    return n_events


@kernel
def friction_torque(bank: Bank, x: Array, state: Integers, u: Array, lock: int) -> float:
    """Return the friction torque at a lock now, held or sliding, N m on its first side."""
    if state[HELD + lock] == 1:
        return held_torque(bank.held_torque, x, u, state[ROW], lock)
    return float(u[N_PORTS + lock])


@kernel
def body_acceleration(bank: Bank, x: Array, state: Integers, u: Array) -> float:
    """Return the body's angular acceleration, rad/s^2."""
    nx = bank.flow.shape[3]
    row = state[ROW]
    total = 0.0
    for j in range(nx):
        total += bank.body_rate[row, j] * x[j]
    for j in range(u.shape[0]):
        total += bank.body_rate[row, nx + j] * u[j]
    return total


@kernel
def energy(bank: Bank, x: Array, state: Integers) -> float:
    """Return kinetic plus elastic energy, J."""
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
