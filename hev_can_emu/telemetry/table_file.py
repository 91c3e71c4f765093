"""A recording as a table: frames and samples of the plant's truth become rows in order of time."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from hev_can_emu.messages.frame import make_frames
from hev_can_emu.telemetry.table import Network, Rows, merge, rows_of, truth_rows

_CHUNK = 4096  #: frames decoded at a time; a row has a cell for every signal of the network


class RowFile(Protocol):
    """A table's file format."""

    def write(self, rows: Rows) -> None:
        """Append rows; raises OSError."""

    def flush(self) -> None:
        """Hand everything to the operating system, readable as it stands; raises OSError."""

    def close(self) -> None:
        """Complete and close the file; raises OSError."""


class TableFile:
    """Gives a table's format the face of a file of frames.

    Rows of the latest instant are kept back until a later one comes: more may belong to it.
    """

    def __init__(self, file: RowFile, network: Network, flush_s: float) -> None:
        self.flush_s = flush_s
        self._file = file
        self._network = network
        self._held: list[Rows] = []
        rows_of(
            network, make_frames(0)
        )  # the first call may take long: now, before the clock starts

    def write(self, frames: npt.NDArray[np.void]) -> None:
        """Append frames; raises OSError."""
        for start in range(0, len(frames), _CHUNK):
            self._hold(rows_of(self._network, frames[start : start + _CHUNK]))

    def write_truth(self, t_ns: npt.NDArray[np.int64], truth: npt.NDArray[np.float64]) -> None:
        """Append samples of the plant's truth, shape (rows, quantities); raises OSError."""
        self._hold(truth_rows(self._network, t_ns, truth))

    def flush(self) -> None:
        """Write what no later frame can add to."""
        self._settle()
        self._file.flush()

    def close(self) -> None:
        """Write the rest, complete and close the file."""
        self._settle(all_rows=True)
        self._file.close()

    def _hold(self, rows: Rows) -> None:
        if len(rows.t_ns):
            self._held.append(rows)
        if sum(len(held.t_ns) for held in self._held) >= _CHUNK:
            self._settle()

    def _settle(self, *, all_rows: bool = False) -> None:
        if not self._held:
            return
        rows = merge(self._held)
        self._held = []
        settled = len(rows.t_ns) if all_rows else int(np.searchsorted(rows.t_ns, rows.t_ns[-1]))
        if settled:
            self._file.write(rows.part(0, settled))
        if settled < len(rows.t_ns):
            self._held = [rows.part(settled, len(rows.t_ns))]
