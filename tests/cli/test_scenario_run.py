"""``scenario run``: verdicts by exit code, results in files, the same bytes every time."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import can
import pytest

from hev_can_emu.cli import main
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.scenario_runs import read_scenario
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.virtual import play_virtual

COMMAND = Path(sys.executable).parent / "hev-can-emu"
SHORT = """\
version: 1
name: a short pull
duration: 400 ms
steps:
- name: pull
  at: 100 ms
  set: {ContactorRequest: Closed, EM2ControlMode: Torque, EM2TorqueRequest: 100 Nm}
expectations:
- {name: pulls, becomes: EM2Torque > 90 Nm, from: step pull, within: 250 ms}
"""


def printed(*arguments: str | Path, code: int = 0) -> str:
    """Run the command as a process of its own and return what it printed."""
    done = subprocess.run(
        [COMMAND, "scenario", "run", *arguments],
        capture_output=True,
        text=True,
        timeout=400,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


def files(folder: Path, endings: Sequence[str]) -> list[bytes]:
    return [(folder / f"series_parallel{ending}").read_bytes() for ending in endings]


def frames_of(path: Path) -> list[tuple[int, int, bytes]]:
    with can.LogReader(path) as reader:
        return [(round(f.timestamp * 1e3), f.arbitration_id, bytes(f.data)) for f in reader]


def test_the_shipped_scenario_passes_and_repeats_to_the_byte(tmp_path: Path) -> None:
    runs = [printed("series_parallel", "--out", tmp_path / name) for name in ("a", "b")]
    traces = [line for run in runs for line in run.splitlines() if line.startswith("trace ")]
    assert len(traces) == 2
    assert traces[0] == traces[1]
    assert "PASS" in runs[0]
    # A BLF's blocks end where the writer was woken; its frames are the same.
    endings = (".log", ".json", ".png")
    assert files(tmp_path / "a", endings) == files(tmp_path / "b", endings)
    log = frames_of(tmp_path / "a" / "series_parallel.log")
    for name in ("a", "b"):
        assert frames_of(tmp_path / name / "series_parallel.blf") == log
    # 2120 frames/s with all nodes, for 26 s
    assert len(log) == pytest.approx(2120 * 27, rel=0.01)
    verdicts = json.loads((tmp_path / "a" / "series_parallel.json").read_text())
    assert verdicts["outcome"] == "pass"
    assert traces[0] == f"trace {verdicts['trace']}"


def test_the_reduced_model_passes_it_too_with_another_trace() -> None:
    assert "PASS" in (reduced := printed("series_parallel", "--model", "4dof"))
    full = printed("series_parallel")
    assert reduced.splitlines()[-1] != full.splitlines()[-1]


@pytest.fixture
def short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


def test_an_expectation_that_fails_gives_1(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenario", "run", str(short)]) == 0
    assert "a short pull: PASS" in capsys.readouterr().out
    short.write_text(SHORT.replace("> 90 Nm", "> 110 Nm"))
    assert main(["scenario", "run", str(short)]) == 1
    out = capsys.readouterr().out
    assert "a short pull: FAIL" in out
    assert "1 fail" in out


def test_a_window_that_stays_open_gives_3(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    waiting = "when: EM2Speed < 1 rpm\n  held: 100 ms\n  timeout: 300 ms"
    late = SHORT.replace("at: 100 ms", waiting).replace("250 ms", "350 ms")
    short.write_text(late.replace("> 90", "> 110"))
    assert main(["scenario", "run", str(short)]) == 3
    assert "INCONCLUSIVE" in capsys.readouterr().out


def test_the_worst_of_several_counts(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = short.with_name("bad.yaml")
    bad.write_text(SHORT.replace("> 90 Nm", "> 110 Nm"))
    assert main(["scenario", "run", str(bad), str(short), "--out", "results"]) == 1
    capsys.readouterr()
    made = {path.name for path in Path("results").iterdir()}
    endings = (".blf", ".log", ".json", ".png", ".html")
    assert made == {f"{n}{e}" for n in ("bad", "short") for e in endings} | {
        "junit.xml",
        "index.html",
    }
    index = Path("results/index.html").read_text()
    assert 'href="bad.html"' in index
    assert "FAIL: bad, short" in index


@pytest.mark.realtime
def test_in_wall_time_it_is_judged_alike_and_leaves_the_same_kinds_of_files(
    short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["scenario", "run", str(short), "--bus", "loopback", "--out", "results"]) == 0
    out, err = capsys.readouterr()
    assert "a short pull: PASS" in out
    assert "400 ticks" in err or "401 ticks" in err
    assert "\r" not in err  # no bar where there is no terminal
    assert len(list(Path("results").iterdir())) == 6
    told = json.loads(Path("results/short.json").read_text())
    assert told["clock"] == "wall (loopback)"
    assert "overruns" in told["timing"]["Ticks"]
    assert told["started"] > "2020"


def test_a_run_tells_what_it_was_and_what_happened(short: Path) -> None:
    silent = "- {name: silent, at: 300 ms, silence: [HCU_EM1Request]}\nexpectations:"
    short.write_text(SHORT.replace("expectations:", silent))
    document, scenario = read_scenario(short)
    playing = Playing(Emulator(Setup(model="4dof", nodes={"HCU": "emulated"})), document, scenario)
    trace = play_virtual(playing, [])
    result = playing.result(trace)
    assert (result.name, result.model, result.car_ns) == ("a short pull", "4dof", 400_000_000)
    assert result.outcome.value == "pass"
    assert result.trace_hash == trace
    assert [verdict.reads for verdict in result.verdicts] == [
        (),
        (),
        ("MCU2_Status.EM2Torque",),
    ]
    told = [(event.kind, event.text) for event in result.events]
    assert told[-1] == ("lost", "HCU_EM1Request: timed out, ramp to zero, U1101-87")


def test_the_report_tells_how_to_run_it_again(short: Path) -> None:
    options = ["--model", "4dof", "--node", "MCU1=silent"]
    assert main(["scenario", "run", str(short), *options, "--out", "results", "--no-plot"]) == 0
    told = json.loads(Path("results/short.json").read_text())
    assert told["command"] == f"hev-can-emu scenario run {short} --model 4dof --node MCU1=silent"
    assert told["command"] in Path("results/short.html").read_text()
    words = told["command"].split()[1:]
    assert main([*words, "--out", "again", "--no-plot"]) == 0
    assert json.loads(Path("again/short.json").read_text())["trace"] == told["trace"]


def test_a_slice_surrounds_each_failure(short: Path) -> None:
    short.write_text(SHORT.replace("> 90 Nm", "> 110 Nm"))
    wanted = ["--record", ".mf4", "--record", ".log", "--slice", "0.05"]
    assert main(["scenario", "run", str(short), "--out", "results", "--no-plot", *wanted]) == 1
    failed = json.loads(Path("results/short.json").read_text())
    assert failed["recordings"] == ["short.mf4", "short.log", "short.slice1.mf4"]
    with can.LogReader("results/short.slice1.mf4") as reader:
        part = [(f.timestamp, f.arbitration_id, bytes(f.data)) for f in reader]
    with can.LogReader("results/short.log") as reader:
        whole = [(f.timestamp, f.arbitration_id, bytes(f.data)) for f in reader]
    expected = [f for f in whole if f[0] >= 0.3 - 1e-9]  # decided at 350 ms; over at 400
    assert part == [(pytest.approx(t), i, data) for t, i, data in expected]
    assert main(["scenario", "run", str(short), "--slice", "1"]) == 2


def test_each_run_of_a_matrix_can_be_repeated_alone(short: Path) -> None:
    text = SHORT.replace("100 Nm", "torque").replace("> 90 Nm", "> 0.9 * torque")
    short.write_text(
        text + "parameters: {torque: 60 Nm}\nmatrix: {torque: [50 Nm, 100 Nm], model: [4dof]}\n"
    )
    assert main(["scenario", "run", str(short), "--out", "results", "--no-plot"]) == 0
    told = [json.loads(path.read_text()) for path in sorted(Path("results").glob("*.json"))]
    assert [run["parameters"]["torque"] for run in told] == ["100 Nm", "50 Nm"]
    index = Path("results/index.html").read_text()
    assert "<th>torque</th>" in index
    assert "2 runs" in index
    for run in told:
        words = shlex.split(run["command"])[1:]
        assert f"torque={run['parameters']['torque']}" in words
        assert main([*words, "--out", "again", "--no-plot"]) == 0
        again = [json.loads(path.read_text()) for path in Path("again").glob("*.json")]
        assert run["trace"] in [each["trace"] for each in again]
