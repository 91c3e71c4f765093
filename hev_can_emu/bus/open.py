"""From ``--bus`` to a bus: ``INTERFACE[:CHANNEL][?OPTION=VALUE&...]``.

==========================================  =====================================================
``socketcand[:HOST[:PORT]]``                the embedded server (default 127.0.0.1:29536)
``socketcand-client:HOST[:PORT[:CHANNEL]]`` a socketcand server elsewhere, or another emulator
``loopback[:NAME]``                         in memory, within this process
``INTERFACE[:CHANNEL]``                     any other python-can interface, e.g. ``socketcan:vcan0``
==========================================  =====================================================

The first and third take ``?bitrate=B&data_bitrate=D``: bit times, arbitration and errors as on a CAN bus.
"""

from __future__ import annotations

import importlib.util
import weakref
from collections.abc import Callable
from typing import Any

from hev_can_emu.bus.lockstep import LockstepBus
from hev_can_emu.bus.loopback import LoopbackHub
from hev_can_emu.bus.port import Bus
from hev_can_emu.bus.socketcand import CHANNEL, DEFAULT_HOST, DEFAULT_PORT, SocketcandBus
from hev_can_emu.bus.wire_parts import Timing
from hev_can_emu.errors import InputError, did_you_mean

MAX_PARTNERS = 64
DEFAULT_BUS = f"socketcand:{DEFAULT_HOST}:{DEFAULT_PORT}"

BITRATES = (10_000, 1_000_000)  #: bit/s, least and greatest
DATA_BITRATES = (10_000, 8_000_000)

_hubs: weakref.WeakValueDictionary[str, LoopbackHub] = weakref.WeakValueDictionary()


def open_bus(spec: str, now_ns: Callable[[], int], *, epoch_ns: int = 0) -> Bus:
    """Return the bus that ``spec`` names, yet to be opened by ``async with``.

    Args:
        spec: see the module's text.
        now_ns: the clock that stamps received frames, in ns.
        epoch_ns: Unix time at the clock's zero, for the time stamps that clients of the embedded
            server see.

    Raises InputError if ``spec`` cannot be understood or names no interface; python-can is imported
    only for interfaces of its own.
    """
    where = f"--bus {spec}"
    body, _, query = spec.partition("?")
    interface, _, channel = body.partition(":")
    options = _parse_options(query, where)
    if interface == "socketcand":
        host, port, _ = _parse_address(channel, where)
        timing = _parse_timing(options, where)
        return SocketcandBus(now_ns, host, port, epoch_ns=epoch_ns, timing=timing)
    if interface == "loopback":
        name = channel or "loopback"
        timing = _parse_timing(options, where)
        hub = _hubs.get(name)
        if hub is None:
            hub = _hubs[name] = LoopbackHub(name, timing)
        elif hub.timing != timing:
            raise InputError(where, f"the bit rates that '{name}' has", f"others ({query})")
        return hub.endpoint(now_ns)
    from hev_can_emu.bus.pythoncan import PythonCanBus

    if interface == "socketcand-client":
        host, port, name = _parse_address(channel, where)
        options |= {"host": host, "port": port, "tcp_tune": True}
        return PythonCanBus(now_ns, "socketcand", name or CHANNEL, options, spec=spec)
    _check_interface(interface, where)
    if interface == "socketcan" and not channel:
        raise InputError(where, "INTERFACE:CHANNEL", "no channel", "e.g. --bus socketcan:vcan0")
    if interface == "udp_multicast" and not channel:
        channel = "239.74.163.2"  # python-can's IPv4 group; its default, IPv6, is often unroutable
    if interface == "udp_multicast" and importlib.util.find_spec("msgpack") is None:
        hint = "pip install 'hev-can-emu[multicast]'"
        raise InputError(where, "the package msgpack", "none installed", hint)
    return PythonCanBus(now_ns, interface, channel, options, spec=body)


