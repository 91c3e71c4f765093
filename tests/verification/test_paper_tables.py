"""Every number of Dai et al. 2024 (WEVJ 15(9), 390) that its model yields, to the printed digit."""

from __future__ import annotations

import numpy as np
import pytest
from random_cars import car

from hev_can_emu.plant.linear import modes
from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.step_response import step_response
from hev_can_emu.plant.structure import CONFIGURATIONS, full_order

G1 = CONFIGURATIONS["parallel_g1"]

# order: damped, undamped, as printed
TABLE_2 = """
5.70 5.69
24.68 24.68
26.78 26.79
174.92 174.92
244.70 244.70
1038.88 1038.47
1208.74 1208.71
2208.00 2207.90
2391.87 2392.06
2905.39 2903.04
3753.86 3756.29
5707.45 5705.27
6077.21 6079.45
7194.69 7198.65
13163.53 13164.13
"""
# 4-DOF damped, undamped
TABLE_3 = """
5.69 5.69
24.49 24.49
26.71 26.72
"""


def printed(values: np.ndarray) -> list[str]:
    return [f"{value:.2f}" for value in values]


def test_table_2_to_the_printed_digit() -> None:
    found = modes(full_order(car("default")), G1)
    rows = [line.split() for line in TABLE_2.strip().splitlines()]
    assert printed(found.damped_hz) == [row[0] for row in rows]
    assert printed(found.undamped_hz) == [row[1] for row in rows]


def test_table_2_means_the_modulus_not_the_imaginary_part() -> None:
    found = modes(full_order(car("default")), G1)
    rows = [line.split() for line in TABLE_2.strip().splitlines()]
    imaginary = printed(found.oscillation_hz)
    assert sum(a != row[0] for a, row in zip(imaginary, rows, strict=True)) >= 12


def test_the_papers_own_table_2_obeys_the_determinant() -> None:
    # det A = product of w^2 over the elastic modes: the printed columns' products must agree.
    rows = np.array([[float(x) for x in line.split()] for line in TABLE_2.strip().splitlines()])
    logs = np.log(rows).sum(axis=0)
    rounding = np.sum(0.005 / rows)
    assert abs(logs[0] - logs[1]) < rounding


def test_table_3_to_the_printed_digit() -> None:
    literal = modes(reduced(car("default"), "paper"), G1)
    rows = [line.split() for line in TABLE_3.strip().splitlines()]
    assert printed(literal.damped_hz) == [row[0] for row in rows]
    assert printed(literal.undamped_hz) == [row[1] for row in rows]


def test_figure_12_to_the_printed_digit() -> None:
    result = step_response(car("default"), G1)
    assert f"{result.velocity_16[-1]:.4f}" == "18.3183"
    assert f"{result.velocity_4[-1]:.4f}" == "18.3167"
    assert f"{result.velocity_difference_percent:.4f}" == "0.0087"
    assert f"{result.acceleration_difference_percent:.3f}" == "0.316"
    assert f"{result.acceleration_difference_time:.2f}" == "5.08"


def test_figure_9_first_mode_moves_everything_but_the_body() -> None:
    found = modes(full_order(car("default")), G1)
    size = dict(zip(found.names, np.abs(found.shapes[:, 0]), strict=True))
    assert size["Jv"] < 0.01
    assert min(value for name, value in size.items() if name != "Jv") > 10 * size["Jv"]


@pytest.mark.parametrize("model", ["16dof", "4dof"])
def test_figures_9_and_11_wheels(model: str) -> None:
    structure = full_order(car("default")) if model == "16dof" else reduced(car("default"), "paper")
    found = modes(structure, G1)
    rows = dict(zip(found.names, found.shapes, strict=True))
    # Mode 2: wheels in opposite phase, one of them the largest; mode 3: wheels in phase.
    assert rows["Jlw"][1] * rows["Jrw"][1] < 0
    assert max(abs(rows["Jlw"][1]), abs(rows["Jrw"][1])) == 1.0
    assert rows["Jlw"][2] * rows["Jrw"][2] > 0
    if model == "16dof":
        assert abs(rows["Jm1"][2]) > 0.7
        assert abs(rows["Jm2"][2]) > 0.7
        outside = [abs(rows[name][3:]).max() for name in ("Jlw", "Jrw", "Jv")]
        assert max(outside) < 0.002
