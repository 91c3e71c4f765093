"""Setup, teardown, loops, and the stimuli beyond lines and sines."""

from __future__ import annotations

import math
from typing import Any

import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.scenario.program import SendFrame
from hev_can_emu.scenario.verdict import Outcome

pytestmark = pytest.mark.kernels

PASS, FAIL, OPEN, ERROR = Outcome.PASS, Outcome.FAIL, Outcome.INCONCLUSIVE, Outcome.ERROR


def at(bench: Any, name: str) -> dict[int, float]:
    return {ms: value for ms, sent, value in bench.sent if sent == name}


def test_the_steps_times_count_from_the_end_of_the_setup(bench: Any) -> None:
    player = bench.play(
        """
        duration: 1 s
        setup:
        - {name: ready, when: ClutchState == Open, timeout: 5 s, set: {EM2TorqueRequest: 5}}
        - {after: 100 ms}
        steps:
        - {name: go, at: 200 ms, set: {EM2TorqueRequest: 7}}
        teardown:
        - {after: 50 ms, set: {EM2TorqueRequest: 0}}
        - {after: 50 ms}
        expectations:
        - {equals: {value: VehicleSpeed, to: 17}, at: 300 ms}
        - {always: t >= 0 s}
        """,
        {"ClutchState": lambda t: 1 if t < 1.2995 else 0, "VehicleSpeed": lambda t: 10 * t},
    )
    assert bench.sent == [
        (1300, "EM2TorqueRequest", 5.0),
        (1600, "EM2TorqueRequest", 7.0),
        (2450, "EM2TorqueRequest", 0.0),
    ]
    assert bench.ticks == 2501
    verdicts = player.verdicts()
    assert [v.kind for v in verdicts] == [
        "setup", "setup", "step", "teardown", "teardown", "expectation", "expectation",
    ]  # fmt: skip
    assert player.outcome is PASS
    assert verdicts[5].instant_ns == 1_700_000_000
    assert verdicts[6].window_ns == (1_400_000_000, 2_400_000_000)
    assert player.origin_ns == 1_400_000_000


def test_a_setup_that_fails_is_an_error_and_the_teardown_still_comes(bench: Any) -> None:
    player = bench.play(
        """
        duration: 1 s
        setup: [{when: ClutchState == Locked, timeout: 300 ms}]
        steps: [{at: 0 s, set: {EM2TorqueRequest: 7}}]
        teardown: [{after: 0 s, set: {EM2TorqueRequest: -1}}]
        expectations: [{always: t >= 0 s}]
        """,
        {"ClutchState": 0},
    )
    assert bench.sent == [(300, "EM2TorqueRequest", -1.0)]
    assert [v.outcome for v in player.verdicts()] == [ERROR, OPEN, PASS, OPEN]
    assert player.verdicts()[1].observed == "not reached: the setup failed at 0.300 s"
    assert player.outcome.exit_code == 2


def test_a_teardown_comes_after_a_stop_and_goes_on_where_it_fails(bench: Any) -> None:
    player = bench.play(
        """
        duration: 5 s
        steps: [{when: ClutchState == Locked, timeout: 1 s}]
        teardown:
        - {when: ClutchState == Locked, timeout: 200 ms, set: {EM2TorqueRequest: 1}}
        - {after: 0 s, set: {AcceleratorPedal: 3}}
        """,
        {"ClutchState": 0},
    )
    assert bench.sent == [(1200, "EM2TorqueRequest", 1.0), (1200, "AcceleratorPedal", 3.0)]
    assert [v.outcome for v in player.verdicts()] == [FAIL, ERROR, PASS]


def test_a_loop_over_values_and_one_by_number(bench: Any) -> None:
    player = bench.play(
        """
        duration: 2 s
        steps:
        - repeat:
            for: {torque: [10 Nm, 20 Nm], pause: [100 ms, 200 ms]}
            steps:
            - {name: pull, after: pause, set: {EM2TorqueRequest: torque}}
            - repeat:
                times: 2
                steps: [{name: blip, after: 10 ms, set: {AcceleratorPedal: 1}}]
        - {after: 500 ms, set: {EM2TorqueRequest: 0}}
        expectations:
        - {always: t > 0.3 s, from: "step pull [2]", for: 100 ms}
        - {always: t > 0.3 s, from: "step blip [2.1]", for: 100 ms}
        """
    )
    assert at(bench, "EM2TorqueRequest") == {100: 10.0, 320: 20.0, 840: 0.0}
    names = [v.name for v in player.verdicts() if v.kind == "step"]
    assert names == [
        "pull [1]", "blip [1.1]", "blip [1.2]", "pull [2]", "blip [2.1]", "blip [2.2]", "step 7",
    ]  # fmt: skip
    assert player.outcome is PASS


