"""Whatever cannot be used is told in one line: where, what was expected, what was found; exit code 2."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from hev_can_emu.cli import main

RUN = ("run", "--duration", "0.01", "--bus", "loopback")
PLAY = ("scenario", "run")

SCENARIO = """\
version: 1
name: a test
duration: 10 ms
steps:
- {at: 0 s, set: {EM2TorqueRequest: 10 Nm}}
"""


@pytest.fixture(scope="module", autouse=True)
def warm() -> None:
    """Compile first, should that be needed: it is told on stderr."""
    assert main(["warm", "--quiet"]) == 0


def complaint(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run the command and return the one line it wrote to stderr."""
    try:
        code = main(arguments)
    except SystemExit as end:  # argparse
        code = int(end.code or 0)
    out, err = capsys.readouterr()
    assert (code, out) == (2, ""), (code, out, err)
    lines = err.splitlines()
    assert len(lines) == 1, err
    assert lines[0].startswith("hev-can-emu")
    return lines[0]


@pytest.mark.parametrize(
    ("arguments", "pattern"),
    [
        ((), "required: COMMAND; see hev-can-emu --help"),
        (("fly",), "'fly'"),
        (("--verbose",), "required: COMMAND"),
        (("run", "--speed", "3"), "--speed"),
        (("run", "--duration"), "--duration"),
        (("run", "--duration", "-1"), "--duration: expected a time above 0 s, got '-1'"),
        (("run", "--duration", "nan"), "--duration: expected a time above 0 s, got 'nan'"),
        (("run", "--duration", "soon"), "--duration: expected .*, got 'soon'"),
        (
            ("run", "--duration", "5 km"),
            "--duration: expected a time such as 10 or '10 s', got '5 km'; see",
        ),
        ((*RUN, "--model", "5dof"), "--model: expected one of .*, got '5dof'; did you mean"),
        ((*RUN, "--reduction", "x"), "--reduction: expected one of .*, got 'x'"),
        ((*RUN, "--protection", "on"), "--protection: expected one of .*, got 'on'"),
        ((*RUN, "--start", "now"), "--start: expected one of ready, off, got 'now'"),
        ((*RUN, "--node", "MCU2"), "--node: expected NAME=OWNER, got 'MCU2'"),
        ((*RUN, "--node", "MCU2=mine"), "--node MCU2: expected one of .*, got 'mine'"),
        ((*RUN, "--node", "MCU3=silent"), "--node: expected one of .*, got 'MCU3'; did you mean"),
        ((*RUN, "--vehicle", "dai2042"), "--vehicle: .* got 'dai2042'; did you mean 'dai2024'"),
        ((*RUN, "--vehicle", "no/car.yaml"), "no/car.yaml: expected .*, got"),
        ((*RUN, "--dbc", "no.dbc"), "no.dbc: expected .*, got"),
        ((*RUN, "--dbc", "."), r"\.: expected .*, got"),
        ((*RUN, "--bindings", "no.yaml"), "no.yaml: expected .*, got"),
        ((*RUN, "--record", "run.mp4"), "--record run.mp4: expected a file ending of .*got '.mp4'"),
        ((*RUN, "--record", "no/run.log"), "--record no/run.log: expected an existing folder"),
        (("run", "--bus", "tincan:1"), "--bus tincan:1: expected INTERFACE.*unknown.*'tincan'"),
        (("run", "--bus", ""), "--bus"),
        (("run", "--bus", "socketcan"), "--bus socketcan: expected INTERFACE:CHANNEL"),
        (("run", "--bus", "socketcan:nosuch0"), "--bus socketcan:nosuch0: expected .*, got"),
        (("run", "--bus", "socketcand:127.0.0.1:x"), "expected a port from 0 .* to 65535, got 'x'"),
        (("run", "--bus", "socketcand:127.0.0.1:99999"), "expected a port .*, got '99999'"),
        (("run", "--bus", "socketcand:nosuch.invalid:0"), "--bus socketcand:nosuch.invalid:0"),
        (("run", "--bus", "socketcand-client:127.0.0.1:1"), "a socketcand server that answers"),
        (("run", "--bus", "pcan:PCAN_USBBUS1"), "--bus pcan:PCAN_USBBUS1: expected .*, got"),
        (("run", "--bus", "virtual:a?x"), r"expected \?OPTION=VALUE"),
        (("scenario",), "ACTION"),
        (PLAY, "FILE"),
        ((*PLAY, "no.yaml"), "no.yaml: expected .*, got"),
        ((*PLAY, "serie_parallel"), "did you mean 'series_parallel'"),
        (
            (*PLAY, "good.yaml", "--clock", "sun"),
            "--clock: expected one of virtual, wall, lockstep, got 'sun'",
        ),
        (
            (*PLAY, "good.yaml", "--clock", "virtual", "--bus", "loopback"),
            "--bus: expected no bus with --clock virtual, got 'loopback'",
        ),
        ((*PLAY, "good.yaml", "--out", "good.yaml"), "--out good.yaml: expected a folder"),
        ((*PLAY, "good.yaml", "--bus", "tincan"), "--bus tincan: expected INTERFACE"),
        ((*PLAY, "good.yaml", "no.yaml"), "no.yaml: expected .*, got"),
        ((*PLAY, "."), r"\.: expected .*, got"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_option_or_file(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: tuple[str, ...],
    pattern: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("good.yaml").write_text(SCENARIO)
    line = complaint(capsys, *arguments)
    assert re.search(pattern, line), line


@pytest.mark.parametrize(
    ("old", "new", "pattern"),
    [
        ("version: 1", "version: [1", r"bad\.yaml:\d+"),
        ("EM2TorqueRequest", "EM2TorqeRequest", r"bad\.yaml:5: .*did you mean 'EM2TorqueRequest'"),
        ("10 Nm", "10 rpm", r"bad\.yaml:5: .*rpm"),
        ("10 Nm", "1e9 Nm", r"bad\.yaml:5: .*1e\+?9|1000000000"),
        ("duration: 10 ms", "duration: 10 kg", r"bad\.yaml:3: .*kg"),
        ("duration: 10 ms", "duration: -1 s", r"bad\.yaml:3: .*-1 s"),
        ("name: a test", "nmae: a test", r"bad\.yaml:\d: .*nmae"),
        ("version: 1", "version: 9", r"bad\.yaml:1: .*9"),
        ("version: 1", "version: 1\nmodel: 5dof", "5dof"),
        ("version: 1", "version: 1\nvehicle: nosuch", "nosuch"),
        (SCENARIO, "", r"bad\.yaml"),
        (SCENARIO, "\x00\x01", r"bad\.yaml"),
        (SCENARIO, "- a\n- b\n", r"bad\.yaml"),
    ],
)
def test_scenario_file(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    old: str,
    new: str,
    pattern: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert old in SCENARIO
    Path("bad.yaml").write_text(SCENARIO.replace(old, new))
    line = complaint(capsys, *PLAY, "bad.yaml")
    assert re.search(pattern, line), line


@pytest.mark.parametrize(
    ("name", "old", "new", "option", "pattern"),
    [
        (
            "vehicles/dai2024.yaml",
            "tyre_radius: {value: 0.35",
            "tyre_radius: {value: -0.35",
            "--vehicle",
            r"tyre_radius.*expected .*-0\.35",
        ),
        ("vehicles/dai2024.yaml", "tyre_radius:", "tyre_radios:", "--vehicle", "tyre_radios"),
        ("vehicles/dai2024.yaml", "0.356033146, unit: m,", "1, unit: kg,", "--vehicle", "kg"),
        ("dbc/hev.dbc", "BO_ 176 ", "BO_ x176 ", "--dbc", r"copy\.dbc:61: expected DBC syntax"),
        ("dbc/hev.dbc", "SG_ EM2Speed :", "SG_ EM2Sped :", "--dbc", "EM2Speed"),
        (
            "dbc/hev.bindings.yaml",
            "em2_torque_request\n",
            "em2_torqe_request\n",
            "--bindings",
            "did you mean 'em2_torque_request'",
        ),
    ],
)
def test_vehicle_and_network_files(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    repository: Path,
    tmp_path: Path,
    name: str,
    old: str,
    new: str,
    option: str,
    pattern: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (repository / name).read_text()
    assert old in text
    copy = Path("copy").with_suffix(Path(name).suffix)
    copy.write_text(text.replace(old, new))
    line = complaint(capsys, *RUN, option, str(copy))
    assert re.search(pattern, line), line


def test_a_scenario_that_cannot_run_stops_before_the_first_plays(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("good.yaml").write_text(SCENARIO)
    Path("bad.yaml").write_text(SCENARIO.replace("10 Nm", "10 rpm"))
    complaint(capsys, *PLAY, "good.yaml", "bad.yaml", "--out", "results")
    assert list(Path("results").glob("*")) == []


def test_the_installed_command_tells_it_likewise(tmp_path: Path) -> None:
    done = subprocess.run(
        [Path(sys.executable).parent / "hev-can-emu", "run", "--bus", "socketcan:nosuch0"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=400,
        check=False,
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    line = done.stderr.splitlines()[-1]
    assert line.startswith("hev-can-emu: --bus socketcan:nosuch0: expected ")