def open_lockstep_bus(
    spec: str, now_ns: Callable[[], int], partners: int, patience_s: float, *, epoch_ns: int = 0
) -> LockstepBus:
    """Return the embedded server in lockstep with ``partners`` clients, yet to be opened.

    Raises InputError if ``spec`` names another bus, or the numbers make no sense.
    """
    where = f"--bus {spec}"
    interface, _, address = spec.partition(":")
    if interface != "socketcand":
        hint = "only the embedded server can let time wait"
        raise InputError(where, "socketcand[:HOST[:PORT]]", f"'{spec}'", hint)
    if not 1 <= partners <= MAX_PARTNERS:
        raise InputError("--partners", f"1 to {MAX_PARTNERS}", f"{partners}")
    if not 0.0 < patience_s <= 1e6:
        raise InputError("--patience", "a time above 0 s", f"{patience_s:g} s")
    host, port, _ = _parse_address(address, where)
    return LockstepBus(
        now_ns, host, port, epoch_ns=epoch_ns, partners=partners, patience_s=patience_s
    )


def _parse_address(text: str, where: str) -> tuple[str, int, str]:
    """Return host, port and channel of ``HOST[:PORT[:CHANNEL]]``."""
    parts = text.split(":") if text else []
    if len(parts) > 3:
        raise InputError(where, "socketcand:HOST:PORT", f"'{text}'", "addresses are IPv4 or names")
    host = (parts[0] if parts else "") or DEFAULT_HOST
    port_text = (parts[1] if len(parts) > 1 else "") or str(DEFAULT_PORT)
    if not (port_text.isascii() and port_text.isdigit() and int(port_text) <= 65_535):
        raise InputError(where, "a port from 0 (any free one) to 65535", f"'{port_text}'")
    return host, int(port_text), parts[2] if len(parts) > 2 else ""


def _parse_options(query: str, where: str) -> dict[str, Any]:
    """Return ``a=1&b=x`` as a dict, numbers and booleans as such."""
    options: dict[str, Any] = {}
    for item in filter(None, query.split("&")):
        name, equals, text = item.partition("=")
        if not (equals and name.isidentifier()):
            raise InputError(where, "?OPTION=VALUE&...", f"'{item}'", "e.g. ?bitrate=500000")
        options[name] = _parse_value(text)
    return options


def _parse_value(text: str) -> bool | int | float | str:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for convert in (int, float):
        try:
            return convert(text)
        except ValueError:
            continue
    return text


def timing_of(spec: str) -> Timing | None:
    """Return the bit rates that a ``--bus`` of our own asks for, or None; raises InputError."""
    body, _, query = spec.partition("?")
    if body.partition(":")[0] not in ("loopback", "socketcand"):
        return None
    where = f"--bus {spec}"
    return _parse_timing(_parse_options(query, where), where)


def _parse_timing(options: dict[str, Any], where: str) -> Timing | None:
    """Return the bit rates among ``options``, which may hold nothing else; None without any."""
    if not options:
        return None
    rates = {"bitrate": BITRATES, "data_bitrate": DATA_BITRATES}
    unknown = [name for name in options if name not in rates]
    if unknown:
        hint = did_you_mean(unknown[0], rates)
        raise InputError(where, "?bitrate=B&data_bitrate=D", ", ".join(unknown), hint)
    if "bitrate" not in options:
        raise InputError(where, "?bitrate=B beside data_bitrate", "none", "e.g. ?bitrate=500000")
    for name, (least, most) in rates.items():
        value = options.get(name, least)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise InputError(where, f"{name} from {least} to {most} bit/s", f"'{value}'")
    bitrate = options["bitrate"]
    data_bitrate = options.get("data_bitrate", max(bitrate, Timing().data_bitrate))
    if data_bitrate < bitrate:
        raise InputError(where, f"data_bitrate of at least {bitrate} bit/s", f"{data_bitrate}")
    return Timing(bitrate, data_bitrate)


def _check_interface(interface: str, where: str) -> None:
    import can  # takes 0.2 s: only for interfaces of its own

    known = {*can.VALID_INTERFACES, "socketcand", "socketcand-client", "loopback"}
    if interface not in known:
        hint = did_you_mean(interface, known) or "known: " + ", ".join(sorted(known))
        raise InputError(where, "INTERFACE[:CHANNEL]", f"unknown interface '{interface}'", hint)
