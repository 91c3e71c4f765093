"""Options of MQTT, and what comes of them beside a run; nothing of MQTT is imported without them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.runtime.event_texts import Event
    from hev_can_emu.runtime.playing import Playing, RunResult
    from hev_can_emu.runtime.remote import Remote
    from hev_can_emu.runtime.service import Service, Watcher
    from hev_can_emu.telemetry.mqtt_address import Address
    from hev_can_emu.telemetry.mqtt_link import Link

_OPTIONS = ("mqtt_ca", "mqtt_rate", "vin", "mqtt_commands")
_RUN_OPTIONS = ("mqtt_scenarios",)


def add_mqtt_arguments(parser: argparse.ArgumentParser, scenarios: bool = False) -> None:
    """Add what decides whether and how the car is told of by MQTT, and whether commands start scenarios."""
    group = parser.add_argument_group(
        "telemetry by MQTT (user and password: HEV_CAN_EMU_MQTT_USER, HEV_CAN_EMU_MQTT_PASSWORD)"
    )
    group.add_argument(
        "--mqtt",
        metavar="BROKER",
        help="mqtt://HOST[:PORT], mqtts://HOST[:PORT], or embedded[:PORT] for a broker of its own",
    )
    group.add_argument("--mqtt-ca", metavar="FILE", help="certificates to trust (mqtts)")
    group.add_argument(
        "--mqtt-rate", metavar="HZ", help="most values of a signal in a second (default: 5)"
    )
    group.add_argument("--vin", metavar="VIN", help="second level of every topic")
    group.add_argument(
        "--mqtt-commands", action="store_true", help="obey commands that come by MQTT"
    )
    if scenarios:
        group.add_argument(
            "--mqtt-scenarios",
            metavar="DIR",
            help="scenarios that commands may start, beside the shipped ones",
        )


def mqtt_address(arguments: argparse.Namespace) -> Address | None:
    """Return where the broker is, None without ``--mqtt``; raises InputError."""
    if arguments.mqtt is None:
        for name in (*_OPTIONS, *_RUN_OPTIONS):
            if getattr(arguments, name, None):
                raise InputError(f"--{name.replace('_', '-')}", "--mqtt beside it", "none")
        return None
    from hev_can_emu.telemetry.mqtt_address import parse_address
    from hev_can_emu.telemetry.mqtt_link import check_installed

    address = parse_address(arguments.mqtt, arguments.vin, arguments.mqtt_ca)
    check_installed(address.embedded)
    address.tls_context()
    _rate(arguments)
    scenario_folder(arguments)
    return address


def scenario_folder(arguments: argparse.Namespace) -> Path | None:
    """Return the folder of scenarios that commands may start, or None; raises InputError."""
    given = getattr(arguments, "mqtt_scenarios", None)
    if given is None:
        return None
    if not arguments.mqtt_commands:
        raise InputError("--mqtt-scenarios", "--mqtt-commands beside it", "none")
    if not Path(given).is_dir():
        raise InputError("--mqtt-scenarios", "a folder", f"'{given}'")
    return Path(given)


class MqttSide:
    """All of MQTT beside one run; does nothing without ``--mqtt``.

    Args:
        arguments: of the command.
        emulator: the car.
        epoch_ns: Unix time of the car's time zero, ns; None in virtual time.
        say: tells people of an event.

    Raises:
        HevError: an address that cannot be one, or an embedded broker that cannot be started.
    """

    def __init__(
        self,
        arguments: argparse.Namespace,
        emulator: Emulator,
        epoch_ns: int | None,
        say: Callable[[Event], None],
    ) -> None:
        self.watchers: list[Watcher] = []
        self._link: Link | None = None
        self._remote: Remote | None = None
        self._say = say
        self._epoch_ns = epoch_ns
        self._emulator = emulator
        address = mqtt_address(arguments)
        if address is None:
            return
        from hev_can_emu.runtime.publishing import open_link
        from hev_can_emu.runtime.remote import Remote
        from hev_can_emu.runtime.service import Watcher

        period_s = 1.0 / _rate(arguments)
        self._own = scenario_folder(arguments)
        self._link = open_link(address, emulator, period_s, arguments.mqtt_commands)
        self._remote = Remote(emulator, self._link, epoch_ns)
        self.watchers.append(Watcher("mqtt", min(period_s, 0.1), self.look))
        self._link.start()
        if address.embedded:
            print(f"MQTT broker on {address.describe()}, topics under {address.root}/")

    @property
    def on(self) -> bool:
        """Whether there is anything to do."""
        return self._link is not None

    def began(self, playing: Playing) -> None:
        """Leave that a scenario has begun, and from now on what is decided of it."""
        if self._remote is not None:
            self._remote.publisher.began(playing.scenario.name)
            self._remote.playing = playing

    def ended(self, result: RunResult) -> None:
        """Leave how a scenario ended."""
        if self._remote is not None:
            self._remote.publisher.ended(result)

    def attach(self, service: Service) -> None:
        """Let commands start scenarios on this service."""
        if self._remote is not None and self._epoch_ns is not None:
            from hev_can_emu.runtime.remote_scenarios import RemoteScenarios

            scenarios = RemoteScenarios(service, self._remote, self._own, self._epoch_ns)
            self._remote.offer(scenarios.actions)

    def look(self) -> None:
        """Leave the car's statuses, do what was asked for, tell what became of the connection."""
        if self._remote is not None:
            self._remote.look()
            self._tell_notices()

    def event(self, event: Event) -> None:
        """Leave an event."""
        if self._remote is not None:
            self._remote.publisher.event(event)

    def stop(self, patience_s: float = 0.0) -> None:
        """Send what waits, if the broker takes it within ``patience_s`` (s), and end."""
        if self._link is not None:
            self._link.stop(patience_s)
            self._tell_notices()

    def print_counters(self) -> None:
        """Print what went to the broker and what did not."""
        if self._link is not None:
            counters = self._link.counters
            print(
                f"MQTT: {counters.sent} sent, {counters.replaced} values replaced by newer ones, "
                f"{counters.dropped} events given up, {counters.connections} connections"
            )

    def _tell_notices(self) -> None:
        from hev_can_emu.runtime.event_texts import Event

        if self._link is not None:
            for notice in self._link.take_notices():
                self._say(Event(self._emulator.now_ns, "mqtt", notice, 0, 0.0))


def _rate(arguments: argparse.Namespace) -> float:
    text = arguments.mqtt_rate
    if text is None:
        return 5.0
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.01 <= value <= 100.0:
        raise InputError("--mqtt-rate", "a number from 0.01 to 100 (Hz)", f"'{text}'")
    return value
