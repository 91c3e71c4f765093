"""A recording played again: to a bus as it stands, or its requests to a car.

A frame of a recording acts on the car at the first tick after its time: what was sent at a tick is
received at the next one.  So requests of a run in virtual time, played to the same car, give the
same answers to the byte.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.bus.port import Bus, Counters
from hev_can_emu.errors import BusError, InputError
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.frame import ERROR, EXTENDED, REMOTE, SENT, make_frames
from hev_can_emu.runtime import tick
from hev_can_emu.runtime.clock import Grid
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.statistics import Histogram
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.runtime.virtual import FrameSink, TraceHash

Frames = npt.NDArray[np.void]

_STRETCH_NS = 1_000_000_000
_DRAIN = 4096


def messages_of(database: Database, frames: Frames) -> npt.NDArray[np.int64]:
    """Return the index of each frame's message, -1 for frames that the network does not know."""
    keys = frames["id"].astype(np.int64) | (frames["flags"] & EXTENDED).astype(np.int64) << 29
    known = {m.can_id | int(m.extended) << 29: m.index for m in database.messages}
    unique, inverse = np.unique(keys, return_inverse=True)
    found = np.array([known.get(int(key), -1) for key in unique], dtype=np.int64)[inverse]
    found[(frames["flags"] & (REMOTE | ERROR)) != 0] = -1
    return found


def frames_of_senders(database: Database, frames: Frames, senders: Sequence[str]) -> Frames:
    """Return the frames that these nodes send."""
    wanted = np.array([m.sender in senders for m in database.messages] + [False])
    chosen: Frames = frames[wanted[messages_of(database, frames)]]
    return chosen


def requesting_setup(setup: Setup, frames: Frames) -> Setup:
    """Return the setup in which the recording's controller, driver and road take the place of ours.

    Nodes that the setup itself gives an owner keep it.
    """
    car = Emulator(setup)
    played = car.origin == tick.ORIGIN_PLAYED
    indices = set(messages_of(car.database, frames).tolist()) - {-1}
    told = {car.database.messages[index].sender for index in indices if played[index]}
    owners = dict.fromkeys(told, "external") | dict(setup.nodes)
    return msgspec.structs.replace(setup, nodes=owners)


def requests_of(emulator: Emulator, frames: Frames) -> Frames:
    """Return the frames that the car takes from outside; raises InputError where there are none."""
    outside = np.append(emulator.origin == tick.ORIGIN_BUS, False)
    chosen: Frames = frames[outside[messages_of(emulator.database, frames)]].copy()
    if not len(chosen):
        names = sorted(
            {m.sender for m in emulator.database.messages if outside[m.index] and m.sender}
        )
        expected = f"frames of {', '.join(names) or 'a node that is external'}"
        raise InputError("replay --as-requests", expected, "none in the recording")
    chosen["flags"] &= 0xFF ^ SENT
    return chosen


def play_requests(
    emulator: Emulator, requests: Frames, until_ns: int, sinks: Sequence[FrameSink] = ()
) -> str:
    """Let the car live through recorded requests, in virtual time; return the trace hash.

    Args:
        emulator: the car, at its start.
        requests: what it receives, in order of time.
        until_ns: when to stop.
        sinks: take what is received and sent.
    """
    trace = TraceHash()
    received = requests.copy()
    received["t_ns"] += 1
    taken = 0
    while emulator.now_ns < until_ns:
        stop = min(emulator.now_ns + _STRETCH_NS, until_ns)
        end = int(np.searchsorted(received["t_ns"], stop - TICK_NS, side="right"))
        frames = emulator.advance(stop, received[taken:end], end - taken)
        trace.add(frames, len(frames))
        for sink in sinks:
            sink(requests[taken:end], end - taken)
            sink(frames, len(frames))
        taken = end
    return trace.hexdigest()


class Difference(NamedTuple):
    """Where an answer differs from the recording: the message, the instant and both frames' data."""

    message: str
    t_ns: int
    recorded: str
    answered: str


class Comparison:
    """Compares what the car sends with what the recording says that it sent, message by message.

    Use :meth:`take` as a sink, then ask for :meth:`result`.
    """

    def __init__(self, emulator: Emulator, recorded: Frames) -> None:
        own = np.append(emulator.origin == tick.ORIGIN_UNIT, False)
        self._database = emulator.database
        self._own = own
        self._recorded = recorded[own[messages_of(emulator.database, recorded)]]
        self._parts: list[Frames] = []

    def take(self, frames: Frames, count: int) -> None:
        """Keep what the car sent."""
        mine = frames[:count]
        self._parts.append(mine[self._own[messages_of(self._database, mine)]].copy())

    def result(self) -> tuple[int, list[Difference]]:
        """Return how many recorded frames were compared, and each message's first difference."""
        answered = np.concatenate(self._parts) if self._parts else make_frames(1)[:0]
        messages = self._database.messages
        first, second = (messages_of(self._database, each) for each in (self._recorded, answered))
        found = []
        for index in sorted(set(first.tolist())):
            before, after = self._recorded[first == index], answered[second == index]
            both = min(len(before), len(after))
            same = (before["data"][:both] == after["data"][:both]).all(axis=1)
            same &= np.abs(before["t_ns"][:both] - after["t_ns"][:both]) < TICK_NS
            at = int(np.argmin(same)) if not same.all() else both
            if at < max(len(before), len(after)):
                there = [each[at] if at < len(each) else None for each in (before, after)]
                t_ns = min(int(each["t_ns"]) for each in there if each is not None)
                found.append(Difference(messages[index].name, t_ns, *map(_shown, there)))
        return len(self._recorded), sorted(found, key=lambda each: each.t_ns)


