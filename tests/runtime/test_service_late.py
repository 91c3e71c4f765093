"""A service whose process was held up: what was sent in time counts as received in time."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from hev_can_emu.bus.loopback import LoopbackHub
from hev_can_emu.messages.frame import frame
from hev_can_emu.messages.named import NamedCodec
from hev_can_emu.runtime import service as module
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

MS = 1_000_000


@pytest.mark.parametrize("sending", [True, False])
def test_frames_read_after_a_stall_refresh_the_time_outs_of_the_missed_ticks(
    sending: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimpleNamespace(now=0)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic_ns=lambda: clock.now))

    async def play() -> list[str]:
        hub = LoopbackHub()
        emulator = Emulator(Setup(protection="off"))
        service = module.Service(emulator, hub.endpoint)
        other = hub.endpoint(lambda: 0)
        request = emulator.database.message("HCU_EM2Request")
        data = NamedCodec(emulator.database).encode_message(
            request.name, {"EM2ControlMode": 1, "EM2TorqueRequest": 50.0, "EM2SpeedRequest": 0.0}
        )
        async with service.bus, other:
            # Ten periods in time, then 70 ms in which this process does not run at all.
            for length in [10] * 10 + [70] + [10] * 5:
                clock.now += length * MS
                service._due()
                for _ in range(length // 10 if sending or clock.now < 120 * MS else 0):
                    other.send(frame(request.can_id, data), 1)
                await asyncio.sleep(0)
            assert emulator.now_ns == clock.now + MS
            assert service.statistics.overruns == clock.now // MS - 15
        return [event.kind for event in emulator.take_events() if event.kind in ("lost", "healed")]

    # With the sender gone during the stall the loss is real, and told.
    assert asyncio.run(play()) == ([] if sending else ["lost"])
