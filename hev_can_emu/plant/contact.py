"""Teeth that touch and part, within the driveline's step: dogs in their play, meshes with play."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.plant import teeth
from hev_can_emu.plant.bank import Bank
from hev_can_emu.plant.holding import (
    HELD,
    MESH,
    MESH_EVENT,
    PARTED,
    ROW,
    SIDE,
    TOUCHED,
    record,
    row_of,
    set_row,
)
from hev_can_emu.plant.motion import row_speed
from hev_can_emu.plant.structure import G1, G2, N_PORTS
from hev_can_emu.plant.teeth import Extras

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@kernel
def dogs_meet(at: Integers, by: Array, x: Array, books: Array, lock: int, travel: float) -> int:
    """Return the end of its play that a free gear with its dogs in has run against, or 0."""
    half = books[teeth.HALF + lock - G1]
    if half > 0.0:
        place = books[teeth.GAP + lock - G1] + travel
        if abs(place) >= half:
            slip = row_speed(at, by, x, N_PORTS + lock)
            if place > 0.0 and slip > 0.0:
                return 1
            if place < 0.0 and slip < 0.0:
                return -1
    return 0


@kernel
def let_dogs_in(bank: Bank, x: Array, state: Integers, extras: Extras, books: Array) -> None:
    """Dogs that have just come in take over from the cone, which lets go."""
    for lock in (G1, G2):
        if books[teeth.HALF + lock - G1] > 0.0:
            if state[HELD + lock] == 1 and state[SIDE + lock - G1] == 0:
                state[HELD + lock] = 0
                set_row(bank, x, state, row_of(state, extras))
        else:
            state[SIDE + lock - G1] = 0


@kernel
def any_dogs_meet(
    at: Integers, by: Array, x: Array, nx: int, state: Integers, books: Array
) -> bool:
    """Return whether dogs touch at ``x``, the end of a step not yet taken, travels included."""
    for lock in (G1, G2):
        if (
            books[teeth.HALF + lock - G1] > 0.0
            and state[HELD + lock] == 0
            and dogs_meet(at, by, x, books, lock, x[nx + N_PORTS + lock]) != 0
        ):
            return True
    return False


@kernel
def any_mesh_changes(x: Array, state: Integers, extras: Extras) -> bool:
    """Return whether the teeth of any mesh touch or part at ``x``."""
    for i in range(extras.mesh.shape[0]):
        if teeth.mesh_changes(extras, x, state[MESH + i], i) != state[MESH + i]:
            return True
    return False


@kernel
def settle_teeth(
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
        side = dogs_meet(bank.speed_at, bank.speed_by, x, books, lock, 0.0)
        if side != 0:
            slip = row_speed(bank.speed_at, bank.speed_by, x, N_PORTS + lock)
            books[teeth.GAP + lock - G1] = side * books[teeth.HALF + lock - G1]
            state[SIDE + lock - G1] = side
            state[HELD + lock] = 1
            books[teeth.LOST_DOGS] += set_row(bank, x, state, row_of(state, extras))
            n_events = record(state, t_ns, TOUCHED, lock, slip, events, n_events)
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
        n_events = record(state, t_ns, kind, MESH_EVENT + i, value, events, n_events)
    return n_events
