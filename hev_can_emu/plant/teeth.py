"""What the detailed driveline adds to the step: teeth with play, the pistons, the work of each damper.

Contact is never adhesive.  The dogs of an engaged gear sit in their play: between its ends sleeve and gear
turn free of each other; at an end they are held (a configuration of its own) as long as the torque
presses them together.  A mesh with play carries ``k*q + c*q'`` as long as that presses, q counted from the
flank that touches, and nothing in between.  What an impact of the dogs or the parting of a mesh drops is
booked.

All of it lives in an array of *books* beside the driveline's state: places first, then sums since
the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.plant.bank import Bank, columns_of, sparse_rows
from hev_can_emu.plant.motion import row_speed
from hev_can_emu.plant.structure import (
    ALL_LOCKS,
    LOCKS,
    N_CONFIGURATIONS,
    N_PORTS,
    Structure,
)

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

N_LOCKS = len(ALL_LOCKS)

# Layout of the books.  LOST, at friction locks, is the only one that a driveline without extras keeps.
LOST = 0
ANGLE = 1  # of the crank, rad, 0 to one turn
THROTTLE = 2  # opening, 1: counts only for a crank that says so
GAP = 3  # sleeve against G1 and G2 within the dogs' play, rad
HALF = 5  # half that play while the dogs are in, else 0
PAIR = 7  # torque of the dogs' chamfers between sleeve and G1, G2, N m
TRAVEL = 9  # of ports, then locks, in the step now over, rad
CRANK_WORK = TRAVEL + N_PORTS + N_LOCKS  # of the pistons' inertial torque on the crank, J
LOST_DOGS, LOST_MESH = CRANK_WORK + 1, CRANK_WORK + 2  # J
PAIR_WORK = CRANK_WORK + 3  # of the chamfers' torques together, J
FRICTION = CRANK_WORK + 4  # heat of each lock's slide, J
DAMPERS = FRICTION + N_LOCKS  # heat of each branch's damper, J; only where asked for
N_BOOKS = DAMPERS + 17

_END_WEIGHT, _MIDDLE_WEIGHT = 1.0 / 6.0, 4.0 / 6.0  # Simpson's rule


class Extras(NamedTuple):
    """Constants; k meshes have play, nb branches damp.

    Attributes:
        crank: packed parameters of the pistons, or empty.
        mesh: shape (k,), index of each mesh's twist.
        mesh_half: shape (k,), half its play, m.
        mesh_stiffness, mesh_damping: shape (k,), N/m and N s/m.
        rates: shape (n, nb), the last filled up to a multiple of eight: the transposed rows that give every
            branch's rate of deflection from the speeds.
        branch_at, branch_by: the same for one branch at a time: shape (nb, k), places
            and factors of what is not zero.
        damping: shape (nb,).
        middle: place of the branches' rates half way through a step behind the states in the bank's
            flow, or 0: then dampers are not booked.
        first_twist: place of the first twist among the states; twist i is branch i's.
        base: number of configurations that the meshes do not tell apart.
    """

    crank: Array
    mesh: Integers
    mesh_half: Array
    mesh_stiffness: Array
    mesh_damping: Array
    rates: Array
    branch_at: Integers
    branch_by: Array
    damping: Array
    middle: int
    first_twist: int
    base: int


def build_extras(
    structure: Structure,
    bank: Bank,
    crank: Array,
    clearance: Mapping[str, float] | None = None,
    damper_work: bool = False,
) -> Extras:
    """Prepare the constants; ``clearance`` gives the whole play of branches by name, m.

    Raises:
        ValueError: the bank was built without these branches' :func:`parting` indices, or, where the
            dampers' work is wanted, without travel and dampers.
    """
    mesh = parting(structure, clearance or {})
    half = [0.5 * (clearance or {})[structure.branch_names[branch]] for branch in mesh]
    base = N_CONFIGURATIONS << (len(structure.locks) - len(LOCKS))
    if len(bank.flow) != base << len(mesh):
        raise ValueError(
            f"bank: expected one built with open_branches={mesh}, got {len(bank.flow)} configurations"
        )
    middle = structure.n + structure.nq + N_PORTS + len(structure.locks)
    if damper_work and not bank.flow[:, :, :, middle:].any():
        raise ValueError("bank: expected one built with travel and dampers, got one without")
    places, factors = sparse_rows(structure.incidence)
    return Extras(
        crank=crank,
        mesh=np.array(mesh, dtype=np.int64),
        mesh_half=np.array(half, dtype=np.float64),
        mesh_stiffness=np.array([structure.stiffness[0, b, b] for b in mesh], dtype=np.float64),
        mesh_damping=np.array([structure.damping[0, b, b] for b in mesh], dtype=np.float64),
        rates=columns_of(structure.incidence),
        branch_at=places,
        branch_by=factors,
        damping=np.diagonal(structure.damping[0]).copy(),
        middle=middle if damper_work else 0,
        first_twist=structure.n,
        base=base,
    )


def parting(structure: Structure, clearance: Mapping[str, float]) -> list[int]:
    """Return the indices of the branches whose teeth may part; KeyError for a name that is none."""
    place = {name: index for index, name in enumerate(structure.branch_names)}
    return sorted(place[name] for name, play in clearance.items() if play > 0.0)


@kernel
def mesh_row(extras: Extras, contact: Integers) -> int:
    """Return what the parted meshes add to the index of the configuration; ``contact`` 0 is parted."""
    row = 0
    for i in range(extras.mesh.shape[0]):
        if contact[i] == 0:
            row += extras.base << i
    return row


@kernel
def mesh_force(extras: Extras, x: Array, i: int) -> float:
    """Return what mesh ``i`` would carry at its flank, N."""
    branch = extras.mesh[i]
    rate = row_speed(extras.branch_at, extras.branch_by, x, branch)
    return float(
        extras.mesh_stiffness[i] * x[extras.first_twist + branch] + extras.mesh_damping[i] * rate
    )


@kernel
def mesh_changes(extras: Extras, x: Array, contact: int, i: int) -> int:
    """Return the contact of mesh ``i`` after this instant: 0 parted, else the side that touches."""
    if contact != 0:
        return contact if mesh_force(extras, x, i) * contact >= 0.0 else 0
    twist = x[extras.first_twist + extras.mesh[i]]
    half = extras.mesh_half[i]
    if abs(twist) > half:
        moving = row_speed(extras.branch_at, extras.branch_by, x, extras.mesh[i])
        if twist > 0.0 and moving > 0.0:
            return 1
        if twist < 0.0 and moving < 0.0:
            return -1
    return 0


@kernel
def branch_torque(extras: Extras, stiffness: Array, x: Array, branch: int) -> float:
    """Return what a branch carries, N m; ``stiffness`` (r, q, q) is diagonal, play not looked at."""
    rate = row_speed(extras.branch_at, extras.branch_by, x, branch)
    twist = x[extras.first_twist + branch]
    return float(stiffness[0, branch, branch] * twist + extras.damping[branch] * rate)


@kernel
def book_dampers(
    damping: Array, length: float, first: Array, middle: Array, last: Array, books: Array
) -> None:
    """Add each damper's heat over an accepted step: Simpson's rule over exact rates.

    Args:
        damping: of :class:`Extras`.
        length: of the step, s.
        first, middle, last: every branch's rate at its beginning, half way, and at its end.
        books: changed in place.
    """
    for branch in range(damping.shape[0]):
        a, b, c = first[branch], middle[branch], last[branch]
        total = _END_WEIGHT * (a * a + c * c) + _MIDDLE_WEIGHT * b * b
        books[DAMPERS + branch] += damping[branch] * total * length


@kernel
def elastic_energy(extras: Extras, stiffness: Array, x: Array, contact: Integers) -> float:
    """Return the energy in the branches, J; ``stiffness`` (q, q) is diagonal, parted meshes hold none."""
    n = extras.first_twist
    total = 0.0
    for branch in range(stiffness.shape[0]):
        carries = True
        for i in range(extras.mesh.shape[0]):
            if extras.mesh[i] == branch and contact[i] == 0:
                carries = False
        if carries:
            total += 0.5 * stiffness[branch, branch] * x[n + branch] * x[n + branch]
    return total
