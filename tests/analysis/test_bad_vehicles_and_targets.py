"""Every way a vehicle or targets file can be wrong: one line, by path, exit code 2."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hev_can_emu.cli import main
from hev_can_emu.resources import folder

VEHICLE = (folder("vehicles") / "dai2024.yaml").read_text(encoding="utf-8")
TARGETS = (folder("vehicles") / "targets" / "synthetic.yaml").read_text(encoding="utf-8")
PAPER = (folder("vehicles") / "targets" / "dai2024.yaml").read_text(encoding="utf-8")
INERTIAS = (
    "Je, Jc1, Jc2, Jm1, Jid, J1, Jm2, J2, Jsleeve, Jg11, Jg12, Jfd1, Jg22, Jg21, Jfd2, Jlw, Jrw, Jv"
)
DRIVING = "series, parallel_g1, parallel_g2, electric_neutral, electric_g1, electric_g2"

# pattern, replacement, message after "car.yaml" (a line number may follow the name)
VEHICLES = [
    (
        r"Je: \{value: [^,]*",
        "Je: {value: -0.15",
        "$.driveline.inertias.Je: expected a value > 0, got -0.15",
    ),
    (
        r"k1: \{value: [^,]*",
        "k1: {value: 1.0e300",
        "$.driveline.stiffness.k1: expected 0.001 to 1e+13 in SI units, got 1e+300; is the unit right?",
    ),
    (
        r"Je: \{value: [^,]*",
        "Je: {value: 1.0e-300",
        "$.driveline.inertias.Je: expected 1e-09 to 1e+06 in SI units, got 1e-300; is the unit right?",
    ),
    (r"    k3: .*\n", "", "$.driveline.stiffness.k3: expected a value, got nothing"),
    (
        "g1: {value: 1.843526",
        "g1: {value: 1.95",
        "$.driveline.reduced_ratios.g1: expected 1.84353 = rg12/rg11 within 0.001 relative, got 1.95;"
        " correct the ratio or the base radii",
    ),
    (
        "    Je:",
        "    Jee: {value: 1, unit: kg m^2, source: guess}\n    Je:",
        f"$.driveline.inertias: expected one of {INERTIAS}, got 'Jee'; did you mean 'Je' or 'Jsleeve'?",
    ),
    (
        r"\ndriveline:",
        "\ndrivline: 3\ndriveline:",
        "$.drivline: expected a known key, got 'drivline'; did you mean 'driveline'?",
    ),
    (
        r"Je: \{value: ([^,]*), unit: kg m\^2, source: identified, note: \"Engine\"\}",
        "Je: {value: 0.15}",
        "$.driveline.inertias.Je: expected the key 'unit', got only 'value'",
    ),
    (
        "k1: {value: 264257.247, unit: N m/rad",
        "k1: {value: 264257.247, unit: N/m",
        "$.driveline.stiffness.k1.unit: expected a unit of N m/rad, got 'N/m'",
    ),
    (
        "k1: {value: 264257.247",
        "k1: {value: stiff",
        "$.driveline.stiffness.k1.value: expected a number or a list, got 'stiff'",
    ),
    (
        "c1: {value: 2.58723891",
        "c1: {value: -2.5",
        "$.driveline.damping.c1: expected a value >= 0, got -2.5",
    ),
]
TARGETS_FILES = [
    (
        r"Je: \{value: 0.21",
        "Je: {value: -0.21",
        "$.inertias.Je.value: expected a value > 0, got -0.21",
    ),
    (r"  k3: .*\n", "", "$.stiffness.k3: expected a value or a range, got nothing"),
    (
        "  Je:",
        "  Jee: {value: 1, unit: kg m^2}\n  Je:",
        f"$.inertias: expected one of {INERTIAS}, got 'Jee'; did you mean 'Je' or 'Jsleeve'?",
    ),
    (
        "name: synthetic",
        "name: synthetic\nfrequncies: []",
        "$.frequncies: expected a known key, got 'frequncies'; did you mean 'frequencies' or 'provenance'?",
    ),
    (
        r"Je: \{value: 0.21, unit: kg m\^2\}",
        "Je: {value: 0.21}",
        "$.inertias.Je: expected the key 'unit', got a value without unit; SI: kg m^2",
    ),
    (
        r"lower: 0.01, upper: 0.08",
        "lower: 0.1, upper: 0.08",
        "$.inertias.Jm2.upper: expected more than lower (0.1), got 0.08",
    ),
    (
        r"lower: 0.01, upper: 0.08",
        "lower: 0.01",
        "$.inertias.Jm2: expected the key 'upper', got nothing",
    ),
    (
        r"lower: 0.01, upper: 0.08",
        "value: 0.2, lower: 0.01, upper: 0.08",
        "$.inertias.Jm2.value: expected a value from 0.01 to 0.08, got 0.2",
    ),
    (
        "same_as: Jlw",
        "same_as: Jlx",
        "$.inertias.Jrw.same_as: expected a parameter of the same kind, got 'Jlx'; did you mean 'Jlw'?",
    ),
    (
        "same_as: Jlw",
        "same_as: Jlw, value: 1, unit: kg m^2",
        "$.inertias.Jrw.same_as: expected nothing beside it, got a value or a range as well",
    ),
    (
        "configuration: parallel_g1",
        "configuration: paralel_g1",
        f"$.frequencies[0].configuration: expected one of {DRIVING}, got 'paralel_g1';"
        " did you mean 'parallel_g1' or 'parallel_g2'?",
    ),
    (
        "tolerance: 0.001\n",
        "tolerance: -1\n",
        "$.frequencies[0].tolerance: expected a value > 0, got -1",
    ),
    (
        "    damping_ratio_tolerance: 0.00001\n",
        "",
        "$.frequencies[0].damping_ratio_tolerance: expected a value > 0, got nothing",
    ),
    (r"\[4.605", "[-4.605", "$.frequencies[0].undamped[0].value: expected a value > 0, got -4.605"),
    ("unit: Hz", "unit: kg", "$.frequencies[0].unit: expected a unit of Hz, got 'kg'"),
    (
        r"\[4.605",
        "[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 4.605",
        "$.frequencies[0].undamped: expected at most 15 modes of the 16dof model, got 16",
    ),
    (
        r"tyre_radius: .*\n",
        "tyre_radius: {lower: 0.25, upper: 0.4, unit: m}\nratio_rounding:\n"
        '  fd: {lower: 0.9, upper: 1.1, unit: "1"}\n',
        "$.ratio_rounding.fd.lower: expected 1 within 0.001, got 0.9",
    ),
]
STEPS = [
    (
        r"  acceleration_difference_time: .*\n",
        "",
        "$.step_response: expected the key 'acceleration_difference_time', got only its counterpart",
    ),
    (
        r"step_time: \{value: 4",
        "step_time: {value: 4.005",
        "$.step_response.step_time: expected a multiple of 0.01 s, got 4.005 s",
    ),
    (
        r"  velocity_16dof:",
        "  samples: [{quantity: vehicle_speed, time: 3.9, value: 1, unit: m/s, tolerance: 0.1}]\n"
        "  velocity_16dof:",
        "$.step_response.samples[0].time: expected a time from 4 to 10 s, got 3.9 s",
    ),
    (
        r"undamped: \[5.69,",
        "undamped: [null,",
        "$.step_response.acceleration_difference_time: expected the first undamped mode of 16dof in that"
        " configuration too, got none",
    ),
    (
        r"read_out_time: \{value: 10",
        "read_out_time: {value: 3",
        "$.step_response.read_out_time: expected a time after the step, got 3 s",
    ),
    (
        r"acceleration_difference_time: \{value: 5.08",
        "acceleration_difference_time: {value: 50.8",
        "$.step_response.acceleration_difference_time.value: expected a time between 4 and 10 s, got 50.8 s",
    ),
    (
        r"velocity_4dof: \{value: 18.3167, unit: m/s",
        "velocity_4dof: {value: 18.3167, unit: N",
        "$.step_response.velocity_4dof.unit: expected a unit of m/s, got 'N'",
    ),
    (
        r"engine_torque: \{value: 150, unit: N m\}",
        "engine_torque: {value: 150}",
        "$.step_response.engine_torque: expected the key 'unit', got only 'value'",
    ),
]


def complaint(
    text: str, words: tuple[str, ...], folder_: Path, capsys: pytest.CaptureFixture[str]
) -> str:
    path = folder_ / "car.yaml"
    path.write_text(text, encoding="utf-8")
    assert main([word.replace("CAR", str(path)) for word in words]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    told = captured.err.strip().removeprefix(f"hev-can-emu: {path}:")
    return re.sub(r"^\d+:", "", told).strip()


def once(text: str, pattern: str, replacement: str) -> str:
    changed, count = re.subn(pattern, lambda _: replacement, text, count=1)
    assert count == 1
    return changed


@pytest.mark.parametrize(("pattern", "replacement", "message"), VEHICLES)
def test_vehicle(
    pattern: str,
    replacement: str,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = once(VEHICLE, pattern, replacement)
    assert complaint(text, ("modes", "--vehicle", "CAR"), tmp_path, capsys) == message


@pytest.mark.parametrize(("pattern", "replacement", "message"), TARGETS_FILES)
def test_targets(
    pattern: str,
    replacement: str,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = once(TARGETS, pattern, replacement)
    assert complaint(text, ("identify", "CAR"), tmp_path, capsys) == message


@pytest.mark.parametrize(("pattern", "replacement", "message"), STEPS)
def test_step_targets(
    pattern: str,
    replacement: str,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = once(PAPER, pattern, replacement)
    assert complaint(text, ("identify", "CAR"), tmp_path, capsys) == message


@pytest.mark.parametrize("command", ["modes", "step-response", "export"])
def test_every_command_refuses_an_impossible_vehicle(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = once(VEHICLE, r"Jv: \{value: [^,]*", "Jv: {value: -1")
    out = ("--out", str(tmp_path / "x.npz")) if command == "export" else ()
    told = complaint(text, (command, "--vehicle", "CAR", *out), tmp_path, capsys)
    assert told == "$.driveline.inertias.Jv: expected a value > 0, got -1"
    assert not (tmp_path / "x.npz").exists()


SHIPPED = "expected a file, or the name of a shipped one"
OPTIONS = [
    ("modes --vehicle dai2042", f"--vehicle: {SHIPPED}, got 'dai2042'; did you mean 'dai2024'?"),
    ("identify syntetic", f"TARGETS: {SHIPPED}, got 'syntetic'; did you mean 'synthetic'?"),
    (
        "modes --configuration parallel",
        f"--configuration: expected one of {DRIVING}, got 'parallel';"
        " did you mean 'parallel_g2' or 'parallel_g1'?",
    ),
    (
        "modes --model 3dof",
        "--model: expected one of 16dof, 4dof, got '3dof'; did you mean '4dof' or '16dof'?",
    ),
    ("modes --reduction paper", "--reduction: expected --model 4dof beside it, got --model 16dof"),
    (
        "export --model 4dof --reduction papr",
        "--reduction: expected one of paper, load-weighted, got 'papr'; did you mean 'paper'?",
    ),
    ("export --format csv", "--format: expected one of npz, mat, got 'csv'"),
    (
        "export --out /nowhere/x.npz",
        "--out: expected a file in an existing folder, got '/nowhere/x.npz'",
    ),
    ("modes --plot x.gif", "x.gif: expected a file name ending in .png, .svg, .pdf, got '.gif'"),
    ("step-response --end-time 3", "--end-time: expected a time after the step at 4 s, got 3 s"),
    ("step-response --grid 0", "--grid: expected a spacing > 0 s, got 0 s"),
    ("step-response --grid 0.003", "--step-time: expected a multiple of 0.003 s, got 4 s"),
    (
        "step-response --grid 1e-9",
        "--grid: expected at most 1000000 points, got 1e+10; widen the grid",
    ),
    ("step-response --engine-torque nan", "--engine-torque: expected a finite number, got nan"),
    ("identify synthetic --starts 0", "--starts: expected a whole number >= 1, got 0"),
]


@pytest.mark.parametrize(("line", "message"), OPTIONS)
def test_options(line: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == f"hev-can-emu: {message}\n"


@pytest.mark.parametrize(
    ("pattern", "replacement", "part"),
    [
        ("^version: 1", "version: 9", "$.version: expected"),
        (
            r"(    k3: \{value: [^,]*, unit: [^,]*), source: [^,}]*",
            r"\1",
            "$.driveline.stiffness.k3: expected the key 'source'",
        ),
    ],
)
def test_vehicle_shape(
    pattern: str, replacement: str, part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = re.sub(pattern, replacement, VEHICLE, count=1)
    assert text != VEHICLE
    assert complaint(text, ("modes", "--vehicle", "CAR"), tmp_path, capsys).startswith(part)


@pytest.mark.parametrize(
    "command", [("export",), ("export", "--format", "mat"), ("identify", "synthetic")]
)
def test_a_file_that_cannot_be_written_is_told_before_any_work(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, "--out", "/proc/no.file"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(
        "hev-can-emu: --out /proc/no.file: expected a file that can be written, got "
    )
    assert error.count("\n") == 1
