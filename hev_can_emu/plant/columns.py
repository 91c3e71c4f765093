"""Matrix times vector for matrices stored by columns: the sums of the driveline's motion.

Compiled with explicit vectors of eight (:mod:`.vector_sums`), since LLVM cannot keep the sums of a plain loop
in registers: for all it knows, result and matrix overlap.  Product and addition are one operation with one
rounding, IEEE 754's fusedMultiplyAdd, which takes half the instructions.  Of each four columns, two go to one
sum and two to another, so that one addition need not wait for the other; what is left goes to the first, and
in the end both are added.  The order is the same whatever the width of a processor's registers, so the bits
are the same on each (one without that instruction calls C's ``fma``, and is slow), and the same as those of
the plain loop that stands in where bounds are checked or nothing is compiled.
"""

from __future__ import annotations

import ctypes
import functools
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import BOUNDS_CHECKED, JIT_DISABLED, before_compiling, counting_kernel

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

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
    sums = np.zeros((2, count))
    for j in range(nz):
        to = j % 2 if j < nz - nz % 4 else 0
        sums[to] = _fused()(columns[j], x[j], sums[to])
    out[:count] = sums[0] + sums[1]


@functools.cache
def _fused() -> Any:
    """Return fusedMultiplyAdd for arrays, as Python's library has it from 3.13 on, or C's."""
    fused: Any = getattr(math, "fma", None)
    if fused is None:
        fused = ctypes.CDLL(None).fma
        fused.argtypes, fused.restype = [ctypes.c_double] * 3, ctypes.c_double
    return np.frompyfunc(fused, 3, 1)


def _checked(matrix: Array, start: int, count: int, x: Array, nz: int, out: Array) -> None:
    """As :func:`columns_times`, in loops whose bounds Numba checks."""
    flat = matrix.ravel()
    for i in range(count):
        first = second = 0.0
        for j in range(nz):
            value = flat[start + j * count + i]
            if j % 2 == 1 and j < nz - nz % 4:
                second = fused(value, x[j], second)
            else:
                first = fused(value, x[j], first)
        out[i] = first + second


def few_columns_times(
    matrix: Array, start: int, places: Integers, at: int, n: int, x: Array, out: Array
) -> None:
    """``out = M x`` where M has few columns that are not zero, of :data:`WIDTH` values each.

    As :func:`columns_times`, but of each two columns, one goes to each sum.

    Args:
        matrix: of any shape, contiguous; the columns are stored from its ``start``-th value on.
        start: see above.
        places: of any shape, contiguous; from its ``at``-th value on, which of ``x`` each column goes with.
        at: see above.
        n: number of columns, even.
        x: the values.
        out: at least ``WIDTH`` values.
    """
    columns = matrix.ravel()[start : start + n * WIDTH].reshape(n, WIDTH)
    taken = places.ravel()[at : at + n]
    sums = np.zeros((2, WIDTH))
    for j in range(n):
        sums[j % 2] = _fused()(columns[j], x[taken[j]], sums[j % 2])
    out[:WIDTH] = sums[0] + sums[1]


def _few_checked(
    matrix: Array, start: int, places: Integers, at: int, n: int, x: Array, out: Array
) -> None:
    """As :func:`few_columns_times`, in loops whose bounds Numba checks."""
    flat, taken = matrix.ravel(), places.ravel()
    for i in range(WIDTH):
        first = second = 0.0
        for j in range(0, n, 2):
            first = fused(flat[start + j * WIDTH + i], x[taken[at + j]], first)
            second = fused(flat[start + (j + 1) * WIDTH + i], x[taken[at + j + 1]], second)
        out[i] = first + second


def _compile_vectors() -> None:
    import hev_can_emu.plant.vector_sums  # noqa: F401


if BOUNDS_CHECKED:
    from hev_can_emu.vector_code import fused

    columns_times = counting_kernel(_checked)
    few_columns_times = counting_kernel(_few_checked)
elif not JIT_DISABLED:
    before_compiling(_compile_vectors)
