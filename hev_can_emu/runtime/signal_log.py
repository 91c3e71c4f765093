"""What the bus said over a run: frames kept, signals read from them afterwards."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.messages.codec import Codec, decode
from hev_can_emu.messages.database import Database


@kernel
def _decode_all(
    codec: Codec,
    message: int,
    signal: int,
    frames: npt.NDArray[np.void],
    values: npt.NDArray[np.float64],
    out: npt.NDArray[np.float64],
) -> None:
    for i in range(frames.shape[0]):
        decode(codec, message, frames[i]["data"], values)
        out[i] = values[signal]


class SignalLog:
    """Keeps every frame of a run (80 bytes each) and gives signals as time series."""

    def __init__(self, database: Database, codec: Codec) -> None:
        self._database = database
        self._codec = codec
        self._parts: list[npt.NDArray[np.void]] = []

    def add(self, frames: npt.NDArray[np.void], count: int) -> None:
        """Keep frames (FRAME records; copied)."""
        if count:
            self._parts.append(frames[:count].copy())

    def series(self, name: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return instants, s, and physical values of a signal; raises InputError for an unknown one."""
        signal = self._database.signal(name)
        message = self._database.messages[signal.message_index]
        parts = [part[part["id"] == message.can_id] for part in self._parts]
        frames = np.concatenate(parts) if parts else np.zeros(0, dtype=np.void)
        if not len(frames):
            return np.zeros(0), np.zeros(0)
        values = np.full(self._codec.signals.shape[0], np.nan)
        out = np.empty(len(frames))
        _decode_all(self._codec, message.index, signal.index, frames, values, out)
        return frames["t_ns"] * 1e-9, out

    def on_grid(self, name: str, t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return a signal at given instants: the last value sent, NaN before the first."""
        instants, values = self.series(name)
        if not len(instants):
            return np.full(len(t_s), np.nan)
        at = np.searchsorted(instants, t_s + 1e-9, side="right") - 1
        return np.where(at >= 0, values[np.maximum(at, 0)], np.nan)
