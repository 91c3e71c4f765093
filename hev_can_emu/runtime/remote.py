"""An emulator at the end of an MQTT link: it is told of, and does what it is asked to."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from hev_can_emu.ecu.faults import parse
from hev_can_emu.errors import InputError
from hev_can_emu.runtime import tick
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.publishing import Publisher
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.telemetry.mqtt_commands import Action, FaultClear, FaultInject, Input, obey
from hev_can_emu.telemetry.mqtt_link import Link, Request


class Remote:
    """Samples a car for a link and obeys the link's requests; all calls from the tick's loop.

    Args:
        emulator: the car.
        link: to the broker.
        epoch_ns: Unix time of the car's time zero, ns; None in virtual time.
    """

    def __init__(self, emulator: Emulator, link: Link, epoch_ns: int | None) -> None:
        self.publisher = Publisher(emulator, link, epoch_ns)
        self.playing: Playing | None = None  #: whose verdicts are told as they are decided
        self._link = link
        self._tasks: set[asyncio.Task[None]] = set()
        self._actions: dict[str, Action] = {
            "input": self._set_input,
            "fault/inject": self._inject,
            "fault/clear": self._clear,
        }
        self.follow(emulator, epoch_ns)

    def offer(self, actions: Mapping[str, Action]) -> None:
        """Obey these verbs as well."""
        self._actions |= actions

    def follow(self, emulator: Emulator, epoch_ns: int | None) -> None:
        """Turn to this car from now on; the arguments are those of the constructor."""
        self._emulator = emulator
        self._signals = Signals(emulator.database.messages)
        self.publisher.follow(emulator, epoch_ns)

    def look(self) -> None:
        """Leave the statuses as they are now, and do what has been asked for."""
        self.publisher.sample()
        if self.playing is not None:
            player = self.playing.player
            self.publisher.decided(self.playing.scenario.name, player.verdicts())
        for request in self._link.take_requests():
            task = asyncio.create_task(self._handle(request), name="mqtt command")
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _handle(self, request: Request) -> None:
        answer = await obey(request, self._actions)
        answer["time"] = round(self._emulator.now_ns * 1e-9, 6)
        self._link.answer(request, answer)

    async def _set_input(self, command: Input) -> dict[str, Any]:
        place = Place(lambda steps: f"command/input: {'.'.join(map(str, steps))}")
        signal = self._signals.require(command.signal, place / "signal")
        emulator = self._emulator
        if emulator.origin[emulator.database.message(signal.message).index] != tick.ORIGIN_PLAYED:
            raise InputError(
                str(place / "signal"),
                "a signal that this program plays",
                f"'{signal.name}' of {signal.message}",
                f"run with --node {signal.sender}=emulated",
            )
        if signal.protected:
            raise InputError(
                str(place / "signal"), "a signal", f"'{signal.name}'", "protection writes it"
            )
        value = signal.parse(command.value, place / "value")
        emulator.set_value(signal.index, value)
        return {"signal": f"{signal.message}.{signal.name}", "value": signal.say(value)}

    async def _inject(self, command: FaultInject) -> dict[str, Any]:
        name = self._emulator.inject(parse(command.inject, "command/fault/inject: inject"))
        return {"name": name}

    async def _clear(self, command: FaultClear) -> dict[str, Any]:
        names = [command.clear]
        if command.clear is None:
            names = [each.name for each in self._emulator.faults if each.state != "ended"]
        for name in names:
            self._emulator.clear(str(name))
        return {"cleared": names}
