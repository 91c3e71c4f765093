"""modes, step-response and export through the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from hev_can_emu.cli import main
from hev_can_emu.commands._vehicle import load_driveline
from hev_can_emu.plant.bank import propagators
from hev_can_emu.plant.linear import state_space
from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.structure import CONFIGURATIONS, PORTS, full_order


def answer(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main([*words, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_modes_json(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, "modes")
    assert found["model"] == "16dof"
    assert found["configuration"] == "parallel_g1"
    assert [round(value, 2) for value in found["undamped_hz"][:3]] == [5.69, 24.68, 26.79]
    assert [round(value, 2) for value in found["damped_hz"][:3]] == [5.70, 24.68, 26.78]
    assert len(found["damping_ratio"]) == 15
    assert " ".join(found["mode_shapes"]) == (
        "Je Jc Jm1 Jid J1 Jm2 J2 Jsg1 Jg12 Jfd1 Jg22 Jg21 Jfd2 Jlw Jrw Jv"
    )
    assert {len(row) for row in found["mode_shapes"].values()} == {15}
    assert "Identified, not published" in found["provenance"]


def test_modes_of_4dof_is_the_papers_unless_told_otherwise(
    capsys: pytest.CaptureFixture[str],
) -> None:
    literal = answer(capsys, "modes", "--model", "4dof")
    close = answer(capsys, "modes", "--model", "4dof", "--reduction", "load-weighted")
    assert literal["reduction"] == "paper"
    assert [round(value, 2) for value in literal["undamped_hz"]] == [5.69, 24.49, 26.72]
    assert [round(value, 2) for value in close["undamped_hz"]] == [5.69, 24.68, 26.79]
    assert list(literal["mode_shapes"]) == ["Jeq", "Jlw", "Jrw", "Jv"]


@pytest.mark.parametrize("name", CONFIGURATIONS)
@pytest.mark.parametrize("model", ["16dof", "4dof"])
def test_modes_of_every_configuration(
    name: str, model: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = answer(capsys, "modes", "--configuration", name, "--model", model)
    count = len(found["undamped_hz"])
    assert count == (15 if model == "16dof" else 3)
    assert len(found["mode_shapes"]) == count + found["rigid_modes"]
    assert found["undamped_hz"] == sorted(found["undamped_hz"])


def test_modes_table_says_that_parameters_are_identified(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["modes"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "Identified, not published" in printed
    assert "not unique" in printed
    assert "13163.53" in printed


def test_step_response_json(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, "step-response")
    assert f"{found['dof16']['velocity']:.4f}" == "18.3183"
    assert f"{found['dof4']['velocity']:.4f}" == "18.3167"
    assert f"{found['velocity_difference_percent']:.4f}" == "0.0087"
    assert f"{found['acceleration_difference_percent']:.3f}" == "0.316"
    assert found["acceleration_difference_time"] == 5.08
    close = answer(capsys, "step-response", "--reduction", "load-weighted")
    assert close["velocity_difference_percent"] < 1e-5


def test_step_response_options(capsys: pytest.CaptureFixture[str]) -> None:
    one = answer(capsys, "step-response", "--end-time", "8")
    two = answer(capsys, "step-response", "--step-time", "1", "--end-time", "5")
    assert two["dof16"]["velocity"] == pytest.approx(one["dof16"]["velocity"], rel=1e-12)
    double = ["--engine-torque", "300", "--em2-torque", "400", "--end-time", "8"]
    three = answer(capsys, "step-response", *double)
    assert three["dof16"]["velocity"] == pytest.approx(2 * one["dof16"]["velocity"], rel=1e-12)
    # In series the engine drives EM1 only: its torque does not move the car.
    rest = ["--em2-torque", "0", "--configuration", "series"]
    assert answer(capsys, "step-response", *rest)["dof16"]["velocity"] == 0.0


@pytest.mark.parametrize("command", ["modes", "step-response"])
@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_plots(command: str, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"plot.{ending}"
    assert main([command, "--plot", str(path)]) == 0
    assert path.stat().st_size > 5000


def read(path: Path) -> dict[str, Any]:
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {key: file[key] for key in file.files}
    content = loadmat(path)
    for key in ("state", "input", "output"):
        content[f"{key}_names"] = [str(cell[0]) for cell in content[f"{key}_names"][:, 0]]
    return content


@pytest.mark.parametrize("kind", ["npz", "mat"])
@pytest.mark.parametrize("name", CONFIGURATIONS)
@pytest.mark.parametrize("model", ["16dof", "4dof"])
def test_export_read_back_gives_the_plants_own_response(
    kind: str, name: str, model: str, tmp_path: Path
) -> None:
    path = tmp_path / f"plant.{kind}"
    words = ["--model", model, "--configuration", name, "--out", str(path)]
    rule = ["--reduction", "load-weighted"] if model == "4dof" else []
    assert main(["export", "--format", kind, *words, *rule]) == 0
    file = read(path)
    a, b, c, d = (np.asarray(file[key]) for key in "ABCD")
    inputs, outputs = list(file["input_names"]), list(file["output_names"])
    assert a.shape == (len(file["state_names"]),) * 2
    assert b.shape == (len(a), len(inputs))
    assert d.shape == (len(outputs), len(inputs))

    # The plant: the very propagators its compiled step uses, in full coordinates.
    p = load_driveline()
    structure = full_order(p) if model == "16dof" else reduced(p)
    big_a, big_b = state_space(structure, CONFIGURATIONS[name])
    step, count = 1e-3, 2000
    flow = propagators(big_a, big_b, step, 0)[0]
    small = propagators(a, b, step, 0)[0]
    torque = {"engine": 120.0, "em1": -40.0, "em2": 180.0, "road": -300.0}
    u = np.zeros(big_b.shape[1])
    u[:4] = [torque[port] for port in PORTS]
    v = np.array([torque.get(one.removesuffix("_torque"), 0.0) for one in inputs])
    x, y = np.zeros(len(big_a)), np.zeros(len(a))
    n = structure.n
    worst: dict[str, float] = {}
    largest: dict[str, float] = {}
    for _ in range(count):
        x = flow @ np.concatenate([x, u])
        y = small @ np.concatenate([y, v])
        found = dict(zip(outputs, c @ y + d @ v, strict=True))
        body = structure.names.index("Jv" if model == "16dof" else "v")
        wanted = {
            "engine_speed": structure.ports[0] @ x[:n],
            "em1_speed": structure.ports[1] @ x[:n],
            "em2_speed": structure.ports[2] @ x[:n],
            "left_wheel_speed": structure.locks[3] @ x[:n],
            "right_wheel_speed": structure.locks[4] @ x[:n],
            "vehicle_speed": p.tyre_radius * x[body],
            "vehicle_acceleration": p.tyre_radius * (big_a[body] @ x + big_b[body] @ u),
        }
        for key, value in wanted.items():
            worst[key] = max(worst.get(key, 0.0), abs(found[key] - value))
            largest[key] = max(largest.get(key, 0.0), abs(value))
    for key, value in worst.items():
        assert value <= 1e-9 * max(largest[key], 1.0), key


def test_export_names_everything(tmp_path: Path) -> None:
    path = tmp_path / "any.name"
    assert main(["export", "--out", str(path)]) == 0
    with np.load(path) as file:
        assert len(file["state_names"]) == len(file["state_units"]) == 31
        assert "speed_Jv" in file["state_names"]
        assert "engine_torque" in file["input_names"]
        assert set(file["state_units"]) == {"rad/s", "rad", "m"}
        assert "Identified, not published" in str(file["provenance"])
        half = list(file["output_names"]).index("left_half_shaft_torque")
        assert file["output_units"][half] == "N m"


def test_export_half_shaft_torque_is_what_turns_the_wheel(tmp_path: Path) -> None:
    path = tmp_path / "plant.npz"
    assert main(["export", "--out", str(path)]) == 0
    with np.load(path) as file:
        file_c, a = file["C"], file["A"]
        rows = dict(zip(file["output_names"], file_c, strict=True))
        states = list(file["state_names"])
    net = rows["left_half_shaft_torque"] - rows["left_tyre_torque"]
    inertia = load_driveline().inertias["Jlw"]
    acceleration = a[states.index("speed_Jlw")]
    assert net / inertia == pytest.approx(acceleration, rel=1e-9, abs=1e-9)
