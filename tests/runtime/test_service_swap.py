"""Another car takes over on the same bus, and hands back: the bus's time goes on, each car's own does too."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from hev_can_emu.bus.loopback import LoopbackHub
from hev_can_emu.messages.frame import frame, make_frames
from hev_can_emu.messages.named import NamedCodec
from hev_can_emu.runtime import service as module
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

MS = 1_000_000


def test_cars_take_turns_on_one_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now=0)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic_ns=lambda: clock.now))
    first, second = (
        Emulator(Setup(protection="off")),
        Emulator(Setup(protection="off", model="4dof")),
    )
    request = first.database.message("HCU_EM2Request")
    data = NamedCodec(first.database).encode_message(
        request.name, {"EM2ControlMode": 1, "EM2TorqueRequest": 50.0, "EM2SpeedRequest": 0.0}
    )
    stamps: list[np.ndarray] = []

    async def play() -> None:
        hub = LoopbackHub()
        sunk: list[np.ndarray] = []
        service = module.Service(
            first, hub.endpoint, [lambda frames, count: sunk.append(frames["t_ns"][:count].copy())]
        )
        other = hub.endpoint(lambda: clock.now)
        heard = make_frames(4096)

        async def run(milliseconds: int) -> None:
            for _ in range(milliseconds // 10):
                clock.now += 10 * MS
                other.send(frame(request.can_id, data), 1)
                await asyncio.sleep(0)
                service._due()
                await asyncio.sleep(0)  # a late loop reads its sockets first
            stamps.append(heard["t_ns"][: other.drain(heard, len(heard))].copy())

        async with service.bus, other:
            await run(100)
            assert service.swap(second) is first
            await run(200)
            assert second.now_ns == 200 * MS
            assert first.now_ns == 101 * MS
            assert second.signal("EM2TorqueRequest") == 50.0  # it hears what the first heard
            assert service.swap(first) is second
            await run(50)
            assert first.now_ns == 151 * MS
            assert service.statistics.overruns == 351 - 35
        assert not [event for event in second.take_events() if event.kind == "lost"]
        recorded = np.concatenate(sunk)
        assert recorded.max() == 350 * MS

    asyncio.run(play())
    on_bus = np.concatenate(stamps)
    assert (np.diff(on_bus) >= 0).all()
    assert on_bus[-1] == 350 * MS
