"""The car's side of MQTT: what of an emulator goes out, off the tick's path."""

from __future__ import annotations

import time
from collections.abc import Iterable
from importlib.metadata import version
from typing import Any

from hev_can_emu.ecu.ports import STATUSES
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.event_texts import Event
from hev_can_emu.runtime.playing import RunResult
from hev_can_emu.scenario.verdict import Verdict
from hev_can_emu.telemetry.mqtt_address import Address
from hev_can_emu.telemetry.mqtt_feed import Feed, rfc3339
from hev_can_emu.telemetry.mqtt_link import Link
from hev_can_emu.telemetry.vss import LEAVES

REFRESH_S = 5.0  #: every signal is told at least so often

# Kinds of events to the last level of their topic; others keep their own name.
_TOPICS = {
    "lost": "supervision",
    "healed": "supervision",
    "lock": "driveline",
    "release": "driveline",
    "reverse": "driveline",
    "synchronizer": "driveline",
    "conflict": "bus",
}


def open_link(address: Address, emulator: Emulator, period_s: float, commands: bool) -> Link:
    """Return a link that tells the statuses of cars like ``emulator``; not yet started.

    Args:
        address: of the broker.
        emulator: the car that the retained status names.
        period_s: least time between two values of a signal, s.
        commands: whether requests are taken.
    """
    names = tuple(port.name for port in STATUSES)
    setup = emulator.setup
    status: dict[str, Any] = {
        "version": version("hev-can-emu"),
        "vss": "6.0",
        "vehicle": emulator.vehicle_name,
        "model": setup.model,
        "protection": setup.protection,
        "commands": commands,
        "since": rfc3339(time.time_ns()),
    }
    return Link(address, Feed(LEAVES, names, period_s, REFRESH_S), status, commands)


class Publisher:
    """Hands an emulator's statuses, events and verdicts to a link.

    Args:
        emulator: the car.
        link: where to.
        epoch_ns: Unix time of the car's time zero, ns; None in virtual time, whose dates are those at
            which things are told.
    """

    def __init__(self, emulator: Emulator, link: Link, epoch_ns: int | None) -> None:
        self._link = link
        self._decided: set[tuple[str, str, str, int | None]] = set()
        self.follow(emulator, epoch_ns)

    def follow(self, emulator: Emulator, epoch_ns: int | None) -> None:
        """Tell of this car from now on; the arguments are those of the constructor."""
        self._emulator = emulator
        self._epoch_ns = epoch_ns

    def sample(self) -> None:
        """Leave the statuses as they are now."""
        now_ns = self._emulator.now_ns
        self._link.offer(self._emulator.state.statuses.copy(), now_ns, self._date(now_ns))

    def event(self, event: Event) -> None:
        """Leave an event."""
        body = self._stamped(event.t_ns) | {
            "kind": event.kind,
            "text": event.text,
            "number": event.number,
            "value": event.value,
        }
        self._link.happen(f"event/{_TOPICS.get(event.kind, event.kind)}", body)

    def began(self, name: str) -> None:
        """Leave that a scenario has begun."""
        self._decided.clear()
        body = self._stamped(self._emulator.now_ns) | {"scenario": name, "state": "running"}
        self._link.happen("scenario/state", body)

    def decided(self, name: str, verdicts: Iterable[Verdict], all_of_them: bool = False) -> None:
        """Leave the verdicts that have been decided and were not told yet, at the end the others, too."""
        for verdict in verdicts:
            key = (verdict.kind, verdict.name, verdict.where, verdict.instant_ns)
            if key not in self._decided and (all_of_them or verdict.instant_ns is not None):
                self._decided.add(key)
                self._link.happen("scenario/verdict", {"scenario": name} | _told(verdict))

    def ended(self, result: RunResult) -> None:
        """Leave how a scenario ended: the verdicts that were still open, then the whole."""
        self.decided(result.name, result.verdicts, all_of_them=True)
        counts: dict[str, int] = {}
        for verdict in result.verdicts:
            word = verdict.outcome.value
            counts[word] = counts.get(word, 0) + 1
        body = self._stamped(self._emulator.now_ns) | {
            "scenario": result.name,
            "state": "ended",
            "outcome": result.outcome.value,
            "counts": counts,
        }
        if result.trace_hash:
            body["trace_hash"] = result.trace_hash
        self._link.happen("scenario/state", body)

    def _date(self, t_ns: int) -> int:
        return time.time_ns() if self._epoch_ns is None else self._epoch_ns + t_ns

    def _stamped(self, t_ns: int) -> dict[str, Any]:
        return {"time": round(t_ns * 1e-9, 6), "timestamp": rfc3339(self._date(t_ns))}


def _told(verdict: Verdict) -> dict[str, Any]:
    fields = {
        "kind": verdict.kind,
        "name": verdict.name,
        "outcome": verdict.outcome.value,
        "time": None if verdict.instant_ns is None else verdict.instant_ns * 1e-9,
        "expected": verdict.expected,
        "observed": verdict.observed,
        "margin": verdict.margin,
        "margin_unit": verdict.margin_unit,
    }
    return {key: value for key, value in fields.items() if value is not None and value != ""}
