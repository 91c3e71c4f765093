"""The other end of each bus adapter, for the contract suite: another program, in one process."""

from __future__ import annotations

import asyncio
import itertools
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass

import can
import numpy as np
import pytest

from hev_can_emu.bus.loopback import LoopbackHub
from hev_can_emu.bus.open import open_bus
from hev_can_emu.bus.port import Bus
from hev_can_emu.bus.socketcand import SocketcandBus
from hev_can_emu.messages.frame import EXTENDED, FD, frame, make_frames

GUARD_S = 10.0  # a failure guard, not a delay

# Every adapter; `make socketcan` gives the last one its kernel.
ADAPTERS = [
    "loopback",
    "virtual",
    "socketcand",
    "socketcand-client",
    "udp_multicast",
    pytest.param("socketcan", marks=pytest.mark.socketcan),
]
CLASSIC_ADAPTERS = {"socketcand", "socketcand-client"}

_names = itertools.count()

Seen = tuple[int, int, bytes]  # id, flags, data


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def batch(*frames: Seen) -> np.ndarray:
    return np.concatenate([frame(can_id, data, flags=flags) for can_id, flags, data in frames])


def seen(buffer: np.ndarray) -> list[Seen]:
    return [(int(f["id"]), int(f["flags"]), f["data"][: f["length"]].tobytes()) for f in buffer]


async def until(condition: Callable[[], bool]) -> None:
    """Return once ``condition`` holds, which another task or process brings about."""
    async with asyncio.timeout(30):
        while not condition():  # noqa: ASYNC110 - the other side has no event to give
            await asyncio.sleep(0.0005)


async def receive(bus: Bus, count: int) -> np.ndarray:
    """Return the next ``count`` frames of ``bus``."""
    buffer = make_frames(count)
    got = 0
    async with asyncio.timeout(GUARD_S):
        while got < count:
            await bus.wait()
            got += bus.drain(buffer[got:], count - got)
    return buffer


@dataclass
class Peer:
    """What a foreign program does; every call returns when it is done."""

    send_one: object
    receive_one: object

    async def send(self, *frames: Seen) -> None:
        for can_id, flags, data in frames:
            await self.send_one(can_id, flags, data)

    async def receive(self, count: int) -> list[Seen]:
        return [await self.receive_one() for _ in range(count)]


def python_can_peer(bus: can.BusABC) -> Peer:
    def send(can_id: int, flags: int, data: bytes) -> None:
        bus.send(
            can.Message(
                arbitration_id=can_id,
                is_extended_id=bool(flags & EXTENDED),
                is_fd=bool(flags & FD),
                data=data,
            )
        )

    def receive_one() -> Seen:
        message = bus.recv(GUARD_S)
        assert message is not None, "the peer received nothing"
        flags = (EXTENDED if message.is_extended_id else 0) | (FD if message.is_fd else 0)
        return message.arbitration_id, flags, bytes(message.data)

    async def send_one(*args: object) -> None:
        await asyncio.to_thread(send, *args)

    async def take_one() -> Seen:
        return await asyncio.to_thread(receive_one)

    return Peer(send_one, take_one)


@asynccontextmanager
async def bus_and_peer(kind: str) -> AsyncIterator[tuple[Bus, Peer]]:
    """Yield an open bus of ours and a foreign node on it."""
    if kind == "loopback":
        hub = LoopbackHub()
        async with hub.endpoint(time.monotonic_ns) as bus, hub.endpoint(lambda: 0) as other:

            async def send_one(can_id: int, flags: int, data: bytes) -> None:
                other.send(frame(can_id, data, flags=flags), 1)

            async def receive_one() -> Seen:
                return seen(await receive(other, 1))[0]

            yield bus, Peer(send_one, receive_one)
        return
    options: dict[str, object]
    if kind == "virtual":
        channel = f"contract-{next(_names)}"
        spec, options = f"virtual:{channel}", {"channel": channel}
    elif kind == "udp_multicast":
        port = free_port(socket.SOCK_DGRAM)
        spec = f"udp_multicast:239.74.163.2?port={port}"
        options = {"channel": "239.74.163.2", "port": port, "hop_limit": 0}
    elif kind == "socketcan":
        spec, options = "socketcan:vcan0", {"channel": "vcan0", "fd": True}
    else:
        spec, options = "socketcand:127.0.0.1:0", {}
    async with AsyncExitStack() as opened:
        bus = await opened.enter_async_context(open_bus(spec, time.monotonic_ns))
        if isinstance(bus, SocketcandBus):
            options = {"channel": "vcan0", "host": "127.0.0.1", "port": bus.port}
            if kind == "socketcand-client":
                spec = f"socketcand-client:127.0.0.1:{bus.port}"
                bus = await opened.enter_async_context(open_bus(spec, time.monotonic_ns))
        interface = kind.removesuffix("-client")
        foreign = await asyncio.to_thread(lambda: can.Bus(interface=interface, **options))
        try:
            yield bus, python_can_peer(foreign)
        finally:
            await asyncio.to_thread(foreign.shutdown)


class Collector(threading.Thread):
    """A foreign reader: collects ``count`` messages of a python-can bus."""

    def __init__(self, bus: can.BusABC, count: int) -> None:
        super().__init__(daemon=True)
        self.bus = bus
        self.count = count
        self.messages: list[can.Message] = []

    def run(self) -> None:
        while len(self.messages) < self.count:
            message = self.bus.recv(GUARD_S)
            if message is None:
                return
            self.messages.append(message)
