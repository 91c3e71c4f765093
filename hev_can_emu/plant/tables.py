"""Look-up tables inside flat parameter arrays: linear between the points, held beyond the ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel


@kernel
def bracket(p: NDArray[np.float64], axis_at: int, count: int, x: float) -> tuple[int, float]:
    """Return the segment of the rising axis ``p[axis_at : axis_at + count]`` that holds ``x``.

    Returns the segment's index and the share (0 to 1) of the way through it; ``x`` beyond an end is
    taken as that end.
    """
    if not x > p[axis_at]:
        return 0, 0.0
    if x >= p[axis_at + count - 1]:
        return count - 2, 1.0
    low = 0
    high = count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if p[axis_at + middle] <= x:
            low = middle
        else:
            high = middle
    left = p[axis_at + low]
    return low, (x - left) / (p[axis_at + low + 1] - left)


@kernel
def between(p: NDArray[np.float64], table_at: int, i: int, share: float) -> float:
    """Return the value of a table of one axis, for a segment and share found by :func:`bracket`."""
    value: float = p[table_at + i] * (1.0 - share) + p[table_at + i + 1] * share
    return value


@kernel
def look_up(p: NDArray[np.float64], axis_at: int, count: int, table_at: int, x: float) -> float:
    """Return the table of one axis at ``x``; axis and table start at the given offsets in ``p``."""
    i, share = bracket(p, axis_at, count, x)
    return between(p, table_at, i, share)


@kernel
def blend(
    p: NDArray[np.float64],
    table_at: int,
    columns: int,
    row: int,
    row_share: float,
    column: int,
    column_share: float,
) -> float:
    """Return the bilinear value of a table stored by rows, for brackets found before."""
    a = table_at + row * columns + column
    b = a + columns
    upper: float = p[a] * (1.0 - column_share) + p[a + 1] * column_share
    lower: float = p[b] * (1.0 - column_share) + p[b + 1] * column_share
    return upper * (1.0 - row_share) + lower * row_share
