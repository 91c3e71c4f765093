"""A car on a bench: everything goes in and comes out as CAN frames, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from hev_can_emu.messages.frame import FRAME
from hev_can_emu.messages.named import NamedCodec, Value
from hev_can_emu.messages.protection import build_protection, protect
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.event_texts import Event
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.signal_log import SignalLog

MS = 1_000_000

Tamper = Callable[[bytearray, int], bytearray | None]
"""From protected data and the count of frames so far to what goes onto the bus, None for nothing."""

IDLE: dict[str, dict[str, Value]] = {
    "HCU_BrakeRequest": {"BrakeTorqueRequest": 0.0},
    "HCU_EM1Request": {
        "EM1ControlMode": "Torque", "EM1TorqueRequest": 0.0, "EM1SpeedRequest": 0.0,
    },
    "HCU_EM2Request": {
        "EM2ControlMode": "Torque", "EM2TorqueRequest": 0.0, "EM2SpeedRequest": 0.0,
    },
    "HCU_EngineRequest": {"EngineRunRequest": "Stop", "EngineTorqueRequest": 0.0},
    "HCU_ClutchRequest": {"ClutchTorqueCapacityRequest": 0.0},
    "HCU_SynchronizerRequest": {"GearRequest": "Neutral", "ShiftForceRequest": 0.0},
    "HCU_HVRequest": {"ContactorRequest": "Closed"},
}  # fmt: skip

_EMULATORS: dict[str, tuple[Emulator, bytes]] = {}


def build(setup: Setup) -> Emulator:
    """Return an emulator at its start; equal set-ups share one."""
    key = repr(setup)
    if key not in _EMULATORS:
        emulator = Emulator(setup)
        _EMULATORS[key] = (emulator, emulator.snapshot())
    emulator, start = _EMULATORS[key]
    emulator.restore(start)
    emulator.take_events()
    return emulator


class Bench:
    """An emulator with a tester beside it that sends what is in ``sending``.

    Attributes:
        sending: values by signal, by message; sent at the message's period from the DBC.
        tamper: what is done to a message's frames on their way.
        events: what the emulator told so far.
    """

    def __init__(
        self,
        setup: Setup | None = None,
        sending: Mapping[str, Mapping[str, Value]] = IDLE,
    ) -> None:
        self.emulator = build(setup or Setup(model="4dof"))
        self.database = self.emulator.database
        self.codec = NamedCodec(self.database)
        self.protection = build_protection([m.protection for m in self.database.messages])
        self.sending = {name: dict(values) for name, values in sending.items()}
        self.tamper: dict[str, Tamper] = {}
        self.counters = dict.fromkeys(self.sending, 0)
        self.events: list[Event] = []
        self.log = SignalLog(self.database, self.codec.codec)
        self.frames = np.zeros(0, dtype=FRAME)

    @property
    def now_ms(self) -> int:
        """Time of the next tick, ms."""
        return self.emulator.now_ns // MS

    def ask(self, **signals: Value) -> None:
        """Change request signals from now on; the message follows from the name."""
        for name, value in signals.items():
            message = self.database.signal(name).message
            self.counters.setdefault(message, 0)
            self.sending.setdefault(message, {})[name] = value

    def frame(self, message: str, values: Mapping[str, Value], counter: int) -> bytearray:
        """Return a message's bytes with counter and CRC."""
        definition = self.database.message(message)
        data = np.frombuffer(self.codec.encode_message(message, values), dtype=np.uint8).copy()
        protect(self.protection, definition.index, data, definition.length, counter)
        return bytearray(data.tobytes())

    def due(self, start_ms: int, stop_ms: int) -> np.ndarray:
        """Return the tester's frames from ``start_ms`` up to but not at ``stop_ms``, in order of time."""
        rows: list[tuple[int, int, bytes]] = []
        for name, values in self.sending.items():
            message = self.database.message(name)
            period = message.cycle_time_ns // MS
            for t in range(-(-start_ms // period) * period, stop_ms, period):
                count = self.counters[name]
                data: bytearray | None = self.frame(name, values, count)
                self.counters[name] += 1
                if name in self.tamper and data is not None:
                    data = self.tamper[name](data, count)
                if data is not None:
                    rows.append((t, message.can_id, bytes(data)))
        rows.sort(key=lambda row: row[:2])
        frames = np.zeros(len(rows), dtype=FRAME)
        for i, (t, can_id, raw) in enumerate(rows):
            frames[i]["t_ns"] = t * MS
            frames[i]["id"] = can_id
            frames[i]["length"] = len(raw)
            frames[i]["data"][: len(raw)] = np.frombuffer(raw, dtype=np.uint8)
        return frames

    def run(self, ms: int) -> Bench:
        """Let ``ms`` milliseconds pass."""
        stop = self.now_ms + ms
        received = self.due(self.now_ms, stop)
        sent = self.emulator.advance(stop * MS, received, len(received))
        self.log.add(sent, len(sent))
        self.frames = sent.copy()
        self.events += self.emulator.take_events()
        return self

    def ask_and_run(self, ms: int, **signals: Value) -> Bench:
        """Change request signals, then let time pass."""
        self.ask(**signals)
        return self.run(ms)

    def run_until(self, condition: Callable[[], bool], limit_ms: int, step_ms: int = 10) -> int:
        """Run until the condition holds; return how long it took, ms; fail beyond the limit."""
        start = self.now_ms
        while not condition():
            assert self.now_ms - start < limit_ms, "condition not met in time"
            self.run(step_ms)
        return self.now_ms - start

    def __getitem__(self, signal: str) -> float:
        """Return a signal as last sent on the bus."""
        return self.emulator.signal(signal)

    def label(self, signal: str) -> str:
        """Return a signal's label as last sent on the bus."""
        definition = self.database.signal(signal)
        value = self.emulator.signal(signal)
        if np.isnan(value):
            return "NotAvailable"
        return definition.labels[round((value - definition.offset) / definition.scale)]

    def series(self, signal: str, start_ms: float = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return a signal's frames from ``start_ms`` on: times in ms, values."""
        t, values = self.log.series(signal)
        later = t * 1e3 >= start_ms - 1e-6
        return t[later] * 1e3, values[later]

    def labels(self, signal: str, start_ms: float = 0) -> list[str]:
        """Return a signal's labels from ``start_ms`` on, each as long as it lasted once."""
        definition = self.database.signal(signal)
        found: list[str] = []
        for value in self.series(signal, start_ms)[1]:
            text = "NotAvailable" if np.isnan(value) else definition.labels[int(value)]
            if not found or found[-1] != text:
                found.append(text)
        return found

    def first(self, signal: str, label: str, start_ms: float = 0) -> float:
        """Return when a label is first told from ``start_ms`` on, ms."""
        definition = self.database.signal(signal)
        raw = next(raw for raw, text in definition.labels.items() if text == label)
        t, values = self.series(signal, start_ms)
        wanted = np.isnan(values) if raw == definition.not_available else values == raw
        assert wanted.any(), f"{signal} never tells {label}"
        return float(t[np.argmax(wanted)])
