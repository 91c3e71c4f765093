"""Locks that hold or slide: the integer state, switches of configuration, catching and letting go.

These run at events only, so they take the whole bank.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import counting_kernel, kernel
from hev_can_emu.plant import teeth
from hev_can_emu.plant.bank import Bank
from hev_can_emu.plant.events import note
from hev_can_emu.plant.motion import held_torque
from hev_can_emu.plant.structure import BODY, C1, G1, G2, LEFT, N_PORTS, REAR, RIGHT
from hev_can_emu.plant.teeth import LOST, PAIR, Extras

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Events = npt.NDArray[np.void]

N_LOCKS = teeth.N_LOCKS
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

LOCKED, RELEASED, REVERSED = 1, 2, 3  #: kinds of driveline events; ``value`` is the held torque
TOUCHED, PARTED = 4, 5  #: teeth: index of the lock, or 10 + mesh; ``value`` is the slip, N m or N
MESH_EVENT = 10


@kernel
def record(
    state: Integers, t_ns: int, kind: int, lock: int, value: float, events: Events, n_events: int
) -> int:
    """Count an event and append its record."""
    state[EVENTS] += 1
    return note(events, n_events, t_ns, kind, lock, value)


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


@counting_kernel
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
def pair_torque(books: Array, lock: int, toothed: bool) -> float:
    """Return what else acts between the two sides of a lock (chamfers of the dogs), N m."""
    if toothed and lock in (G1, G2):
        return float(books[PAIR + lock - G1])
    return 0.0


@kernel
def slide(
    state: Integers, u: Array, kinetic: Array, books: Array, lock: int, toothed: bool
) -> None:
    """Let a lock slide in the direction of its sign; ``toothed``: there are extras."""
    pair = pair_torque(books, lock, toothed)
    u[N_PORTS + lock] = pair - state[SIGN + lock] * max(kinetic[lock], 0.0)


@counting_kernel
def try_to_hold(
    bank: Bank,
    x: Array,
    state: Integers,
    u: Array,
    static: Array,
    lock: int,
    books: Array,
    extras: Extras | None,
) -> bool:
    """At zero slip: hold if the static capacity suffices, else turn the sign to the way it is pushed."""
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
    torque -= pair_torque(books, lock, extras is not None)
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
def must_go(
    torque: float, state: Integers, static: Array, books: Array, lock: int, toothed: bool
) -> bool:
    """Return whether a held lock that carries ``torque`` N m must let go.

    Beyond its static capacity, or dogs at an end of their play that would pull.
    """
    if np.isinf(static[lock]):
        if not toothed or lock not in (G1, G2) or not books[teeth.HALF + lock - G1] > 0.0:
            return False
        return bool(torque * state[SIDE + lock - G1] > 0.0)
    if static[lock] <= 0.0:
        return True
    return bool(abs(torque - pair_torque(books, lock, toothed)) > static[lock])


@kernel
def overloaded(
    held: Array,
    x: Array,
    u: Array,
    state: Integers,
    static: Array,
    books: Array,
    lock: int,
    toothed: bool,
) -> bool:
    """Return whether a held lock must let go at ``x``; ``held`` is the bank's ``held_torque``."""
    torque = held_torque(held, x, u, state[ROW], lock)
    return must_go(torque, state, static, books, lock, toothed)


@kernel
def any_overloaded(
    torques: Array, state: Integers, static: Array, books: Array, locks: int, toothed: bool
) -> bool:
    """Return whether any held lock must let go, for the torques of all of them."""
    for lock in range(locks):
        if state[HELD + lock] == 1 and must_go(torques[lock], state, static, books, lock, toothed):
            return True
    return False


@kernel
def release(
    bank: Bank,
    x: Array,
    state: Integers,
    u: Array,
    kinetic: Array,
    static: Array,
    books: Array,
    lock: int,
    extras: Extras | None,
    t_ns: int,
    events: Events,
    n_events: int,
) -> int:
    """Let an overloaded lock go, the way that it is pushed."""
    torque = held_torque(bank.held_torque, x, u, state[ROW], lock)
    rigid = np.isinf(static[lock])
    state[HELD + lock] = 0
    state[SIGN + lock] = -1 if torque - pair_torque(books, lock, extras is not None) > 0.0 else 1
    set_row(bank, x, state, row_of(state, extras))
    slide(state, u, kinetic, books, lock, extras is not None)
    if lock in (G1, G2):
        state[SIDE + lock - G1] = 0
    kind = PARTED if rigid else RELEASED
    return record(state, t_ns, kind, lock, torque, events, n_events)