def _shown(frame: np.void | None) -> str:
    if frame is None:
        return "nothing"
    data = frame["data"][: frame["length"]].tobytes().hex(" ").upper()
    return f"{data} at {frame['t_ns'] * 1e-9:.3f} s"


class BusPlayer:
    """Plays frames to a bus, each at its time on an absolute grid of 1 ms.

    Args:
        bus: opened by the caller.
        frames: in order of time; the first ones at 0 or later.
        factor: 2 plays twice as fast.

    Attributes:
        sent: frames handed to the bus.
        lateness: from each frame's time to its sending.
    """

    def __init__(self, bus: Bus, frames: Frames, factor: float = 1.0) -> None:
        self.sent = 0
        self.lateness = Histogram()
        self._bus = bus
        self._frames = frames
        self._due_ns = (frames["t_ns"] / factor).astype(np.int64)
        self._scratch = make_frames(_DRAIN)
        self._over = asyncio.Event()
        self._failure: Exception | None = None
        self._start_ns = 0

    def stop(self) -> None:
        """End early."""
        self._over.set()

    async def play(self) -> None:
        """Return when all is sent; raises BusError when the bus is lost."""
        self._start_ns = time.monotonic_ns() + 2 * TICK_NS
        grid = Grid(self._start_ns, TICK_NS, self._send_due)
        grid.start()
        try:
            await self._over.wait()
        finally:
            grid.stop()
        if self._failure is not None:
            raise self._failure

    def _send_due(self) -> None:
        if self._over.is_set():
            return
        try:
            self._bus.drain(self._scratch, _DRAIN)  # nobody reads here: what comes is let go
            now = time.monotonic_ns() - self._start_ns
            end = int(np.searchsorted(self._due_ns, now, side="right"))
            if end > self.sent:
                self._bus.send(self._frames[self.sent : end], end - self.sent)
                for due in self._due_ns[self.sent : end].tolist():
                    self.lateness.add(now - due)
                self.sent = end
        except Exception as error:  # noqa: BLE001 - carried to play(), which raises it
            self._failure = error
            self._over.set()
        if self.sent == len(self._frames):
            self._over.set()


class FedBus(Bus):
    """A bus on which a recording's frames arrive as if another node sent them.

    Programs on the bus see them too.

    Args:
        bus: the medium.
        now_ns: the car's clock.
        frames: in order of time; acting at the first tick after it.
        factor: 2 plays twice as fast.
    """

    def __init__(
        self, bus: Bus, now_ns: Callable[[], int], frames: Frames, factor: float = 1.0
    ) -> None:
        super().__init__(now_ns)
        self._bus = bus
        self._frames = frames.copy()
        self._frames["t_ns"] = (frames["t_ns"] / factor).astype(np.int64) + 1
        self._fed = 0

    @property
    def counters(self) -> Counters:
        """The medium's counters, what was fed in counted as received."""
        inner = self._bus.counters
        return inner._replace(received=inner.received + self._fed)

    @property
    def lost(self) -> BusError | None:
        """Why the medium went away while open, or None."""
        return self._bus.lost

    def describe(self) -> str:
        """Return the medium's name."""
        return self._bus.describe()

    def join_hint(self) -> str:
        """Return how to join the medium."""
        return self._bus.join_hint()

    def drain(self, frames: Frames, capacity: int) -> int:
        """Hand out what is due of the recording, then what came by the medium."""
        now = self._now_ns()
        end = int(np.searchsorted(self._frames["t_ns"], now, side="right"))
        end = min(end, self._fed + capacity)
        count = end - self._fed
        if count:
            fed = self._frames[self._fed : end]
            frames[:count] = fed
            self._bus.send(fed, count)
            self._fed = end
        came = self._bus.drain(frames[count:], capacity - count)
        if came and count:
            both = frames[: count + came]
            both[:] = both[np.argsort(both["t_ns"], kind="stable")]
        return count + came

    def take_notices(self) -> list[str]:
        """Return the medium's notices."""
        return self._bus.take_notices()

    async def _open(self) -> None:
        await self._bus.__aenter__()

    async def _close(self) -> None:
        await self._bus.__aexit__(None, None, None)

    def _send(self, raw: bytes, count: int) -> None:
        self._bus._send(raw, count)
