"""Expectations on synthetic signals: outcome, instant, observation, margin."""

from __future__ import annotations

import math
from typing import Any

import pytest

from hev_can_emu.scenario.verdict import Outcome, Verdict, worst

NAN = math.nan
PASS, FAIL, OPEN = Outcome.PASS, Outcome.FAIL, Outcome.INCONCLUSIVE


def judge(bench: Any, expectation: str, bus: Any, steps: str = "") -> Verdict:
    head = f"duration: 4 s\n{steps}\nexpectations:\n- {expectation}"
    player = bench.play(head, bus)
    verdict: Verdict = player.verdicts()[-1]
    return verdict


def parabola(t: float) -> float:
    return 30.0 - 5.0 * (t - 2.0) ** 2


def test_always_passes_with_its_smallest_margin(bench: Any) -> None:
    verdict = judge(
        bench, "{always: VehicleSpeed < 10 m/s, from: 1 s, to: 3 s}", {"VehicleSpeed": parabola}
    )
    assert verdict.outcome is PASS
    assert verdict.instant_ns == 3_000_000_000
    assert verdict.margin == pytest.approx(6.0)
    assert verdict.margin_unit == "km/h"
    assert verdict.expected == "always: VehicleSpeed < 10 m/s from 1 s to 3 s"
    assert verdict.observed == "nearest at 2.000 s: VehicleSpeed = 30 km/h"
    assert verdict.where == "s.yaml:6: $.expectations[0]"
    assert verdict.name == "expectation 1"
    assert verdict.window_ns == (1_000_000_000, 3_000_000_000)
    assert verdict.reads == ("ESC_Vehicle.VehicleSpeed",)


def test_always_fails_at_the_first_contradiction(bench: Any) -> None:
    verdict = judge(bench, "{name: slow, always: VehicleSpeed < 25}", {"VehicleSpeed": parabola})
    assert (verdict.name, verdict.outcome, verdict.instant_ns) == ("slow", FAIL, 1_000_000_000)
    assert verdict.observed == "VehicleSpeed = 25 km/h"
    assert verdict.margin == pytest.approx(0.0)


def test_always_looks_only_into_its_window_ends_included(bench: Any) -> None:
    bus = {"VehicleSpeed": lambda t: 1.0 if 0.9995 < t < 2.0005 else 0.0}
    inside = "{always: VehicleSpeed == 1, from: 1 s, to: 2 s}"
    assert judge(bench, inside, bus).outcome is PASS
    before = judge(bench, "{always: VehicleSpeed == 1, from: 999 ms, to: 2 s}", bus)
    after = judge(bench, "{always: VehicleSpeed == 1, from: 1 s, to: 2.001 s}", bus)
    assert (before.outcome, before.instant_ns) == (FAIL, 999_000_000)
    assert (after.outcome, after.instant_ns) == (FAIL, 2_001_000_000)


def test_always_fails_on_what_is_not_available(bench: Any) -> None:
    verdict = judge(bench, "{always: VehicleSpeed < 25}", {"VehicleSpeed": NAN})
    assert verdict.outcome is FAIL
    assert verdict.observed == "VehicleSpeed = not available"
    assert verdict.margin is None


def test_never(bench: Any) -> None:
    bus = {"VehicleSpeed": parabola}
    passed = judge(bench, "{never: VehicleSpeed > 32}", bus)
    failed = judge(bench, "{never: VehicleSpeed >= 25, to: 3 s}", bus)
    assert (passed.outcome, passed.margin) == (PASS, pytest.approx(2.0))
    assert (failed.outcome, failed.instant_ns) == (FAIL, 1_000_000_000)


def test_never_says_nothing_about_a_signal_that_never_came(bench: Any) -> None:
    verdict = judge(bench, "{never: VehicleSpeed > 32}", {})
    assert verdict.outcome is OPEN
    assert verdict.observed == "a signal was not available all the while"


def test_becomes(bench: Any) -> None:
    bus = {"VehicleSpeed": parabola, "ClutchState": lambda t: 2 if t > 1.4995 else 1}
    passed = judge(bench, "{becomes: ClutchState == Locked, from: 1 s, within: 2 s}", bus)
    assert (passed.outcome, passed.instant_ns) == (PASS, 1_500_000_000)
    assert passed.margin == pytest.approx(1.5)
    assert passed.margin_unit == "s"
    assert passed.observed == "ClutchState = Locked"
    failed = judge(bench, "{becomes: VehicleSpeed > 28, within: 1 s}", bus)
    assert (failed.outcome, failed.instant_ns) == (FAIL, 1_000_000_000)
    assert failed.margin == pytest.approx(-3.0)
    assert failed.margin_unit == "km/h"


@pytest.mark.parametrize(
    ("window", "outcome", "instant", "margin"),
    [
        # e^(-t) * 100 falls below 20 at t = 1.609 s
        ("within: 2 s", PASS, 2000, 0.39),
        ("within: 2 s, hold: 1 s", PASS, 3000, 0.39),
        ("within: 1.5 s, hold: 1 s", FAIL, 1500, 20 - 100 * math.exp(-1.5)),
    ],
)
def test_settles(bench: Any, window: str, outcome: Outcome, instant: int, margin: float) -> None:
    bus = {"EM1Speed": lambda t: 100 * math.exp(-t)}
    text = f"{{settles: {{value: EM1Speed, to: 0, band: 20 rpm}}, {window}}}"
    verdict = judge(bench, text, bus)
    assert (verdict.outcome, verdict.instant_ns) == (outcome, instant * 1_000_000)
    assert verdict.margin == pytest.approx(margin, abs=1e-6)


