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

from hev_can_emu.jit import kernel
from hev_can_emu.plant import teeth
from hev_can_emu.plant.bank import Bank
from hev_can_emu.plant.crank import crank_torque, wrap
from hev_can_emu.plant.events import note
from hev_can_emu.plant.structure import BODY, C1, ENGINE, G1, G2, LEFT, REAR, RIGHT
from hev_can_emu.plant.teeth import LOST, Extras

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

N_LOCKS = teeth.N_LOCKS
N_PORTS = 4
# Integer state of a driveline: whether each lock holds, the sign of each slide, then:
HELD = 0
SIGN = N_LOCKS
ROW = 2 * N_LOCKS  # index of the configuration
EVENTS = 2 * N_LOCKS + 1  # lock and release events since the start
UNRESOLVED = 2 * N_LOCKS + 2  # steps in which events came faster than the ladder resolves
SIDE = 2 * N_LOCKS + 3  # of the dogs' play at which G1 and G2 are held: -1, +1, or 0
MESH = 2 * N_LOCKS + 5  # of each mesh with play, the flank that touches, or 0
MAX_MESHES = 2
N_INTEGERS = MESH + MAX_MESHES

MAX_EVENTS_PER_STEP = 24

LOCKED, RELEASED, REVERSED = 1, 2, 3  #: kinds of driveline events; ``value`` is the held torque
TOUCHED, PARTED = 4, 5  #: teeth: index of the lock, or 10 + mesh; ``value`` is the slip, N m or N
MESH_EVENT = 10

_STILL = 1e-12  # rad/s: slip that counts as none


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
def row_of(state: Integers, extras: Extras | None = None) -> int:
    """Return the configuration's row from the hold flags and touching meshes."""
    row = state[HELD + C1] + 6 * state[HELD + LEFT] + 12 * state[HELD + RIGHT]
    row += 24 * state[HELD + BODY] + 48 * state[HELD + REAR]
    if state[HELD + G1] == 1:
        row += 2
    elif state[HELD + G2] == 1:
        row += 4
    if extras is not None:
        row += teeth.mesh_row(extras, state[MESH : MESH + MAX_MESHES])
    return int(row)


@kernel
def row_speed(rows: Array, x: Array, row: int) -> float:
    """Return ``rows[row] @ speeds``, rad/s: the slip at a lock, or the speed at a port.

    Takes the array rather than the bank: handing the whole bank on costs more than the sum.
    """
    total = 0.0
    for i in range(rows.shape[1]):
        if rows[row, i] != 0.0:
            total += rows[row, i] * x[i]
    return total


@kernel
def held_torque(rows: Array, x: Array, u: Array, row: int, lock: int) -> float:
    """Return the friction torque that a held lock carries, N m (on its first side).

    ``rows`` is the bank's ``held_torque``.
    """
    nx = rows.shape[2] - u.shape[0]
    # Four sums side by side: one alone would wait for each addition.
    a = b = c = d = 0.0
    j = 0
    while j + 3 < nx:
        a += rows[row, lock, j] * x[j]
        b += rows[row, lock, j + 1] * x[j + 1]
        c += rows[row, lock, j + 2] * x[j + 2]
        d += rows[row, lock, j + 3] * x[j + 3]
        j += 4
    while j < nx:
        a += rows[row, lock, j] * x[j]
        j += 1
    for k in range(u.shape[0]):
        b += rows[row, lock, nx + k] * u[k]
    return (a + b) + (c + d)


@kernel
def propagate(flow: Array, row: int, level: int, x: Array, u: Array, out: Array) -> None:
    """``out = F [x; u]``, one exact step of ``unit * 2**level``; ``flow`` is the bank's.

    ``out`` has the states, then the travels where the bank has them; ``x`` is read as far as it goes.
    """
    count = flow.shape[3]
    nx = flow.shape[2] - u.shape[0]
    for i in range(count):
        out[i] = 0.0
    # Four columns at a time: the sums are loaded and stored a quarter as often.
    j = 0
    while j + 3 < nx:
        x0, x1, x2, x3 = x[j], x[j + 1], x[j + 2], x[j + 3]
        for i in range(count):
            out[i] += (flow[row, level, j, i] * x0 + flow[row, level, j + 1, i] * x1) + (
                flow[row, level, j + 2, i] * x2 + flow[row, level, j + 3, i] * x3
            )
        j += 4
    while j < nx:
        factor = x[j]
        for i in range(count):
            out[i] += flow[row, level, j, i] * factor
        j += 1
    for k in range(u.shape[0]):
        factor = u[k]
        if factor != 0.0:
            for i in range(count):
                out[i] += flow[row, level, nx + k, i] * factor


