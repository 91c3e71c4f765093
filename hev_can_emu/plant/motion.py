"""Linear motion between events: propagation, speeds and slips, and the torque that a held lock carries.

On the hot path.  These kernels take arrays, not the bank: handing a tuple of arrays on costs more
than the sums.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant.columns import WIDTH, columns_times, few_columns_times

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@small_kernel
def row_speed(at: Integers, by: Array, x: Array, row: int) -> float:
    """Return the slip at a lock, or the speed at a port, rad/s.

    ``at`` and ``by``, shape (rows, k), are the places and factors of the row's entries that are not zero.
    """
    total = 0.0
    for i in range(at.shape[1]):
        total += by[row, i] * x[at[row, i]]
    return total


@small_kernel
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


@small_kernel
def combine(columns: Array, row: int, level: int, z: Array, out: Array) -> None:
    """``out = M z`` with M stored by columns in ``columns[row, level]``; ``out`` takes a whole column."""
    levels, nz, count = columns.shape[1], columns.shape[2], columns.shape[3]
    columns_times(columns, (row * levels + level) * nz * count, count, z, nz, out)


@small_kernel
def combine_few(
    columns: Array, places: Integers, counts: Integers, row: int, z: Array, out: Array
) -> None:
    """``out = M z`` with the columns of M that are not zero in ``columns[row]``, see the bank."""
    most = places.shape[1]
    few_columns_times(columns, row * most * WIDTH, places, row * most, counts[row], z, out)


@small_kernel
def all_rows(columns: Array, x: Array, out: Array) -> None:
    """``out = M x`` with the small M stored by columns, shape (nz, count)."""
    columns_times(columns, 0, columns.shape[1], x, columns.shape[0], out)
