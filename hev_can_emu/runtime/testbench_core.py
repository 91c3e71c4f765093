"""What a test does with a car and sees of it; how time passes is left to :mod:`.testbench`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu.faults import Fault, parse
from hev_can_emu.errors import InputError, NotMet, StateError
from hev_can_emu.messages.frame import EXTENDED, FD, frame, make_frames
from hev_can_emu.messages.frame_copy import copy_frames
from hev_can_emu.runtime.conditions import Asker
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.event_texts import Event
from hev_can_emu.runtime.fault_book import InjectedFault
from hev_can_emu.runtime.recording import Recording
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.signal_log import SignalLog
from hev_can_emu.runtime.tick import ORIGIN_PLAYED, TICK_NS
from hev_can_emu.runtime.virtual import FrameSink, TraceHash
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.signals import Signal, Signals
from hev_can_emu.units import parse_quantity

Frames = npt.NDArray[np.void]
Value = float | str

PLAYED = {"HCU": "emulated", "VEH": "emulated"}
PERIOD_NS = 10_000_000


@runtime_checkable
class SignalController(Protocol):
    """A controller that reads and sets signals; the bench sends its messages."""

    def step(self, t_s: float, read: Callable[[str], float]) -> Mapping[str, Value] | None:
        """Return what to send from ``t_s`` on; ``read`` gives a signal as last seen on the bus."""


@runtime_checkable
class FrameController(Protocol):
    """A controller that speaks CAN: its node is external, its frames are taken as they are."""

    def exchange(self, t_ns: int, received: Frames) -> Frames:
        """Return what is sent at ``t_ns``; ``received``: what was on the bus since the last call."""


class Snapshot(NamedTuple):
    """All of a bench at an instant."""

    car: bytes
    t_ns: int
    trace: TraceHash
    next_control_ns: int
    controller: object


class BenchCore:
    """What both faces share; see :class:`.testbench.SyncTestbench`."""

    def __init__(
        self,
        setup: Setup | None = None,
        *,
        controller: SignalController | FrameController | None = None,
        period: Value = "10 ms",
        seed: int = 0,
        record: Sequence[str | Path] = (),
        **choices: Any,
    ) -> None:
        if setup is not None and choices:
            raise ValueError("expected a setup or its fields, got both")
        if controller is not None and not isinstance(
            controller, SignalController | FrameController
        ):
            raise ValueError("expected a controller with a method step or exchange")
        owners = dict(PLAYED)
        if isinstance(controller, FrameController):
            owners["HCU"] = "external"
        setup = setup or Setup(**choices)
        owners |= setup.nodes
        self.emulator = Emulator(msgspec.structs.replace(setup, nodes=owners))
        self.emulator.reseed(seed)
        self.events: list[Event] = []  #: all that happened so far
        self._period_ns = nanoseconds(period, "period")
        if self._period_ns < TICK_NS:
            raise ValueError("expected a period of 1 ms or more")
        self._controller = controller
        self._next_control_ns = 0
        self._heard: list[Frames] = []
        self._given: list[Frames] = []
        self._signals = Signals(self.emulator.database.messages)
        self._asker = Asker(self.emulator)
        self._log = SignalLog(self.emulator.database, self.emulator.constants.codec)
        self._trace = TraceHash()
        self._record = tuple(record)
        self._recording: Recording | None = None
        self._sinks: list[FrameSink] = []
        self._open = False

    # What a test does

    def set(self, signals: Mapping[str, Value] | None = None, /, **more: Value) -> None:
        """Set what played nodes send from now on.

        Args:
            signals, more: by name; a number in the signal's unit, a quantity (``"20 km/h"``), a label, or
                ``"not available"``.

        Raises:
            InputError: an unknown signal or label, a wrong unit, out of range; a node that is not played.
        """
        for name, value in {**(signals or {}), **more}.items():
            place = Place(lambda steps: f"bench.set {steps[0]}") / name
            signal = self._signals.require(name, place)
            message = self.emulator.database.message(signal.message)
            if self.emulator.origin[message.index] != ORIGIN_PLAYED:
                owner = f"a signal of a played node ({', '.join(self._played())})"
                raise InputError(f"bench.set {name}", owner, f"one of {message.sender}")
            self.emulator.set_value(signal.index, signal.parse(value, place))

    def silence(self, message: str) -> None:
        """Stop the sending of a message; raises InputError for an unknown one."""
        self.emulator.send_message(self.emulator.database.message(message).index, False)

    def resume(self, message: str) -> None:
        """Send a message again."""
        self.emulator.send_message(self.emulator.database.message(message).index, True)

    def send(self, can_id: int, data: bytes, *, extended: bool = False, fd: bool = False) -> None:
        """Put a frame on the bus, once, as it stands; the car receives it at the next tick."""
        self._check_open()
        flags = EXTENDED * extended | FD * fd
        self._given.append(frame(can_id, data, self.emulator.now_ns, flags))
        if isinstance(self._controller, FrameController):
            self._heard.append(self._given[-1])

    def inject(self, fault: Fault | Mapping[str, Any]) -> str:
        """Inject a fault; return the name by which it is cleared (see docs/faults.md)."""
        return self.emulator.inject(parse(fault) if isinstance(fault, Mapping) else fault)

    def clear(self, name: str) -> None:
        """End a fault; raises InputError where none of this name is live."""
        self.emulator.clear(name)

    # What a test sees

    @property
    def now_s(self) -> float:
        """The car's time."""
        return self.emulator.now_ns * 1e-9

    def __getitem__(self, name: str) -> float:
        """Return a signal as last seen on the bus, or ``truth.NAME``; NaN for not available."""
        if name.startswith("truth."):
            return self.emulator.truth(name.removeprefix("truth."))
        return self.emulator.signal(name)

    def say(self, name: str) -> str:
        """Return a signal in words: its label, or its value with the unit."""
        return self._signal(name).say(self.emulator.signal(name))

    def holds(self, condition: str) -> bool:
        """Return whether a condition of the scenario language holds now."""
        return self._asker.condition(condition).holds()

    def value(self, expression: str) -> float:
        """Return the value of an expression of the scenario language now."""
        return self._asker.expression(expression).value()

    def series(self, name: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return instants, s, and values of a signal so far."""
        return self._log.series(name)

    @property
    def faults(self) -> tuple[InjectedFault, ...]:
        """What was injected, and what became of it."""
        return self.emulator.faults

    @property
    def trace(self) -> str:
        """SHA-256 over all frames that the car and its played nodes sent so far."""
        return self._trace.hexdigest()

    # Going back

    def snapshot(self) -> Snapshot:
        """Return the state of the car, and of a controller that has a ``snapshot`` of its own."""
        take = getattr(self._controller, "snapshot", None)
        return Snapshot(
            self.emulator.snapshot(),
            self.emulator.now_ns,
            self._trace.copy(),
            self._next_control_ns,
            None if take is None else take(),
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this bench; a recording goes on, and shows both ways.

        Raises:
            StateError: a controller without ``snapshot`` and ``restore`` cannot go back.
            ValueError: the snapshot of another car.
        """
        if self._controller is not None and not hasattr(self._controller, "restore"):
            raise StateError("the controller cannot be restored: it needs snapshot and restore")
        self.emulator.restore(snapshot.car)
        if self._controller is not None:
            cast(Any, self._controller).restore(snapshot.controller)
        self._next_control_ns = snapshot.next_control_ns
        self._trace = snapshot.trace.copy()
        self._log.forget_from(snapshot.t_ns)
        self._heard, self._given = [], []

    # Running

    def _start(self) -> None:
        if self._open:
            raise StateError("the bench is open already")
        self._recording = Recording(self.emulator, self._record)
        self._sinks = [*self._recording.sinks, self._log.add]
        self._open = True

    def _end(self) -> None:
        self._open = False
        if self._recording is not None:
            self._recording.close()
            self._recording = None

    def _check_open(self) -> None:
        if not self._open:
            raise StateError("the bench is not open: use it in a with block")

    def _control(self, until_ns: int) -> int:
        """Let the controller act where it is due; return how far the car may run."""
        now = self.emulator.now_ns
        if self._controller is None:
            return until_ns
        if now >= self._next_control_ns:
            self._next_control_ns += self._period_ns
            if isinstance(self._controller, FrameController):
                heard = np.concatenate(self._heard) if self._heard else make_frames(0)
                self._heard = []
                sent = self._controller.exchange(now, heard)
                if len(sent):
                    stamped = copy_frames(sent)
                    stamped["t_ns"] = now
                    self._given.append(stamped)
            else:
                self.set(self._controller.step(now * 1e-9, self.emulator.signal) or {})
        return min(until_ns, self._next_control_ns)

    def _take_given(self) -> Frames:
        given = np.concatenate(self._given) if self._given else make_frames(0)
        self._given = []
        return given

    def _note(self, received: Frames, sent: Frames) -> None:
        """Keep what was on the bus."""
        self._trace.add(sent, len(sent))
        self.events += self.emulator.take_events()
        if isinstance(self._controller, FrameController):
            self._heard.append(copy_frames(sent))
        for sink in self._sinks:
            if len(received):
                sink(received, len(received))
            sink(sent, len(sent))

    def _instant(self, duration: Value) -> int:
        self._check_open()
        length = nanoseconds(duration, "duration")
        return self.emulator.now_ns + -(-length // TICK_NS) * TICK_NS

    def _missed(self, condition: str, within: Value, since_ns: int) -> NotMet:
        seen = self._asker.condition(condition).observe(since_ns)
        limit = within if isinstance(within, str) else f"{within:g} s"
        return NotMet(f"{condition} within {limit}: {seen} at {self.now_s:.3f} s")

    def _signal(self, name: str) -> Signal:
        return self._signals.require(name, Place(lambda steps: "bench"))

    def _played(self) -> list[str]:
        messages = self.emulator.database.messages
        return sorted(
            {m.sender for m in messages if self.emulator.origin[m.index] == ORIGIN_PLAYED}
        )


def nanoseconds(value: Value, what: str) -> int:
    """Return a time given in seconds or as text with a unit; raises InputError."""
    if isinstance(value, str):
        value = parse_quantity(value, f"bench {what}", "s").si_value
    if not 0.0 <= value < 1e7:
        raise InputError(f"bench {what}", "a time of 0 s or more", f"{value:g} s")
    return round(value * 1e9)