@kernel
def _try_to_hold(
    bank: Bank,
    x: Array,
    state: Integers,
    u: Array,
    static: Array,
    lock: int,
    books: Array,
    extras: Extras | None,
) -> bool:
    """At zero slip: hold if the static capacity suffices, else slide on in the direction pushed."""
    other_gear = G2 if lock == G1 else G1
    if lock in (G1, G2) and state[HELD + other_gear] == 1:
        return False
    state[HELD + lock] = 1
    candidate = row_of(state, extras)
    n = bank.inertia.shape[0]
    nx = n + bank.stiffness.shape[1]
    before = np.empty(nx)
    for i in range(nx):
        before[i] = x[i]
    old = state[ROW]
    saved_friction = u[N_PORTS + lock]
    dropped = set_row(bank, x, state, candidate)
    u[N_PORTS + lock] = 0.0
    torque = held_torque(bank.held_torque, x, u, candidate, lock)
    if abs(torque) <= static[lock]:
        books[LOST] += dropped
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
def _presses(
    state: Integers, books: Array, lock: int, torque: float, extras: Extras | None
) -> bool:
    """Return whether a rigidly held lock stays: dogs at an end of their play only push."""
    if extras is not None and lock in (G1, G2) and books[teeth.HALF + lock - G1] > 0.0:
        return bool(torque * state[SIDE + lock - G1] <= 0.0)
    return True


@kernel
def _release_overloaded(
    bank: Bank,
    x: Array,
    state: Integers,
    u: Array,
    kinetic: Array,
    static: Array,
    books: Array,
    extras: Extras | None,
    t_ns: int,
    events: npt.NDArray[np.void],
    n_events: int,
) -> int:
    """Release every held lock whose torque exceeds its static capacity, and dogs that would pull."""
    for lock in range(bank.locks.shape[0]):
        if state[HELD + lock] == 0:
            continue
        rigid = np.isinf(static[lock])
        if rigid and extras is None:
            continue
        torque = held_torque(bank.held_torque, x, u, state[ROW], lock)
        if rigid:
            if _presses(state, books, lock, torque, extras):
                continue
        elif abs(torque) <= static[lock] and static[lock] > 0.0:
            continue
        state[HELD + lock] = 0
        state[SIGN + lock] = -1 if torque > 0.0 else 1
        set_row(bank, x, state, row_of(state, extras))
        u[N_PORTS + lock] = -state[SIGN + lock] * kinetic[lock]
        kind = PARTED if rigid else RELEASED
        if lock in (G1, G2):
            state[SIDE + lock - G1] = 0
        n_events = _note(state, t_ns, kind, lock, torque, events, n_events)
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
def _dogs_meet(bank: Bank, x: Array, books: Array, lock: int, travel: float) -> int:
    """Return the end of its play that a free gear with its dogs in has run against, or 0."""
    half = books[teeth.HALF + lock - G1]
    if half > 0.0:
        place = books[teeth.GAP + lock - G1] + travel
        if abs(place) >= half:
            slip = row_speed(bank.locks, x, lock)
            if place > 0.0 and slip > 0.0:
                return 1
            if place < 0.0 and slip < 0.0:
                return -1
    return 0


@kernel
def _let_dogs_in(bank: Bank, x: Array, state: Integers, extras: Extras, books: Array) -> None:
    """Dogs that have just come in take over from the cone, which lets go."""
    for lock in (G1, G2):
        if books[teeth.HALF + lock - G1] > 0.0:
            if state[HELD + lock] == 1 and state[SIDE + lock - G1] == 0:
                state[HELD + lock] = 0
                set_row(bank, x, state, row_of(state, extras))
        else:
            state[SIDE + lock - G1] = 0


@kernel
def _teeth_change(bank: Bank, x: Array, state: Integers, books: Array, extras: Extras) -> bool:
    """Return whether any teeth touch or part at ``x``, the end of a step not yet taken."""
    nx = bank.inertia.shape[0] + bank.stiffness.shape[1]
    for lock in (G1, G2):
        if (
            state[HELD + lock] == 0
            and _dogs_meet(bank, x, books, lock, x[nx + N_PORTS + lock]) != 0
        ):
            return True
    for i in range(extras.mesh.shape[0]):
        if teeth.mesh_changes(extras, x, state[MESH + i], i) != state[MESH + i]:
            return True
    return False


