"""What a client on the bus sees of each fault: a car in series driving, one fault at a time.

The client has the database and nothing else: it takes the frames, checks counter and CRC, decodes what is
right, and compares with what it saw without the fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from hev_can_emu.ecu.faults import CATALOGUE, COMMON, Fault
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.named import NamedCodec
from hev_can_emu.messages.protection import (
    COUNTER_JUMP,
    COUNTER_REPEATED,
    CRC_WRONG,
    NEVER,
    build_protection,
    check,
)
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

MS = 1_000_000
SHOWN_MS = 600  #: how long each fault acts
_CHANGE_MS = 200  # when the controller asks for something else
_LOOK_MS = 200  # values are compared over the last part
_MOST_SIGNALS = 5
_NOTICED = 0.001  # of a signal's range
_LEAD_MS = 50  # for which the client has listened before

_START = (
    (1200, {"ContactorRequest": 1, "EM1ControlMode": 2, "EM1SpeedRequest": 1500,
            "ClutchTorqueCapacityRequest": 200, "EM2ControlMode": 1}),
    (1500, {"EngineRunRequest": 1, "EngineTorqueRequest": 40, "EM2TorqueRequest": 80}),
)  # fmt: skip
_THEN = {"EM2TorqueRequest": 60, "ClutchTorqueCapacityRequest": 120}

_VERDICTS = (
    (CRC_WRONG, "CRC wrong"),
    (COUNTER_REPEATED, "counter repeated"),
    (COUNTER_JUMP, "counter jumped"),
    (-1, "wrong length"),
)


class Seen(NamedTuple):
    """One row: the fault's name, what it is, and what the client saw of frames and of signals."""

    name: str
    what: str
    frames: str
    signals: str


class _Message(NamedTuple):
    times: list[int]
    verdicts: dict[int, int]


