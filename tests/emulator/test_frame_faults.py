"""Faults of frames and signals as everybody on the bus sees them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from can_bench import MS, Bench, build

from hev_can_emu.ecu.fault_table import SLOTS
from hev_can_emu.ecu.faults import parse
from hev_can_emu.errors import InputError, StateError
from hev_can_emu.messages import protection
from hev_can_emu.messages.frame import SENT
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

CAR = Setup(model="4dof")
MESSAGE = "MCU2_Status"
PERIOD = 10


class Client:
    """What a receiver with the database sees of one message."""

    def __init__(self, bench: Bench, message: str = MESSAGE) -> None:
        self.bench = bench
        self.definition = bench.database.message(message)
        self.state = np.array([protection.NEVER])

    def frames(self) -> np.ndarray:
        frames = self.bench.frames
        return frames[frames["id"] == self.definition.can_id]

    def counters(self) -> list[int]:
        return [int(data[1] & 15) for data in self.frames()["data"]]

    def codes(self) -> list[int]:
        return [
            int(
                protection.check(
                    self.bench.protection, self.definition.index, frame["data"], 8, self.state
                )
            )
            for frame in self.frames()
        ]

    def times(self) -> list[int]:
        return (self.frames()["t_ns"] // MS).tolist()


def running() -> tuple[Bench, Client]:
    """Return a car at work and a client that has seen some of its frames."""
    bench = Bench(CAR).ask_and_run(400, EM2TorqueRequest=30.0)
    client = Client(bench)
    assert client.codes()[1:] == [protection.OK] * 39
    return bench, client


def inject(bench: Bench, **fault: Any) -> str:
    return bench.emulator.inject(
        parse({"message": MESSAGE, **fault} if "signal" not in fault else fault)
    )


@pytest.mark.parametrize(
    ("kind", "counters"),
    [
        ("counter_wrong", [4, 3, 2, 1]),
        ("counter_frozen", [10, 10, 10, 10]),
        ("counter_offset", [12, 13, 14, 0]),
    ],
)
@pytest.mark.parametrize("resume", ["running", "stopped"])
def test_counters(kind: str, counters: list[int], resume: str) -> None:
    bench, client = running()
    inject(bench, fault=kind, frames=4, resume=resume)
    bench.run(7 * PERIOD)
    assert client.counters()[:4] == counters
    last = counters[-1] if resume == "stopped" else 13
    assert client.counters()[4:] == [(last + n) % 15 for n in (1, 2, 3)]
    codes = client.codes()
    assert protection.CRC_WRONG not in codes
    if resume == "stopped":
        assert codes[4:] == [protection.OK] * 3


def test_random_counters_come_from_the_faults_own_seed() -> None:
    seen = []
    for seed in (1, 1, 2):
        bench, client = running()
        inject(bench, fault="counter_random", seed=seed)
        bench.run(300)
        seen.append(client.counters())
    assert seen[0] == seen[1] != seen[2]
    assert set(seen[0]) <= set(range(15))
    assert len(set(seen[0])) > 8


@pytest.mark.parametrize("kind", ["crc_wrong", "crc_frozen", "crc_random", "crc_offset"])
def test_crcs(kind: str) -> None:
    bench, client = running()
    inject(bench, fault=kind, frames=5)
    bench.run(8 * PERIOD)
    codes = client.codes()
    wrong = codes[1:5] if kind == "crc_frozen" else codes[:5]  # the first is the one it stays at
    assert wrong == [protection.CRC_WRONG] * len(wrong)
    assert protection.CRC_WRONG not in codes[5:]
    assert client.counters() == [(10 + n) % 15 for n in range(8)]


@pytest.mark.parametrize(("resume", "after"), [("running", 13), ("stopped", 10)])
def test_dropped_frames_and_the_counter_after(resume: str, after: int) -> None:
    bench, client = running()
    inject(bench, fault="drop", frames=3, resume=resume)
    bench.run(5 * PERIOD)
    assert client.times() == [431, 441]
    assert client.counters() == [after, after + 1]


def test_chance() -> None:
    bench, client = running()
    inject(bench, fault="drop", chance=0.3)
    bench.run(3000)
    assert 180 < len(client.frames()) < 240  # of 300; four standard deviations
    assert bench.emulator.faults[-1].hits == 300 - len(client.frames())


def test_late_frames_keep_their_order() -> None:
    bench, client = running()
    inject(bench, fault="delay", delay="25 ms", frames=3)
    bench.run(100)
    assert client.times() == [426, 431, 436, 441, 446, 451, 461, 471, 481, 491]
    assert sorted(client.counters()) == [*range(5), *range(10, 15)]
    bench, client = running()
    inject(bench, fault="jitter", jitter="15 ms")
    bench.run(600)
    assert client.counters() == [(10 + n) % 15 for n in range(len(client.frames()))]
    late = np.array(client.times()) - (401 + 10 * np.arange(len(client.frames())))
    assert late.min() == 0
    assert late.max() == 15
    assert len(set(late.tolist())) > 10


def test_copies_and_order() -> None:
    bench, client = running()
    inject(bench, fault="duplicate", copies=2, frames=2)
    bench.run(3 * PERIOD)
    assert client.counters() == [10, 10, 10, 11, 11, 11, 12]
    bench.run(3 * PERIOD)
    inject(bench, fault="reorder", frames=2)
    bench.run(6 * PERIOD)
    assert client.counters() == [2, 1, 4, 3, 5, 6]


def test_a_wrong_length_is_on_the_bus_but_tells_nothing() -> None:
    bench, client = running()
    speed = bench["EM2Torque"]
    inject(bench, fault="wrong_length", length=6)
    bench.ask_and_run(100, EM2TorqueRequest=80.0)
    assert set(client.frames()["length"].tolist()) == {6}
    assert not client.frames()["data"][:, 6:].any()
    assert bench["EM2Torque"] == speed


@pytest.mark.parametrize("resume", ["running", "stopped"])
def test_a_silent_node(resume: str) -> None:
    bench, client = running()
    bench.emulator.inject(
        parse({"fault": "silent_node", "node": "MCU2", "duration": "200 ms", "resume": resume})
    )
    bench.run(200)
    assert not np.isin(bench.frames["id"], [0x158, 0x218, 0x238, 0x308]).any()
    assert (bench.frames["id"] == 0x150).sum() == 20
    bench.run(20)
    assert client.counters()[0] == (0 if resume == "running" else 10)


def test_a_babbling_node() -> None:
    bench, _ = running()
    bench.emulator.inject(parse({"fault": "babbling_node", "rate": 3000, "id": 5, "duration": 0.1}))
    bench.run(200)
    babble = bench.frames[bench.frames["id"] == 5]
    assert len(babble) == 300
    assert len({bytes(data[:8]) for data in babble["data"]}) == 300
    assert (babble["flags"] == SENT).all()
    assert bench.label("EM2RequestStatus") == "OK"


def test_signals() -> None:
    bench, client = running()
    first = bench["EM2Torque"]

    def after(**fault: Any) -> np.ndarray:
        start = bench.now_ms
        name = bench.emulator.inject(parse({"signal": "EM2Torque", **fault}))
        bench.run(400)
        bench.emulator.clear(name)
        values = bench.series("EM2Torque", start)[1]
        codes = client.codes()
        assert codes == [protection.OK] * len(codes)
        bench.run(50)
        client.codes()
        assert bench["EM2Torque"] == first
        return values

    np.testing.assert_allclose(after(fault="signal_stuck", value="-12 Nm"), -12.0)
    np.testing.assert_allclose(after(fault="signal_offset", offset="5 Nm"), first + 5.0)
    assert np.isnan(after(fault="signal_not_available")).all()
    drift = after(fault="signal_drift", rate="100 Nm/s")
    np.testing.assert_allclose(np.diff(drift), 1.0, atol=0.11)  # the signal's step is 0.1 Nm
    noise = after(fault="signal_noise", deviation=2.0) - first
    assert 1.3 < noise.std() < 2.8
    bench.emulator.inject(parse({"fault": "signal_stuck", "signal": "EM2Torque"}))
    bench.ask_and_run(300, EM2TorqueRequest=90.0)
    assert bench["EM2Torque"] == first
    assert bench.emulator.truth("em2_torque") == pytest.approx(90.0)


def test_labels_and_saturation() -> None:
    bench, _ = running()
    bench.emulator.inject(parse({"fault": "signal_stuck", "signal": "EM2State", "value": "Fault"}))
    bench.emulator.inject(parse({"fault": "signal_offset", "signal": "EM2Speed", "offset": 1e6}))
    bench.run(20)
    assert bench.label("EM2State") == "Fault"
    assert bench["EM2Speed"] == 24000.0


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        ("drop", "Timeout"),
        ("crc_wrong", "CRCWrong"),
        ("counter_frozen", "CounterWrong"),
        ("wrong_length", "LengthWrong"),
        ("silent_node", "Timeout"),
        ("signal_not_available", "SignalNotAvailable"),
    ],
)
@pytest.mark.parametrize("hcu", ["external", "emulated"])
def test_requests_on_their_way_to_a_unit(kind: str, status: str, hcu: str) -> None:
    """The controller may be on the bus or played: its frames can be hit alike."""
    if hcu == "external":
        bench = Bench(CAR).ask_and_run(400, EM2TorqueRequest=30.0)
    else:
        bench = Bench(Setup(model="4dof", nodes={"HCU": "emulated"}), sending={})
        for signal, value in (("EM2ControlMode", 1.0), ("EM2TorqueRequest", 30.0)):
            bench.emulator.set_value(bench.database.signal(signal).index, value)
        bench.emulator.set_value(bench.database.signal("ContactorRequest").index, 1.0)
        bench.run(400)
    assert bench["EM2Torque"] == pytest.approx(30.0, abs=0.1)
    fault: dict[str, Any] = {"fault": kind, "duration": 0.2}
    target = {
        "silent_node": {"node": "HCU"},
        "signal_not_available": {"signal": "EM2TorqueRequest"},
    }
    bench.emulator.inject(parse(fault | target.get(kind, {"message": "HCU_EM2Request"})))
    bench.run(200)
    assert bench.label("EM2RequestStatus") == status
    assert bench.label("EM1RequestStatus") == ("Timeout" if kind == "silent_node" else "OK")
    assert bench["EM2Torque"] == pytest.approx(0.0, abs=2.0)
    bench.run(100)
    assert bench.label("EM2RequestStatus") == "OK"


def test_the_record_of_faults_and_their_events() -> None:
    bench, _ = running()
    emulator = bench.emulator
    name = inject(bench, fault="drop", after="20 ms", duration="50 ms")
    other = inject(bench, fault="drop", frames=2, after=1.0)
    assert (name, other) == ("drop MCU2_Status", "drop MCU2_Status 2")
    assert [record.state for record in emulator.faults[-2:]] == ["waiting", "waiting"]
    bench.run(30)
    first, second = emulator.faults[-2:]
    assert (first.state, first.injected_ns, first.start_ns, first.until_ns) == (
        "active", 400 * MS, 420 * MS, 470 * MS,
    )  # fmt: skip
    assert (second.state, second.until_ns) == ("waiting", None)
    emulator.clear(name)
    emulator.clear(other)
    bench.run(30)
    first, second = emulator.faults[-2:]
    assert (first.state, first.until_ns, first.hits) == ("ended", 430 * MS, 1)
    assert (second.state, second.hits) == ("ended", 0)
    assert [(event.t_ns, event.text) for event in bench.events if event.kind == "fault"] == [
        (420 * MS, "drop MCU2_Status begins"),
        (430 * MS, "drop MCU2_Status ends, 1 hits"),
    ]


def test_more_faults_than_places_are_refused_and_old_ones_remembered() -> None:
    bench = Bench(CAR).run(10)
    before = len(bench.emulator.faults)
    for _ in range(4):
        names = [inject(bench, fault="drop", message="EMU_PlantState") for _ in range(60)]
        bench.run(2)
        for name in names:
            bench.emulator.clear(name)
        bench.run(2)
    assert len(bench.emulator.faults) == before + 240
    for _ in range(SLOTS):
        inject(bench, fault="drop", message="EMU_PlantState")
    with pytest.raises(StateError, match=f"all {SLOTS} places"):
        inject(bench, fault="drop")


def test_snapshots_and_cuts_of_time_with_faults() -> None:
    def start() -> Emulator:
        bench = Bench(CAR).run(300)
        inject(bench, fault="jitter", jitter="12 ms")
        inject(bench, fault="reorder", message="EMS_Status")
        bench.emulator.inject(
            parse({"fault": "signal_noise", "signal": "EM2Speed", "deviation": 5.0})
        )
        bench.emulator.inject(
            parse({"fault": "babbling_node", "after": "55 ms", "duration": "60 ms"})
        )
        return bench.emulator

    emulator = start()
    saved = emulator.snapshot()
    whole = emulator.advance(600 * MS).tobytes()
    state, faults = emulator.snapshot(), emulator.faults
    emulator.restore(saved)
    pieces = [emulator.advance(t * MS).tobytes() for t in (317, 318, 356, 402, 600)]
    assert b"".join(pieces) == whole
    assert emulator.snapshot() == state
    assert emulator.faults == faults
    assert len(faults) == 4


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        (
            {"fault": "drop", "message": "MCU2_Stat"},
            "fault.message: expected a message of the network, got 'MCU2_Stat'; "
            "did you mean 'MCU2_Status' or 'MCU1_Status'",
        ),
        (
            {"fault": "signal_offset", "signal": "EM2Sped", "offset": 1},
            "fault.signal: expected a signal of the database, got 'EM2Sped'; did you mean 'EM2Speed'",
        ),
        (
            {"fault": "signal_offset", "signal": "MCU2_Status_Counter", "offset": 1},
            "fault.signal: expected a signal that carries a value, got 'MCU2_Status_Counter'; "
            "counter and CRC have faults of their own",
        ),
        (
            {"fault": "signal_offset", "signal": "EM2Speed", "offset": "3 Nm"},
            "fault.offset: expected a number with a unit such as '1 rad/s', got '3 Nm'; the unit does not",
        ),
        (
            {"fault": "signal_stuck", "signal": "EM2State", "value": "Fautl"},
            "fault.value: expected a number with a unit, got 'Fautl'; did you mean 'Fault'?",
        ),
        (
            {"fault": "silent_node", "node": "MCU3"},
            "fault.node: expected one of HCU, EMS, MCU1, MCU2, TCU, BMS, ESC, VEH, EMU, got 'MCU3'",
        ),
        (
            {"fault": "wrong_length", "message": "MCU2_Status", "length": 8},
            "fault.length: expected 0 to 8 bytes, other than its own 8, got 8",
        ),
    ],
)
def test_what_a_network_does_not_have(fault: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError) as refused:
        build(CAR).inject(parse(fault))
    assert str(refused.value).startswith(complaint)
    assert "\n" not in str(refused.value)


def test_clearing_what_is_not_there() -> None:
    bench, _ = running()
    with pytest.raises(InputError, match="clear: expected the name of a live fault, got 'x'; none"):
        bench.emulator.clear("x")
    inject(bench, fault="drop", name="lost")
    with pytest.raises(InputError, match="got 'lots'; did you mean 'lost'"):
        bench.emulator.clear("lots")
    with pytest.raises(InputError, match="'lost', which is live; clear it first"):
        inject(bench, fault="drop", name="lost")
