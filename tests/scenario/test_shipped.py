"""The scenarios that ship to teach do what they say, through the command."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hev_can_emu.cli import main
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.playing import Playing, RunResult
from hev_can_emu.runtime.scenario_runs import Run, read_runs
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.virtual import play_virtual

SCENARIOS = Path(__file__).parents[2] / "scenarios"


def play(run: Run, emulator: Emulator | None = None, start: bytes | None = None) -> RunResult:
    scenario = run.scenario
    if emulator is None:
        owners = dict.fromkeys(scenario.plays, "emulated")
        emulator = Emulator(Setup(model=scenario.model or "16dof", nodes=owners))
    playing = Playing(emulator, run.document, scenario, run.locate, start)
    return playing.result(play_virtual(playing, []))


def runs_of(name: str, **parameters: str) -> list[Run]:
    return read_runs(SCENARIOS / f"{name}.yaml", parameters)


def test_the_first_launch_passes_with_something_to_spare() -> None:
    (run,) = runs_of("first_launch")
    result = play(run)
    assert result.outcome.value == "pass"
    expectations = [v for v in result.verdicts if v.kind == "expectation"]
    assert len(expectations) == 8
    assert all(v.margin is not None and v.margin >= 0.0 for v in expectations)


def test_the_wrong_ratio_is_found_and_the_mended_controller_passes() -> None:
    (run,) = runs_of("wrong_ratio")
    failed = {v.name: v for v in play(run).verdicts if v.outcome.value == "fail"}
    assert set(failed) == {
        "EM1 is at G1's speed when G1 is asked for",
        "the synchronizer has little to do",
        "the driver does not feel the shift",
    }
    first = failed["EM1 is at G1's speed when G1 is asked for"]
    assert first.margin == pytest.approx(-236, abs=30)
    (mended,) = runs_of("wrong_ratio", ratio="1.843526")
    assert play(mended).outcome.value == "pass"


def test_the_matrix_gives_each_run_its_own_name_and_trace() -> None:
    runs = [run for run in runs_of("launch_matrix") if run.scenario.model == "4dof"]
    assert len(runs) == 6
    emulator = Emulator(Setup(model="4dof", nodes={"HCU": "emulated", "VEH": "emulated"}))
    start = emulator.snapshot()
    results = [play(run, emulator, start) for run in runs]
    assert {result.outcome.value for result in results} == {"pass"}
    assert len({result.name for result in results}) == 6
    assert len({result.trace_hash for result in results}) == 6
    assert [result.seed for result in results] == [1, 2] * 3
    assert results[0].parameters == {"launch_torque": "120 Nm"}
    (fault,) = results[0].faults
    assert (fault.name, fault.state) == ("bad luck", "ended")
    assert fault.hits > 10
    # An emulator used before gives what a fresh one gives.
    assert play(runs[3]).trace_hash == results[3].trace_hash


def test_the_matrix_runs_as_one_command(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["scenario", "run", "launch_matrix", "--model", "4dof", "--set", "launch_torque=1 Nm"]
    assert main(command) == 1
    out = capsys.readouterr().out
    names = re.findall(r"^Launches with frames lost \[(.*?)\]: FAIL", out, re.MULTILINE)
    assert names == ["seed=1", "seed=2"]
    assert main([*command, "--seed", "7"]) == 1
    assert "Launches with frames lost: FAIL" in capsys.readouterr().out
