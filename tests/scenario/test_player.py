"""What a player sends, and when."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hev_can_emu.scenario.program import SendMessage
from hev_can_emu.scenario.verdict import Outcome

NAN = math.nan


def at(bench: Any, name: str) -> dict[int, float]:
    return {ms: value for ms, sent, value in bench.sent if sent == name}


def test_set_by_time_and_after(bench: Any) -> None:
    bench.play(
        """
        duration: 2 s
        steps:
        - {at: 500 ms, set: {EM2TorqueRequest: 0.15 kNm, EM2ControlMode: Torque}}
        - {after: 0.25 s, set: {EM2TorqueRequest: -20}}
        - {after: 0 s, set: {AmbientTemperature: 300 K, EM2ControlMode: NotAvailable}}
        """
    )
    assert sorted(bench.sent) == [
        (500, "EM2ControlMode", 1.0),
        (500, "EM2TorqueRequest", 150.0),
        (750, "AmbientTemperature", 26.85),
        (750, "EM2ControlMode", pytest.approx(NAN, nan_ok=True)),
        (750, "EM2TorqueRequest", -20.0),
    ]
    assert bench.player.outcome is Outcome.PASS
    assert [v.instant_ns for v in bench.player.verdicts()] == [
        500_000_000,
        750_000_000,
        750_000_000,
    ]


def test_a_step_off_the_grid_comes_at_the_next_tick(bench: Any) -> None:
    bench.play("duration: 1 s\nsteps:\n- {at: 1.5 ms, set: {EM2TorqueRequest: 1}}")
    assert bench.sent == [(2, "EM2TorqueRequest", 1.0)]


def test_ramp_starts_at_the_present_value_and_ends_exactly(bench: Any) -> None:
    bench.play(
        """
        duration: 1 s
        steps:
        - {at: 0 s, set: {EM2TorqueRequest: 50}}
        - {at: 0.1 s, ramp: {EM2TorqueRequest: {to: 150 Nm, over: 200 ms}}}
        """
    )
    sent = at(bench, "EM2TorqueRequest")
    assert sent[101] == pytest.approx(50.5)
    assert sent[200] == pytest.approx(100.0)
    assert sent[300] == 150.0
    assert max(sent) == 300
    assert len(sent) == 1 + 200


def test_ramp_with_a_start_of_its_own_and_hold(bench: Any) -> None:
    bench.play(
        """
        duration: 1 s
        steps:
        - {at: 0.1 s, ramp: {EM2TorqueRequest: {from: -100, to: 100, over: 1 s}}}
        - {after: 0.25 s, hold: [EM2TorqueRequest]}
        """
    )
    sent = at(bench, "EM2TorqueRequest")
    assert sent[100] == -100.0
    assert max(sent) == 349
    assert sent[349] == pytest.approx(-100 + 200 * 0.249)


def test_sine(bench: Any) -> None:
    bench.play(
        """
        duration: 1 s
        steps:
        - at: 0.1 s
          sine: {EM2TorqueRequest: {amplitude: 10, frequency: 2 Hz, offset: 5, phase: 90 deg}}
        - {after: 500 ms, release: [EM2TorqueRequest]}
        """
    )
    sent = at(bench, "EM2TorqueRequest")
    for ms in (100, 137, 225, 350, 599):
        expected = 5 + 10 * math.cos(2 * math.pi * 2 * (ms - 100) * 1e-3)
        assert sent[ms] == pytest.approx(expected, abs=1e-9)
    assert sent[600] == 0.0
    assert max(sent) == 600


def test_follow_converts_to_the_signals_unit_and_keeps_the_last_value(bench: Any) -> None:
    bench.play(
        """
        duration: 1 s
        parameters: {rolling_radius: 0.3 m, ratio: 9}
        steps:
        - at: 0.1 s
          follow:
            EM1SpeedRequest: quantity(convert(WheelSpeedFL, 'm/s') / rolling_radius * ratio, 'rad/s')
        - {at: 0.5 s, set: {EM1SpeedRequest: 100}}
        """,
        {"WheelSpeedFL": lambda t: 36.0 * t if t < 0.3 else NAN},
    )
    sent = at(bench, "EM1SpeedRequest")
    assert min(sent) == 100
    assert sent[200] == pytest.approx(2.0 / 0.3 * 9 * 30 / math.pi)
    assert max(ms for ms in sent if ms < 500) == 299
    assert sent[500] == 100.0
    assert max(sent) == 500


def test_parameters_stand_for_values_and_times(bench: Any) -> None:
    bench.play(
        """
        duration: length
        parameters: {length: 1 s, torque: 0.1 kNm, pause: 300 ms, half: 50}
        steps:
        - {at: pause, set: {EM2TorqueRequest: torque, AcceleratorPedal: half}}
        """
    )
    assert bench.sent == [(300, "EM2TorqueRequest", 100.0), (300, "AcceleratorPedal", 50.0)]


def test_silence_and_resume(bench: Any) -> None:
    bench.play(
        """
        duration: 1 s
        steps:
        - {at: 0.2 s, silence: [HCU_EM2Request]}
        - {at: 0.3 s, resume: [HCU_EM2Request], silence: [HCU_EM1Request]}
        """
    )
    assert bench.commands == [
        (200, SendMessage("HCU_EM2Request", enabled=False)),
        (300, SendMessage("HCU_EM1Request", enabled=False)),
        (300, SendMessage("HCU_EM2Request", enabled=True)),
    ]


def test_when_waits_for_its_condition_and_tells_what_was_left(bench: Any) -> None:
    player = bench.play(
        """
        duration: 5 s
        steps:
        - at: 0.5 s
        - {name: fast, when: VehicleSpeed > 10 m/s, timeout: 3 s, set: {EM2TorqueRequest: 1}}
        """,
        {"VehicleSpeed": lambda t: 18 * t},
    )
    assert bench.sent == [(2001, "EM2TorqueRequest", 1.0)]
    verdict = player.verdicts()[1]
    assert verdict.outcome is Outcome.PASS
    assert verdict.name == "fast"
    assert verdict.margin == pytest.approx(3 - 1.501)
    assert verdict.margin_unit == "s"
    assert verdict.expected == "VehicleSpeed > 10 m/s within 3 s"
    assert verdict.observed == "VehicleSpeed = 36.018 km/h"


def test_when_must_be_held(bench: Any) -> None:
    bench.play(
        """
        duration: 1 s
        steps:
        - {when: ClutchState == Locked, held: 50 ms, timeout: 1 s, set: {EM2TorqueRequest: 1}}
        """,
        {"ClutchState": lambda t: 2 if 0.0995 < t < 0.1295 or t > 0.1995 else 1},
    )
    assert bench.sent == [(250, "EM2TorqueRequest", 1.0)]


def test_a_condition_is_first_tested_one_tick_after_the_step_before(bench: Any) -> None:
    bench.play(
        """
        duration: 1 s
        steps:
        - {at: 0.1 s, set: {EM2TorqueRequest: 1}}
        - {when: ClutchState == Open, timeout: 1 s, set: {EM2TorqueRequest: 2}}
        - {when: since_step >= 10 ms, timeout: 1 s, set: {EM2TorqueRequest: 3}}
        """,
        {"ClutchState": 0},
    )
    assert [ms for ms, _, _ in bench.sent] == [100, 101, 111]


def test_time_out_stops_and_fails(bench: Any) -> None:
    player = bench.play(
        """
        duration: 5 s
        steps:
        - {when: VehicleSpeed > 30 km/h, timeout: 1 s, set: {EM2TorqueRequest: 1}}
        - {name: later, after: 1 s}
        expectations:
        - {always: VehicleSpeed < 100 km/h}
        - {always: VehicleSpeed < 100 km/h, from: step later, for: 1 s}
        """,
        {"VehicleSpeed": 20.0},
    )
    assert bench.sent == []
    assert bench.ticks == 1001
    first, second, third, fourth = player.verdicts()
    assert (first.outcome, first.instant_ns) == (Outcome.FAIL, 1_000_000_000)
    assert first.observed == "VehicleSpeed = 20 km/h"
    assert second.outcome is third.outcome is fourth.outcome is Outcome.INCONCLUSIVE
    assert second.observed == "not reached: the scenario stopped at 1.000 s"
    assert third.observed == "the scenario stopped at 1.000 s"
    assert player.outcome is Outcome.FAIL
    assert player.outcome.exit_code == 1


def test_time_out_may_go_on(bench: Any) -> None:
    player = bench.play(
        """
        duration: 2 s
        steps:
        - {when: VehicleSpeed > 30, timeout: 1 s, on_timeout: continue, set: {EM2TorqueRequest: 1}}
        - {after: 0.5 s, set: {EM2TorqueRequest: 2}}
        """
    )
    assert bench.sent == [(1000, "EM2TorqueRequest", 1.0), (1500, "EM2TorqueRequest", 2.0)]
    outcomes = [verdict.outcome for verdict in player.verdicts()]
    assert outcomes == [Outcome.FAIL, Outcome.PASS]
    assert player.verdicts()[0].observed == "VehicleSpeed = not available"


def test_a_step_that_comes_too_late_fails(bench: Any) -> None:
    player = bench.play(
        """
        duration: 5 s
        steps:
        - {when: VehicleSpeed > 30, timeout: 4 s}
        - {at: 1 s, set: {EM2TorqueRequest: 2}}
        """,
        {"VehicleSpeed": lambda t: 20 * t},
    )
    verdict = player.verdicts()[1]
    assert bench.sent == [(1501, "EM2TorqueRequest", 2.0)]
    assert verdict.outcome is Outcome.FAIL
    assert verdict.observed == "the step before came too late"
    assert verdict.margin == pytest.approx(-0.501)


def test_a_step_still_waiting_at_the_end_fails_the_next_is_inconclusive(bench: Any) -> None:
    player = bench.play(
        "duration: 1 s\nsteps:\n- {when: VehicleSpeed > 30, timeout: 4 s}\n- {after: 0 s}"
    )
    first, second = player.verdicts()
    assert (first.outcome, second.outcome) == (Outcome.FAIL, Outcome.INCONCLUSIVE)
    assert first.observed == "not reached: the scenario ended at 1.000 s"


def test_finish_leaves_the_undecided_inconclusive(bench: Any) -> None:
    player = bench.play(
        """
        duration: 5 s
        steps:
        - at: 0.5 s
        - at: 4 s
        expectations:
        - {always: t >= 0 s}
        - {becomes: t > 0.2 s, within: 1 s}
        """,
        until=1.0,
    )
    player.finish(1_000_000_000, "the bus was lost")
    assert player.finished
    assert [v.outcome.value for v in player.verdicts()] == [
        "pass",
        "inconclusive",
        "inconclusive",
        "pass",
    ]
    assert player.verdicts()[2].observed == "the bus was lost at 1.000 s"
    assert player.outcome.exit_code == 3
    assert player.due(2_000_000_000, np.zeros(20)) == []


def test_a_status_line_can_tell_what_is_awaited(bench: Any) -> None:
    text = (
        "duration: 1 s\nsteps:\n- at: 0.1 s\n- {name: fast, when: VehicleSpeed > 9, timeout: 9 s}"
    )
    assert bench.load(text).awaited == "step 1"
    assert bench.play(text, until=0.5).awaited == "fast"
    assert bench.play(text, {"VehicleSpeed": 10.0}).awaited == ""


MIXED = """
duration: 20 s
steps:
- {name: one, at: 1 s, ramp: {EM2TorqueRequest: {to: 100, over: 0.5 s}}}
- {name: two, after: 5 s, set: {EM2TorqueRequest: 0}}
- {name: three, when: VehicleSpeed > 80, timeout: 5 s, silence: [HCU_EM2Request]}
- {name: four, at: 15.0005 s, resume: [HCU_EM2Request], set: {EM2TorqueRequest: 7}}
expectations:
- {always: VehicleSpeed < 100, from: step one, for: 300 ms}
- {becomes: VehicleSpeed > 30, from: 2 s, within: 3 s}
- {equals: {value: VehicleSpeed, to: 160, tolerance: 1}, at: 16 s}
- {equals: {value: VehicleSpeed, to: 170.5, tolerance: 1}, at: step four + 2 s}
- {settles: {value: VehicleSpeed, to: 180, band: 10}, from: step four, within: 2.5 s, hold: 1 s}
"""


@pytest.mark.parametrize(
    ("every", "behind"), [(7, False), (13, True), (100, False), (3000, True), (100_000, False)]
)
def test_how_often_and_where_the_expectations_look_changes_nothing(
    bench: Any, every: int, behind: bool
) -> None:
    bus = {"VehicleSpeed": lambda t: 10 * t}
    verdicts, sent = bench.play(MIXED, bus).verdicts(), bench.sent
    assert bench.play(MIXED, bus, look_every=every, behind=behind).verdicts() == verdicts
    assert bench.sent == sent
    assert [v.outcome.value for v in verdicts] == ["pass"] * 9


def test_two_runs_are_equal(bench: Any) -> None:
    bus = {"VehicleSpeed": lambda t: 10 * t}
    first = (bench.play(MIXED, bus).verdicts(), bench.sent)
    assert (bench.play(MIXED, bus).verdicts(), bench.sent) == first


def test_asking_for_verdicts_meanwhile_decides_nothing(bench: Any) -> None:
    text = """
        duration: 1 s
        expectations:
        - {name: stays, always: EM2Speed < 100 rpm, from: 10 ms}
        - {name: comes, becomes: EM2Speed > 50 rpm, within: 1 s}
        """
    asked: list[int] = []

    def speed(t_s: float) -> float:
        verdicts = bench.player.verdicts()
        asked.append(sum(v.outcome is Outcome.INCONCLUSIVE for v in verdicts))
        return 100.0 * t_s

    bench.play(text, {"EM2Speed": speed})
    assert asked[0] == 2
    assert [v.outcome for v in bench.player.verdicts()] == [Outcome.FAIL, Outcome.PASS]
