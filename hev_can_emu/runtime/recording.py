"""What a run leaves in files: its frames, and for tables of decoded signals the plant's truth as well."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hev_can_emu.messages.frame import make_frames
from hev_can_emu.messages.frame_copy import copy_frames
from hev_can_emu.plant.powertrain import TRUTH
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.virtual import FrameSink
from hev_can_emu.scenario.monitor import NEVER
from hev_can_emu.telemetry.recorder import TABLES, Recorder, open_recorder

if TYPE_CHECKING:
    from hev_can_emu.telemetry.table import Network


def network_of(emulator: Emulator) -> Network:
    """Return what decoded signals of this car mean."""
    from hev_can_emu.plant.truth_units import truth_unit
    from hev_can_emu.telemetry.table import Network

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
        # Not yet in the tables: samples, and frames of the car's last call.
        self._truth: list[tuple[int, npt.NDArray[np.float64]]] = []
        self._frames: list[npt.NDArray[np.void]] = []
        self._called_ns = -1
        tables = any(Path(path).suffix.lower() in TABLES for path in paths)
        network = network_of(emulator) if tables else None
        with contextlib.ExitStack() as undo:
            for path in paths:
                recorder = open_recorder(path, epoch_ns=epoch_ns, network=network)
                undo.callback(recorder.close)
                self._recorders.append(recorder)
            undo.pop_all()
        self._tables = [recorder for recorder in self._recorders if recorder.takes_truth]
        self._end_watch = emulator.watch_truth(self._see) if self._tables else None

    @property
    def sinks(self) -> list[FrameSink]:
        """What takes the run's frames."""
        sinks: list[FrameSink] = [
            recorder.write for recorder in self._recorders if recorder not in self._tables
        ]
        return [*sinks, self._keep] if self._tables else sinks

    def close(self) -> None:
        """Complete all files; raises the first failure, when all are closed."""
        if self._end_watch is not None:
            self._end_watch()
        with contextlib.ExitStack() as closing:
            for recorder in self._recorders:
                closing.callback(recorder.close)
            self._write_tables(NEVER)

    def _see(self, t_ns: npt.NDArray[np.int64], truth: npt.NDArray[np.float64]) -> None:
        self._truth += zip(t_ns.tolist(), truth, strict=True)

    def _keep(self, frames: npt.NDArray[np.void], count: int) -> None:
        """Keep frames until the car goes on: what is received and what is sent in a call come one by one."""
        now_ns = self._emulator.now_ns
        if now_ns != self._called_ns:
            self._write_tables(self._called_ns)
            self._called_ns = now_ns
        if count:
            self._frames.append(copy_frames(frames[:count]))

    def _write_tables(self, until_ns: int) -> None:
        """Write the frames kept, and samples of the truth before a time, in the order of time."""
        samples = [each for each in self._truth if each[0] < until_ns]
        self._truth = [each for each in self._truth if each[0] >= until_ns]
        frames = np.concatenate(self._frames) if self._frames else make_frames(0)
        self._frames = []
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]
        ends = np.searchsorted(frames["t_ns"], [t_ns for t_ns, _ in samples]).tolist()
        for table in self._tables:
            at = 0
            for end, (t_ns, values) in zip(ends, samples, strict=True):
                table.write(frames[at:], end - at)
                table.write_truth(t_ns, values)
                at = end
            table.write(frames[at:], len(frames) - at)
