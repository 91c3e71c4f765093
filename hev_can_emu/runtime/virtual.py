"""Virtual time: a scenario as fast as the machine goes, repeatable to the byte."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hev_can_emu.messages.frame import make_frames
from hev_can_emu.messages.frame_copy import lasting_frames
from hev_can_emu.runtime.behind import Behind
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.scenario.monitor import NEVER

if TYPE_CHECKING:
    from hev_can_emu.bus.medium import Medium
    from hev_can_emu.bus.wire_parts import Timing

FrameSink = Callable[[npt.NDArray[np.void], int], None]


class TraceHash:
    """SHA-256 over every frame's time, identifier, flags, length and data, in order."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def add(self, frames: npt.NDArray[np.void], count: int) -> None:
        """Take frames (FRAME records) into the hash."""
        self._digest.update(np.ascontiguousarray(frames[:count]).view(np.uint8).data)

    def hexdigest(self) -> str:
        """Return the hash so far."""
        return self._digest.hexdigest()

    def copy(self) -> TraceHash:
        """Return another one that goes on from here."""
        other = TraceHash()
        other._digest = self._digest.copy()
        return other


def play_on_wire(
    playing: Playing, sinks: Sequence[FrameSink], timing: Timing
) -> tuple[str, Medium]:
    """Play the scenario to its end on a bus with bit times; return the trace hash and the bus.

    Each tick is a call: what is sent in one may be on the bus by the next.
    """
    from hev_can_emu.runtime.wired import VirtualWire

    emulator = playing.emulator
    wire = VirtualWire(emulator, timing)
    trace = TraceHash()
    waiting = make_frames(0)
    while not playing.finished:
        before = emulator.now_ns
        sent, taken = playing.run(before + TICK_NS, waiting, len(waiting))
        if emulator.now_ns == before:
            continue
        wire.send(sent)
        carried = wire.receive()
        trace.add(carried, len(carried))
        for sink in sinks:
            sink(carried, len(carried))
        waiting = np.concatenate([waiting[taken:], carried])
    return trace.hexdigest(), wire.medium


def play_virtual(
    playing: Playing, sinks: Sequence[FrameSink], longest_ns: int | None = None
) -> str:
    """Play the scenario to its end; return the trace hash.

    Stretches between two of its steps run as one call, but none ends later than the
    next multiple of ``longest_ns``, for sinks that look at the car and its verdicts.  The trace is the same
    either way.  Sinks get frames that last.
    """
    emulator = playing.emulator
    trace = TraceHash()
    with Behind() as behind:
        if longest_ns is None:
            playing.player.look_behind(behind)
        try:
            while not playing.finished:
                until = NEVER
                if longest_ns is not None:
                    until = (emulator.now_ns // longest_ns + 1) * longest_ns
                sent, _ = playing.run(until)
                # One copy serves all.
                frames = lasting_frames(sent)
                behind.do(partial(trace.add, frames, len(frames)))
                for sink in sinks:
                    sink(frames, len(frames))
            behind.wait()
        finally:
            playing.player.look_behind(None)
    return trace.hexdigest()
