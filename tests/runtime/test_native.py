"""Runs start without Numba, from machine code kept on disk; what is damaged or missing is made anew."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from hev_can_emu.jit import kernel
from hev_can_emu.machine_code import link
from hev_can_emu.messages.frame import FRAME, make_frames
from hev_can_emu.native import Bound, native

ROWS = """\
import sys
import numpy as np
from hev_can_emu.scenario.evaluation import ADD, COLUMN, CONSTANT, build
from hev_can_emu.scenario.expression import over_rows
rows = np.arange(6.0).reshape(3, 2)
print(over_rows(build([(COLUMN, 1), (CONSTANT, 0.5), (ADD, 0)]), rows).tolist(), "numba" in sys.modules)
"""
STATE = """\
import hashlib, sys
from hev_can_emu.jit import ready_compiler
from hev_can_emu.runtime.emulator import Emulator
if "compiled" in sys.argv:
    ready_compiler()
car = Emulator()
print(hashlib.sha256(car.snapshot()).hexdigest(), "numba" in sys.modules)
"""


def python(code: str, *arguments: str, cache: Path | None = None) -> str:
    """Run code in a process of its own, with Numba's usual settings; return what it printed."""
    usual = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    if cache is not None:
        usual["HEV_CAN_EMU_CACHE"] = str(cache)
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=usual, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout.strip()


def test_code_is_kept_and_damaged_code_made_anew(tmp_path: Path) -> None:
    right = "[1.5, 3.5, 5.5]"
    assert python(ROWS, cache=tmp_path) == f"{right} True"
    assert python(ROWS, cache=tmp_path) == f"{right} False"
    (path,) = tmp_path.rglob("*.code")
    whole = path.read_bytes()
    half = len(whole) // 2
    for damaged in (whole[:half], whole[:half] + b"\x90" + whole[half + 1 :], b"", b"\xff" * 99):
        path.write_bytes(damaged)
        assert python(ROWS, cache=tmp_path) == f"{right} True"
        assert python(ROWS, cache=tmp_path) == f"{right} False"


@pytest.mark.parametrize(
    ("spoiled", "kept"),
    [
        ("machine_code.link = lambda code, name: None", True),  # as where it is not for x86-64
        ("native._processor = lambda: 'another'", True),
        ("machine_code.load = refuse", False),
    ],
)
def test_code_that_cannot_be_linked_or_run_is_left_to_llvm_or_made(
    tmp_path: Path, spoiled: str, kept: bool
) -> None:
    head = "from hev_can_emu import machine_code, native\n"
    head += "def refuse(image, addresses): raise PermissionError\n"
    right = "[1.5, 3.5, 5.5]"
    code = f"{head}{spoiled}\n{ROWS}"
    assert python(code if kept else ROWS, cache=tmp_path) == f"{right} True"
    assert python(code, cache=tmp_path) == f"{right} {not kept}"


def test_only_objects_for_this_kind_of_machine_are_linked() -> None:
    for code in (b"", b"\x7fELF", b"\x7fELF\x02\x01\x01" + bytes(60), b"MZ" * 100):
        assert link(code, "entry") is None


def test_a_car_starts_without_numba_and_in_the_same_state() -> None:
    python(STATE)  # whatever has to be made is made
    without, imported = python(STATE).split()
    assert imported == "False"
    assert python(STATE, "compiled").split() == [without, "True"]


class Inner(NamedTuple):
    factor: float
    nothing: None
    table: np.ndarray


class Outer(NamedTuple):
    inner: Inner
    frames: np.ndarray
    offset: int


@kernel
def weigh(outer: Outer, count: int, values: np.ndarray, out: np.ndarray) -> int:
    total = 0.0
    for i in range(count):
        for j in range(values.shape[1]):
            total += values[i, j] * outer.inner.table[j] * outer.inner.factor
        out[i] = total + outer.frames[i]["length"]
    if count > values.shape[0]:
        raise ValueError("more than there are")
    return count + outer.offset


def outer_of(factor: float) -> Outer:
    frames = make_frames(4)
    frames["length"] = 7, 6, 5, 4
    return Outer(Inner(factor, None, np.array([1, 10, 100])), frames, -2)


def test_bound_arguments_stay_and_the_rest_is_handed_over() -> None:
    values, out = np.arange(12.0).reshape(4, 3), np.zeros(4)
    bound = Bound(weigh, (outer_of(0.5),), (1, values, out))
    other = Bound(weigh, (outer_of(2.0),), (1, values, out))
    assert bound(2, values, out) == 0
    assert out.tolist() == [0.5 * 210 + 7, 0.5 * (210 + 543) + 6, 0.0, 0.0]
    assert other(1, values, out, release=True) == -1
    assert out[0] == 2.0 * 210 + 7
    # Every second row: not contiguous, and its length is another.
    assert bound(2, values[::2], out) == 0
    assert out[1] == 0.5 * (210 + 876) + 6


def test_what_a_kernel_raises_is_raised() -> None:
    values = np.zeros((1, 3))
    bound = Bound(weigh, (outer_of(1.0),), (1, values, np.zeros(4)))
    with pytest.raises(ValueError, match="more than there are"):
        bound(2, np.zeros((2, 3))[:1], np.zeros(4))
    assert bound(1, values, np.zeros(4)) == -1


def test_arrays_of_another_type_are_refused() -> None:
    bound = Bound(weigh, (outer_of(1.0),), (1, np.zeros((1, 3)), np.zeros(4)))
    with pytest.raises(ValueError, match="expected an array of float64, got float32"):
        bound(1, np.zeros((1, 3), dtype=np.float32), np.zeros(4))
    with pytest.raises(ValueError, match="expected 2 dimensions, got 1"):
        bound(1, np.zeros(3), np.zeros(4))
    with pytest.raises(TypeError, match="expected 3 arguments, got 2"):
        bound(1, np.zeros((1, 3)))
    with pytest.raises(TypeError, match="no argument for machine code: str"):
        Bound(weigh, (outer_of(1.0),), ("two",))
    assert outer_of(1.0).frames.dtype == FRAME


@kernel
def fill(start: int, out: np.ndarray) -> int:
    for i in range(out.shape[0]):
        out[i] = math.sqrt(start + i)
    return start


def test_threads_do_not_mix_their_arguments() -> None:
    failures = []

    def work(start: int) -> None:
        for length in range(1, 60):
            out = np.zeros(length)
            if native(fill, start, out) != start or out[-1] != math.sqrt(start + length - 1):
                failures.append((start, length))

    threads = [threading.Thread(target=work, args=(start,)) for start in (0, 1000, 2000, 3000)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