@kernel
def _settle_teeth(
    bank: Bank,
    x: Array,
    state: Integers,
    books: Array,
    extras: Extras,
    t_ns: int,
    events: npt.NDArray[np.void],
    n_events: int,
) -> int:
    """Let teeth touch and part at this instant."""
    n = bank.inertia.shape[0]
    for lock in (G1, G2):
        if state[HELD + lock] == 1:
            continue
        side = _dogs_meet(bank, x, books, lock, 0.0)
        if side != 0:
            slip = row_speed(bank.locks, x, lock)
            books[teeth.GAP + lock - G1] = side * books[teeth.HALF + lock - G1]
            state[SIDE + lock - G1] = side
            state[HELD + lock] = 1
            books[teeth.LOST_DOGS] += set_row(bank, x, state, row_of(state, extras))
            n_events = _note(state, t_ns, TOUCHED, lock, slip, events, n_events)
    for i in range(extras.mesh.shape[0]):
        before = state[MESH + i]
        after = teeth.mesh_changes(extras, x, before, i)
        if after == before:
            continue
        twist = n + extras.mesh[i]
        value = x[twist]
        if after == 0:
            # What is still compressed springs back without pushing anything.
            books[teeth.LOST_MESH] += 0.5 * extras.mesh_stiffness[i] * value * value
            x[twist] = value + before * extras.mesh_half[i]
        else:
            x[twist] = value - after * extras.mesh_half[i]
            books[teeth.LOST_MESH] -= 0.5 * extras.mesh_stiffness[i] * x[twist] * x[twist]
        state[MESH + i] = after
        state[ROW] = row_of(state, extras)
        kind = PARTED if after == 0 else TOUCHED
        n_events = _note(state, t_ns, kind, MESH_EVENT + i, value, events, n_events)
    return n_events


@kernel
def _add_pistons(
    bank: Bank,
    extras: Extras,
    books: Array,
    row: int,
    level: int,
    x: Array,
    length: float,
    trial: Array,
) -> float:
    """Add the pistons' inertial torque to a trial step; return it, N m."""
    nx = bank.inertia.shape[0] + bank.stiffness.shape[1]
    column = nx + ENGINE
    flow = bank.flow
    end_gain = end = 0.0
    for i in range(bank.inertia.shape[0]):
        if bank.ports[ENGINE, i] != 0.0:
            end += bank.ports[ENGINE, i] * trial[i]
            end_gain += bank.ports[ENGINE, i] * flow[row, level, column, i]
    torque = crank_torque(
        extras.crank, books[teeth.ANGLE], row_speed(bank.ports, x, ENGINE), end,
        trial[nx + ENGINE], end_gain, flow[row, level, column, nx + ENGINE], length,
        books[teeth.THROTTLE],
    )  # fmt: skip
    for i in range(flow.shape[3]):
        trial[i] += flow[row, level, column, i] * torque
    return torque


@kernel
def _book(
    bank: Bank,
    extras: Extras,
    books: Array,
    row: int,
    level: int,
    x: Array,
    u: Array,
    pistons: float,
    length: float,
    trial: Array,
) -> None:
    """Enter an accepted step: travel, gaps, crank angle, heat of slides and dampers."""
    nx = bank.inertia.shape[0] + bank.stiffness.shape[1]
    for i in range(N_PORTS + bank.locks.shape[0]):
        books[teeth.TRAVEL + i] += trial[nx + i]
    for lock in range(bank.locks.shape[0]):
        books[teeth.FRICTION + lock] -= u[N_PORTS + lock] * trial[nx + N_PORTS + lock]
    for lock in (G1, G2):
        if books[teeth.HALF + lock - G1] > 0.0:
            books[teeth.GAP + lock - G1] += trial[nx + N_PORTS + lock]
    turned = trial[nx + ENGINE]
    books[teeth.ANGLE] = wrap(books[teeth.ANGLE] + turned)
    books[teeth.CRANK_WORK] += pistons * turned
    if extras.nodes.shape[0] > 0:
        teeth.book_dampers(extras, row, level, length, x, u, trial, books)


