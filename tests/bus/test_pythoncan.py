"""The python-can adapter with a driver that misbehaves: slow, full, broken."""

from __future__ import annotations

import asyncio
import errno
import os
import queue
import socket
import threading
import time
from typing import Any

import can
import pytest
from bus_peers import batch, free_port, receive, seen, until

from hev_can_emu.bus.echo import EXPECTED_WITHIN_NS, EchoFilter
from hev_can_emu.bus.open import open_bus
from hev_can_emu.bus.pythoncan import FAILURES_MEAN_LOST, PythonCanBus
from hev_can_emu.errors import BusError
from hev_can_emu.messages.frame import make_frames

FRAME = (0x123, 0, b"\x01")


class Driver:
    """Stands for a python-can bus: what it receives and what its send does is set by the test."""

    def __init__(self) -> None:
        self.incoming: queue.Queue[can.Message | Exception] = queue.Queue()
        self.sent: list[can.Message] = []
        self.on_send: Any = None
        self.shut_down = False

    def recv(self, timeout: float) -> can.Message | None:
        try:
            item = self.incoming.get(timeout=timeout)
        except queue.Empty:
            return None
        if isinstance(item, Exception):
            raise item
        return item

    def send(self, message: can.Message) -> None:
        if self.on_send is not None:
            self.on_send()
        self.sent.append(message)

    def shutdown(self) -> None:
        self.shut_down = True


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    driver = Driver()
    monkeypatch.setattr(can, "Bus", lambda **_: driver)
    return driver


def bus(**options: Any) -> PythonCanBus:
    return PythonCanBus(time.monotonic_ns, "faulty", "x", **options)


def run(test: Any) -> None:
    asyncio.run(asyncio.wait_for(test(), 30))


def test_frames_of_other_local_processes_are_not_taken_for_own(driver: Driver) -> None:
    async def test() -> None:
        async with bus() as port:
            port.send(batch(FRAME), 1)
            message = can.Message(
                arbitration_id=0x123, data=b"\x01", is_extended_id=False, is_rx=False
            )
            driver.incoming.put(message)
            assert seen(await receive(port, 1)) == [FRAME]

    run(test)


def test_a_lost_bus_is_told_after_what_came_before(driver: Driver) -> None:
    async def test() -> None:
        async with bus() as port:
            driver.incoming.put(
                can.Message(arbitration_id=0x123, data=b"\x01", is_extended_id=False)
            )
            driver.incoming.put(can.CanOperationError("cable out"))
            await until(lambda: port.lost is not None)
            buffer = make_frames(4)
            await port.wait()
            assert port.drain(buffer, 4) == 1
            await port.wait()
            with pytest.raises(BusError, match="receiving failed: cable out") as caught:
                port.drain(buffer, 4)
            assert isinstance(caught.value.__cause__, can.CanOperationError)
            with pytest.raises(BusError):
                port.send(batch(FRAME), 1)

    run(test)
    assert driver.shut_down


def test_a_full_driver_is_tried_again(driver: Driver) -> None:
    refusals = [can.CanOperationError("Transmit buffer full", errno.ENOBUFS)] * 5

    def on_send() -> None:
        if refusals:
            raise refusals.pop()

    driver.on_send = on_send

    async def test() -> None:
        async with bus() as port:
            port.send(batch(FRAME, FRAME), 2)
            await until(lambda: port.counters.sent == 2)
            assert port.counters.errors == 0

    run(test)


def test_a_refused_frame_is_counted_and_many_mean_a_lost_bus(driver: Driver) -> None:
    def on_send() -> None:
        raise can.CanOperationError("error passive")

    driver.on_send = on_send

    async def test() -> None:
        async with bus() as port:
            port.send(batch(FRAME), 1)
            await until(lambda: port.counters.errors == 1)
            assert port.lost is None
            assert "frame 123 not sent: error passive" in port.take_notices()[0]
            port.send(batch(*[FRAME] * (FAILURES_MEAN_LOST - 1)), FAILURES_MEAN_LOST - 1)
            await until(lambda: port.lost is not None)
            assert "sending failed: error passive" in str(port.lost)

    run(test)


def test_a_device_that_is_gone_is_lost_at_once(driver: Driver) -> None:
    def on_send() -> None:
        raise can.CanOperationError("Failed to transmit", errno.ENETDOWN)

    driver.on_send = on_send

    async def test() -> None:
        async with bus() as port:
            port.send(batch(FRAME), 1)
            await until(lambda: port.lost is not None)

    run(test)


def test_a_blocked_driver_blocks_nobody_and_the_queue_is_bounded(driver: Driver) -> None:
    gate = threading.Event()
    driver.on_send = gate.wait

    async def test() -> None:
        async with bus(queue_frames=10) as port:
            for n in range(30):
                port.send(batch((n, 0, b"")), 1)
            assert port.counters.dropped == 20
            gate.set()
            await until(lambda: port.counters.sent == 10)
            assert [m.arbitration_id for m in driver.sent] == list(range(10))

    run(test)


def test_closing_sends_what_is_queued(driver: Driver) -> None:
    async def test() -> None:
        async with bus() as port:
            port.send(batch(*[(n, 0, b"") for n in range(100)]), 100)

    run(test)
    assert [m.arbitration_id for m in driver.sent] == list(range(100))


def test_an_opening_that_is_cancelled_leaves_no_open_bus(
    driver: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, gate = threading.Event(), threading.Event()

    def slow_open(**_: Any) -> Driver:
        begun.set()
        gate.wait()
        return driver

    monkeypatch.setattr(can, "Bus", slow_open)

    async def test() -> None:
        opening = asyncio.ensure_future(bus().__aenter__())
        await asyncio.to_thread(begun.wait)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        gate.set()
        await until(lambda: driver.shut_down)

    run(test)


def test_multicast_stays_on_the_machine() -> None:
    async def test() -> None:
        port = free_port(socket.SOCK_DGRAM)
        spec = f"udp_multicast:239.74.163.2?port={port}"
        async with open_bus(spec, time.monotonic_ns) as opened:
            with socket.socket(fileno=os.dup(opened._bus.fileno())) as shared:
                assert shared.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
                device = shared.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4)
                assert socket.inet_ntoa(device) == "127.0.0.1"

    run(test)


def test_echoes_are_expected_once_each_and_not_forever() -> None:
    now = 0
    echo = EchoFilter(lambda: now)
    echo.expect(*FRAME)
    echo.expect(*FRAME)
    assert not echo.is_own(0x124, 0, b"\x01")
    assert [echo.is_own(*FRAME) for _ in range(3)] == [True, True, False]
    echo.expect(*FRAME)
    now = EXPECTED_WITHIN_NS + 1
    assert not echo.is_own(*FRAME)
