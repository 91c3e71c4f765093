"""A service whose process was held up: what was sent in time counts as received in time."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

import pytest

from hev_can_emu import config
from hev_can_emu.bus.loopback import LoopbackHub
from hev_can_emu.messages.frame import frame
from hev_can_emu.messages.named import NamedCodec
from hev_can_emu.runtime import service as module
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.scenario.schema import Scenario

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


FAILING = """\
version: 1
name: test
duration: 300 ms
expectations:
- {always: t < 50 ms}
- {always: t >= 0 s}
"""


@pytest.mark.parametrize(("stall", "outcomes"), [(20, ["fail", "pass"]), (150, None)])
def test_a_host_too_slow_makes_a_failure_inconclusive(
    stall: int, outcomes: list[str] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimpleNamespace(now=0)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic_ns=lambda: clock.now))
    document = config.parse(FAILING)
    playing = Playing(
        Emulator(Setup(nodes={"HCU": "emulated"})), document, document.convert(Scenario)
    )

    async def play() -> None:
        service = module.Service(playing.emulator, LoopbackHub().endpoint, playing=playing)
        async with service.bus:
            for length in [1] * 100 + [stall] + [1] * 300:
                clock.now += length * MS
                service._due()
                await asyncio.sleep(0)
        service.judge_clock()

    asyncio.run(play())
    verdicts = playing.player.verdicts()
    if outcomes is None:
        assert [v.outcome.value for v in verdicts] == ["inconclusive", "inconclusive", "pass"]
        assert verdicts[0].name == "the host keeps up"
        assert verdicts[0].expected == "no tick 100 ms late"
        assert verdicts[1].observed.endswith("; not told against: a tick 149 ms late")
        assert playing.player.outcome.exit_code == 3
    else:
        assert [v.outcome.value for v in verdicts] == outcomes
