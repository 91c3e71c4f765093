"""Matrix times vector for matrices stored by columns: the sums of the driveline's motion.

Compiled with explicit vectors of eight (:mod:`.vector_sums`), since LLVM cannot keep the sums of a plain loop
in registers: for all it knows, result and matrix overlap.  Each sum adds four products at a time,
``(a + b) + (c + d)``, in the same order whatever the width of a processor's registers, so the bits are the
same on each, and the same as those of the plain loop that stands in where bounds are checked or nothing is
compiled.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import BOUNDS_CHECKED, JIT_DISABLED, before_compiling, counting_kernel, kernel

Array = npt.NDArray[np.float64]

WIDTH = 8  #: values that are loaded at once


def aligned(*shape: int) -> Array:
    """Return zeros that begin where a processor's cache line does: each vector then lies in one."""
    count = int(np.prod(shape))
    raw = np.zeros(count + WIDTH)
    first = -raw.ctypes.data // raw.itemsize % WIDTH
    return raw[first : first + count].reshape(shape)


def filled_up(count: int, to: int = WIDTH) -> int:
    """Return the next multiple of ``to``."""
    return -(-count // to) * to


def _plain(matrix: Array, start: int, count: int, x: Array, nz: int, out: Array) -> None:
    """As :func:`columns_times`, in plain loops."""
    _plain_sums(matrix.ravel(), start, count, x, nz, out, count)


def _plain_sums(
    flat: Array, start: int, count: int, x: Array, nz: int, out: Array, width: int
) -> None:
    for i in range(width):
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


def _uncompiled(width: int) -> Callable[..., None]:
    def sums(matrix: Array, start: int, count: int, x: Array, nz: int, out: Array) -> None:
        _plain_sums(matrix.ravel(), start, count, x, nz, out, width)

    return sums


# Widths of results; their place is taken by vectors as soon as anything is compiled.
_sums_32, _sums_16, _sums_8, _sums_4 = (_uncompiled(width) for width in (32, 16, 8, 4))


def _make_sums() -> None:
    global _sums_32, _sums_16, _sums_8, _sums_4
    from hev_can_emu.plant.vector_sums import vector_sums

    _sums_32, _sums_16, _sums_8 = (vector_sums(WIDTH, vectors) for vectors in (4, 2, 1))
    _sums_4 = vector_sums(4, 1)


@kernel
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
    i = 0
    while i + 32 <= count:
        _sums_32(matrix, start + i, count, x, nz, out[i:])
        i += 32
    if i + 16 <= count:
        _sums_16(matrix, start + i, count, x, nz, out[i:])
        i += 16
    if i + 8 <= count:
        _sums_8(matrix, start + i, count, x, nz, out[i:])
        i += 8
    if i + 4 <= count:
        _sums_4(matrix, start + i, count, x, nz, out[i:])


if BOUNDS_CHECKED:
    _plain_sums = kernel(_plain_sums)
    columns_times = counting_kernel(_plain)
elif not JIT_DISABLED:
    before_compiling(_make_sums)
