"""Options of MQTT, and the link that comes of them; nothing of MQTT is imported without them."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.telemetry.mqtt_address import Address
    from hev_can_emu.telemetry.mqtt_link import Link

_OPTIONS = ("mqtt_ca", "mqtt_rate", "vin", "mqtt_commands")


def add_mqtt_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what decides whether and how the car is told of by MQTT."""
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


def mqtt_address(arguments: argparse.Namespace) -> Address | None:
    """Return where the broker is, None without ``--mqtt``; raises InputError."""
    if arguments.mqtt is None:
        for name in _OPTIONS:
            if getattr(arguments, name):
                raise InputError(f"--{name.replace('_', '-')}", "--mqtt beside it", "none")
        return None
    from hev_can_emu.telemetry.mqtt_address import parse_address
    from hev_can_emu.telemetry.mqtt_link import check_installed

    address = parse_address(arguments.mqtt, arguments.vin, arguments.mqtt_ca)
    check_installed(address.embedded)
    address.tls_context()
    _rate(arguments)
    return address


def start_link(arguments: argparse.Namespace, emulator: Emulator) -> Link | None:
    """Return a link that has begun to connect, None without ``--mqtt``; raises HevError."""
    address = mqtt_address(arguments)
    if address is None:
        return None
    from hev_can_emu.runtime.publishing import open_link

    link = open_link(address, emulator, period_s(arguments), arguments.mqtt_commands)
    link.start()
    if address.embedded:
        print(f"MQTT broker on {address.describe()}, topics under {address.root}/")
    return link


def period_s(arguments: argparse.Namespace) -> float:
    """Return the least time between two values of a signal, s."""
    return 1.0 / _rate(arguments)


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


def print_counters(link: Link) -> None:
    """Print what went to the broker and what did not."""
    counters = link.counters
    print(
        f"MQTT: {counters.sent} sent, {counters.replaced} values replaced by newer ones, "
        f"{counters.dropped} events given up, {counters.connections} connections"
    )
