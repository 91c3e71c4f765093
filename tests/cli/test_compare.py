"""``compare``: one scenario with several fidelities, as a table and as a picture."""

from __future__ import annotations

from pathlib import Path

import pytest

from hev_can_emu.cli import main

PULL = """\
version: 1
name: a short pull
duration: 600 ms
steps:
- name: pull
  at: 100 ms
  set: {ContactorRequest: Closed, EM2ControlMode: Torque, EM2TorqueRequest: 100 Nm}
- name: let go
  after: 300 ms
  set: {EM2TorqueRequest: 0 Nm}
"""


@pytest.fixture
def scenario(tmp_path: Path) -> str:
    path = tmp_path / "pull.yaml"
    path.write_text(PULL)
    return str(path)


def compared(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, list[str]]:
    """Return the table's rows by their first words, cells apart."""
    assert main(["compare", *words]) == 0
    rows = [line.split("  ") for line in capsys.readouterr().out.splitlines()]
    return {row[0].strip(): [cell.strip() for cell in row[1:] if cell.strip()] for row in rows}


def test_both_fidelities_pull_alike(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    rows = compared(
        capsys, scenario, "--models", "4dof,16dof", "--quantity", "vehicle_speed",
        "--quantity", "em2_torque",
    )  # fmt: skip
    four, sixteen, apart = rows["car (km/h)"]
    # Steps and delays aside: 100 N m for 0.3 s through 5.6, on 252 kg m^2 of 0.356 m.
    assert float(sixteen.split(" .. ")[1]) == pytest.approx(0.85, abs=0.1)
    assert float(four.split(" .. ")[1]) == pytest.approx(float(sixteen.split(" .. ")[1]), rel=2e-2)
    assert 0.0 < float(apart) < 0.02
    assert rows["EM2 (N·m)"][1].endswith(".. 100")


def test_a_window_between_steps(scenario: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = (scenario, "--models", "16dof", "--quantity", "em2_torque", "--from", "let go")
    low, high = compared(capsys, *words)["EM2 (N·m)"][0].split(" .. ")
    assert float(high) == pytest.approx(100.0, abs=0.5)
    assert float(low) == pytest.approx(0.0, abs=0.5)


def test_a_picture(scenario: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    compared(capsys, scenario, "--models", "4dof,16dof", "--plot", str(tmp_path / "a.svg"))
    text = (tmp_path / "a.svg").read_text()
    # Letters are drawn as outlines, named in comments.
    for words in ("a short pull", "4dof", "16dof", "pull", "let go", "acceleration (m/s²)"):
        assert f"{words} -->" in text


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--models", "16dof,3dof"), "--models: expected some of"),
        (("--quantity", "engine_sped"), "--quantity: expected a quantity of the plant"),
        (("--from", "nowhere"), "--from: expected a step taken with"),
        (("--plot", "a.bmp"), "expected a file name ending in .png"),
        (("--vehicle", "nocar"), "--vehicle: expected a file"),
    ],
)
def test_bad_input_is_one_line(
    words: tuple[str, str], told: str, scenario: str, capsys: pytest.CaptureFixture[str]
) -> None:
    given = words if "--models" in words else ("--models", "4dof", *words)
    assert main(["compare", scenario, *given]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1