def test_what_a_name_stands_for_counts_in_loops_inside_and_around_its_own(bench: Any) -> None:
    bench.play(
        """
        duration: 3 s
        steps:
        - repeat:
            times: 2
            steps:
            - repeat:
                for: {torque: [10 Nm, 20 Nm], pause: [100 ms, 200 ms]}
                steps:
                - repeat:
                    times: 2
                    steps:
                    - {after: pause, set: {EM2TorqueRequest: torque}}
                    - {when: t > pause, timeout: 1 s, set: {EM2TorqueRequest: 0}}
            - {after: 300 ms, set: {EM2TorqueRequest: 5}}
        """
    )
    sent = at(bench, "EM2TorqueRequest").items()
    assert {ms: torque for ms, torque in sent if torque} == {
        100: 10.0, 201: 10.0, 402: 20.0, 603: 20.0, 904: 5.0,
        1004: 10.0, 1105: 10.0, 1306: 20.0, 1507: 20.0, 1808: 5.0,
    }  # fmt: skip


@pytest.mark.parametrize(("sweep", "phase"), [("linear", 0), ("logarithmic", 1)])
def test_chirp_has_the_phase_of_its_sweep(bench: Any, sweep: str, phase: int) -> None:
    bench.play(
        f"""
        duration: 3 s
        steps:
        - at: 0.1 s
          chirp:
            EM2TorqueRequest:
              {{amplitude: 10, from: 1 Hz, to: 8 Hz, over: 2 s, offset: 5, sweep: {sweep}}}
        """
    )
    sent = at(bench, "EM2TorqueRequest")
    for ms in (250, 1000, 1900, 2099):
        t = (ms - 100) * 1e-3
        if phase == 0:
            turns = t + 7 * t * t / 4
        else:
            turns = 2 / math.log(8) * (8 ** (t / 2) - 1)
        assert sent[ms] == pytest.approx(5 + 10 * math.sin(2 * math.pi * turns), abs=1e-9)
    assert sent[2100] == 5.0
    assert max(sent) == 2100


def test_a_train_of_steps(bench: Any) -> None:
    bench.play(
        """
        duration: 3 s
        steps:
        - at: 0.1 s
          train: {EM2TorqueRequest: {values: [10 Nm, -10 Nm, 5 Nm], every: 100 ms, times: 2}}
        """
    )
    assert at(bench, "EM2TorqueRequest") == {
        100: 10.0, 200: -10.0, 300: 5.0, 400: 10.0, 500: -10.0, 600: 5.0,
    }  # fmt: skip


PROFILE = "time [ms],speed [m/s],torque\n0,0,0\n500,10,50\n\n1000,5,-50\n"


def test_a_profile_from_a_file(bench: Any) -> None:
    bench.profiles["p.csv"] = PROFILE
    bench.play(
        """
        duration: 3 s
        steps:
        - at: 0.1 s
          profile:
            EM2TorqueRequest: {file: p.csv, column: torque, between: hold}
            EM1SpeedRequest: {file: p.csv, column: torque}
        """
    )
    assert at(bench, "EM2TorqueRequest") == {600: 50.0, 1100: -50.0}
    speed = at(bench, "EM1SpeedRequest")
    assert (speed[100], speed[350], speed[600], speed[850]) == (0.0, 25.0, 50.0, 0.0)
    assert speed[1100] == -50.0
    assert max(speed) == 1100


def test_a_raw_frame(bench: Any) -> None:
    bench.play(
        """
        duration: 1 s
        steps:
        - at: 0.2 s
          send: [{id: 0x123, data: "01 a0"}, {id: 0x18DAF110, extended: true, data: ""}]
        """
    )
    assert bench.commands == [
        (200, SendFrame(0x123, b"\x01\xa0", extended=False, fd=False)),
        (200, SendFrame(0x18DAF110, b"", extended=True, fd=False)),
    ]


