"""A test sets signals, lets time pass, waits, reads, breaks and goes back."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path

import can
import numpy as np
import pytest
from controllers import Follow, HoldSpeed, Silent

from hev_can_emu.errors import InputError, NotMet, StateError
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.testbench import SyncTestbench, Testbench

PULL = {"ContactorRequest": "Closed", "EM2ControlMode": "Torque", "EM2TorqueRequest": "100 Nm"}


@pytest.fixture(scope="module")
def opened() -> SyncTestbench:
    with SyncTestbench(model="4dof") as bench:
        bench.advance(0)
    return bench


def test_a_pull(tmp_path: Path) -> None:
    log = tmp_path / "pull.log"
    with SyncTestbench(model="4dof", record=[log]) as bench:
        assert bench.now_s == 0.0
        assert math.isnan(bench["VehicleSpeed"])
        bench.set(PULL)
        waited = bench.until("VehicleSpeed > 5 km/h", within="5 s")
        assert waited == pytest.approx(bench.now_s)
        assert 5.0 < bench["VehicleSpeed"] < 5.2
        assert bench["truth.vehicle_speed"] * 3.6 == pytest.approx(bench["VehicleSpeed"], abs=0.1)
        assert bench.say("ContactorState") == "Closed"
        assert bench.holds("Gear == Neutral and EM2Torque > 99 Nm")
        assert bench.value("EM2Torque / 2") == pytest.approx(50.0, abs=0.1)
        bench.set(EM2TorqueRequest="0 Nm")
        before = bench.now_s
        bench.advance("150 ms")
        bench.advance(0.05)
        assert bench.now_s == pytest.approx(before + 0.2)
        assert abs(bench["EM2Torque"]) < 1.0
        t, speed = bench.series("VehicleSpeed")
        assert len(t) == pytest.approx(bench.now_s * 100, abs=2)
        assert speed.max() > 5.0
        assert [event.text for event in bench.events if event.kind == "release"]
    with can.LogReader(log) as reader:
        assert sum(message.arbitration_id == 400 for message in reader) == len(t)


def test_what_does_not_come_is_told_with_what_was_seen() -> None:
    with SyncTestbench(model="4dof") as bench:
        bench.set(PULL)
        with pytest.raises(NotMet) as told:
            bench.until("VehicleSpeed > 90 km/h", within="300 ms")
        assert isinstance(told.value, AssertionError)
        text = str(told.value)
        assert text.startswith("VehicleSpeed > 90 km/h within 300 ms: VehicleSpeed = ")
        assert text.endswith(" at 0.300 s")


def test_going_back_gives_the_same_bytes_again() -> None:
    with SyncTestbench(model="4dof") as bench:
        bench.set(PULL)
        bench.advance("300 ms")
        here = bench.snapshot()
        trace, speed = bench.trace, bench["truth.vehicle_speed"]
        bench.advance("200 ms")
        there = bench.trace
        bench.restore(here)
        assert (bench.trace, bench["truth.vehicle_speed"]) == (trace, speed)
        assert bench.series("EM2Torque")[0][-1] < 0.3
        bench.advance("200 ms")
        assert bench.trace == there
        bench.restore(here)
        bench.set(EM2TorqueRequest=10)
        bench.advance("200 ms")
        assert bench.trace != there


def test_a_fault_acts_and_is_cleared() -> None:
    with SyncTestbench(model="4dof") as bench:
        bench.set(PULL)
        bench.until("EM2Torque > 99 Nm")
        name = bench.inject({"fault": "crc_wrong", "message": "HCU_EM2Request"})
        bench.until("EM2RequestStatus == CRCWrong", within="100 ms")
        bench.until("abs(EM2Torque) < 1 Nm", within="250 ms")
        bench.clear(name)
        bench.until("EM2RequestStatus == OK and EM2Torque > 99 Nm", within="500 ms")
        assert [fault.state for fault in bench.faults] == ["ended"]
        assert "lost" in [event.kind for event in bench.events]


def test_silence_and_raw_frames() -> None:
    with SyncTestbench(model="4dof") as bench:
        bench.advance("100 ms")
        bench.silence("HCU_EM2Request")
        assert bench.until("event('lost')", within="100 ms") > 0.0
        bench.resume("HCU_EM2Request")
        bench.until("EM2RequestStatus == OK", within="200 ms")
        bench.send(0x123, b"\x01")
        bench.send(0x1ABCDEF, b"\x02", extended=True)
        bench.advance("1 ms")
        assert bench.emulator.state.scalars[2] >= 2  # unknown frames


@pytest.mark.parametrize(
    ("signals", "complaint"),
    [
        ({"EM2TorqueReqest": 1}, "did you mean 'EM2TorqueRequest'"),
        ({"EM2TorqueRequest": "100 km/h"}, "EM2TorqueRequest is in Nm"),
        ({"EM2TorqueRequest": 9999}, "expected -800 to 800 Nm, got 9999 Nm"),
        ({"EM2ControlMode": "Torqe"}, "did you mean 'Torque'"),
        ({"VehicleSpeed": 10}, "expected a signal of a played node (HCU, VEH), got one of ESC"),
    ],
)
def test_misuse_is_told(
    opened: SyncTestbench, signals: dict[str, float | str], complaint: str
) -> None:
    with pytest.raises(InputError) as told:
        opened.set(signals)
    assert complaint in str(told.value)
    assert next(iter(signals)) in str(told.value)


def test_more_misuse(opened: SyncTestbench) -> None:
    with pytest.raises(StateError, match="not open"):
        opened.advance(1)
    with pytest.raises(InputError, match="expected a condition"):
        opened.holds("VehicleSpeed")
    with pytest.raises(InputError, match=r"bench\.fault|fault"):
        opened.inject({"fault": "crc_wrongg", "message": "HCU_EM2Request"})
    with pytest.raises(ValueError, match="expected a setup or its fields, got both"):
        SyncTestbench(Setup(), model="4dof")
    with pytest.raises(ValueError, match="expected a controller with a method step or exchange"):
        SyncTestbench(controller=object())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="1 ms or more"):
        SyncTestbench(model="4dof", controller=Follow(), period="10 us")
    with pytest.raises(InputError, match="--model"):
        SyncTestbench(model="5dof")
    with SyncTestbench(model="4dof", controller=Follow()) as bench:
        state = bench.snapshot()
        with pytest.raises(StateError, match="needs snapshot and restore"):
            bench.restore(state)


def test_a_controller_of_signals_is_stepped_with_the_car() -> None:
    with SyncTestbench(model="4dof", controller=Follow()) as bench:
        assert bench.until("VehicleSpeed > 25 km/h", within="20 s") > 2.0
        bench.advance("10 s")
        assert 28.0 < bench["VehicleSpeed"] < 30.5


def test_a_controller_of_frames_hears_what_the_car_sends() -> None:
    controller = HoldSpeed()
    with SyncTestbench(model="4dof", controller=controller) as bench:
        bench.advance("1 s")
        assert controller.steps == 100
        assert bench.say("EM2RequestStatus") == "OK"
        assert controller.speed == pytest.approx(bench["VehicleSpeed"], abs=0.5)
        here = bench.snapshot()
        bench.advance("500 ms")
        there = bench.trace
        bench.restore(here)
        assert controller.steps == 100
        bench.advance("500 ms")
        assert bench.trace == there
        t, torque = bench.series("EM2TorqueRequest")
        assert np.all(np.diff(t) == pytest.approx(0.01))
        assert torque[0] == 120.0


def test_a_silent_controller_is_a_lost_one() -> None:
    with SyncTestbench(model="4dof", controller=Silent()) as bench:
        bench.until("EM2RequestStatus == NeverReceived", within="1 s")


def test_the_asynchronous_bench_does_the_same() -> None:
    def by_steps() -> str:
        with SyncTestbench(model="4dof", controller=HoldSpeed()) as bench:
            bench.inject({"fault": "drop", "message": "HCU_EM2Request", "chance": 0.3})
            bench.until("VehicleSpeed > 3 km/h")
            bench.advance("100 ms")
            return bench.trace

    async def by_awaiting() -> str:
        async with Testbench(model="4dof", controller=HoldSpeed()) as bench:
            bench.inject({"fault": "drop", "message": "HCU_EM2Request", "chance": 0.3})
            await bench.until("VehicleSpeed > 3 km/h")
            await bench.advance("100 ms")
            return bench.trace

    assert by_steps() == asyncio.run(by_awaiting())


def test_a_table_is_in_the_order_of_time_whatever_is_handed_in(tmp_path: Path) -> None:
    table = tmp_path / "frames.csv"
    with SyncTestbench(record=[table]) as bench:
        for _ in range(3):
            bench.send(0x7F0, b"\1")
            bench.advance("2 s")
    lines = table.read_text().splitlines()[1:]
    times = np.array([float(line.partition(",")[0]) for line in lines])
    assert (np.diff(times) > 0.0).all()
    assert times[-1] == 6.0
    assert len(times) == 6001
