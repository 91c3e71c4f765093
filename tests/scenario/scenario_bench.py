"""A small network, and a bench that plays a scenario against signals given as functions of time."""

from __future__ import annotations

import contextlib
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hev_can_emu import config
from hev_can_emu.messages.definitions import MessageDef, SignalDef
from hev_can_emu.messages.frame import make_frames
from hev_can_emu.plant.events import EVENT
from hev_can_emu.runtime.behind import Behind
from hev_can_emu.scenario import script
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.player import Player
from hev_can_emu.scenario.schema import Scenario
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.scenario.sources import EventKind, Sources, Truth
from hev_can_emu.units import unit

MODES = {0: "Off", 1: "Torque", 2: "Speed", 15: "NotAvailable"}
CLUTCH = {0: "Open", 1: "Slipping", 2: "Locked"}
DRIVE = {0: "Transition", 1: "Series", 2: "ParallelG1", 3: "Parallel G2"}

#: message: (sender, {signal: (unit, minimum, maximum, initial, labels)})
NETWORK: dict[str, tuple[str, dict[str, tuple[Any, ...]]]] = {
    "HCU_EM2Request": (
        "HCU",
        {
            "EM2TorqueRequest": ("Nm", -400, 400, 0, {}),
            "EM2ControlMode": ("", 0, 4, 0, MODES),
        },
    ),
    "HCU_EM1Request": (
        "HCU",
        {
            "EM1SpeedRequest": ("rpm", -12000, 12000, None, {}),
            "EM1ControlMode": ("", 0, 4, 0, MODES),
        },
    ),
    "VEH_Driver": (
        "VEH",
        {
            "AcceleratorPedal": ("%", 0, 100, 0, {}),
            "AmbientTemperature": ("degC", -40, 60, 20, {}),
            "Odd": ("furlong", None, None, 0, {}),
        },
    ),
    "MCU1_Status": (
        "MCU1",
        {"EM1Speed": ("rpm", -12000, 12000, 0, {}), "Temperature": ("degC", -40, 215, 0, {})},
    ),
    "MCU2_Status": (
        "MCU2",
        {"EM2Speed": ("rpm", -12000, 12000, 0, {}), "Temperature": ("degC", -40, 215, 0, {})},
    ),
    "TCU_Clutch": ("TCU", {"ClutchState": ("", 0, 3, 0, CLUTCH)}),
    "ESC_Vehicle": (
        "ESC",
        {"VehicleSpeed": ("km/h", 0, 300, 0, {}), "WheelSpeedFL": ("km/h", 0, 300, 0, {})},
    ),
    "EMU_PlantState": ("EMU", {"DrivingMode": ("", 0, 6, 0, DRIVE)}),
}


def make_messages() -> list[MessageDef]:
    messages: list[MessageDef] = []
    index = 0
    for number, (name, (sender, entries)) in enumerate(NETWORK.items()):
        signals = []
        for signal, (shown, low, high, initial, labels) in entries.items():
            signals.append(
                SignalDef(
                    index=index,
                    message_index=number,
                    name=signal,
                    message=name,
                    start=0,
                    length=16,
                    unit=shown,
                    minimum=low,
                    maximum=high,
                    initial=initial,
                    labels=labels,
                    not_available=15 if labels is MODES else None,
                )
            )
            index += 1
        messages.append(
            MessageDef(
                index=number, name=name, can_id=number, sender=sender, signals=tuple(signals)
            )
        )
    return messages


#: Truth of the synthetic plant, and its events.
TRUTHS = {
    "vehicle_speed": Truth(0, unit("m/s")),
    "acceleration": Truth(1, unit("m/s^2")),
    "share": Truth(2, None),
}
EVENTS = {
    "lock": EventKind(1, {"C1": 0, "G1": 1}),
    "synchronizer": EventKind(2, {"engaged": 3, "neutral": 0}, by_value=True),
}


