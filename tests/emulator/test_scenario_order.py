"""A scenario on the whole car: the order of what comes at equal times, raw frames, events, repeatability."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hev_can_emu import config
from hev_can_emu.messages.frame import SENT
from hev_can_emu.messages.named import NamedCodec
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.virtual import play_virtual
from hev_can_emu.scenario.schema import Scenario

MS = 1_000_000
COMMAND = Path(sys.executable).parent / "hev-can-emu"


def playing(text: str, **setup: str) -> Playing:
    document = config.parse("version: 1\nname: test\n" + text)
    emulator = Emulator(Setup(model="4dof", nodes={"HCU": "emulated", "VEH": "emulated"}, **setup))
    return Playing(emulator, document, document.convert(Scenario))


def frames_of(play: Playing, until_ns: int | None = None) -> np.ndarray:
    parts: list[np.ndarray] = []
    while not play.finished and (until_ns is None or play.emulator.now_ns < until_ns):
        frames, _ = play.run(until_ns or 1 << 60)
        parts.append(frames.copy())
    return np.concatenate(parts)


def test_at_equal_times_steps_come_first_then_stimuli_then_looks_then_the_tick() -> None:
    play = playing(
        """
duration: 40 ms
steps:
- {name: first, at: 20 ms, set: {EM2ControlMode: Torque, EM2TorqueRequest: 10 Nm}}
- {name: second, at: 20 ms, ramp: {EM2TorqueRequest: {from: 30 Nm, to: 40 Nm, over: 1 s}}}
- {name: third, when: since_step >= 0 s, timeout: 1 s}
expectations:
# The bus still shows what was sent before: the step's frame is not out yet.
- {equals: {value: EM2TorqueRequest, to: 0 Nm}, at: 20 ms}
- {equals: {value: EM2TorqueRequest, to: 30 Nm, tolerance: 0.2 Nm}, at: 30 ms}
"""
    )
    frames = frames_of(play)
    request = play.emulator.database.message("HCU_EM2Request")
    mine = frames[frames["id"] == request.can_id]
    codec = NamedCodec(play.emulator.database)
    sent = {
        int(record["t_ns"]) // MS: codec.decode_message(request.can_id, bytes(record["data"][:8]))
        for record in mine
    }
    before = [ms for ms in sent if ms < 20]
    after = [ms for ms in sent if ms >= 20]
    assert sent[before[-1]]["EM2TorqueRequest"] == 0.0
    # What both steps and the ramp made of it is in the first frame from then on.
    assert sent[after[0]]["EM2TorqueRequest"] == pytest.approx(30 + (after[0] - 20) * 0.01, abs=0.1)
    verdicts = play.player.verdicts()
    assert [v.outcome.value for v in verdicts] == ["pass"] * 5
    # A step with a condition is not tested in the tick of the step before it.
    assert [v.instant_ns for v in verdicts[:3]] == [20 * MS, 20 * MS, 21 * MS]


def test_a_silenced_message_may_be_sent_raw_and_is_obeyed() -> None:
    text = """
duration: 300 ms
steps:
- {at: 0 ms, set: {ContactorRequest: Closed}}
- {at: 100 ms, silence: [HCU_EM2Request]}
- repeat:
    times: 15
    steps: [{after: 10 ms, send: [{id: %d, data: "%s"}]}]
