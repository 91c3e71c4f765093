"""What the bus said over a run: frames kept, signals read from them afterwards."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.messages.codec import Codec, decode
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.definitions import MessageDef
from hev_can_emu.messages.frame import EXTENDED, make_frames
from hev_can_emu.messages.frame_copy import copy_frames
from hev_can_emu.native import Bound


@kernel
def _decode_all(
    codec: Codec,
    message: int,
    signal: int,
    frames: npt.NDArray[np.void],
    values: npt.NDArray[np.float64],
    out: npt.NDArray[np.float64],
) -> int:
    for i in range(frames.shape[0]):
        decode(codec, message, frames[i]["data"], values)
        out[i] = values[signal]
    return int(frames.shape[0])


class SignalLog:
    """Keeps every frame of a run (80 bytes each) and gives signals as time series."""

    def __init__(self, database: Database, codec: Codec) -> None:
        self._database = database
        self._values = np.full(codec.signals.shape[0], np.nan)
        example = (0, 0, make_frames(0), self._values, np.zeros(0))
        self._decode = Bound(_decode_all, (codec,), example)
        self._parts: list[npt.NDArray[np.void]] = []
        self._sorted: dict[int, npt.NDArray[np.void]] = {}
        self.count = 0  #: frames kept

    def add(self, frames: npt.NDArray[np.void], count: int) -> None:
        """Keep frames (FRAME records; copied)."""
        if count:
            self._parts.append(copy_frames(frames[:count]))
            self._sorted.clear()
            self.count += count

    def forget_from(self, t_ns: int) -> None:
        """Drop what came at an instant or later."""
        frames = self._whole()
        self._parts = [frames[frames["t_ns"] < t_ns]]
        self._sorted.clear()
        self.count = len(self._parts[0])

    def instants_ns(self, message: MessageDef) -> npt.NDArray[np.int64]:
        """Return when a message was on the bus."""
        t_ns: npt.NDArray[np.int64] = self._of(message)["t_ns"]
        return t_ns

    def between(self, start_ns: int, stop_ns: int) -> npt.NDArray[np.void]:
        """Return all frames from an instant up to but not at another."""
        frames = self._whole()
        first, last = np.searchsorted(frames["t_ns"], [start_ns, stop_ns])
        return frames[first:last]

    def _whole(self) -> npt.NDArray[np.void]:
        """Return all frames as one array, in order of time."""
        if len(self._parts) != 1:
            joined = np.concatenate(self._parts) if self._parts else make_frames(0)
            self._parts = [joined[np.argsort(joined["t_ns"], kind="stable")]]
        return self._parts[0]

    def _of(self, message: MessageDef) -> npt.NDArray[np.void]:
        """Return a message's frames; all messages are told apart at once, as reports ask for many."""
        if not self._sorted:
            frames = self._whole()
            keys = frames["id"] | (frames["flags"] & EXTENDED).astype(np.uint32) << 29
            order = np.argsort(keys, kind="stable")
            unique, starts = np.unique(keys[order], return_index=True)
            parts = np.split(order, starts[1:])
            self._sorted = {
                int(key): frames[part] for key, part in zip(unique, parts, strict=True) if len(part)
            }
        key = message.can_id | int(message.extended) << 29
        return self._sorted.get(key, make_frames(0))

    def series(self, name: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return instants, s, and physical values of a signal; raises InputError for an unknown one."""
        signal = self._database.signal(name)
        message = self._database.messages[signal.message_index]
        frames = self._of(message)
        frames = frames[frames["length"] == message.wire_length]
        if not len(frames):
            return np.zeros(0), np.zeros(0)
        out = np.empty(len(frames))
        self._values.fill(np.nan)
        self._decode(message.index, signal.index, frames, self._values, out)
        return frames["t_ns"] * 1e-9, out

    def on_grid(self, name: str, t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return a signal at given instants: the last value sent, NaN before the first."""
        instants, values = self.series(name)
        if not len(instants):
            return np.full(len(t_s), np.nan)
        at = np.searchsorted(instants, t_s + 1e-9, side="right") - 1
        return np.where(at >= 0, values[np.maximum(at, 0)], np.nan)
