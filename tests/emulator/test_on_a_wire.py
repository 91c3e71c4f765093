"""The car on a bus with bit times, in virtual time: late, lost and destroyed frames have their effects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hev_can_emu import config
from hev_can_emu.bus.wire_parts import Timing
from hev_can_emu.ecu.faults import parse
from hev_can_emu.errors import InputError
from hev_can_emu.messages.frame import SENT, make_frames
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.runtime.virtual import play_on_wire
from hev_can_emu.runtime.wired import VirtualWire
from hev_can_emu.scenario.schema import Scenario

MS = 1_000_000


class Drive:
    """A car whose controller is played here, on a wire, in virtual time."""

    def __init__(self, bitrate: int = 500_000) -> None:
        self.car = Emulator(Setup(model="4dof", nodes={"HCU": "emulated"}))
        self.wire = VirtualWire(self.car, Timing(bitrate))
        self.heard: list[np.ndarray] = []
        self._waiting = make_frames(0)
        index = self.car.database.signal_index
        self.car.set_value(index("HCU_HVRequest", "ContactorRequest"), 1)
        self.car.set_value(index("HCU_EM2Request", "EM2ControlMode"), 1)
        self.car.set_value(index("HCU_EM2Request", "EM2TorqueRequest"), 50.0)

    def go(self, duration_ms: int) -> None:
        for _ in range(duration_ms):
            sent = self.car.advance(self.car.now_ns + TICK_NS, self._waiting, len(self._waiting))
            self.wire.send(sent)
            self._waiting = self.wire.receive()
            self.heard.append(self._waiting.copy())

    def count(self, message: str, since: int = 0) -> int:
        can_id = self.car.database.message(message).can_id
        return sum(int(np.count_nonzero(each["id"] == can_id)) for each in self.heard[since:])


def test_all_is_carried_in_time_on_a_bus_that_is_fast_enough() -> None:
    drive = Drive()
    drive.go(1000)
    assert drive.car.signal("EM2Torque") == pytest.approx(50.0, abs=0.5)
    assert drive.car.signal("RequestsFailed") == 0
    frames = np.concatenate(drive.heard)
    assert np.all(frames["flags"] & SENT != 0)
    assert np.all(np.diff(frames["t_ns"]) > 0)
    assert drive.count("HCU_EM2Request") == 100
    # 2,100 frames a second of about 0.23 ms
    assert drive.wire.medium.wire.statistics.load(1000 * MS) == pytest.approx(0.48, abs=0.04)


def test_the_same_again_to_the_byte() -> None:
    def run() -> bytes:
        drive = Drive()
        drive.car.inject(parse({"fault": "bus_errors", "chance": 0.05}))
        drive.go(300)
        return np.concatenate(drive.heard).tobytes()

    assert run() == run()


def test_a_slow_bus_overwrites_what_has_no_turn_and_requests_are_lost() -> None:
    drive = Drive(125_000)
    drive.go(1000)
    statistics = drive.wire.medium.wire.statistics
    assert statistics.peak > 0.99
    assert statistics.overwritten > 500
    # Identifiers decide: the controller's, which are lowest, come through; the last ones never.
    assert drive.count("HCU_EM2Request") > 90
    assert drive.count("EMU_PlantState") == 0


def test_a_flood_takes_the_bus_from_everybody_until_it_is_cleared() -> None:
    drive = Drive()
    drive.go(300)
    name = drive.car.inject(parse({"fault": "bus_flood", "after": "10 ms"}))
    drive.go(200)
    assert drive.car.measured("em2_torque") == pytest.approx(50.0, abs=51.0)
    assert [e.kind for e in drive.car.take_events()].count("lost") >= 6
    assert drive.count("MCU2_Status", 350) == 0
    (told,) = drive.car.faults
    assert (told.name, told.state, told.start_ns) == (name, "active", 310 * MS)
    assert told.hits > 500
    drive.car.clear(name)
    drive.go(500)
    assert drive.car.signal("RequestsFailed") == 0
    assert drive.car.faults[0].state == "ended"


def test_a_unit_off_the_bus_is_silent_and_deaf_and_comes_back() -> None:
    drive = Drive()
    drive.go(300)
    name = drive.car.inject(parse({"fault": "bus_off", "node": "MCU2"}))
    drive.go(300)
    assert drive.count("MCU2_Status", 310) == 0
    assert drive.count("MCU1_Status", 310) > 20
    # It hears no requests either, and so lets go.
    assert abs(drive.car.truth("em2_torque")) < 1.0
    drive.car.clear(name)
    drive.go(300)
    assert drive.car.signal("EM2Torque") == pytest.approx(50.0, abs=0.5)


def test_destroyed_frames_are_sent_again_and_a_unit_may_go_off_for_it() -> None:
    drive = Drive()
    drive.go(100)
    drive.car.inject(parse({"fault": "bus_errors", "chance": 0.02}))
    drive.go(500)
    assert drive.car.signal("RequestsFailed") == 0
    assert 10 < drive.wire.medium.wire.statistics.errors < 100
    drive.car.clear("bus_errors")
    drive.car.inject(parse({"fault": "bus_errors", "node": "TCU", "frames": 40, "name": "cable"}))
    drive.go(200)
    # 32 errors put it off; back on, the other 8 do it no harm.
    assert drive.wire.medium.wire.statistics.lost > 0
    assert [f.state for f in drive.car.faults if f.name == "cable"] == ["ended"]


def test_what_cannot_be_injected_is_one_line() -> None:
    car = Emulator(Setup(model="4dof"))
    with pytest.raises(InputError, match=r"expected a bus with bit times, got bus_off"):
        car.inject(parse({"fault": "bus_off", "node": "MCU2"}))
    drive = Drive()
    with pytest.raises(InputError, match=r"fault\.node: expected one of .*got 'MCU3'"):
        drive.car.inject(parse({"fault": "bus_off", "node": "MCU3"}))
    drive.car.inject(parse({"fault": "bus_flood", "name": "x"}))
    with pytest.raises(InputError, match="a name that is not in use"):
        drive.car.inject(parse({"fault": "bus_flood", "name": "x"}))
    drive.car.clear("x")
    with pytest.raises(InputError, match="clear: expected the name of a live fault"):
        drive.car.clear("x")


def test_a_scenario_breaks_the_bus(tmp_path: Path) -> None:
    path = tmp_path / "flood.yaml"
    path.write_text(
        """
