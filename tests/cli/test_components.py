"""Each component of the detailed model beside its known answers, by the command that draws them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from matplotlib.image import imread

from hev_can_emu.cli import main
from hev_can_emu.commands._components.card import Car
from hev_can_emu.commands._components.load import load_car
from hev_can_emu.commands.components import COMPONENTS, compute
from hev_can_emu.report.component_plot import Fact


@pytest.fixture(scope="module")
def car() -> Car:
    return load_car("dai2024")


@pytest.mark.parametrize("name", COMPONENTS)
def test_a_component_gives_what_is_known(name: str, car: Car) -> None:
    card = compute(name, car)
    assert card.panels
    assert card.facts
    missed = [fact for fact in card.facts if not fact.holds]
    assert missed == []
    for panel in card.panels:
        for curve in panel.curves:
            assert len(curve.x) == len(curve.y)


def test_the_known_values_are_those_of_the_literature(car: Car) -> None:
    known = {
        (name, fact.what): fact.known
        for name in ("machine", "clutch")
        for fact in compute(name, car).facts
    }
    assert known["clutch", "lock-up"] == 0.2238806
    assert known["clutch", "heat: capacity times dw t/2"] == 2014.925
    assert known["machine", "MTPA at 400 A: torque"] == 339.5916
    assert known["machine", "corner without resistance"] == 2057.75
    assert known["machine", "corner with 8 mOhm"] == 2033.66
    assert known["machine", "MTPV begins (0.05 Wb)"] == 6556.9


def test_what_is_apart_is_told_as_a_share_or_absolutely() -> None:
    assert Fact("", "s", 2.0, 2.1, 0.06).off == pytest.approx(0.05)
    assert Fact("", "s", 2.0, 2.1, 0.06).holds
    assert not Fact("", "s", -2.0, -2.1, 0.04).holds
    assert Fact("", "s", 0.0, 1e-3, 1e-3).holds
    assert not Fact("", "s", 0.0, float("nan"), 1.0).holds


def test_pictures_and_numbers_come_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["components", "machine", "mesh", "--out", str(tmp_path / "new")]) == 0
    told = capsys.readouterr().out
    assert "MTPV begins (0.05 Wb)" in told
    assert "TOO FAR" not in told
    for name in ("machine", "mesh"):
        picture = imread(tmp_path / "new" / f"{name}.png")
        assert picture.shape[1] == 1600
        assert 0.01 < (picture[:, :, :3] < 0.9).any(axis=2).mean() < 0.5
    assert main(["components", "mesh", "--json"]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert [fact["holds"] for fact in numbers["mesh"]] == [True] * len(numbers["mesh"])


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["gearbox"], "components: expected one of engine, clutch, "),
        (
            ["mesh", "--format", "gif", "--out", "x"],
            "--format: expected png, svg or pdf, got 'gif'",
        ),
        (["mesh", "--vehicle", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["components", *arguments]) == 2
    told = capsys.readouterr().err
    assert complaint in told
    assert told.count("\n") == 1