class _Client:
    """Takes frames as any receiver does."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._codec = NamedCodec(database)
        self._protection = build_protection([m.protection for m in database.messages])

    def see(
        self, frames: np.ndarray, from_ns: int
    ) -> tuple[dict[str, _Message], dict[str, list[float]], int]:
        """Return each message's frames, each signal's values from a time on, and unknown frames."""
        messages = {m.name: _Message([], {}) for m in self._database.messages}
        values: dict[str, list[float]] = {s.name: [] for s in self._database.signals}
        counters = {m.name: np.array([NEVER]) for m in self._database.messages}
        unknown = 0
        for frame in frames:
            message = self._database.message_of_id(int(frame["id"]))
            if message is None:
                unknown += 1
                continue
            seen = messages[message.name]
            seen.times.append(int(frame["t_ns"]) // MS)
            code = -1
            if frame["length"] == message.wire_length:
                code = int(
                    check(
                        self._protection, message.index, frame["data"], message.length,
                        counters[message.name],
                    )
                )  # fmt: skip
            seen.verdicts[code] = seen.verdicts.get(code, 0) + 1
            if code in (-1, CRC_WRONG, COUNTER_REPEATED, COUNTER_JUMP):
                continue
            data = bytes(frame["data"][: message.length])
            if frame["t_ns"] >= from_ns:
                for name, value in self._codec.decode_message(message.can_id, data).items():
                    values[name].append(value)
        return messages, values, unknown


def show(faults: Sequence[Fault]) -> list[Seen]:
    """Return what a client of the shipped network sees of each fault."""
    emulator = Emulator(Setup(model="4dof", nodes={"HCU": "emulated"}))
    _play(emulator, _START)
    start = emulator.snapshot()
    client = _Client(emulator.database)

    def watched(fault: Fault | None) -> np.ndarray:
        emulator.restore(start)
        lead = emulator.advance(begin_ns).copy()
        if fault is not None:
            emulator.inject(fault)
        first = emulator.advance(begin_ns + _CHANGE_MS * MS).copy()
        _ask(emulator, _THEN)
        return np.concatenate([lead, first, emulator.advance(begin_ns + SHOWN_MS * MS)])

    begin_ns = emulator.now_ns + _LEAD_MS * MS
    look_ns = begin_ns + (SHOWN_MS - _LOOK_MS) * MS
    usual = client.see(watched(None), look_ns)
    rows = []
    for fault in faults:
        seen = client.see(watched(fault), look_ns)
        frames = _frames_told(usual[0], seen[0], seen[2])
        rows.append(
            Seen(
                fault.label,
                _described(fault),
                frames,
                _signals_told(emulator.database, usual[1], seen[1]),
            )
        )
    return rows


def _play(emulator: Emulator, steps: Sequence[tuple[int, dict[str, int]]]) -> None:
    for milliseconds, values in steps:
        _ask(emulator, values)
        emulator.advance(emulator.now_ns + milliseconds * MS)


def _ask(emulator: Emulator, values: dict[str, int]) -> None:
    for name, value in values.items():
        emulator.set_value(emulator.database.signal(name).index, float(value))


def _described(fault: Fault) -> str:
    """Return a fault as it stands in a file."""
    given = {key: value for key, value in msgspec.to_builtins(fault).items() if key != "name"}
    defaults = {p.name: p.default for p in CATALOGUE[fault.kind].parameters}
    parts = [
        f"{key}: {value}"
        for key, value in given.items()
        if key == "fault" or (value is not None and str(value) != defaults.get(key, ""))
    ]
    target = next((k for k in given if k not in ("fault", *COMMON)), "")
    parts.sort(key=lambda part: (not part.startswith("fault:"), not part.startswith(f"{target}:")))
    return "{" + ", ".join(parts) + "}"


def _frames_told(usual: dict[str, _Message], seen: dict[str, _Message], unknown: int) -> str:
    told: dict[str, list[str]] = {}
    for name, before in usual.items():
        now, parts = seen[name], []
        if len(now.times) != len(before.times):
            parts.append(f"{len(now.times)} frames instead of {len(before.times)}")
        for code, words in _VERDICTS:
            if now.verdicts.get(code, 0) != before.verdicts.get(code, 0):
                parts.append(f"{now.verdicts.get(code, 0)} {words}")
        late = [after - was for was, after in zip(before.times, now.times, strict=False)]
        # A few missing frames at the end are still on their way; lost ones would only look late.
        on_way = 0 <= len(before.times) - len(now.times) <= 5
        if now.times and on_way and max(late) > 0:
            parts.append(f"up to {max(late)} ms late")
        if parts:
            told.setdefault(", ".join(parts), []).append(name)
    lines = [f"{', '.join(names)}: {what}" for what, names in told.items()]
    if unknown:
        lines.append(f"{unknown} frames that nobody knows")
    return "; ".join(lines) or "as usual"


def _signals_told(
    database: Database, usual: dict[str, list[float]], seen: dict[str, list[float]]
) -> str:
    found: list[tuple[float, str]] = []
    for signal in database.signals:
        before, now = usual[signal.name], seen[signal.name]
        message = database.messages[signal.message_index]
        protected = message.protection is not None and not message.protection.bits().isdisjoint(
            signal.bits()
        )
        if not before or protected or signal.name == "FaultsActive":
            continue
        labels = {raw * signal.scale + signal.offset: text for raw, text in signal.labels.items()}
        if not now:
            continue  # the frames tell
        if len(labels) > 1:
            if now[-1] != before[-1] and not (math.isnan(now[-1]) and math.isnan(before[-1])):
                found.append((2.0, f"{signal.name} {_label(labels, now[-1])}"))
            continue
        if math.isnan(now[-1]):
            if not math.isnan(before[-1]):
                found.append((2.0, f"{signal.name} not available"))
            continue
        span = float(signal.maximum or 1.0) - float(signal.minimum or 0.0)
        ends = [abs(min(now) - min(before)), abs(max(now) - max(before))]
        if max(ends) > _NOTICED * span:
            low, high = _number(min(now)), _number(max(now))
            size = low if low == high else f"{low} to {high}"
            was = (_number(min(before)), _number(max(before)))
            usually = was[0] if was[0] == was[1] else f"{was[0]} to {was[1]}"
            text = f"{signal.name} {size} {signal.unit}".rstrip() + f" (usually {usually})"
            found.append((max(ends) / span, text))
    # Codes first, then by how much the signal uses of its range; ties as in the file.
    found.sort(key=lambda item: -item[0])
    told = [text for _, text in found[:_MOST_SIGNALS]]
    if len(found) > _MOST_SIGNALS:
        told.append(f"{len(found) - _MOST_SIGNALS} more")
    return "; ".join(told) or "as usual"


def _label(labels: dict[float, str], value: float) -> str:
    return "NotAvailable" if math.isnan(value) else labels.get(value, f"{value:g}")


def _number(value: float) -> str:
    return f"{round(value, 0 if abs(value) >= 10.0 else 1):g}"


def as_markdown(rows: Sequence[Seen]) -> str:
    """Return the table as it stands in docs/faults.md."""
    lines = ["| no. | fault | frames | signals |", "|---|---|---|---|"]
    lines += [
        f"| {number} | `{row.what}` | {row.frames} | {row.signals} |"
        for number, row in enumerate(rows)
    ]
    return "\n".join(lines) + "\n"
