"""The vector sums against the plain order of additions, bit for bit, and their place in memory."""

from fractions import Fraction

import numpy as np
import pytest

from hev_can_emu.plant.columns import aligned, columns_times, filled_up
from hev_can_emu.plant.motion import all_rows, combine


def in_order(matrix, x):
    """In turn to one sum and the other, what is left to the first: the order that the page promises.

    Each product is added exactly, and rounded once.
    """
    columns, count = matrix.shape
    totals = []
    for i in range(count):
        sums = [0.0, 0.0]
        for j in range(columns):
            to = j % 2 if j < columns - columns % 4 else 0
            exact = Fraction(float(matrix[j, i])) * Fraction(float(x[j])) + Fraction(sums[to])
            sums[to] = float(exact)
        totals.append(sums[0] + sums[1])
    return totals


@pytest.mark.parametrize("count", [4, 8, 12, 16, 36, 40, 64])
@pytest.mark.parametrize("columns", [1, 4, 18, 19, 44])
def test_sums_have_the_bits_of_the_stated_order(columns, count):
    random = np.random.default_rng(columns * 100 + count)
    shape = (2, 3, columns, count)
    whole = random.normal(size=shape) * 10.0 ** random.integers(-9, 9, shape)
    x = random.normal(size=columns)
    expected = in_order(whole[1, 2], x)
    out = np.full(count + 2, 7.0)
    combine(whole, 1, 2, x, out)  # compiled
    assert out.tolist() == [*expected, 7.0, 7.0]
    out = np.full(count + 2, 7.0)
    all_rows(whole[1, 2].copy(), x, out)
    assert out.tolist() == [*expected, 7.0, 7.0]
    out = np.full(count + 2, 7.0)
    columns_times(whole, 5 * columns * count, count, x, columns, out)  # as written
    assert out.tolist() == [*expected, 7.0, 7.0]


@pytest.mark.parametrize("shape", [(1,), (7, 3), (5, 4, 16)])
def test_aligned_arrays_begin_at_a_cache_line(shape):
    array = aligned(*shape)
    assert array.shape == shape
    assert array.ctypes.data % 64 == 0
    assert not array.any()


def test_filled_up_gives_the_next_whole_number():
    assert [filled_up(n) for n in (0, 1, 8, 9)] == [0, 8, 8, 16]
    assert [filled_up(n, 4) for n in (4, 5)] == [4, 8]
