"""A scenario's player beside an emulator: what it asks for is set, what it sees is the bus."""

from __future__ import annotations

from pathlib import Path

from hev_can_emu import config
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.scenario.player import Player
from hev_can_emu.scenario.schema import Scenario
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.scenario.stimuli import SetSignal


class Playing:
    """One scenario played on one emulator; used alike in virtual and in wall time."""

    def __init__(self, emulator: Emulator, document: config.Document, scenario: Scenario) -> None:
        self.emulator = emulator
        self.scenario = scenario
        signals = Signals(emulator.database.messages)
        self.player = Player(scenario, signals, document.where, TICK_NS)

    @property
    def finished(self) -> bool:
        """Whether the scenario is over."""
        return self.player.finished

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
