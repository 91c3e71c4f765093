"""A small network, and a bench that plays a scenario against signals given as functions of time."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hev_can_emu import config
from hev_can_emu.messages.definitions import MessageDef, SignalDef
from hev_can_emu.scenario.player import Player
from hev_can_emu.scenario.schema import Scenario
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.scenario.stimuli import SetSignal

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
        for signal, (unit, low, high, initial, labels) in entries.items():
            signals.append(
                SignalDef(
                    index=index,
                    message_index=number,
                    name=signal,
                    message=name,
                    start=0,
                    length=16,
                    unit=unit,
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


class Bench:
    """Plays scenario texts; what is sent is kept by tick (ms)."""

    def __init__(self, signals: Signals) -> None:
        self.signals = signals
        self.player: Player
        self.sent: list[tuple[int, str, float | bool]] = []
        self.calls = 0

    def load(self, text: str) -> Player:
        """Return a player; a missing head is added."""
        if "version:" not in text:
            text = "version: 1\nname: test\n" + textwrap.dedent(text)
        document = config.parse(text, "s.yaml")
        self.player = Player(document.convert(Scenario), self.signals, document.where)
        return self.player

    def play(
        self,
        text: str,
        bus: Mapping[str, Callable[[float], float] | float] | None = None,
        *,
        every_tick: bool = True,
        until: float = 1e9,
    ) -> Player:
        """Play to the end; ``bus`` gives signals as constants or functions of seconds."""
        player = self.load(text)
        found_all = [self.signals.find(name) for name in self.signals.names()]
        names = {signal.index: signal.name for signal in found_all if signal is not None}
        size = max(names) + 1
        values = np.full(size, math.nan)
        seen = np.full(size, -1, dtype=np.int64)
        self.sent, self.calls = [], 0
        t_ns = 0
        while not player.finished and t_ns * 1e-9 <= until:
            for name, source in (bus or {}).items():
                found = self.signals.find(name)
                assert found is not None
                values[found.index] = source(t_ns * 1e-9) if callable(source) else source
                if not math.isnan(values[found.index]):
                    seen[found.index] = t_ns
            for each in player.step(t_ns, values, seen):
                name = names[each.signal] if isinstance(each, SetSignal) else each.message
                value = each.value if isinstance(each, SetSignal) else each.enabled
                self.sent.append((t_ns // 1_000_000, name, value))
            self.calls += 1
            t_ns = t_ns + 1_000_000 if every_tick else player.next_wake_ns(t_ns)
        return player
