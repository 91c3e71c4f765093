"""Virtual time in step with controllers in other processes, over the embedded server."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from hev_can_emu.bus.lockstep import LockstepBus
from hev_can_emu.messages.frame import make_frames
from hev_can_emu.messages.frame_copy import copy_frames
from hev_can_emu.runtime.virtual import FrameSink

Frames = npt.NDArray[np.void]

RECEIVE_FRAMES = 8192


class Car(Protocol):
    """An emulator, or a scenario beside one."""

    def advance(self, until_ns: int, frames: Frames | None = None, count: int = 0) -> Frames:
        """Run every tick before ``until_ns``; return the frames sent."""


class Lockstep:
    """Steps a car as far as the partners on a bus allow.

    Args:
        car: what is stepped.
        now_ns: its time.
        bus: open; its clock is the car's.
        sinks: take what is received and sent.
    """

    def __init__(
        self,
        car: Car,
        now_ns: Callable[[], int],
        bus: LockstepBus,
        sinks: Sequence[FrameSink] = (),
    ) -> None:
        self._car = car
        self._now_ns = now_ns
        self._bus = bus
        self._sinks = sinks
        self._received = make_frames(RECEIVE_FRAMES)
        self._allowed_ns = 0

    async def step(self, until_ns: int, given: Frames | None = None) -> tuple[Frames, Frames]:
        """Run to ``until_ns``, or as far as all partners allow; return frames received and sent.

        Args:
            until_ns: not beyond this.
            given: frames from this process that the car and the partners receive now.

        Raises:
            BusError: a partner has left, or has not answered in time.
        """
        now = self._now_ns()
        if self._allowed_ns <= now:
            self._allowed_ns = await self._bus.agree()
        count = self._bus.drain(self._received, RECEIVE_FRAMES)
        frames = copy_frames(self._received[:count])
        if given is not None and len(given):
            frames = np.concatenate([given, frames])
            self._bus.send(given, len(given))
        sent = self._car.advance(min(until_ns, self._allowed_ns), frames, len(frames))
        sent = copy_frames(sent)
        self._bus.send(sent, len(sent))
        for sink in self._sinks:
            sink(frames, len(frames))
            sink(sent, len(sent))
        if self._allowed_ns <= self._now_ns():
            self._bus.tell()
        return frames, sent
