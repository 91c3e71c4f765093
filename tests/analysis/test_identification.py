"""Identification: its derivatives, and whether it finds again what is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hev_can_emu import config
from hev_can_emu.cli import main
from hev_can_emu.commands._vehicle import load_driveline
from hev_can_emu.plant.identification import determinacy, fit_start, table
from hev_can_emu.plant.linear import modes
from hev_can_emu.plant.problem import Problem, problem
from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.residuals import parameters_at, predict_modes
from hev_can_emu.plant.step_residuals import predict_step, run_step
from hev_can_emu.plant.step_response import Step, step_response
from hev_can_emu.plant.structure import CONFIGURATIONS, full_order
from hev_can_emu.plant.targets import TargetsFile
from hev_can_emu.resources import folder

TARGETS = folder("vehicles") / "targets"
# What the synthetic car's numbers were computed from.
TRUTH = {
    "inertias.Jlw": 1.2,
    "inertias.Jm2": 0.028,
    "inertias.Jc2": 0.006,
    "stiffness.kg2": 3.3e8,
    "stiffness.k1": 2.1e5,
    "stiffness.klh": 14500.0,
    "stiffness.krh": 17200.0,
    "stiffness.klw": 9100.0,
    "stiffness.km2": 2.6e8,
    "damping.clh": 2.4,
    "damping.clw": 13.0,
    "tyre_radius": 0.33,
}


def posed(name: str) -> Problem:
    return problem(config.load(TARGETS / f"{name}.yaml", TargetsFile), name)


def somewhere(one: Problem, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return one.middle + 0.3 * one.width * random.normal(size=len(one.sought))


def numerical(function, at: np.ndarray, step: float = 1e-5) -> np.ndarray:  # type: ignore[no-untyped-def]
    columns = []
    for index in range(len(at)):
        aside = np.zeros(len(at))
        aside[index] = step
        columns.append((function(at + aside) - function(at - aside)) / (2 * step))
    return np.array(columns).T


@pytest.mark.parametrize("name", ["dai2024", "synthetic"])
def test_analytic_derivatives_are_those_of_differences(name: str) -> None:
    one = posed(name)
    at = somewhere(one, 5)
    for index, prediction in enumerate(predict_modes(one, at, True)):
        assert prediction is not None

        def values(x: np.ndarray, index: int = index) -> np.ndarray:
            found = predict_modes(one, x, True)[index]
            assert found is not None
            return found.values

        scale = prediction.values[:, None]
        assert prediction.jacobian / scale == pytest.approx(numerical(values, at) / scale, abs=3e-7)


def test_predictions_are_those_of_the_linear_analysis() -> None:
    one = posed("dai2024")
    at = somewhere(one, 6)
    parameters = parameters_at(one, at)
    for observation, prediction in zip(one.observations, predict_modes(one, at, True), strict=True):
        structure = (
            full_order(parameters) if observation.model == "16dof" else reduced(parameters, "paper")
        )
        found = modes(structure, CONFIGURATIONS[observation.configuration])
        wanted = found.undamped_hz if observation.quantity == "undamped" else found.damped_hz
        assert prediction is not None
        assert prediction.values == pytest.approx(wanted[list(observation.orders)], rel=1e-9)


def test_modal_superposition_agrees_with_the_exact_propagator() -> None:
    one = posed("dai2024")
    at = somewhere(one, 7)
    smooth = predict_step(one, at).values
    run = run_step(one, at)
    assert smooth[0] == pytest.approx(run.velocity_16[-1], rel=1e-9)
    assert smooth[1] == pytest.approx(run.velocity_4[-1], rel=1e-9)
    gap = run.acceleration_16[508] - run.acceleration_4[508]
    assert abs(smooth[3]) == pytest.approx(
        100 * abs(gap / run.acceleration_16[508]), rel=1e-6, abs=1e-9
    )


def test_synthetic_cars_determined_combinations_come_back_within_one_percent() -> None:
    one = posed("synthetic")
    fit = fit_start(one, 1, 0)
    assert fit.matched
    found = dict(zip(one.sought, np.exp(fit.sought), strict=True))
    if found["stiffness.klh"] > found["stiffness.krh"]:
        # Wheels and tyres being equal, frequencies cannot tell left from right: take its mirror image.
        found["stiffness.klh"], found["stiffness.krh"] = (
            found["stiffness.krh"],
            found["stiffness.klh"],
        )
    truth = np.log([TRUTH[name] for name in one.sought])
    known = determinacy(one, truth)
    assert known.determined == 10
    deviations = known.combinations @ (np.log([found[name] for name in one.sought]) - truth)
    assert np.abs(deviations[: known.determined]).max() < 0.01
    # What the frequencies do not tell is told to be so: an idle mesh, and the tyre radius.
    shares = dict(zip(one.sought, known.shares, strict=True))
    assert shares["tyre_radius"] == pytest.approx(0.0, abs=1e-9)
    assert shares["stiffness.kg2"] < 0.01
    for name in one.sought:
        if shares[name] > 0.99:
            assert found[name] == pytest.approx(TRUTH[name], rel=0.01), name
    assert sum(share > 0.99 for share in shares.values()) == 10


def test_a_measured_step_response_determines_the_tyre_radius(tmp_path: Path) -> None:
    # Frequencies cannot tell the tyre radius; the car's speed after a torque step does.
    one = posed("synthetic")
    truth = parameters_at(one, np.log([TRUTH[name] for name in one.sought]))
    run = step_response(truth, CONFIGURATIONS["parallel_g1"], Step(1.0, 3.0, 100.0, 0.0, 50.0))
    samples = [
        f"    - {{quantity: vehicle_{what}, time: {time}, value: {values[round(time * 100)]:.5f},"
        f" unit: {unit}, tolerance: 0.0001}}"
        for what, unit, values in (
            ("speed", "m/s", run.velocity_16),
            ("acceleration", "m/s^2", run.acceleration_16),
        )
        for time in (1.1, 1.2, 3.0)
    ]
    step = [
        "step_response:",
        "  configuration: parallel_g1",
        "  step_time: {value: 1, unit: s}",
        "  read_out_time: {value: 3, unit: s}",
        "  engine_torque: {value: 100, unit: N m}",
        "  em2_torque: {value: 50, unit: N m}",
        "  samples:",
        *samples,
    ]
    path = tmp_path / "measured.yaml"
    text = (TARGETS / "synthetic.yaml").read_text(encoding="utf-8")
    path.write_text(text + "\n".join(step) + "\n", encoding="utf-8")
    two = problem(config.load(path, TargetsFile), "measured")
    fit = fit_start(two, 1, 0)
    assert fit.matched
    found = dict(zip(two.sought, np.exp(fit.sought), strict=True))
    assert found["tyre_radius"] == pytest.approx(TRUTH["tyre_radius"], rel=1e-3)
    assert determinacy(two, fit.sought).determined == 11
    assert sum(row.what.startswith("step response") for row in table(two, fit.sought)) == 6


def test_starts_do_not_depend_on_each_other_and_repeat() -> None:
    one = posed("synthetic")
    fits = [fit_start(one, 1, 2) for _ in range(2)]
    assert np.array_equal(fits[0].sought, fits[1].sought)
    assert not np.array_equal(fits[0].sought, fit_start(one, 2, 2).sought)


def test_a_start_on_the_papers_tables_meets_the_tables() -> None:
    # Without Figure 12: the frequencies and damping of Tables 2 and 3 alone, in seconds.
    one = posed("dai2024")._replace(step=None)
    fit = fit_start(one, 1, 0)
    assert fit.matched
    for row in table(one, fit.sought):
        assert f"{row.found:.2f}" == f"{row.measured:.2f}", row.what


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_command_writes_a_vehicle_that_meets_the_targets(
    jobs: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found.yaml"
    assert main(["identify", "synthetic", "--out", str(out), "--jobs", jobs]) == 0
    printed = capsys.readouterr().out
    assert "10 of 12 combinations" in printed
    assert "not unique" in printed
    parameters = load_driveline(str(out))
    found = modes(full_order(parameters), CONFIGURATIONS["parallel_g1"])
    wanted = posed("synthetic").observations[0]
    assert found.undamped_hz[:6] == pytest.approx(wanted.values, abs=wanted.tolerances[0])
    text = out.read_text()
    assert "not unique" in text
    assert "klh: {value" in text
    assert 'source: "identified"' in text
    assert 'Je: {value: 0.21, unit: "kg m^2", source: "given"}' in text


def test_command_says_so_when_nothing_matches(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[no-untyped-def]
    text = (TARGETS / "synthetic.yaml").read_text()
    target = tmp_path / "impossible.yaml"
    target.write_text(text.replace("undamped: [4.605,", "undamped: [12.0,"))
    assert main(["identify", str(target), "--starts", "1", "--jobs", "1"]) == 1
    printed = capsys.readouterr().out
    assert "MISSED" in printed
    assert "Not every measured number is met" in printed
