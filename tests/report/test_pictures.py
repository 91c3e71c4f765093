"""Pictures: what they refuse, what they draw; the looks are for human eyes."""

import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from hev_can_emu.errors import InputError
from hev_can_emu.report.modes_plot import plot_modes, unit_shapes
from hev_can_emu.report.plot import plot_run
from hev_can_emu.report.ribbons import Ribbon, Segment, StepMarker, readable, segments_of
from hev_can_emu.report.step_plot import Response, plot_step_response

NAN = float("nan")
TIME = np.linspace(0.0, 10.0, 101)


def draw_run(path: Path, **changes: object) -> None:
    arguments: dict[str, object] = {
        "t_s": TIME,
        "series": {
            "engine_speed_rpm": 1500.0 + TIME,
            "vehicle_speed_kmh": 5.0 * TIME,
            "em2_torque_nm": np.where(TIME < 5.0, NAN, 40.0),
        },
        "ribbons": [
            Ribbon("mode", [Segment(0.0, 4.0, "series"), Segment(4.0, 10.0, "parallel_g1")])
        ],
        "title": "A run",
        "steps": [StepMarker(4.0, "close C1")],
    } | changes
    plot_run(path, **arguments)  # type: ignore[arg-type]


def test_run_fills_a_picture_of_1600_by_1000(tmp_path: Path) -> None:
    draw_run(tmp_path / "made" / "run.png")
    picture = imread(tmp_path / "made" / "run.png")
    assert picture.shape[:2] == (1000, 1600)
    # The mode's ribbon lies near the bottom, in the colour of series on the left.
    left = {tuple(np.round(255 * dot).astype(int)) for dot in picture[700:, 400, :3]}
    right = {tuple(np.round(255 * dot).astype(int)) for dot in picture[700:, 1300, :3]}
    assert (0xFB, 0xD9, 0xA5) in left
    assert (0xA9, 0xD3, 0xEE) in right


@pytest.mark.parametrize("ending", [".png", ".svg", ".pdf"])
def test_same_run_gives_same_bytes(tmp_path: Path, ending: str) -> None:
    first, second = tmp_path / f"a{ending}", tmp_path / f"b{ending}"
    draw_run(first)
    draw_run(second)
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize(
    "changes",
    [
        {"t_s": TIME[:0], "series": {}, "ribbons": [], "steps": []},
        {"series": {"vehicle_speed_kmh": np.full(101, NAN)}},
        {"series": {"em1_speed_rpm": -100.0 * TIME, "vehicle_speed_kmh": TIME}},
        {"steps": [StepMarker(4.0 + 0.01 * i, f"step number {i}") for i in range(30)]},
    ],
    ids=["nothing", "speed never available", "negative speed", "crowded steps"],
)
def test_odd_runs_are_drawn(tmp_path: Path, changes: dict[str, object]) -> None:
    draw_run(tmp_path / "run.png", **changes)
    assert (tmp_path / "run.png").stat().st_size > 5000


def test_run_refuses_other_endings_before_drawing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"run\.bmp: expected a file name ending in \.png"):
        draw_run(tmp_path / "run.bmp")


def test_run_tells_which_curve_is_short(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"series\['em1_speed_rpm'\]: expected 101 values, got 3"):
        draw_run(tmp_path / "run.png", series={"em1_speed_rpm": np.zeros(3)})


def test_unwritable_place_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected a file that can be written"):
        draw_run(tmp_path / "file" / "run.png")


def test_missing_matplotlib_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError, match=r"pip install 'hev-can-emu\[plot\]'"):
        draw_run(tmp_path / "run.png")


def test_segments_follow_the_state_and_leave_gaps() -> None:
    times = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    codes = np.array([0.0, 0.0, 1.0, NAN, NAN, 7.0, 7.0])
    assert segments_of(times, codes, {0: "open", 1: "closed"}) == [
        Segment(0.0, 2.0, "open"),
        Segment(2.0, 3.0, "closed"),
        Segment(5.0, 6.0, "7"),
    ]
    assert segments_of(times[:0], codes[:0], {}) == []


def test_labels_are_readable() -> None:
    assert readable("parallel_g1") == "parallel G1"
    assert readable("Gear G2") == "Gear G2"


def test_shapes_are_scaled_to_plus_one() -> None:
    scaled = unit_shapes(np.array([[1.0, 0.0], [-4.0, 0.0], [2.0, 0.0]]))
    assert scaled[:, 0].tolist() == [-0.25, 1.0, -0.5]
    assert scaled[:, 1].tolist() == [0.0, 0.0, 0.0]


def test_modes_share_panels(tmp_path: Path) -> None:
    shapes = np.cos(np.outer(np.arange(16), np.arange(1, 16)))
    frequencies = np.geomspace(3.0, 13160.0, 15)
    plot_modes(
        tmp_path / "modes.svg", [f"J{i}" for i in range(16)], list(frequencies), shapes, "Modes"
    )
    drawn = (tmp_path / "modes.svg").read_text()
    assert drawn.count('id="axes_') == 5
    with pytest.raises(ValueError, match=r"expected \(2, 15\), got \(16, 15\)"):
        plot_modes(tmp_path / "x.png", ["Ja", "Jb"], list(frequencies), shapes, "Modes")


def test_step_response_has_two_panels_with_insets(tmp_path: Path) -> None:
    reference = Response("16 DOF", TIME, np.ones(101))
    other = Response("4 DOF", 0.999 * TIME, np.full(101, 0.999))
    path = tmp_path / "step.svg"
    plot_step_response(path, TIME, reference, other, "Step", ["one", "two"])
    assert path.read_text().count('id="axes_') == 4
    with pytest.raises(ValueError, match=r"4 DOF: expected \(50,\), got \(101,\)"):
        plot_step_response(path, TIME[:50], Response("16 DOF", TIME[:50], TIME[:50]), other, "Step")
