"""The vector sums against the plain order of additions, bit for bit, and their place in memory."""

from fractions import Fraction

import numpy as np
import pytest

from hev_can_emu.plant.bank import few_columns
from hev_can_emu.plant.columns import aligned, columns_times, few_columns_times, filled_up
from hev_can_emu.plant.motion import all_rows, combine, combine_few


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


@pytest.mark.parametrize("n", [0, 2, 6, 20])
def test_few_columns_are_summed_in_pairs(n):
    random = np.random.default_rng(n)
    columns = random.normal(size=(3, 20, 8)) * 10.0 ** random.integers(-9, 9, (3, 20, 8))
    places = random.integers(0, 44, (3, 20))
    x = random.normal(size=44)
    expected = []
    for i in range(8):
        sums = [0.0, 0.0]
        for j in range(n):
            product = Fraction(float(columns[1, j, i])) * Fraction(float(x[places[1, j]]))
            sums[j % 2] = float(product + Fraction(sums[j % 2]))
        expected.append(sums[0] + sums[1])
    out = np.full(9, 7.0)
    combine_few(columns, places, np.array([0, n, 0]), 1, x, out)  # compiled
    assert out.tolist() == [*expected, 7.0]
    out = np.full(9, 7.0)
    few_columns_times(columns, 20 * 8, places, 20, n, x, out)  # as written
    assert out.tolist() == [*expected, 7.0]


def test_few_columns_hold_all_that_is_not_zero():
    random = np.random.default_rng(1)
    matrices = random.normal(size=(4, 7, 30)) * (random.random((4, 1, 30)) < 0.3)
    columns, places, counts = few_columns(matrices)
    assert (counts % 2 == 0).all()
    for row, matrix in enumerate(matrices):
        whole = np.zeros((30, 8))
        np.add.at(whole, places[row, : counts[row]], columns[row, : counts[row]])
        np.testing.assert_array_equal(whole[:, :7], matrix.T)