class Bench:
    """Plays scenario texts; what is sent is kept by tick (ms)."""

    def __init__(self, signals: Signals) -> None:
        self.signals = signals
        self.profiles: dict[str, str] = {}
        self.player: Player
        self.sent: list[tuple[int, str, float | bool]] = []
        self.commands: list[tuple[int, Any]] = []
        self.ticks = 0

    def load(self, text: str) -> Player:
        """Return a player; a missing head is added."""
        if "version:" not in text:
            text = "version: 1\nname: test\n" + textwrap.dedent(text)
        document = config.parse(text, "s.yaml")
        sources = Sources(self.signals, TRUTHS, EVENTS, self._profile)
        self.player = Player(document.convert(Scenario), sources, document.where)
        return self.player

    def _profile(self, file: str, place: Place) -> str:
        if file not in self.profiles:
            raise place.refuse("a file", f"'{file}'")
        return self.profiles[file]

    def play(
        self,
        text: str,
        bus: Mapping[str, Callable[[float], float] | float] | None = None,
        *,
        until: float = 1e9,
        look_every: int = 1,
        behind: bool = False,
        events: Sequence[tuple[int, int, int, float]] = (),
        frames: Sequence[tuple[int, int]] = (),
    ) -> Player:
        """Play to the end.

        Args:
            text: the scenario.
            bus: signals and ``truth.name`` as constants or functions of seconds.
            until: seconds, where it is to be left unfinished.
            look_every: after how many ticks the expectations look.
            behind: whether they do so on a second thread.
            events: ms at whose end they are noted, kind, index, value.
            frames: ns, identifier.
        """
        player = self.load(text)
        found_all = [self.signals.find(name) for name in self.signals.names()]
        names = {signal.index: signal.name for signal in found_all if signal is not None}
        size = max(names) + 1
        on_bus, truth = np.full(size, math.nan), np.full(len(TRUTHS), math.nan)
        seen = np.full(size, -1, dtype=np.int64)
        values = np.full(size, math.nan)
        for signal in found_all:
            if signal is not None:
                values[signal.index] = signal.initial
        self.sent, self.commands = [], []
        with contextlib.ExitStack() as stack:
            if behind:
                player.look_behind(stack.enter_context(Behind()))
                stack.callback(player.look_behind, None)
            ms = self.ticks = 0
            while not player.finished and ms * 1e-3 <= until:
                self._fill(bus or {}, ms, on_bus, seen, truth)
                before = values.copy()
                self._tick(player, ms, (on_bus, seen, truth, values))
                for index in np.flatnonzero(
                    (values != before) & ~(np.isnan(values) & np.isnan(before))
                ):
                    self.sent.append((ms, names[int(index)], float(values[index])))
                self._happen(player, ms, events, frames)
                if ms % look_every == 0:
                    player.observe()
                ms += 1
                self.ticks = ms
        return player

    def _fill(self, bus: Mapping[str, Any], ms: int, on_bus: Any, seen: Any, truth: Any) -> None:
        for name, source in bus.items():
            value = source(ms * 1e-3) if callable(source) else source
            if name.startswith("truth."):
                truth[TRUTHS[name.removeprefix("truth.")].place] = value
                continue
            found = self.signals.find(name)
            assert found is not None
            on_bus[found.index] = value
            if not math.isnan(value):
                seen[found.index] = ms * 1_000_000

    def _tick(self, player: Player, ms: int, vectors: Any) -> None:
        """Do what happens at a tick, as a run does it."""
        t_ns = ms * 1_000_000
        while not player.finished:
            for command in player.due(t_ns, vectors[3]):
                self.commands.append((ms, command))
            if player.finished:
                return
            ending = player.ending(t_ns)
            if player.look(t_ns, *vectors) == script.GO_ON:
                if not ending:
                    return
                player.end(t_ns)
            elif player.full:
                player.observe()

    def _happen(self, player: Player, ms: int, events: Any, frames: Any) -> None:
        noted = [event for event in events if event[0] == ms]
        if noted:
            records = np.zeros(len(noted), dtype=EVENT)
            for record, (_, kind, index, value) in zip(records, noted, strict=True):
                record["kind"], record["index"], record["value"] = kind, index, value
            script.mark_events(player.script, records, 0, len(noted))
        heard = [each for each in frames if ms <= each[0] * 1e-6 < ms + 1]
        records = make_frames(len(heard))
        for record, (t_ns, identifier) in zip(records, heard, strict=True):
            record["t_ns"], record["id"] = t_ns, identifier
        player.hear(records)
