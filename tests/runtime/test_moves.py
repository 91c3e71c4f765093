"""Stretches of arrays copied, compared and filled inside kernels: nothing beside them is touched."""

import numpy as np
import pytest

from hev_can_emu.jit import kernel
from hev_can_emu.moves import fill, fill_integers, move, same

pytestmark = pytest.mark.kernels


@kernel
def _move(source: np.ndarray, at: int, target: np.ndarray, to: int, count: int) -> None:
    move(source, at, target, to, count)


@kernel
def _same(first: np.ndarray, at: int, second: np.ndarray, to: int, count: int) -> bool:
    return same(first, at, second, to, count)


@kernel
def _fill(target: np.ndarray, integers: np.ndarray, to: int, count: int) -> None:
    fill(target, to, count, 2.5)
    fill_integers(integers, to, count, -7)


@kernel
def _fill_words(words: np.ndarray, to: int, count: int) -> None:
    fill_integers(words, to, count, 9)


@pytest.mark.parametrize("count", [*range(19), 32, 47])
def test_moves(count: int) -> None:
    source = np.linspace(-1.0, 1.0, 64)
    target, integers = np.arange(64.0), np.arange(64)
    _move(source, 3, target, 5, count)
    expected = np.arange(64.0)
    expected[5 : 5 + count] = source[3 : 3 + count]
    np.testing.assert_array_equal(target, expected)
    assert _same(source, 3, target, 5, count)
    assert not _same(source, 3, target, 5, count + 1)
    for place in range(count):
        target[5 + place] = np.nan
        assert not _same(source, 3, target, 5, count)
        assert not _same(target, 5, target, 5, count)  # NaN equals none
        target[5 + place] = source[3 + place]
    _fill(target, integers, 4, count)
    expected[4 : 4 + count] = 2.5
    np.testing.assert_array_equal(target, expected)
    whole = np.arange(64)
    whole[4 : 4 + count] = -7
    np.testing.assert_array_equal(integers, whole)
    _fill_words(integers.view(np.uint64), 4, count)
    whole[4 : 4 + count] = 9
    np.testing.assert_array_equal(integers, whole)
