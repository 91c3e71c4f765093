"""Exact propagators of every configuration, ready for the compiled step.

For each configuration (48; 96 with the rear wheels; doubled by every mesh with play) the bank holds
``x(t+h) = F [x; u]`` for a ladder of steps ``h = period / 2^k``, the torque that each held lock carries,
and the momentum-keeping projection onto the configuration.  The matrix exponential is our own
plain-loop kernel: its bits do not depend on which BLAS a machine has.  It works on ``X = exp(M) - 1``,
``X <- 2X + X^2``, which keeps the small motions that plain squaring of numbers near one would round away.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import counting_kernel, kernel
from hev_can_emu.plant.columns import WIDTH, aligned, filled_up
from hev_can_emu.plant.structure import (
    LOCKS,
    N_CONFIGURATIONS,
    Configuration,
    Structure,
    configuration_at,
)

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

COLUMNS = 4  # are summed at a time
TAYLOR_TERMS = 14
TAYLOR_REACH = 0.1  # largest |eigenvalue| * step at which the series is used


class Bank(NamedTuple):
    """What the driveline kernel reads.

    n speeds and q twists are nx = n + q states; p = 4 port torques and m = 6 or 7 lock torques are
    nu inputs; of r configurations.

    Attributes:
        period: the base step, s.
        levels: number of halvings; the ladder's unit is ``period / 2**levels``.
        flow: shape (r, levels+1, nx+nu, nx), the last two filled up to multiples of four and eight:
            transposed propagators, level 0 the unit.  With travel, p+m values follow the states: the
            integral of every port's and lock's speed over the step; with dampers, then every
            branch's rate half way through the step.
        held_torque: shape (r, m, nx+nu), rows giving each held lock's friction torque.
        held_columns: shape (r, k, m+1), the last filled up to a whole vector: the same for all locks at once,
            and after them the body's angular acceleration; only the columns that are not zero.
        held_places: shape (r, k), which of the nx+nu values each of these columns belongs to.
        held_counts: shape (r,), how many there are, filled up to an even number.
        project: shape (r, n, n), speeds onto the configuration, momentum kept.
        remap: shape (6, 6, q, q), twists when the driving configuration changes.
        stiffness: shape (6, q, q), elastic energy is ``q' K q / 2``.
        inertia: shape (n,).
        speeds: shape (n, p+m), the last filled up to a multiple of eight: the transposed rows that give the
            speed at each port and the slip at each lock from the speeds, for all of them at once.
        speed_at, speed_by: the same for one at a time: shape (p+m, k), places and
            factors of what is not zero (padded with zero factors).
    """

    period: float
    levels: int
    flow: Array
    held_torque: Array
    held_columns: Array
    held_places: Integers
    held_counts: Integers
    project: Array
    remap: Array
    stiffness: Array
    inertia: Array
    speeds: Array
    speed_at: Integers
    speed_by: Array


@kernel
def _multiply(a: Array, b: Array, out: Array) -> None:
    """``out = a @ b`` in a fixed order of summation."""
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] = 0.0
        for k in range(n):
            factor = a[i, k]
            if factor != 0.0:
                for j in range(n):
                    out[i, j] += factor * b[k, j]


@counting_kernel
def exponential_ladder(matrix: Array, halvings: int, levels: int, terms: int, out: Array) -> None:
    """Fill ``out[k]`` with ``exp(matrix * 2^k) - 1`` for k = 0 .. levels.

    Args:
        matrix: shape (m, m), generator times the ladder's unit.
        halvings: how many further halvings bring the series within its reach.
        levels: number of doublings to store.
        terms: terms of the Taylor series.
        out: shape (levels+1, m, m).
    """
    # Plain loops: array expressions would compile Numba's whole broadcasting machinery.
    n = matrix.shape[0]
    scale = 1.0
    for _ in range(halvings):
        scale *= 0.5
    scaled = np.empty((n, n))
    term = np.empty((n, n))
    x = np.empty((n, n))
    work = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            scaled[i, j] = matrix[i, j] * scale
            term[i, j] = scaled[i, j]
            x[i, j] = scaled[i, j]
    for order in range(2, terms + 1):
        _multiply(term, scaled, work)
        for i in range(n):
            for j in range(n):
                term[i, j] = work[i, j] / order
                x[i, j] += term[i, j]
    for _ in range(halvings):
        _multiply(x, x, work)
        for i in range(n):
            for j in range(n):
                x[i, j] = 2.0 * x[i, j] + work[i, j]
    for level in range(levels + 1):
        if level > 0:
            _multiply(x, x, work)
            for i in range(n):
                for j in range(n):
                    x[i, j] = 2.0 * x[i, j] + work[i, j]
        for i in range(n):
            for j in range(n):
                out[level, i, j] = x[i, j]


def propagators(a: Array, b: Array, unit: float, levels: int, rows: Array | None = None) -> Array:
    """Return ``[exp(A h) , integral exp(A s) B ds]`` for h = unit * 2^k, inputs held constant.

    Args:
        a: shape (nx, nx), 1/s.
        b: shape (nx, nu).
        unit: smallest step, s.
        levels: number of doublings.
        rows: shape (nz, nx): what is integrated over the step besides.

    Returns:
        Shape (levels+1, nx+nz, nx+nu).
    """
    nx, nu = b.shape
    nz = 0 if rows is None else len(rows)
    matrix = np.zeros((nx + nz + nu, nx + nz + nu))
    matrix[:nx, :nx], matrix[:nx, nx + nz :] = a * unit, b * unit
    if rows is not None:
        matrix[nx : nx + nz, :nx] = rows * unit
    radius = float(np.abs(np.linalg.eigvals(matrix[:nx, :nx])).max())
    halvings = max(0, int(np.ceil(np.log2(max(radius, 1e-300) / TAYLOR_REACH))))
    ladder = np.empty((levels + 1, *matrix.shape))
    exponential_ladder(matrix, halvings, levels, TAYLOR_TERMS, ladder)
    ladder += np.eye(len(matrix))
    return np.delete(ladder[:, : nx + nz, :], np.s_[nx : nx + nz], axis=2)


def build_bank(
    structure: Structure,
    period: float = 1e-3,
    levels: int = 10,
    travel: bool = False,
    dampers: bool = False,
    open_branches: Sequence[int] = (),
) -> Bank:
    """Prepare all configurations of ``structure``.

    Args:
        structure: the driveline.
        period: of one step, s.
        levels: how often it can be halved to locate events.
        travel: also integrate the speeds of ports and locks.
        dampers: also give every branch's rate half way through each step.
        open_branches: branches whose teeth may part: configuration ``row + base*mask`` is ``row``
            without those whose bit is set in ``mask``, ``base`` being the number without any.
    """
    # Building alone needs it; most runs find a bank kept.
    from hev_can_emu.plant.linear import held_speeds, state_space

    n, nq = structure.n, structure.nq
    ports, m = structure.ports.shape[0], structure.locks.shape[0]
    nx, nu = n + nq, ports + m
    rows = np.zeros((nu if travel else 0, nx))
    if travel:
        rows[:, :n] = np.vstack([structure.ports, structure.locks])
    base = N_CONFIGURATIONS << (m - len(LOCKS))
    count = base << len(open_branches)
    nb = len(structure.branch_names) if dampers else 0
    flow = aligned(count, levels + 1, filled_up(nx + nu, COLUMNS), filled_up(nx + len(rows) + nb))
    held_torque = np.zeros((count, m, nx + nu))
    body_rate = np.zeros((count, nx + nu))
    project = np.zeros((count, n, n))
    body = int(np.flatnonzero(structure.ports[3])[0])
    for mask in range(1 << len(open_branches)):
        parted = [branch for bit, branch in enumerate(open_branches) if mask >> bit & 1]
        variant = without_branches(structure, parted) if parted else structure
        for index in range(base):
            row = index + base * mask
            configuration = configuration_at(index)
            a, b = state_space(variant, configuration)
            # One halving more than there are levels: what is half way through the smallest step.
            ladder = propagators(a, b, period / 2 ** (levels + 1), levels + 1, rows)
            flow[row, :, : nx + nu, : nx + len(rows)] = np.swapaxes(ladder[1:], 1, 2)
            if dampers:
                rates = structure.incidence @ ladder[:-1, :n]
                at = nx + len(rows)
                flow[row, :, : nx + nu, at : at + nb] = np.swapaxes(rates, 1, 2)
            project[row] = held_speeds(variant, configuration) * structure.inertia[None, :]
            body_rate[row] = np.concatenate([a[body], b[body]])
            held = [lock for lock, holds in enumerate(configuration.locks) if holds]
            if held:
                held_torque[row, held] = _held_torques(variant, configuration, held)
                # A held lock's own friction input is the result, not a cause.
                held_torque[row][:, [nx + ports + lock for lock in held]] = 0.0
    held_columns, held_places, held_counts = few_columns(
        np.concatenate([held_torque, body_rate[:, np.newaxis]], axis=1)
    )
    basis = structure.basis
    places, factors = sparse_rows(np.vstack([structure.ports, structure.locks]))
    return Bank(
        period=period,
        levels=levels,
        flow=flow,
        held_torque=held_torque,
        held_columns=held_columns,
        held_places=held_places,
        held_counts=held_counts,
        project=project,
        remap=np.ascontiguousarray(structure.twist_remap),
        stiffness=np.ascontiguousarray(basis.T @ structure.stiffness @ basis),
        inertia=structure.inertia.copy(),
        speeds=columns_of(np.vstack([structure.ports, structure.locks])),
        speed_at=places,
        speed_by=factors,
    )


def columns_of(rows: Array) -> Array:
    """Return rows stored by columns, their number filled up to whole vectors."""
    columns = aligned(rows.shape[1], filled_up(rows.shape[0]))
    columns[:, : rows.shape[0]] = rows.T
    return columns


def few_columns(matrices: Array) -> tuple[Array, Integers, Integers]:
    """Return of matrices, shape (r, rows, columns), the columns that are not zero, places and counts.

    See the bank's ``held_columns`` and those that follow.
    """
    if matrices.shape[1] > WIDTH:
        raise ValueError(f"{matrices.shape[1]} rows: at most {WIDTH} are summed at once")
    found = [np.flatnonzero(matrix.any(axis=0)) for matrix in matrices]
    counts = np.array([filled_up(len(each), 2) for each in found])
    columns = aligned(len(matrices), int(counts.max()), filled_up(matrices.shape[1]))
    places = np.zeros(columns.shape[:2], dtype=np.int64)
    for row, (matrix, taken) in enumerate(zip(matrices, found, strict=True)):
        columns[row, : len(taken), : len(matrix)] = matrix[:, taken].T
        places[row, : len(taken)] = taken
    return columns, places, counts


def sparse_rows(rows: Array) -> tuple[Integers, Array]:
    """Return places and factors of what is not zero in each row, padded to one length."""
    width = max(int(np.count_nonzero(rows, axis=1).max()), 1)
    places = np.zeros((len(rows), width), dtype=np.int64)
    factors = np.zeros((len(rows), width))
    for index, row in enumerate(rows):
        found = np.flatnonzero(row)
        places[index, : len(found)] = found
        factors[index, : len(found)] = row[found]
    return places, factors


def without_branches(structure: Structure, branches: Sequence[int]) -> Structure:
    """Return ``structure`` with branches (independent, uncoupled ones) that carry nothing."""
    stiffness, damping = structure.stiffness.copy(), structure.damping.copy()
    for matrix in (stiffness, damping):
        matrix[:, branches, :] = 0.0
        matrix[:, :, branches] = 0.0
    return msgspec.structs.replace(structure, stiffness=stiffness, damping=damping)


def _held_torques(structure: Structure, configuration: Configuration, held: list[int]) -> Array:
    """Rows giving the friction torques that keep the held slips at zero acceleration."""
    driving = configuration.driving
    inverse = 1.0 / structure.inertia
    incidence, damping = structure.incidence, structure.damping[driving]
    stiffness = structure.stiffness[driving] @ structure.basis
    free = np.hstack(
        [
            -inverse[:, None] * (incidence.T @ damping @ incidence),
            -inverse[:, None] * (incidence.T @ stiffness),
            inverse[:, None] * np.vstack([structure.ports, structure.locks]).T,
        ]
    )
    slips = structure.locks[held]
    mobility = slips @ (inverse[:, None] * slips.T)
    solved: Array = -np.linalg.solve(mobility, slips @ free)
    return solved
