"""One suite for every bus adapter: what the service relies on, with a foreign node at the other end."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

import pytest
from bus_peers import ADAPTERS, CLASSIC_ADAPTERS, batch, bus_and_peer, receive, seen

from hev_can_emu.errors import StateError
from hev_can_emu.messages.frame import EXTENDED, FD, SENT, make_frames

FRAMES = [
    (0x123, 0, bytes.fromhex("1122334455667788")),
    (0x7FF, 0, b""),
    (0x000, 0, b"\x00"),
    (0x12345, EXTENDED, b"\xff\x00\xab"),
    (0x001, EXTENDED, b"\x01\x02\x03\x04\x05\x06\x07"),
]

pytestmark = pytest.mark.parametrize("kind", ADAPTERS)


def run(test: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(test, 30))


def test_frames_arrive_as_sent_in_order(kind: str) -> None:
    async def test() -> None:
        async with bus_and_peer(kind) as (bus, peer):
            frames = batch(*[(i, flags | SENT, data) for i, flags, data in FRAMES])
            bus.send(frames, len(frames))
            assert await peer.receive(len(FRAMES)) == FRAMES
            await peer.send(*FRAMES)
            assert seen(await receive(bus, len(FRAMES))) == FRAMES
            assert bus.counters.sent == bus.counters.received == len(FRAMES)
            assert (bus.counters.dropped, bus.counters.errors) == (0, 0)

    run(test())


def test_nobody_hears_itself_but_equal_frames_of_others(kind: str) -> None:
    async def test() -> None:
        async with bus_and_peer(kind) as (bus, peer):
            same = FRAMES[0]
            bus.send(batch(same, same), 2)
            assert await peer.receive(2) == [same, same]
            await peer.send(same, FRAMES[3])
            # Exactly one of the equal frames, the peer's; the marker shows that none follows.
            assert seen(await receive(bus, 2)) == [same, FRAMES[3]]

    run(test())


def test_a_burst_is_lossless_and_ordered_both_ways(kind: str) -> None:
    frames = [(0x100 + n % 256, 0, n.to_bytes(4, "big")) for n in range(200)]

    async def test() -> None:
        async with bus_and_peer(kind) as (bus, peer):
            for start in range(0, 200, 50):
                bus.send(batch(*frames[start : start + 50]), 50)
                assert await peer.receive(50) == frames[start : start + 50]
            await peer.send(*frames)
            assert seen(await receive(bus, 200)) == frames

    run(test())


def test_receipt_is_stamped_by_the_clock_passed_in(kind: str) -> None:
    async def test() -> None:
        async with bus_and_peer(kind) as (bus, peer):
            bus._now_ns = lambda: 42_000_000
            await peer.send(FRAMES[0])
            assert (await receive(bus, 1))["t_ns"][0] == 42_000_000

    run(test())


def test_drain_respects_capacity_and_never_waits(kind: str) -> None:
    async def test() -> None:
        async with bus_and_peer(kind) as (bus, peer):
            buffer = make_frames(8)
            assert bus.drain(buffer, 8) == 0
            await peer.send(*FRAMES[:3])
            got = 0
            while got < 3:
                await bus.wait()
                step = bus.drain(buffer[got:], 2)
                assert 1 <= step <= 2
                got += step
            assert seen(buffer[:3]) == FRAMES[:3]
            assert bus.drain(buffer, 8) == 0

    run(test())


def test_a_closed_bus_stays_closed(kind: str) -> None:
    async def test() -> None:
        async with bus_and_peer(kind) as (bus, _):
            pass
        with pytest.raises(StateError):
            bus.send(batch(FRAMES[0]), 1)
        with pytest.raises(StateError):
            await bus.__aenter__()

    run(test())


def test_can_fd_goes_through_or_is_refused_and_counted(kind: str) -> None:
    async def test() -> None:
        async with bus_and_peer(kind) as (bus, peer):
            wide = (0x155, FD, bytes(range(64)))
            bus.send(batch(wide, FRAMES[0]), 2)
            if kind not in CLASSIC_ADAPTERS:
                assert await peer.receive(2) == [wide, FRAMES[0]]
                await peer.send(wide)
                assert seen(await receive(bus, 1)) == [wide]
            else:
                assert await peer.receive(1) == [FRAMES[0]]
                assert bus.counters.errors == 1
                assert any("CAN FD" in notice for notice in bus.take_notices())

    run(test())
