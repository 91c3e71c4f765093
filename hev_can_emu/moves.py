"""Copying, comparing and filling short stretches of arrays inside kernels.

Compiled with explicit vectors (:mod:`.vector_moves`): what LLVM makes of a plain loop is ten times as long,
since it tests whether the arrays overlap and how many values there are, and a tick whose code does not
fit a processor's store of decoded instructions decodes it anew each time.  Plain loops stand in where
bounds are checked or nothing is compiled.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import BOUNDS_CHECKED, JIT_DISABLED, before_compiling, inlined_kernel

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


def move(source: Array, at: int, target: Array, to: int, count: int) -> None:
    """Copy ``count`` values from ``source[at:]`` to ``target[to:]``; the two do not overlap."""
    for i in range(count):
        target[to + i] = source[at + i]


def same(first: Array, at: int, second: Array, to: int, count: int) -> Any:
    """Return whether ``count`` values from ``first[at:]`` and ``second[to:]`` are equal; NaN equals none."""
    equal: Any = np.int64(0)
    for i in range(count):
        equal += np.int64(first[at + i] == second[to + i])
    return equal == count


def fill(target: Array, to: int, count: int, value: float) -> None:
    """Write ``value`` into ``count`` places from ``target[to:]`` on."""
    for i in range(count):
        target[to + i] = value


def fill_integers(target: Integers, to: int, count: int, value: int) -> None:
    """Write ``value`` into ``count`` places from ``target[to:]`` on."""
    for i in range(count):
        target[to + i] = value


def _compile_vectors() -> None:
    from hev_can_emu import vector_moves

    vector_moves.stand_in(move, same, fill, fill_integers)


if BOUNDS_CHECKED:
    move, same = inlined_kernel(move), inlined_kernel(same)
    fill, fill_integers = inlined_kernel(fill), inlined_kernel(fill_integers)
elif not JIT_DISABLED:
    before_compiling(_compile_vectors)