@kernel
def step(
    bank: Bank,
    x: Array,
    state: Integers,
    u: Array,
    kinetic: Array,
    static: Array,
    books: Array,
    t_ns: int,
    period_ns: int,
    events: npt.NDArray[np.void],
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
        t_ns: time at entry, ns.
        period_ns: length of the step, ns.
        events: EVENT records; ``n_events`` of them are taken.
        n_events: number of event records on entry.
        extras: of the detailed driveline, or None.

    Returns:
        The number of event records on return.
    """
    nx = bank.inertia.shape[0] + bank.stiffness.shape[1]
    m = bank.locks.shape[0]
    levels = bank.levels
    units = 1 << levels
    trial = np.empty(bank.flow.shape[3])
    pistons = 0.0
    engine_torque = u[ENGINE]
    if extras is not None:
        for i in range(N_PORTS + m):
            books[teeth.TRAVEL + i] = 0.0
        _let_dogs_in(bank, x, state, extras, books)
    for lock in range(m):
        u[N_PORTS + lock] = 0.0
    # Frictions of the sliding locks first: what a held one carries depends on them.
    for lock in range(m):
        if state[HELD + lock] == 0 and kinetic[lock] > 0.0:
            speed = row_speed(bank.locks, x, lock)
            if speed > 0.0:
                state[SIGN + lock] = 1
            elif speed < 0.0:
                state[SIGN + lock] = -1
            u[N_PORTS + lock] = -state[SIGN + lock] * kinetic[lock]
    for lock in range(m):
        if (
            state[HELD + lock] == 0
            and kinetic[lock] > 0.0
            and abs(row_speed(bank.locks, x, lock)) < _STILL
        ):
            if _try_to_hold(bank, x, state, u, static, lock, books, extras):
                n_events = _note(state, t_ns, LOCKED, lock, 0.0, events, n_events)
            else:
                u[N_PORTS + lock] = -state[SIGN + lock] * kinetic[lock]
    n_events = _release_overloaded(
        bank, x, state, u, kinetic, static, books, extras, t_ns, events, n_events
    )

    position = 0
    happened = 0
    level = levels
    while position < units:
        while (position & ((1 << level) - 1)) != 0 or position + (1 << level) > units:
            level -= 1
        row = state[ROW]
        propagate(bank.flow, row, level, x, u, trial)
        length = 0.0
        if extras is not None:
            length = bank.period * (1 << level) / units
            if extras.crank.shape[0] > 0:
                pistons = _add_pistons(bank, extras, books, row, level, x, length, trial)
                u[ENGINE] = engine_torque + pistons
        eventful = False
        for lock in range(m):
            if state[HELD + lock] == 1:
                rigid = np.isinf(static[lock])
                if rigid and extras is None:
                    continue
                torque = held_torque(bank.held_torque, trial, u, row, lock)
                if rigid:
                    if not _presses(state, books, lock, torque, extras):
                        eventful = True
                elif abs(torque) > static[lock]:
                    eventful = True
            elif (
                kinetic[lock] > 0.0
                and row_speed(bank.locks, trial, lock) * state[SIGN + lock] < -_STILL
            ):
                eventful = True
        if extras is not None and _teeth_change(bank, trial, state, books, extras):
            eventful = True
        if eventful and happened < MAX_EVENTS_PER_STEP and level > 0:
            level -= 1
            u[ENGINE] = engine_torque
            continue
        if extras is not None:
            _book(bank, extras, books, row, level, x, u, pistons, length, trial)
            u[ENGINE] = engine_torque
        for i in range(nx):
            x[i] = trial[i]
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
                and row_speed(bank.locks, x, lock) * state[SIGN + lock] < -_STILL
            ):
                if _try_to_hold(bank, x, state, u, static, lock, books, extras):
                    n_events = _note(state, now, LOCKED, lock, 0.0, events, n_events)
                else:
                    u[N_PORTS + lock] = -state[SIGN + lock] * kinetic[lock]
                    n_events = _note(state, now, REVERSED, lock, 0.0, events, n_events)
        if extras is not None:
            n_events = _settle_teeth(bank, x, state, books, extras, now, events, n_events)
        n_events = _release_overloaded(
            bank, x, state, u, kinetic, static, books, extras, now, events, n_events
        )
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
    nx = bank.inertia.shape[0] + bank.stiffness.shape[1]
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
