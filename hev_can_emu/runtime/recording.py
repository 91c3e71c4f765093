"""What a run leaves in files: its frames, and for tables of decoded signals the plant's truth as well."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant.powertrain import TRUTH
from hev_can_emu.plant.truth_units import truth_unit
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.virtual import FrameSink
from hev_can_emu.telemetry.recorder import Recorder, open_recorder
from hev_can_emu.telemetry.table import Network

TRUTH_NS = 10_000_000  #: distance of samples of the plant's truth


def network_of(emulator: Emulator) -> Network:
    """Return what decoded signals of this car mean."""
    units = [truth_unit(name) for name in TRUTH]
    return Network(emulator.database, emulator.constants.codec, TRUTH, units)


class Recording:
    """Recorders of one run.

    Args:
        emulator: the car.
        paths: of the files; the endings choose the formats.
        epoch_ns: Unix time, in ns, at the run's start.

    Raises:
        InputError: a file cannot be written; those opened before it are closed.
    """

    def __init__(self, emulator: Emulator, paths: Sequence[str | Path], epoch_ns: int = 0) -> None:
        self._emulator = emulator
        self._recorders: list[Recorder] = []
        self._sampled_ns = -1
        network = network_of(emulator)
        with contextlib.ExitStack() as undo:
            for path in paths:
                recorder = open_recorder(path, epoch_ns=epoch_ns, network=network)
                undo.callback(recorder.close)
                self._recorders.append(recorder)
            undo.pop_all()
        self._tables = [recorder for recorder in self._recorders if recorder.takes_truth]

    @property
    def sinks(self) -> list[FrameSink]:
        """What takes the run's frames."""
        sinks: list[FrameSink] = [recorder.write for recorder in self._recorders]
        return [*sinks, self._sample] if self._tables else sinks

    @property
    def longest_ns(self) -> int | None:
        """How long the car may run between two looks at it; None for as long as it likes."""
        return TRUTH_NS if self._tables else None

    def close(self) -> None:
        """Complete all files; raises the first failure, when all are closed."""
        with contextlib.ExitStack() as closing:
            for recorder in self._recorders:
                closing.callback(recorder.close)

    def _sample(self, frames: npt.NDArray[np.void], count: int) -> None:
        """Note the plant's truth at the first call in each period."""
        now_ns = self._emulator.now_ns
        if now_ns // TRUTH_NS != self._sampled_ns // TRUTH_NS:
            self._sampled_ns = now_ns
            for table in self._tables:
                table.write_truth(now_ns, self._emulator.state.truth)
