"""Virtual time: a scenario as fast as the machine goes, repeatable to the byte."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Sequence
from queue import Queue
from typing import TYPE_CHECKING, Self

import numpy as np
import numpy.typing as npt

from hev_can_emu.messages.frame import make_frames
from hev_can_emu.messages.frame_copy import copy_frames
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.scenario.monitor import NEVER

if TYPE_CHECKING:
    from hev_can_emu.bus.medium import Medium
    from hev_can_emu.bus.wire_parts import Timing

_BEHIND = 16  # calls' frames that may wait for the hash

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


class HashBehind:
    """As :class:`TraceHash`, on a thread of its own, to be used by ``with``: it hashes while ticks run."""

    def __init__(self) -> None:
        self._trace = TraceHash()
        self._failure: Exception | None = None
        self._batches: Queue[npt.NDArray[np.void] | None] = Queue(maxsize=_BEHIND)
        self._thread = threading.Thread(target=self._run, name="trace hash", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._join()

    def add(self, frames: npt.NDArray[np.void], count: int) -> None:
        """Take frames (FRAME records, copied) into the hash, some time before the end."""
        if count > 0:
            self._batches.put(copy_frames(frames[:count]))

    def end(self) -> str:
        """Wait until all is hashed; return the hash."""
        self._join()
        if self._failure is not None:
            raise self._failure
        return self._trace.hexdigest()

    def _join(self) -> None:
        if self._thread.is_alive():
            self._batches.put(None)
            self._thread.join()

    def _run(self) -> None:
        while (batch := self._batches.get()) is not None:
            try:
                self._trace.add(batch, len(batch))
            except Exception as error:  # noqa: BLE001 - such as no memory; told at the end
                self._failure = error


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
    next multiple of ``longest_ns``, for sinks that look at the car.  The trace is the same either way.
    """
    emulator = playing.emulator
    with HashBehind() as trace:
        while not playing.finished:
            until = NEVER
            if longest_ns is not None:
                until = (emulator.now_ns // longest_ns + 1) * longest_ns
            frames, _ = playing.run(until)
            count = len(frames)
            trace.add(frames, count)
            for sink in sinks:
                sink(frames, count)
        return trace.end()
