"""The plant's truth over a run, sampled once per tick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.plant.powertrain import TRUTH
from hev_can_emu.runtime.emulator import Emulator

Array = npt.NDArray[np.float64]


class TruthLog:
    """Keeps some of the plant's quantities, SI; a sink for :func:`.virtual.play_virtual`.

    Args:
        emulator: whose plant is watched.
        names: of :data:`.powertrain.TRUTH`.

    Raises:
        InputError: the plant has no such quantity.
    """

    def __init__(self, emulator: Emulator, names: Sequence[str]) -> None:
        for name in names:
            if name not in TRUTH:
                hint = did_you_mean(name, TRUTH) or f"known: {', '.join(TRUTH)}"
                raise InputError("--quantity", "a quantity of the plant", f"'{name}'", hint)
        self._emulator = emulator
        self._places = np.array([TRUTH.index(name) for name in names], dtype=np.intp)
        self._times: list[int] = []
        self._rows: list[Array] = []

    def add(self, _frames: npt.NDArray[np.void], _count: int) -> None:
        """Take a sample where time has gone on; what was sent does not matter."""
        if self._times and self._times[-1] == self._emulator.now_ns:
            return
        self._times.append(self._emulator.now_ns)
        self._rows.append(self._emulator.state.truth[self._places])

    @property
    def times(self) -> Array:
        """Instants of the samples, shape (n,), s."""
        return np.array(self._times, dtype=np.float64) * 1e-9

    @property
    def values(self) -> Array:
        """Samples, shape (n, quantities)."""
        return np.array(self._rows).reshape(len(self._rows), len(self._places))
