"""The car's side of MQTT: what of an emulator goes out, off the tick's path."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any, NamedTuple

from hev_can_emu.ecu.ports import STATUSES
from hev_can_emu.runtime.emulator import Emulator, Event
from hev_can_emu.scenario.verdict import Verdict
from hev_can_emu.telemetry.mqtt_address import Address
from hev_can_emu.telemetry.mqtt_feed import Epoch, Feed
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


class Rates(NamedTuple):
    """``period_s``: least time between two values of a signal, s."""

    period_s: float = 0.2


class Publisher:
    """Hands an emulator's statuses, events and verdicts to a link.

    Args:
        emulator: the car.
        address: of the broker.
        epoch_ns: Unix time of the car's time zero, ns.
        rates: how often signals are told.
        commands: whether requests are taken.
    """

    def __init__(
        self,
        emulator: Emulator,
        address: Address,
        epoch_ns: int,
        rates: Rates | None = None,
        commands: bool = False,
    ) -> None:
        rates = rates or Rates()
        self.emulator = emulator
        self.epoch = Epoch(epoch_ns)
        self.period_s = rates.period_s
        names = tuple(port.name for port in STATUSES)
        feed = Feed(LEAVES, names, self.epoch, rates.period_s, REFRESH_S)
        setup = emulator.setup
        status: dict[str, Any] = {
            "version": version("hev-can-emu"),
            "vss": "6.0",
            "vehicle": emulator.vehicle_name,
            "model": setup.model,
            "protection": setup.protection,
            "commands": commands,
            "since": self.epoch.stamp(emulator.now_ns).timestamp,
        }
        self.link = Link(address, feed, status, commands)

    def sample(self) -> None:
        """Leave the statuses as they are now."""
        emulator = self.emulator
        self.link.offer(emulator.state.statuses.copy(), emulator.now_ns)

    def event(self, event: Event) -> None:
        """Leave an event."""
        body = self._stamped(event.t_ns) | {
            "kind": event.kind,
            "text": event.text,
            "number": event.number,
            "value": event.value,
        }
        self.link.happen(f"event/{_TOPICS.get(event.kind, event.kind)}", body)

    def verdicts(self, name: str, outcome: str, verdicts: list[Verdict]) -> None:
        """Leave how a scenario ended: each verdict, then the whole."""
        for verdict in verdicts:
            self.link.happen("scenario/verdict", {"scenario": name} | _told(verdict))
        stamp = self._stamped(self.emulator.now_ns)
        counts: dict[str, int] = {}
        for verdict in verdicts:
            word = verdict.outcome.name.lower()
            counts[word] = counts.get(word, 0) + 1
        body = stamp | {"scenario": name, "state": "ended", "outcome": outcome, "counts": counts}
        self.link.happen("scenario/state", body)

    def began(self, name: str) -> None:
        """Leave that a scenario has begun."""
        body = self._stamped(self.emulator.now_ns) | {"scenario": name, "state": "running"}
        self.link.happen("scenario/state", body)

    def _stamped(self, t_ns: int) -> dict[str, Any]:
        stamp = self.epoch.stamp(t_ns)
        return {"time": stamp.time, "timestamp": stamp.timestamp}


def _told(verdict: Verdict) -> dict[str, Any]:
    fields = {
        "kind": verdict.kind,
        "name": verdict.name,
        "outcome": verdict.outcome.name.lower(),
        "time": None if verdict.instant_ns is None else verdict.instant_ns * 1e-9,
        "expected": verdict.expected,
        "observed": verdict.observed,
        "margin": verdict.margin,
        "margin_unit": verdict.margin_unit,
    }
    return {key: value for key, value in fields.items() if value is not None and value != ""}
