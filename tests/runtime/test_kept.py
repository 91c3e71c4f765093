"""Results kept between runs: the same when read, made anew when damaged, and never in the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hev_can_emu.plant.start import Start
from hev_can_emu.runtime import kept as module
from hev_can_emu.runtime.kept import kept


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(module, "cache_folder", lambda name: tmp_path)
    return tmp_path


def made() -> Any:
    grid = np.arange(6, dtype=np.int64).reshape(2, 3)
    return (
        Start(0.1, 293.15, False),
        np.linspace(0, 1, 7),
        grid,
        np.zeros((0, 3)),
        None,
        3,
        np.inf,
    )


def never() -> Any:
    raise AssertionError("made again")


def assert_made(found: Any) -> None:
    start, line, grid, nothing, none, number, infinity = found
    assert start == Start(0.1, 293.15, False)
    assert isinstance(start, Start)
    assert line.tolist() == np.linspace(0, 1, 7).tolist()
    assert grid.dtype == np.int64
    assert grid.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert nothing.shape == (0, 3)
    assert (none, number, infinity) == (None, 3, np.inf)
    line[0] = grid[0, 0] = 9  # to be written to, and to nobody else's harm


def test_made_once_for_each_key(folder: Path) -> None:
    assert_made(kept("anything", "thing", b"a", made))
    assert_made(kept("anything", "thing", b"a", never))
    assert_made(kept("anything", "thing", b"a", never))
    assert kept("anything", "thing", b"b", lambda: (1,)) == (1,)
    assert kept("anything", "other", b"a", lambda: (2,)) == (2,)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda whole: b"",
        lambda whole: whole[:20],
        lambda whole: whole[:-1],
        lambda whole: whole[:100] + bytes([whole[100] ^ 1]) + whole[101:],
        lambda whole: whole[:32] + b"\xff" * 8 + whole[40:],
    ],
)
def test_damaged_entries_are_made_anew(folder: Path, spoil: Callable[[bytes], bytes]) -> None:
    kept("anything", "thing", b"a", made)
    (path,) = folder.iterdir()
    path.write_bytes(spoil(path.read_bytes()))
    assert_made(kept("anything", "thing", b"a", made))
    assert_made(kept("anything", "thing", b"a", never))


def test_a_folder_that_is_not_there_costs_time_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "cache_folder", lambda name: tmp_path / "none")
    for _ in range(2):
        assert_made(kept("anything", "thing", b"a", made))


def test_old_entries_go(folder: Path) -> None:
    for number in range(25):
        kept("anything", "thing", bytes([number]), made)
    assert len(list(folder.iterdir())) == 20
    assert_made(kept("anything", "thing", bytes([24]), never))
