"""A scenario's player beside an emulator: all that happens between two of its steps is one call."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt

from hev_can_emu import config
from hev_can_emu.ecu.faults import Fault
from hev_can_emu.errors import InputError, StateError
from hev_can_emu.messages.frame import EXTENDED, FD, SENT, make_frames
from hev_can_emu.messages.frame_copy import copy_frames
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.event_texts import Event
from hev_can_emu.runtime.fault_book import InjectedFault
from hev_can_emu.runtime.sources import sources_of
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.player import Player
from hev_can_emu.scenario.program import Clear, Command, Inject, SendMessage
from hev_can_emu.scenario.schema import Scenario
from hev_can_emu.scenario.script import GO_ON
from hev_can_emu.scenario.verdict import Outcome, Verdict


class RunResult(NamedTuple):
    """What one run came to.

    Attributes:
        name: the scenario's, with the run's parameters where there are several runs.
        file: where the scenario stands.
        parameters: value of each parameter in this run, as written.
        vehicle, model, start: what was run.
        seed: of everything random in the run.
        verdicts: of steps, then of expectations.
        outcome: the worst of them.
        car_ns: how long the car ran.
        events: supervision, faults, locks, modes, ... in the order of time.
        faults: what was injected, when, until when, and how often it acted.
        trace_hash: SHA-256 over all frames; empty where the clock was the wall's.
    """

    name: str
    file: str
    parameters: Mapping[str, str]
    vehicle: str
    model: str
    start: str
    seed: int
    verdicts: tuple[Verdict, ...]
    outcome: Outcome
    car_ns: int
    events: tuple[Event, ...]
    faults: tuple[InjectedFault, ...]
    trace_hash: str


class Playing:
    """One scenario played on one emulator; used alike in virtual and in wall time.

    Args:
        emulator: the car.
        document: where the scenario stands.
        scenario: what to play.
        locate: turns a path in the scenario into its place; default: the document's.
        start: snapshot to begin from, where several runs share the emulator.

    Raises:
        InputError: the scenario does not fit the car's network, or itself.
    """

    def __init__(
        self,
        emulator: Emulator,
        document: config.Document,
        scenario: Scenario,
        locate: Callable[[config.Steps], str] | None = None,
        start: bytes | None = None,
    ) -> None:
        self.emulator = emulator
        self.scenario = scenario
        self._start = start
        self._begun = False
        self.events: list[Event] = []  #: all that happened so far
        self._untold = 0
        self._file = document.name

        def profile(file: str, place: Place) -> str:
            return document.text_beside(file, place.steps)

        sources = sources_of(emulator, profile)
        self.player = Player(scenario, sources, locate or document.where, TICK_NS)
        self._raw: list[npt.NDArray[np.void]] = []
        self._none = make_frames(0)

    def begin(self) -> None:
        """Take the emulator: from now on the scenario acts at every tick."""
        self._begun = True
        if self._start is not None:
            self.emulator.restore(self._start)
            self.emulator.take_events()
        self.emulator.reseed(self.scenario.seed or 0)
        self.emulator.attach(self.player.script)

    @property
    def finished(self) -> bool:
        """Whether the scenario is over."""
        return self.player.finished

    def take_events(self) -> list[Event]:
        """Return what happened since the last call."""
        self.events += self.emulator.take_events()
        fresh = self.events[self._untold :]
        self._untold = len(self.events)
        return fresh

    def result(self, trace_hash: str = "") -> RunResult:
        """Return what the run has come to so far."""
        self.events += self.emulator.take_events()
        setup, scenario = self.emulator.setup, self.scenario
        return RunResult(
            name=scenario.name,
            file=self._file,
            parameters={key: str(value) for key, value in scenario.parameters.items()},
            vehicle=setup.vehicle,
            model=setup.model,
            start=setup.start,
            seed=scenario.seed or 0,
            verdicts=tuple(self.player.verdicts()),
            outcome=self.player.outcome,
            car_ns=self.emulator.now_ns,
            events=tuple(self.events),
            faults=self.emulator.faults,
            trace_hash=trace_hash,
        )

    def run(
        self, until_ns: int, frames: npt.NDArray[np.void] | None = None, count: int = 0
    ) -> tuple[npt.NDArray[np.void], int]:
        """Play ticks before ``until_ns``: as many as one call does, or up to the scenario's end.

        Args:
            until_ns: time to stop at.
            frames: received frames in order of time (FRAME records), none later than the last tick.
            count: how many of them.

        Returns:
            The frames sent, valid until the next call, and how many of the given ones were taken.
        """
        if not self._begun:
            self.begin()
        emulator, player = self.emulator, self.player
        given = self._none if frames is None else frames[:count]
        while not player.finished:
            now = emulator.now_ns
            for command in player.due(now, emulator.state.values):
                self._obey(command)
            if player.finished:
                break
            if player.ending(now):
                if self._look() == GO_ON:
                    player.end(now)
                elif player.full:
                    player.observe()
                continue
            target = min(until_ns, player.horizon_ns(now))
            if target <= now:
                break
            sent, taken = self._step(target, given)
            if player.full:
                player.observe()
            if emulator.now_ns > now:
                return sent, taken
        return self._none, 0

    def advance(
        self, until_ns: int, frames: npt.NDArray[np.void] | None = None, count: int = 0
    ) -> npt.NDArray[np.void]:
        """Play every tick before ``until_ns``, or up to the scenario's end; see :meth:`run`."""
        parts: list[npt.NDArray[np.void]] = []
        taken = 0
        while self.emulator.now_ns < until_ns and not self.finished:
            rest = None if frames is None else frames[taken:count]
            sent, used = self.run(until_ns, rest, count - taken)
            parts.append(copy_frames(sent))
            taken += used
        return np.concatenate(parts) if parts else self._none

    def _step(self, until_ns: int, given: npt.NDArray[np.void]) -> tuple[npt.NDArray[np.void], int]:
        """Advance the emulator, raw frames first; return what was sent and how many were taken."""
        emulator, raw = self.emulator, self._raw
        before = emulator.now_ns
        if not raw:
            sent, taken = emulator.run(until_ns, given, len(given))
        else:
            whole = np.concatenate([*raw, given])
            sent, taken = emulator.run(until_ns, whole, len(whole))
            if emulator.now_ns > before:
                self._raw = []
                own = np.concatenate(raw)
                own["flags"] |= SENT
                sent, taken = np.concatenate([own, sent]), taken - len(own)
        if emulator.now_ns > before and self.player.listens:
            self.player.hear(given[:taken])
            if (
                not emulator.wired
            ):  # else what was sent is among what is given, once it is on the bus
                self.player.hear(sent)
        return sent, taken

    def _look(self) -> int:
        state = self.emulator.state
        return self.player.look(
            self.emulator.now_ns, state.on_bus, state.seen_ns, state.truth, state.values
        )

    def _obey(self, command: Command) -> None:
        emulator = self.emulator
        if isinstance(command, SendMessage):
            message = emulator.database.message(command.message)
            emulator.send_message(message.index, command.enabled)
            return
        if isinstance(command, Inject):
            self._inject(command)
            return
        if isinstance(command, Clear):
            with contextlib.suppress(InputError):  # it has ended by itself
                emulator.clear(command.label)
            return
        record = make_frames(1)
        record["t_ns"] = emulator.now_ns
        record["id"] = command.identifier
        record["flags"] = (EXTENDED if command.extended else 0) | (FD if command.fd else 0)
        record["length"] = len(command.data)
        record["data"][0, : len(command.data)] = np.frombuffer(command.data, dtype=np.uint8)
        self._raw.append(record)

    def _inject(self, command: Inject) -> None:
        try:
            self.emulator.inject(cast(Fault, command.fault))
        except (InputError, StateError) as error:
            self.player.fail(self.emulator.now_ns, command.label, command.where, str(error))
