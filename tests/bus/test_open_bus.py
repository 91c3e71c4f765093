"""``--bus`` in words: what is understood, and one clear line for what is not."""

from __future__ import annotations

import asyncio
import errno
import re
import subprocess
import sys
import time
from typing import Any

import can
import pytest
from bus_peers import batch, bus_and_peer, free_port, receive, seen

from hev_can_emu.bus.loopback import LoopbackBus
from hev_can_emu.bus.open import DEFAULT_BUS, open_bus
from hev_can_emu.bus.pythoncan import PythonCanBus
from hev_can_emu.bus.socketcand import SocketcandBus
from hev_can_emu.errors import InputError


def now_ns() -> int:
    return 0


@pytest.mark.parametrize(
    ("spec", "host", "port"),
    [
        (DEFAULT_BUS, "127.0.0.1", 29536),
        ("socketcand", "127.0.0.1", 29536),
        ("socketcand:127.0.0.1:0", "127.0.0.1", 0),
        ("socketcand:localhost", "localhost", 29536),
        ("socketcand::1234", "127.0.0.1", 1234),
    ],
)
def test_the_embedded_server_is_the_default(spec: str, host: str, port: int) -> None:
    bus = open_bus(spec, now_ns)
    assert isinstance(bus, SocketcandBus)
    assert (bus.host, bus.port) == (host, port)


def test_options_reach_python_can_with_their_types() -> None:
    bus = open_bus("virtual:a:b?rate=5&factor=0.5&preserve_timestamps=true&name=x", now_ns)
    assert isinstance(bus, PythonCanBus)
    assert (bus.interface, bus.channel) == ("virtual", "a:b")
    assert bus._options == {"rate": 5, "factor": 0.5, "preserve_timestamps": True, "name": "x"}


def test_loopbacks_of_one_name_are_one_bus() -> None:
    async def test() -> None:
        async with (
            open_bus("loopback:x", now_ns) as a,
            open_bus("loopback:x", now_ns) as b,
            open_bus("loopback:y", now_ns) as c,
        ):
            assert isinstance(a, LoopbackBus)
            a.send(batch((1, 0, b"")), 1)
            assert seen(await receive(b, 1)) == [(1, 0, b"")]
            assert c.counters.received == a.counters.received == 0

    asyncio.run(test())


def test_another_emulator_joins_as_a_client() -> None:
    async def test() -> None:
        async with open_bus("socketcand:127.0.0.1:0", time.monotonic_ns) as server:
            assert isinstance(server, SocketcandBus)
            spec = f"socketcand-client:127.0.0.1:{server.port}"
            async with open_bus(spec, time.monotonic_ns) as client:
                client.send(batch((5, 0, b"\x01")), 1)
                assert seen(await receive(server, 1)) == [(5, 0, b"\x01")]
                server.send(batch((6, 0, b"\x02")), 1)
                assert seen(await receive(client, 1)) == [(6, 0, b"\x02")]

    asyncio.run(test())


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        ("socketcan", "expected INTERFACE:CHANNEL, got no channel; e.g. --bus socketcan:vcan0"),
        ("sockercan:vcan0", "got unknown interface 'sockercan'; did you mean 'socketcan'"),
        ("qqq", "known: .*loopback, .*socketcan, socketcand, "),
        ("", "got unknown interface ''"),
        ("socketcand:127.0.0.1:port", "expected a port from 0 .* got 'port'"),
        ("socketcand:127.0.0.1:65536", "got '65536'"),
        ("socketcand:127.0.0.1:-1", "got '-1'"),
        ("socketcand:a:b:c:d", "expected socketcand:HOST:PORT"),
        ("socketcand?x=1", "expected .bitrate=B&data_bitrate=D, got x"),
        ("loopback?bitrat=500000", "got bitrat; did you mean 'bitrate'"),
        ("loopback?bitrate=5", "expected bitrate from 10000 to 1000000 bit/s, got '5'"),
        ("loopback?bitrate=500k", "expected bitrate from 10000 to 1000000 bit/s, got '500k'"),
        ("loopback?bitrate=true", "expected bitrate from 10000 to 1000000 bit/s, got 'True'"),
        ("loopback?data_bitrate=2000000", "expected .bitrate=B beside data_bitrate, got none"),
        ("socketcand?bitrate=500000&data_bitrate=250000", "at least 500000 bit/s, got 250000"),
        ("virtual:x?bitrate", "expected \\?OPTION=VALUE&..., got 'bitrate'"),
    ],
)
def test_a_spec_that_cannot_be_understood_is_one_line(spec: str, text: str) -> None:
    with pytest.raises(InputError, match=text) as caught:
        open_bus(spec, now_ns)
    assert str(caught.value).startswith(f"--bus {spec}: expected ")
    assert "\n" not in str(caught.value)


async def _open(spec: str) -> None:
    async with open_bus(spec, now_ns):
        pass


@pytest.mark.parametrize(
    ("spec", "raised", "text"),
    [
        ("socketcan:vcan7", OSError(errno.ENODEV, "x"), "ip link add dev vcan7 type vcan"),
        ("socketcan:vcan7", OSError(errno.EAFNOSUPPORT, "x"), "expected a kernel with SocketCAN"),
        ("socketcan:vcan7", OSError(errno.ENETDOWN, "x"), "ip link set vcan7 up"),
        ("pcan:PCAN_USBBUS1", OSError("library not found."), "OSError: library not found; are its"),
        ("kvaser:0", NameError("canOpen"), "got NameError: canOpen;"),
        ("slcan:tty", ValueError(), "got ValueError: ValueError;"),
    ],
)
def test_what_drivers_raise_becomes_one_line(
    spec: str, raised: Exception, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(**_: Any) -> can.BusABC:
        raise raised

    monkeypatch.setattr(can, "Bus", refuse)
    with pytest.raises(InputError, match=re.escape(text)) as caught:
        asyncio.run(_open(spec))
    assert caught.value.__cause__ is raised
    assert "\n" not in str(caught.value)


def test_a_missing_server_is_told_at_once() -> None:
    spec = f"socketcand-client:127.0.0.1:{free_port()}"
    with pytest.raises(InputError, match=f"--bus {spec}: expected a socketcand server"):
        asyncio.run(_open(spec))


def test_python_can_and_the_compiler_are_imported_only_where_they_are_needed() -> None:
    code = (
        "import sys; from hev_can_emu.bus.open import open_bus\n"
        "open_bus('socketcand', int); open_bus('loopback', int)\n"
        "assert not {'can', 'numba'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=_root())


def _root() -> str:
    import hev_can_emu

    return str(next(iter(hev_can_emu.__path__)) + "/..")


@pytest.mark.parametrize("kind", ["loopback", "virtual", "socketcand"])
def test_hints_are_commands_only_where_a_process_can_join(kind: str) -> None:
    async def test() -> None:
        async with bus_and_peer(kind) as (bus, _):
            assert bool(bus.join_hint()) == (kind == "socketcand")
            assert bus.describe()

    asyncio.run(test())
