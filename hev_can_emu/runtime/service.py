"""The service: an emulator on a bus in real time, as one asyncio task group.

One grid of absolute 1 ms deadlines; at each, frames are drained from the bus, one compiled call advances
the car, and what is due is handed to the bus's own sender.  A tick that starts a whole period or more after
its deadline is an *overrun*: it is counted, made up for at once (all missed ticks in one call, so no
cyclic message is lost), and the grid stays.  What arrived while this process was held up is spread
over the missed ticks, so that a busy host does not look like a lost request.  A stall of
more than a second (suspended machine) is not made
up for: car time stands still meanwhile, and the jump
is counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import signal
import sys
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.bus.port import Bus
from hev_can_emu.jit import ready_compiler
from hev_can_emu.messages.frame import make_frames
from hev_can_emu.runtime.clock import Grid
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.event_texts import Event
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.statistics import Statistics
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.runtime.virtual import FrameSink
from hev_can_emu.runtime.wired import WiredCar

RECEIVE_FRAMES = 8192
STALL_NS = 1_000_000_000
SWITCH_S = 2e-4  #: how long another thread may keep the tick waiting for the interpreter, s
TOO_LATE_MS = 100.0  #: a tick so late can cost the other side its time-outs
LATE_TICKS = 3  #: from here on a late loop reads its sockets before it catches up


class Watcher(NamedTuple):
    """Something done now and then beside the ticks; ``look`` must return at once."""

    name: str
    period_s: float
    look: Callable[[], None]


class Service:
    """Runs an emulator on a bus until told to stop.

    Args:
        emulator: the car.
        make_bus: makes the bus from the clock that stamps received frames.
        sinks: take what is received and sent, as recorders do.
        playing: a scenario, or None; its end ends the run.
        duration_ns: car time to stop at, or None.
        on_ready: called once the bus is open.
        on_status: called about five times a second.
        on_event: called with each event and each notice of the bus.
        watchers: run as tasks beside the ticks.
    """

    def __init__(
        self,
        emulator: Emulator,
        make_bus: Callable[[Callable[[], int]], Bus],
        sinks: Sequence[FrameSink] = (),
        playing: Playing | None = None,
        duration_ns: int | None = None,
        on_ready: Callable[[Bus], None] | None = None,
        on_status: Callable[[Statistics], None] | None = None,
        on_event: Callable[[Event], None] | None = None,
        watchers: Sequence[Watcher] = (),
    ) -> None:
        self.emulator = emulator
        self.statistics = Statistics()
        self.interrupted = False
        self.opened = False
        self._sinks = sinks
        self._playing = playing
        self._duration_ns = duration_ns
        self._on_ready = on_ready
        self._on_status = on_status
        self._on_event = on_event
        self._watchers = watchers
        self._on_played: Callable[[], None] | None = None
        self._start_ns = time.monotonic_ns()
        self._shift_ns = 0  # from the car's time to the bus's, after another car took over
        self.bus = make_bus(self._bus_now_ns)
        self._wired: WiredCar | None = None
        self._wire()
        self._received = make_frames(RECEIVE_FRAMES)
        self._waiting = 0  # frames in it that came after the last tick's deadline
        self._postponed = False  # a late tick waits until the sockets have been read
        self._stop = asyncio.Event()
        self._failure: Exception | None = None

    def _wire(self) -> None:
        """Put the car's units on the bus one by one, where the bus has bit times."""
        if self.bus.medium is not None:
            self._wired = WiredCar(self.emulator, self.bus.medium)
            self.bus.play(self._wired.senders)

    def stop(self) -> None:
        """End the run after the present tick."""
        self._stop.set()

    def swap(
        self,
        emulator: Emulator,
        playing: Playing | None = None,
        on_played: Callable[[], None] | None = None,
    ) -> Emulator:
        """Let another car take over at the next tick; the bus's time goes on. Return the one before.

        Args:
            emulator: the car; its time goes on from where it stands.
            playing: a scenario played on it, or None.
            on_played: called when the scenario is over, instead of ending the run.
        """
        self.tell()
        before = self.emulator
        shift_ns = before.now_ns - emulator.now_ns
        self._shift_ns += shift_ns
        self._start_ns += shift_ns
        self._received["t_ns"][: self._waiting] -= shift_ns
        self.emulator, self._playing, self._on_played = emulator, playing, on_played
        self._wire()
        return before

    async def run(self) -> None:
        """Run to the end; raises BusError when the bus is lost, InputError when it cannot be opened."""
        loop = asyncio.get_running_loop()
        with contextlib.ExitStack() as undo:
            # Python's default lets a recorder's thread keep the interpreter for 5 ms.
            undo.callback(sys.setswitchinterval, sys.getswitchinterval())
            sys.setswitchinterval(SWITCH_S)
            for number in (signal.SIGINT, signal.SIGTERM):
                with contextlib.suppress(ValueError, RuntimeError, NotImplementedError):
                    loop.add_signal_handler(number, self._interrupt)
                    undo.callback(loop.remove_signal_handler, number)
            # No kernel called for the first time may hold up the tick while the compiler is imported.
            ready_compiler()
            # A full collection over the compiler's half a million objects would take a hundred ticks.
            gc.collect()
            gc.freeze()
            undo.callback(gc.unfreeze)
            async with self.bus:
                self.opened = True
                if self._on_ready is not None:
                    self._on_ready(self.bus)
                async with asyncio.TaskGroup() as tasks:
                    beside = [tasks.create_task(self._report(), name="status")]
                    beside += [
                        tasks.create_task(_watch(watcher), name=watcher.name)
                        for watcher in self._watchers
                    ]
                    await self._tick_until_stopped()
                    for task in beside:
                        task.cancel()
        self.judge_clock()
        if self._failure is not None:
            raise self._failure

    def judge_clock(self) -> None:
        """Let a scenario's failures not count where the host was too slow to tell."""
        statistics = self.statistics
        late_ms = statistics.lateness.largest_us * 1e-3
        if self._playing is None or (late_ms < TOO_LATE_MS and not statistics.stalls):
            return
        observed = f"a tick {late_ms:.0f} ms late"
        if statistics.stalls:
            observed = f"a stall of {statistics.stalled_ns * 1e-9:.1f} s"
        self._playing.player.distrust(
            self.emulator.now_ns, observed, f"no tick {TOO_LATE_MS:g} ms late"
        )

    def _interrupt(self) -> None:
        self.interrupted = True
        self.stop()

    def _now_ns(self) -> int:
        return time.monotonic_ns() - self._start_ns

    def _bus_now_ns(self) -> int:
        return self._now_ns() + self._shift_ns

    async def _tick_until_stopped(self) -> None:
        # The car's time starts with the first deadline, a moment from now.
        self._start_ns = time.monotonic_ns() + 5 * TICK_NS - self.emulator.now_ns
        grid = Grid(self._start_ns + self.emulator.now_ns, TICK_NS, self._due)
        grid.start()
        try:
            await self._stop.wait()
        finally:
            grid.stop()
        if self._failure is None and self.bus.lost is None:
            # What came after the last tick moves the car no more, but it was on the bus.
            count = self._receive(self._now_ns())
            self._waiting = 0
            received = self._on_bus_time(self._received[:count])
            for sink in self._sinks:
                sink(received, count)

    def _due(self) -> None:
        """Do every tick whose deadline has passed."""
        if self._stop.is_set():
            return
        late = self._now_ns() - self.emulator.now_ns >= LATE_TICKS * TICK_NS
        if late and not self._postponed:
            # This loop was held up, so frames that came meanwhile still lie in the sockets.  They are
            # read first, or the ticks made up for would miss requests that were sent in time.
            self._postponed = True
            asyncio.get_running_loop().call_soon(self._due)
            return
        try:
            self._catch_up()
        except Exception as error:  # noqa: BLE001 - carried to run(), which raises it
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self._failure = self._failure or error
        self.stop()

    def _catch_up(self) -> None:
        emulator, statistics = self.emulator, self.statistics
        now = self._now_ns()
        behind = now - emulator.now_ns
        if behind < 0:
            return
        if behind >= STALL_NS:
            lost = behind // TICK_NS * TICK_NS
            self._start_ns += lost
            statistics.stalls += 1
            statistics.stalled_ns += lost
            now -= lost
            behind -= lost
        missed = behind // TICK_NS
        statistics.overruns += missed
        begin = emulator.now_ns
        last = begin + missed * TICK_NS
        if self._duration_ns is not None:
            last = max(begin, min(last, self._duration_ns - self._shift_ns - TICK_NS))
        count = self._receive(now)
        taken = self._advance(last, 0, count)
        self._waiting = count - taken
        if taken and self._waiting:
            self._received[: self._waiting] = self._received[taken:count].copy()
        done = (emulator.now_ns - begin) // TICK_NS
        statistics.ticks += done
        late = self._now_ns() - emulator.now_ns + TICK_NS
        for tick in range(done):
            statistics.lateness.add(late + tick * TICK_NS)
        if self._duration_ns is not None and self._bus_time_ns >= self._duration_ns:
            self.stop()
        if self._playing is not None and self._playing.finished:
            if self._on_played is None:
                self.stop()
            else:
                self._on_played()

    @property
    def shift_ns(self) -> int:
        """From the present car's time to the bus's, ns; 0 until another car has taken over."""
        return self._shift_ns

    @property
    def _bus_time_ns(self) -> int:
        return self.emulator.now_ns + self._shift_ns

    def _receive(self, now_ns: int) -> int:
        """Take what has come, behind what still waits; return how many frames there are."""
        waiting = self._waiting
        fresh = self._received[waiting:]
        count = self.bus.drain(fresh, RECEIVE_FRAMES - waiting)
        if self._wired is None:
            self.statistics.received += count
        else:
            count, foreign = self._wired.sort_out(fresh, count)
            self.statistics.received += foreign
        count += waiting
        if count:
            # The car's time was set back after a stamp was given: at the start, after a stall.
            stamps = self._received["t_ns"][:count]
            stamps[waiting:] -= self._shift_ns
            np.minimum(stamps, now_ns, out=stamps)
            if self._postponed:
                # When they came is not known any more: spread over the ticks to be made up for.
                first = self.emulator.now_ns
                stamps[waiting:] = np.linspace(first, now_ns, count - waiting, endpoint=False)
        self._postponed = False
        return count

    def _advance(self, last_ns: int, first: int, count: int) -> int:
        """Do the ticks up to ``last_ns``, handing them what came by then.

        A frame that comes between a deadline and its tick belongs to the next tick.

        Args:
            last_ns: deadline of the last tick to do.
            first: first frame not yet handed over.
            count: end of the received frames.

        Returns:
            The first frame that is now not yet handed over.
        """
        end = count
        if first < count:
            later = np.flatnonzero(self._received["t_ns"][first:count] > last_ns)
            if len(later):
                end = first + int(later[0])
        received = self._received[first:end]
        car = self._playing or self.emulator
        frames = car.advance(last_ns + TICK_NS, received, end - first)
        received, frames = self._on_bus_time(received), self._on_bus_time(frames)
        if len(frames):
            self.statistics.sent += len(frames)
            self.bus.send(frames, len(frames))
        for sink in self._sinks:
            sink(received, end - first)
            if self._wired is None:  # else they come back once they are on the bus
                sink(frames, len(frames))
        return end

    def _on_bus_time(self, frames: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
        if not self._shift_ns:
            return frames
        shifted = frames.copy()
        shifted["t_ns"] += self._shift_ns
        return shifted

    async def _report(self) -> None:
        """Tell status, events and the bus's notices, off the tick's path."""
        while True:
            await asyncio.sleep(0.2)
            self.tell()
            if self._on_status is not None:
                self._on_status(self.statistics)
            if self.bus.lost is not None:
                self._fail(self.bus.lost)

    def tell(self) -> None:
        """Hand over events and notices that have come since the last time."""
        source = self._playing or self.emulator
        events = source.take_events()
        if self._on_event is None:
            return
        for event in events:
            self._on_event(event)
        for notice in self.bus.take_notices():
            self._on_event(Event(self.emulator.now_ns, "bus", notice, 0, 0.0))


async def _watch(watcher: Watcher) -> None:
    while True:
        await asyncio.sleep(watcher.period_s)
        watcher.look()