HEAD = "version: 1\nname: test\nduration: 10 s\nsteps:\n- at: 1 s\n  "


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "repeat: {times: 2, steps: [{at: 1 s}]}",
            "s.yaml:5: $.steps[0].at: expected nothing beside 'repeat', got 'at'; "
            "put it into a step of the loop",
        ),
        (
            "profile: {EM2TorqueRequest: {file: p.csv, column: torqe}}",
            "s.yaml:6: $.steps[0].profile.EM2TorqueRequest.column: expected a column of p.csv, "
            "got 'torqe'; did you mean 'torque'?",
        ),
        (
            "profile: {EM2TorqueRequest: {file: p.csv, column: speed}}",
            "s.yaml:6: $.steps[0].profile.EM2TorqueRequest.column: expected a column in Nm, "
            "got 'm/s' in p.csv",
        ),
        (
            "profile: {EM2TorqueRequest: {file: x.csv, column: torque}}",
            "s.yaml:6: $.steps[0].profile.EM2TorqueRequest.file: expected a file, got 'x.csv'",
        ),
        (
            "profile: {EM2TorqueRequest: {file: bad.csv, column: torque}}",
            "s.yaml:6: $.steps[0].profile.EM2TorqueRequest.column: expected a number, "
            "got 'x' in line 3 of bad.csv",
        ),
        (
            "profile: {EM2TorqueRequest: {file: back.csv, column: torque}}",
            "s.yaml:6: $.steps[0].profile.EM2TorqueRequest.time: expected times that rise, "
            "got 1 s in line 3 of back.csv",
        ),
        (
            "profile: {EM2TorqueRequest: {file: big.csv, column: torque}}",
            "s.yaml:6: $.steps[0].profile.EM2TorqueRequest.column: expected -400 to 400 Nm, "
            "got 900 Nm at 1 s, row 2 of big.csv; the range of HCU_EM2Request.EM2TorqueRequest",
        ),
        (
            "send: [{id: 0x123, data: xyz}]",
            "s.yaml:6: $.steps[0].send[0].data: expected hexadecimal bytes such as '01 a0', "
            "got 'xyz'",
        ),
        (
            "send: [{id: 0x1234}]",
            "s.yaml:6: $.steps[0].send[0].id: expected an identifier up to 0x7FF, got 0x1234; "
            "say extended: true for a 29-bit identifier",
        ),
        (
            'send: [{id: 1, data: "00 11 22 33 44 55 66 77 88"}]',
            "s.yaml:6: $.steps[0].send[0].data: expected at most 8 bytes, got 9; "
            "say fd: true for up to 64",
        ),
        (
            "chirp: {EM2TorqueRequest: {amplitude: 1, from: 1 Hz, to: 0 Hz, over: 1 s}}",
            "s.yaml:6: $.steps[0].chirp.EM2TorqueRequest.to: expected a frequency above 0 Hz, "
            "got '0 Hz'",
        ),
        (
            "train: {EM2TorqueRequest: {values: [1, 500], every: 1 s}}",
            "s.yaml:6: $.steps[0].train.EM2TorqueRequest.values[1]: expected -400 to 400 Nm, "
            "got 500 Nm; the range of HCU_EM2Request.EM2TorqueRequest",
        ),
        (
            "clear: [drop]",
            "s.yaml:6: $.steps[0].clear[0]: expected the name of a fault injected before, "
            "got 'drop'",
        ),
    ],
)
def test_one_line_says_what_is_wrong(text: str, message: str, bench: Any) -> None:
    bench.profiles |= {
        "p.csv": PROFILE,
        "bad.csv": "time,torque\n0,1\n1,x\n",
        "back.csv": "time,torque\n1,1\n1,2\n",
        "big.csv": "time,torque\n0,1\n1,900\n",
    }
    with pytest.raises(InputError) as caught:
        bench.load(HEAD + text + "\n")
    assert str(caught.value) == message


LOOP = "version: 1\nname: test\nduration: 10 s\nsteps:\n- repeat:\n    "


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "steps: [{after: 1 s}]",
            "s.yaml:5: $.steps[0].repeat: expected 'times' or 'for', got none",
        ),
        (
            "times: 2\n    steps: [{at: 1 s}]",
            "s.yaml:7: $.steps[0].repeat.steps[0].at: expected 'after' or 'when' in a loop, "
            "got 'at'; a loop's rounds have no times of their own",
        ),
        (
            "for: {a: [1, 2], b: [1]}\n    steps: [{after: 1 s}]",
            "s.yaml:6: $.steps[0].repeat.for.b: expected 2 values, as 'a' has, got 1",
        ),
        (
            "for: {a: [1, 2]}\n    steps: [{after: 1 s}]",
            "s.yaml:6: $.steps[0].repeat.for.a: expected a name in use, got 'a'; remove it",
        ),
        (
            "times: 20000\n    steps: [{after: 1 us}]",
            "s.yaml:6: $.steps[0].repeat.times: expected a whole number <= 10000, got 20000",
        ),
        (
            "times: 1100\n    steps:\n    - {repeat: {times: 20, steps: [{after: 0 s}]}}",
            "s.yaml:8: $.steps[0].repeat.steps[0].repeat.steps[0]: "
            "expected at most 20000 steps, loops unrolled, got more",
        ),
        (
            "times: 100\n    steps: [{after: 1 s}]",
            "s.yaml:7: $.steps[0].repeat.steps[0].after: expected a time up to the scenario's end, "
            "10 s, got 11 s; raise duration or move it",
        ),
    ],
)
def test_one_line_says_what_is_wrong_with_a_loop(text: str, message: str, bench: Any) -> None:
    with pytest.raises(InputError) as caught:
        bench.load(LOOP + text + "\n")
    assert str(caught.value) == message
