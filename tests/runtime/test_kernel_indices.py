"""The package's kernels index from zero, inside arrays; what others compile does as Python does."""

import os
import subprocess
import sys

import numba
import numpy as np
import pytest

from hev_can_emu.jit import ready_compiler

SOURCE = """
def at(x, i):
    return x[i]

def length(x, start, stop):
    return x[start:stop].shape[0]
"""


def compiled(module: str) -> dict:
    ready_compiler()
    space: dict = {"__name__": module}
    exec(SOURCE, space)
    return {name: numba.njit(space[name]) for name in ("at", "length")}


def test_functions_of_others_count_from_the_end_and_cut_slices() -> None:
    theirs = compiled("somebody.elses")
    x = np.arange(5.0)
    assert theirs["at"](x, -1) == 4.0
    assert theirs["length"](x, -2, 100) == 2


def test_functions_of_the_package_take_indices_as_they_are() -> None:
    ours = compiled("hev_can_emu.made")
    x = np.arange(5.0)[2:]
    assert ours["at"](x, -1) == 1.0
    assert ours["length"](x, 0, 4) == 4
    assert ours["length"](x, 1, sys.maxsize) == 2
    assert ours["length"](x, 2, 1) == 0


@pytest.mark.parametrize(
    ("call", "told"),
    [
        ("['at'](x, -1)", "out of bounds"),
        ("['at'](x, 5)", "out of bounds"),
        ("['length'](x, 0, 6)", "a slice reaches beyond its array"),
        ("['length'](x, -1, 3)", "a slice reaches beyond its array"),
        ("['length'](x, 6, 6)", "a slice reaches beyond its array"),
    ],
)
def test_bounds_checks_find_what_lies_outside(call: str, told: str) -> None:
    here = os.path.dirname(os.path.abspath(__file__))
    program = (
        f"import sys; sys.path.insert(0, {here!r})\n"
        "import numpy as np, test_kernel_indices as t\n"
        "ours, x = t.compiled('hev_can_emu.made'), np.arange(5.0)\n"
        "assert ours['length'](x, 1, 5) == 4\n"
        f"ours{call}\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "NUMBA_BOUNDSCHECK": "1"},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 1
    assert "IndexError" in run.stderr
    assert told in run.stderr
