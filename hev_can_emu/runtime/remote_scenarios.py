"""Scenarios started and stopped from afar while a car runs on its bus.

A scenario begins with a car of its own, at rest, made as ``scenario run`` makes it; it takes over the bus
while the car of the run stands still, and hands back when the scenario is over.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import msgspec

from hev_can_emu.errors import InputError, StateError, did_you_mean
from hev_can_emu.resources import folder
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.remote import Remote
from hev_can_emu.runtime.scenario_runs import Run, read_runs, setup_of
from hev_can_emu.runtime.service import Service
from hev_can_emu.telemetry.mqtt_commands import Action, Parameter, ScenarioStart, ScenarioStop

_WHERE = "command/scenario/start: scenario"


class RemoteScenarios:
    """Lets scenarios take over a service.

    Args:
        service: runs the car.
        remote: is told which car runs.
        own: folder with scenarios beside the shipped ones, or None.
        epoch_ns: Unix time of the bus's time zero, ns.
    """

    def __init__(self, service: Service, remote: Remote, own: Path | None, epoch_ns: int) -> None:
        self._service = service
        self._remote = remote
        self._own = own
        self._epoch_ns = epoch_ns
        self._parameters: dict[str, str] = {}
        self._playing: Playing | None = None
        self._before: Emulator | None = None
        self._busy = False

    @property
    def actions(self) -> dict[str, Action]:
        """What this adds to a :class:`Remote`."""
        return {
            "scenario/start": self._start,
            "scenario/stop": self._stop,
            "parameter": self._set_parameter,
        }

    async def _set_parameter(self, command: Parameter) -> dict[str, Any]:
        if command.value is None:
            self._parameters.pop(command.name, None)
        else:
            self._parameters[command.name] = str(command.value)
        return {"parameters": dict(self._parameters)}

    async def _start(self, command: ScenarioStart) -> dict[str, Any]:
        if self._busy:
            raise StateError("command/scenario/start: a scenario is running; stop it first")
        self._busy = True
        try:
            # Reading and building takes a while; the tick goes on meanwhile.
            playing = await asyncio.to_thread(self._prepare, command)
        except BaseException:
            self._busy = False
            raise
        playing.begin()
        self._playing = playing
        self._before = self._service.swap(playing.emulator, playing, self._ended)
        self._follow()
        self._remote.publisher.began(playing.scenario.name)
        self._remote.playing = playing
        return {"scenario": playing.scenario.name}

    async def _stop(self, _: ScenarioStop) -> dict[str, Any]:
        playing = self._playing
        if playing is None:
            raise StateError("command/scenario/stop: no scenario is running")
        playing.player.finish(playing.emulator.now_ns, "stopped by a command")
        self._ended()
        return {"scenario": playing.scenario.name, "outcome": playing.player.outcome.value}

    def _ended(self) -> None:
        playing, before = self._playing, self._before
        if playing is None or before is None:
            return
        self._remote.playing = None
        self._remote.publisher.ended(playing.result())
        self._service.swap(before)
        self._playing = self._before = None
        self._busy = False
        self._follow()

    def _follow(self) -> None:
        service = self._service
        self._remote.follow(service.emulator, self._epoch_ns + service.shift_ns)

    def _prepare(self, command: ScenarioStart) -> Playing:
        run = self._read(command)
        scenario = run.scenario
        base = msgspec.structs.replace(self._service.emulator.setup, start="ready")
        emulator = Emulator(setup_of(scenario, base))
        emulator.advance(0)
        return Playing(emulator, run.document, scenario, run.locate, emulator.snapshot())

    def _read(self, command: ScenarioStart) -> Run:
        known: dict[str, Path] = {}
        for place in (folder("scenarios"), self._own):
            if place is not None:
                known |= {path.stem: path for path in sorted(place.glob("*.yaml"))}
        path = known.get(command.scenario)
        if path is None:
            hint = did_you_mean(command.scenario, known)
            expected = f"one of {', '.join(sorted(known))}"
            raise InputError(_WHERE, expected, f"'{command.scenario}'", hint)
        given = {name: str(value) for name, value in command.parameters.items()}
        declared = read_runs(path)[0].scenario.parameters
        kept = {name: value for name, value in self._parameters.items() if name in declared}
        runs = read_runs(path, kept | given)
        if len(runs) > 1:
            labels = ", ".join(run.label for run in runs[:3])
            raise InputError(
                _WHERE,
                "a single run",
                f"a matrix of {len(runs)}",
                f"set its parameters: {labels} ...",
            )
        return runs[0]
