"""Virtual time: a scenario as fast as the machine goes, repeatable to the byte."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.tick import TICK_NS

FrameSink = Callable[[npt.NDArray[np.void], int], None]


class TraceHash:
    """SHA-256 over every frame's time, identifier, flags, length and data, in order."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def add(self, frames: npt.NDArray[np.void], count: int) -> None:
        """Take frames (FRAME records) into the hash."""
        self._digest.update(frames[:count].tobytes())

    def hexdigest(self) -> str:
        """Return the hash so far."""
        return self._digest.hexdigest()


def play_virtual(playing: Playing, sinks: list[FrameSink]) -> str:
    """Play the scenario to its end; return the trace hash.

    Stretches in which the player neither acts nor looks run as one call.
    """
    emulator, player = playing.emulator, playing.player
    trace = TraceHash()
    while not player.finished:
        now = emulator.now_ns
        playing.act(now)
        if player.finished:
            break
        wake = max(player.next_wake_ns(now), now + TICK_NS)
        frames = emulator.advance(wake)
        count = len(frames)
        trace.add(frames, count)
        for sink in sinks:
            sink(frames, count)
    return trace.hexdigest()
