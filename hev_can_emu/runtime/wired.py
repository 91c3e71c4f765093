"""A car on a bus with bit times: each control unit is a node of its own, and hears only what gets through."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.bus.medium import Medium, Port
from hev_can_emu.bus.wire_parts import Timing, WireEvent
from hev_can_emu.messages.frame import EXTENDED, FRAME, SENT
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.event_texts import Event
from hev_can_emu.runtime.tick import ORIGIN_PLAYED, ORIGIN_UNIT
from hev_can_emu.runtime.wire_faults import WireFaults

Frames = npt.NDArray[np.void]


class WiredCar:
    """An emulator and the medium it is on.

    Args:
        emulator: from now on it sees what it sends only when that comes back.
        medium: the bus.

    Attributes:
        senders: which unit sends which identifier (and whether that is extended), of those played here.
    """

    def __init__(self, emulator: Emulator, medium: Medium) -> None:
        emulator.wired = True
        self._wire = medium.wire
        self.senders: dict[tuple[int, bool], str] = {}
        self._receivers: dict[tuple[int, bool], frozenset[str]] = {}
        here = set()
        for message in emulator.database.messages:
            if emulator.origin[message.index] in (ORIGIN_UNIT, ORIGIN_PLAYED) and message.sender:
                self.senders[message.can_id, message.extended] = message.sender
                here.add(message.sender)
        for message in emulator.database.messages:
            receivers = frozenset(here.intersection(message.receivers))
            self._receivers[message.can_id, message.extended] = receivers
        emulator.bus_faults = WireFaults(medium, sorted(here))

    def sort_out(self, frames: Frames, count: int) -> tuple[int, int]:
        """Keep, of the first ``count`` frames, those that a unit of the car can hear.

        A frame goes unheard when all its receivers here are off the bus.

        Returns:
            How many are left, now at the beginning; how many of them were sent by others.
        """
        foreign = int(np.count_nonzero(frames["flags"][:count] & SENT == 0))
        off = self._wire.names_off
        if not off:
            return count, foreign
        kept = [i for i in range(count) if not self._is_unheard(frames[i], off)]
        frames[: len(kept)] = frames[kept]
        return len(kept), int(np.count_nonzero(frames["flags"][: len(kept)] & SENT == 0))

    def _is_unheard(self, frame: np.void, off: set[str]) -> bool:
        identifier = (int(frame["id"]), bool(int(frame["flags"]) & EXTENDED))
        receivers = self._receivers.get(identifier, frozenset())
        return bool(receivers) and receivers <= off


class VirtualWire:
    """A medium in virtual time with a car on it: what is sent in one tick is carried in the next.

    Args:
        emulator: the car, whose time is the medium's.
        timing: bit rates.

    Attributes:
        medium: the bus; other ports may join it.
    """

    def __init__(self, emulator: Emulator, timing: Timing) -> None:
        self._emulator = emulator
        self._horizon_ns = emulator.now_ns
        self.medium = Medium(timing, lambda: self._horizon_ns)
        self._car = WiredCar(emulator, self.medium)
        self._carried: list[bytes] = []
        self._port: Port = self.medium.join("car", self._take)
        self._port.play(self._car.senders)
        self.medium.listeners.append(self._note_state)

    def _note_state(self, event: WireEvent) -> None:
        self._emulator.note(Event(event.t_ns, "bus", event.describe(), 0, 0.0))

    def _take(self, record: bytes, t_ns: int) -> None:
        self._carried.append(record)

    def send(self, frames: Frames) -> None:
        """Submit what the car has just sent, at the time of its latest tick."""
        self._port.send(frames.tobytes())

    def receive(self) -> Frames:
        """Let the wire run up to the car's next tick; return what it carried, as the car hears it."""
        self._horizon_ns = self._emulator.now_ns
        self.medium.pump()
        frames = np.frombuffer(b"".join(self._carried), dtype=FRAME).copy()
        self._carried.clear()
        count, _ = self._car.sort_out(frames, len(frames))
        return frames[:count]
