"""A bus full of nonsense: nothing breaks, the own frames are on time, the counters move."""

from __future__ import annotations

import numpy as np
import pytest
from can_bench import MS, Bench, build

from hev_can_emu.messages.frame import FRAME
from hev_can_emu.messages.protection import protect
from hev_can_emu.runtime import tick
from hev_can_emu.runtime.setup import Setup


def garbage(seed: int, ms: int, per_ms: int, ids: list[int]) -> np.ndarray:
    """Return random frames: known and unknown identifiers, all flags, all lengths."""
    generator = np.random.default_rng(seed)
    count = ms * per_ms
    frames = np.zeros(count, dtype=FRAME)
    frames["t_ns"] = np.sort(generator.integers(-5 * MS, ms * MS - MS, count))
    known = generator.choice(ids, count)
    wild = generator.integers(0, 1 << 32, count, dtype=np.uint64).astype(np.uint32)
    frames["id"] = np.where(generator.random(count) < 0.8, known, wild)
    frames["flags"] = np.where(generator.random(count) < 0.6, 0, generator.integers(0, 64, count))
    frames["length"] = np.where(generator.random(count) < 0.7, 8, generator.integers(0, 256, count))
    frames["channel"] = generator.integers(0, 4, count)
    frames["data"] = generator.integers(0, 256, (count, 64), dtype=np.uint8)
    frames["data"][generator.random(count) < 0.1] = 0xFF
    return frames


@pytest.mark.parametrize("protection", ["off", "observe", "enforce"])
@pytest.mark.parametrize("outside", [{}, dict.fromkeys(["EMS", "MCU2", "TCU", "BMS"], "external")])
def test_garbage_is_survived(protection: str, outside: dict[str, str]) -> None:
    setup = Setup(model="4dof", protection=protection, nodes=outside)
    emulator = build(setup)
    ids = [message.can_id for message in emulator.database.messages]
    frames = garbage(7, 3000, 10, ids)
    sent = emulator.advance(3000 * MS, frames, len(frames))
    for message in emulator.database.messages:
        times = sent["t_ns"][sent["id"] == message.can_id]
        if message.sender in ("HCU", *outside):
            assert len(times) == 0
        elif message.sender in ("VEH", "EMU"):
            assert (np.diff(times) == message.cycle_time_ns).all()
            assert len(times) == 3000 * MS // message.cycle_time_ns
    scalars = emulator.state.scalars
    assert scalars[tick.RECEIVED] == len(frames)
    assert scalars[tick.UNKNOWN] > 3000
    assert scalars[tick.CONFLICTS] > 3000
    if protection != "off":
        assert scalars[tick.REFUSED] > 2000
    assert np.isfinite(emulator.state.truth).all()
    assert np.isfinite(emulator.state.plant_x).all()
    assert abs(emulator.truth("vehicle_speed")) < 60.0


def test_a_tester_in_the_middle_of_garbage_is_obeyed() -> None:
    """CRCs keep the nonsense out: random frames on other identifiers cost nothing."""
    bench = Bench(Setup(model="4dof"))
    bench.ask(EM2TorqueRequest=80.0)
    good = bench.due(0, 1000)
    ids = [m.can_id for m in bench.database.messages if m.sender != "HCU"]
    noise = garbage(3, 1000, 20, ids)
    noise = noise[~np.isin(noise["id"], good["id"])]
    both = np.concatenate([good, noise])
    both = both[np.argsort(both["t_ns"], kind="stable")]
    sent = bench.emulator.advance(1000 * MS, both, len(both))
    assert len(sent) > 1400
    assert bench["EM2Torque"] == pytest.approx(80.0, abs=0.1)
    assert bench["RequestsFailed"] == 0


def test_random_requests_with_good_protection_never_break_the_car() -> None:
    """Every bit pattern, correctly signed: refused or limited, and the state stays finite."""
    bench = Bench(Setup(model="4dof"))
    generator = np.random.default_rng(11)

    def scramble(data: bytearray, count: int) -> bytearray:
        values = np.frombuffer(bytes(data), dtype=np.uint8).copy()
        values[2:] = generator.integers(0, 256, 6)
        values[1] = generator.integers(0, 16) << 4 | values[1] & 15
        return bytearray(values.tobytes())

    for name in bench.sending:
        message = bench.database.message(name)

        def signed(data: bytearray, count: int, index: int = message.index) -> bytearray:
            values = np.frombuffer(bytes(scramble(data, count)), dtype=np.uint8).copy()
            protect(bench.protection, index, values, 8, count)
            return bytearray(values.tobytes())

        bench.tamper[name] = signed
    for _ in range(20):
        bench.run(500)
        assert np.isfinite(bench.emulator.state.truth).all()
    assert bench["RejectedFrames"] == 0  # protection found nothing wrong with them
    assert set(bench.labels("EM2RequestStatus")) >= {"OK"}
