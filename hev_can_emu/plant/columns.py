"""Matrix times vector for matrices stored by columns: the sums of the driveline's motion.

Compiled with explicit vectors of eight (:mod:`.vector_sums`), since LLVM cannot keep the sums of a plain loop
in registers: for all it knows, result and matrix overlap.  Each sum adds four products at a time,
``(a + b) + (c + d)``, in the same order whatever the width of a processor's registers, so the bits are the
same on each, and the same as those of the plain loop that stands in where bounds are checked or nothing is
compiled.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import BOUNDS_CHECKED, JIT_DISABLED, before_compiling, counting_kernel

Array = npt.NDArray[np.float64]

WIDTH = 8  #: values that are loaded at once
CACHE_LINE = 8 * WIDTH  #: bytes


def aligned(*shape: int) -> Array:
    """Return zeros that begin where a processor's cache line does: each vector then lies in one."""
    count = int(np.prod(shape))
    raw = np.zeros(count + WIDTH)
    first = -raw.ctypes.data // raw.itemsize % WIDTH
    return raw[first : first + count].reshape(shape)


def filled_up(count: int, to: int = WIDTH) -> int:
    """Return the next multiple of ``to``."""
    return -(-count // to) * to


def columns_times(matrix: Array, start: int, count: int, x: Array, nz: int, out: Array) -> None:
    """``out = M x``.

    Args:
        matrix: of any shape, contiguous; M is stored by columns from its ``start``-th value on.
        start: see above.
        count: values of a column, a multiple of four.
        x: at least ``nz`` values.
        nz: number of columns.
        out: at least ``count`` values.
    """
    columns = matrix.ravel()[start : start + nz * count].reshape(nz, count)
    total = np.zeros(count)
    j = 0
    while j + 3 < nz:
        total += (columns[j] * x[j] + columns[j + 1] * x[j + 1]) + (
            columns[j + 2] * x[j + 2] + columns[j + 3] * x[j + 3]
        )
        j += 4
    while j < nz:
        total += columns[j] * x[j]
        j += 1
    out[:count] = total


def _checked(matrix: Array, start: int, count: int, x: Array, nz: int, out: Array) -> None:
    """As :func:`columns_times`, in loops whose bounds Numba checks."""
    flat = matrix.ravel()
    for i in range(count):
        total = 0.0
        at = start + i
        j = 0
        while j + 3 < nz:
            total += (flat[at] * x[j] + flat[at + count] * x[j + 1]) + (
                flat[at + 2 * count] * x[j + 2] + flat[at + 3 * count] * x[j + 3]
            )
            at += 4 * count
            j += 4
        while j < nz:
            total += flat[at] * x[j]
            at += count
            j += 1
        out[i] = total


def _compile_vectors() -> None:
    import hev_can_emu.plant.vector_sums  # noqa: F401


if BOUNDS_CHECKED:
    columns_times = counting_kernel(_checked)
elif not JIT_DISABLED:
    before_compiling(_compile_vectors)
