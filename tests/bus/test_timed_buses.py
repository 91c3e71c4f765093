"""The loopback and the embedded server with a bit rate: frames take their time and their turn."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine
from typing import Any

import can
import numpy as np
import pytest
from bus_peers import batch, receive, seen, until

from hev_can_emu.bus.bits import bits_of
from hev_can_emu.bus.disturbance import Disturbance
from hev_can_emu.bus.loopback import LoopbackHub
from hev_can_emu.bus.open import open_bus
from hev_can_emu.bus.wire_parts import Timing
from hev_can_emu.errors import InputError
from hev_can_emu.messages.frame import BRS, FD, SENT, frame

BITRATE = 500_000
LOW, HIGH = (0x100, 0, b"\x01" * 8), (0x700, 0, b"\x02" * 8)


def run(test: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(test, 30))


def bit_ns(one: tuple[int, int, bytes]) -> int:
    can_id, flags, data = one
    return int(bits_of(frame(can_id, data, flags=flags))[0, 0]) * 1_000_000_000 // BITRATE


def test_frames_are_carried_by_priority_and_stamped_as_carried() -> None:
    async def test() -> None:
        hub = LoopbackHub("x", Timing(BITRATE))
        async with hub.endpoint(time.monotonic_ns) as a, hub.endpoint(time.monotonic_ns) as b:
            a.send(batch(HIGH, LOW, HIGH), 3)
            got = await receive(b, 3)
            assert seen(got) == [LOW, HIGH, HIGH]
            gaps = np.diff(got["t_ns"])
            assert gaps == pytest.approx([bit_ns(HIGH) + 6000] * 2, abs=20_000)
            assert a.drain(got, 3) == 0  # nobody hears itself
            assert b.counters.received == a.counters.sent == 3

    run(test())


def test_who_plays_several_units_hears_them_once_they_are_carried() -> None:
    async def test() -> None:
        hub = LoopbackHub("x", Timing(BITRATE))
        car, other = hub.endpoint(time.monotonic_ns), hub.endpoint(time.monotonic_ns)
        car.play({(0x100, False): "EMS", (0x700, False): "TCU"})
        async with car, other:
            car.send(batch(HIGH, LOW), 2)
            assert seen(await receive(other, 2)) == [LOW, HIGH]
            own = await receive(car, 2)
            assert seen(own) == [(i, f | SENT, d) for i, f, d in (LOW, HIGH)]
            assert car.counters.received == 0
            assert hub.medium is not None
            hub.medium.wire.hold_off("TCU", hub.medium.now_ns())
            car.send(batch(HIGH, LOW), 2)
            assert seen(await receive(other, 1)) == [LOW]
            assert any("TCU is bus off" in notice for notice in other.take_notices())

    run(test())


def test_can_fd_on_the_loopback() -> None:
    async def test() -> None:
        hub = LoopbackHub("x", Timing(BITRATE, 2_000_000))
        wide = (0x155, FD | BRS, bytes(range(64)))
        async with hub.endpoint(time.monotonic_ns) as a, hub.endpoint(time.monotonic_ns) as b:
            a.send(batch(wide), 1)
            assert seen(await receive(b, 1)) == [wide]

    run(test())


def test_clients_of_the_embedded_server_contend_and_errors_are_told() -> None:
    async def test() -> None:
        async with open_bus(f"socketcand:127.0.0.1:0?bitrate={BITRATE}", time.monotonic_ns) as bus:
            assert bus.medium is not None
            options = {"channel": "vcan0", "host": "127.0.0.1", "port": bus.port}
            clients = [
                await asyncio.to_thread(lambda: can.Bus(interface="socketcand", **options))
                for _ in range(2)
            ]
            try:
                await until(lambda: bus.client_count == 2)
                message = can.Message(arbitration_id=0x123, data=b"\x55", is_extended_id=False)
                await asyncio.to_thread(clients[0].send, message)
                assert seen(await receive(bus, 1)) == [(0x123, 0, b"\x55")]
                heard = await asyncio.to_thread(clients[1].recv, 10.0)
                assert heard is not None
                assert (heard.arbitration_id, heard.data) == (0x123, b"\x55")
                # The emulator's own, of which 32 tries fail: it goes off the bus and back.
                bus.medium.wire.disturb(Disturbance(frames=32))
                bus.send(batch(LOW), 1)
                told: list[str] = []

                def recovered() -> bool:
                    bus.medium.pump()
                    told.extend(bus.take_notices())
                    return any("emulator is error active" in line for line in told)

                await until(recovered)
                assert any("emulator is error passive" in line for line in told)
                assert any("emulator is bus off" in line for line in told)
                bus.send(batch(HIGH), 1)
                for client in clients:
                    frame_heard = await asyncio.to_thread(client.recv, 10.0)
                    assert frame_heard is not None
                    assert frame_heard.arbitration_id == 0x700
                assert "32 error frames" in bus.medium.describe()
            finally:
                for client in clients:
                    await asyncio.to_thread(client.shutdown)

    run(test())


def test_one_loopback_has_one_bit_rate() -> None:
    first = open_bus("loopback:rates?bitrate=500000", time.monotonic_ns)
    assert first.medium is not None
    with pytest.raises(InputError, match="expected the bit rates that 'rates' has"):
        open_bus("loopback:rates?bitrate=250000", time.monotonic_ns)
    with pytest.raises(InputError, match="expected the bit rates that 'rates' has"):
        open_bus("loopback:rates", time.monotonic_ns)


def test_without_a_bit_rate_there_is_no_wire() -> None:
    assert open_bus("loopback:plain", time.monotonic_ns).medium is None
    assert open_bus("socketcand:127.0.0.1:0", time.monotonic_ns).medium is None