def test_settles_fails_where_it_leaves_the_band_again(bench: Any) -> None:
    bus = {"EM1Speed": lambda t: 0 if t < 2.5 else 30}
    text = "{settles: {value: EM1Speed, to: 0, band: 20}, within: 2 s, hold: 1 s}"
    verdict = judge(bench, text, bus)
    assert (verdict.outcome, verdict.instant_ns) == (FAIL, 2_500_000_000)
    assert verdict.margin == pytest.approx(-10)
    assert verdict.expected == "settles: EM1Speed = 0 ± 20 rpm within 2 s hold 1 s"


@pytest.mark.parametrize(
    ("value", "outcome", "margin"), [(1003.0, PASS, 2.0), (994.0, FAIL, -1.0), (NAN, FAIL, None)]
)
def test_equals(bench: Any, value: float, outcome: Outcome, margin: float | None) -> None:
    bus = {"EM1Speed": lambda t: value if 1.9995 < t < 2.0005 else 0.0}
    text = "{equals: {value: EM1Speed, to: 1000 rpm, tolerance: 5}, at: step go + 1 s}"
    verdict = judge(bench, text, bus, "steps: [{name: go, at: 1 s}]")
    assert (verdict.outcome, verdict.instant_ns) == (outcome, 2_000_000_000)
    assert verdict.margin == (None if margin is None else pytest.approx(margin))
    assert verdict.margin_unit == ("" if margin is None else "rpm")


def test_equals_takes_labels_and_temperature_differences(bench: Any) -> None:
    bus = {"ClutchState": 2, "MCU1_Status.Temperature": 25.0}
    assert judge(bench, "{equals: {value: ClutchState, to: Locked}, at: 1 s}", bus).outcome is PASS
    warm = "{equals: {value: MCU1_Status.Temperature, to: 300 K, tolerance: 2 K}, at: end}"
    assert judge(bench, warm, bus).margin == pytest.approx(0.15)


def modes(t: float) -> float:
    return [1, 1, 0, 2, 0, 1, 1, 1, 1][int(2 * t + 1e-6)]


@pytest.mark.parametrize(
    ("sequence", "outcome", "instant", "observed"),
    [
        (
            "of: [Series, ParallelG1, Series]",
            PASS,
            2500,
            "Series > Transition > ParallelG1 > Transition > Series",
        ),
        (
            "of: [ParallelG1, Series, Parallel G2]",
            FAIL,
            4000,
            "Series > Transition > ParallelG1 > Transition > Series",
        ),
        (
            "of: [Series, Transition, ParallelG1, Transition, Series], exactly: true",
            PASS,
            4000,
            "Series > Transition > ParallelG1 > Transition > Series",
        ),
        ("of: [Series, ParallelG1], exactly: true", FAIL, 1000, "Series > Transition"),
        ("of: [Series, Transition], exactly: true", FAIL, 1500, "Series > Transition > ParallelG1"),
    ],
)
def test_sequence(bench: Any, sequence: str, outcome: Outcome, instant: int, observed: str) -> None:
    text = f"{{sequence: {{value: DrivingMode, {sequence}}}}}"
    verdict = judge(bench, text, {"DrivingMode": modes})
    assert (verdict.outcome, verdict.instant_ns) == (outcome, instant * 1_000_000)
    assert verdict.observed == observed


def test_a_window_between_two_steps(bench: Any) -> None:
    steps = """steps:
- {name: a, when: VehicleSpeed > 10, timeout: 4 s}
- {name: b, when: VehicleSpeed > 20, timeout: 4 s}"""
    bus = {"VehicleSpeed": lambda t: 10 * t}
    verdict = judge(bench, "{always: VehicleSpeed < 21, from: step a, to: step b}", bus, steps)
    assert (verdict.outcome, verdict.instant_ns) == (PASS, 2_001_000_000)
    assert verdict.margin == pytest.approx(21 - 20.01)


def test_a_window_that_the_end_cuts_off_is_inconclusive(bench: Any) -> None:
    steps = "steps: [{name: a, when: VehicleSpeed > 35, timeout: 4 s}]"
    bus = {"VehicleSpeed": lambda t: 10 * t}
    for text in (
        "{always: VehicleSpeed > 3, from: step a, for: 2 s}",
        "{becomes: VehicleSpeed > 99, from: step a, within: 2 s}",
    ):
        verdict = judge(bench, text, bus, steps)
        assert verdict.outcome is OPEN
        assert verdict.observed == "the scenario ended at 4.000 s"
        assert verdict.instant_ns is None


def test_worst_wins_and_gives_the_exit_code() -> None:
    def of(*outcomes: Outcome) -> int:
        blank = Verdict("step", "", PASS, None, "", "", None, "", "")
        return worst(blank._replace(outcome=each) for each in outcomes).exit_code

    assert of() == 0
    assert of(PASS, PASS) == 0
    assert of(PASS, OPEN) == 3
    assert of(OPEN, FAIL, PASS) == 1
    assert of(FAIL, Outcome.ERROR, OPEN) == 2
