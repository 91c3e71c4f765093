"""The tables of docs/paper.md are what the program says."""

from __future__ import annotations

from pathlib import Path

import pytest
from random_cars import car

from hev_can_emu.plant.linear import modes
from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.step_response import step_response
from hev_can_emu.plant.structure import CONFIGURATIONS, full_order

PAGE = Path(__file__).resolve().parents[2] / "docs" / "paper.md"
G1 = CONFIGURATIONS["parallel_g1"]


def rows(name: str) -> list[list[str]]:
    """Return the cells of the table marked ``<!-- table: name -->``, without its head."""
    _, mark, rest = PAGE.read_text(encoding="utf-8").partition(f"<!-- table: {name} -->\n")
    assert mark
    lines = rest.partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_table_2() -> None:
    found = modes(full_order(car("default")), G1)
    table = rows("2")
    assert [row[0] for row in table] == [str(order) for order in range(1, 16)]
    for row, undamped, damped, oscillation, ratio in zip(
        table,
        found.undamped_hz,
        found.damped_hz,
        found.oscillation_hz,
        found.damping_ratio,
        strict=True,
    ):
        assert f"{undamped:.2f}" == row[1]
        assert f"{damped:.2f}" == row[4]
        assert row[2] == f"{undamped:.4f}"
        assert row[5] == f"{damped:.4f}"
        assert float(row[3]) == pytest.approx(undamped - float(row[1]), abs=6e-5)
        assert float(row[6]) == pytest.approx(damped - float(row[4]), abs=6e-5)
        assert row[7:] == [f"{oscillation:.2f}", f"{ratio:.5f}"]


def test_table_3() -> None:
    literal = modes(reduced(car("default"), "paper"), G1)
    close = modes(reduced(car("default")), G1)
    full = modes(full_order(car("default")), G1)
    for index, row in enumerate(rows("3")):
        assert f"{literal.undamped_hz[index]:.2f}" == row[1]
        assert f"{literal.damped_hz[index]:.2f}" == row[4]
        assert row[2] == f"{literal.undamped_hz[index]:.4f}"
        assert row[5] == f"{literal.damped_hz[index]:.4f}"
        assert row[7] == f"{close.undamped_hz[index]:.4f}"
        assert row[8] == f"{full.undamped_hz[index]:.4f}"


def test_figure_12() -> None:
    for column, rule in ((2, "paper"), (4, "load-weighted")):
        found = step_response(car("default"), G1, rule=rule)
        numbers = (
            found.velocity_16[-1],
            found.velocity_4[-1],
            found.velocity_difference_percent,
            found.acceleration_difference_percent,
            found.acceleration_difference_time,
        )
        for row, number in zip(rows("12"), numbers, strict=True):
            digits = len(row[column].partition(".")[2])
            assert row[column] == f"{number:.{digits}f}"


def test_full_order_in_all_configurations() -> None:
    table = rows("full")
    assert [row[0] for row in table] == list(CONFIGURATIONS)
    for row in table:
        found = modes(full_order(car("default")), CONFIGURATIONS[row[0]])
        assert row[1:4] == [f"{value:.4f}" for value in found.undamped_hz[:3]]
        assert row[4:] == [f"{value:.5f}" for value in found.damping_ratio[:3]]


def test_reductions() -> None:
    table = rows("reductions")
    assert len(table) == 12
    for name, rule, *cells in table:
        full = modes(full_order(car("default")), CONFIGURATIONS[name])
        found = modes(reduced(car("default"), rule), CONFIGURATIONS[name])
        wanted = [
            *(100 * (found.undamped_hz / full.undamped_hz[:3] - 1)),
            *(100 * (found.damping_ratio / full.damping_ratio[:3] - 1)),
        ]
        # One or two digits are shown, and the smallest deviations are near rounding themselves.
        for cell, value in zip(cells, wanted, strict=True):
            assert float(cell) == pytest.approx(value, rel=0.2, abs=1e-6)