version: 1
name: the bus is flooded
duration: 1 s
steps:
- {name: flood, at: 300 ms, inject: [{fault: bus_flood, duration: 200 ms}]}
- {name: off, after: 400 ms, inject: [{fault: bus_off, node: MCU2, name: off}]}
expectations:
- {name: lost, becomes: RequestsFailed > 0, from: step flood, within: 600 ms}
"""
    )
    document = config.read(path)
    scenario = document.convert(Scenario)
    car = Emulator(Setup(model="4dof", nodes=dict.fromkeys(scenario.plays, "emulated")))
    playing = Playing(car, document, scenario)
    _, medium = play_on_wire(playing, [], Timing())
    assert [fault.hits > 500 for fault in car.faults] == [True, False]
    assert playing.player.outcome.name == "PASS"
    assert any("MCU2 is bus off" in event.text for event in playing.take_events())
    assert medium.wire.statistics.peak > 0.5


def test_a_scenario_plays_on_a_bus_with_bit_times_to_the_byte(repository: Path) -> None:
    def play(bitrate: int) -> tuple[str, list[str]]:
        document = config.read(repository / "scenarios" / "series_parallel.yaml")
        scenario = document.convert(Scenario)
        car = Emulator(Setup(model="4dof", nodes=dict.fromkeys(scenario.plays, "emulated")))
        playing = Playing(car, document, scenario)
        trace, _ = play_on_wire(playing, [], Timing(bitrate))
        return trace, [verdict.outcome.name for verdict in playing.player.verdicts()]

    trace, outcomes = play(500_000)
    assert set(outcomes) == {"PASS"}
    assert play(500_000)[0] == trace
    assert play(1_000_000)[0] != trace
    assert "FAIL" in play(125_000)[1]