expectations:
- {name: pulls, becomes: EM2Torque > 40 Nm, within: 300 ms}
- {name: nothing lost, count: {of: event('lost'), max: 0}, to: 250 ms}
- {name: not told of a stranger, count: {of: event('conflict'), max: 0}}
- {name: comes in time, period: {message: HCU_EM2Request, of: 10 ms, jitter: 10 ms}, to: 250 ms}
"""
    probe = Emulator(Setup(model="4dof", nodes={"HCU": "emulated"}))
    request = probe.database.message("HCU_EM2Request")
    data = NamedCodec(probe.database).encode_message(
        request.name, {"EM2ControlMode": 1, "EM2TorqueRequest": 50.0, "EM2SpeedRequest": 0.0}
    )
    play = playing(text % (request.can_id, data.hex()), protection="off")
    frames = frames_of(play)
    verdicts = {v.name: v for v in play.player.verdicts() if v.kind == "expectation"}
    assert {name: v.outcome.value for name, v in verdicts.items()} == dict.fromkeys(
        verdicts, "pass"
    )
    raw = frames[(frames["id"] == request.can_id) & (frames["t_ns"] > 100 * MS)]
    assert [int(t) // MS for t in raw["t_ns"]] == list(range(110, 260, 10))
    assert all(record["flags"] & SENT for record in raw)
    assert np.all(np.diff(frames["t_ns"].astype(np.int64)) >= 0)


def test_a_raw_frame_of_a_message_that_is_sent_is_told_as_a_conflict() -> None:
    text = "duration: 50 ms\nsteps:\n- {at: 20 ms, send: [{id: %d, data: '00'}]}\nexpectations:\n"
    text += "- {count: {of: 'event(conflict, HCU_EM2Request)', min: 1, max: 1}}\n"
    probe = Emulator(Setup(model="4dof"))
    play = playing(text % probe.database.message("HCU_EM2Request").can_id)
    frames_of(play)
    assert play.player.outcome.value == "pass"


LONG = """
duration: 3 s
steps:
- {at: 0 s, set: {ContactorRequest: Closed, EM2ControlMode: Torque}}
- {at: 100 ms, sine: {EM2TorqueRequest: {amplitude: 50 Nm, frequency: 3 Hz, offset: 150 Nm}}}
- {when: VehicleSpeed > 5 km/h, timeout: 3 s, follow: {EM1SpeedRequest: EM2Speed * 2}}
expectations:
- {always: VehicleSpeed < 100 km/h, from: 200 ms}
- {jerk: {value: truth.acceleration, limit: 100 m/s^3}}
- {sequence: {value: ContactorState, of: [Closed]}}
"""


def test_how_a_run_is_cut_into_calls_changes_neither_frames_nor_verdicts() -> None:
    whole = playing(LONG)
    frames, verdicts = frames_of(whole), whole.player.verdicts()
    assert [v.outcome.value for v in verdicts] == ["pass"] * 6
    pieces = playing(LONG)
    parts = []
    step = 1
    while not pieces.finished:
        parts.append(pieces.advance(pieces.emulator.now_ns + step * MS).copy())
        step = step % 37 + 5
    assert np.concatenate(parts).tobytes() == frames.tobytes()
    assert pieces.player.verdicts() == verdicts


def test_where_the_expectations_look_changes_neither_frames_nor_verdicts() -> None:
    text = f"{LONG}- {{always: EM2Torque < 100 Nm, from: 100 ms}}\n"
    here, behind = playing(text), playing(text)
    frames, parts = frames_of(here), []
    play_virtual(behind, [lambda sent, _: parts.append(sent)])
    assert np.concatenate(parts).tobytes() == frames.tobytes()
    verdicts = behind.player.verdicts()
    assert verdicts == here.player.verdicts()
    assert [v.outcome.value for v in verdicts] == ["pass"] * 6 + ["fail"]


def test_the_hash_does_not_depend_on_the_processors_linear_algebra() -> None:
    own = playing(LONG)
    trace = play_virtual(own, [])
    again = playing(LONG)
    assert play_virtual(again, []) == trace
    traces = set()
    for core in ("Prescott", "Haswell"):
        done = subprocess.run(
            [COMMAND, "scenario", "run", "first_launch", "--model", "4dof"],
            env=dict(os.environ, OPENBLAS_CORETYPE=core),
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        )
        traces.add(done.stdout.splitlines()[-1])
    assert len(traces) == 1
