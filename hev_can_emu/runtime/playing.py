"""A scenario's player beside an emulator: what it asks for is set, what it sees is the bus."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from hev_can_emu import config
from hev_can_emu.runtime.emulator import Emulator, Event
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.scenario.player import Player
from hev_can_emu.scenario.schema import Scenario
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.scenario.stimuli import SetSignal
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
        faults: what was injected, a line each.
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
    faults: tuple[str, ...]
    trace_hash: str


class Playing:
    """One scenario played on one emulator; used alike in virtual and in wall time."""

    def __init__(self, emulator: Emulator, document: config.Document, scenario: Scenario) -> None:
        self.emulator = emulator
        self.scenario = scenario
        self.events: list[Event] = []  #: all that happened so far
        self._untold = 0
        self._file = document.name
        signals = Signals(emulator.database.messages)
        self.player = Player(scenario, signals, document.where, TICK_NS)

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
            faults=(),
            trace_hash=trace_hash,
        )

    def act(self, t_ns: int) -> None:
        """Let the player look at the bus at tick ``t_ns`` and set what it asks for."""
        emulator = self.emulator
        for stimulus in self.player.step(t_ns, emulator.on_bus, emulator.seen_ns):
            if isinstance(stimulus, SetSignal):
                emulator.set_value(stimulus.signal, stimulus.value)
            else:
                message = emulator.database.message(stimulus.message)
                emulator.send_message(message.index, stimulus.enabled)


def read_scenario(path: Path) -> tuple[config.Document, Scenario]:
    """Read a scenario file; raises InputError."""
    document = config.read(path)
    return document, document.convert(Scenario)
