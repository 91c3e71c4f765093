"""The crank at rest in the car: it withstands C1's drag, breaks away beyond, and comes to rest again."""

from __future__ import annotations

import pytest

from hev_can_emu.plant.detailed_parameters import Effects
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.setup import Setup

NAN = float("nan")


def beside_em1(capacity: float, step_ns: int = 50_000) -> Bench:
    """EM1 turns the input shaft, the engine is off, C1 carries so much."""
    car = Bench(Setup(model="detailed"), Effects(step_ns=step_ns))
    car.command(
        em1_mode=2.0, em1_speed=150.0, em1_torque_min=NAN, em1_torque_max=NAN,
        external_clutch_capacity=capacity,
    )  # fmt: skip
    return car


@pytest.mark.parametrize("step_ns", [100_000, 50_000])
def test_it_stands_still_under_less_than_it_withstands(step_ns: int) -> None:
    car = beside_em1(15.0, step_ns)
    car.run(500)
    assert car.truth("em1_speed") > 100.0
    assert car.truth("clutch_torque") == pytest.approx(-15.0)
    before = car.truth("crank_angle")
    assert abs(car.truth("engine_speed")) < 1e-9
    car.run(500)
    assert car.truth("crank_angle") == pytest.approx(before, abs=1e-9)
    # It withstands with what C1 brings.
    assert car.truth("engine_torque") == pytest.approx(-15.0, abs=1e-6)
    ledger = car.ledger()
    assert ledger is not None
    assert abs(ledger.residue) < 1e-9 * ledger.moved


def test_it_breaks_away_beyond_and_comes_to_rest_again() -> None:
    car = beside_em1(25.0)
    car.run(300)
    assert car.truth("engine_speed") > 15.0
    car.command(external_clutch_capacity=0.0)
    car.run(3000)
    assert abs(car.truth("engine_speed")) < 1e-9
    ledger = car.ledger()
    assert ledger is not None
    assert ledger["engine_drag"] > 1.0
    assert abs(ledger.residue) < 1e-9 * ledger.moved


def test_the_open_clutch_does_not_turn_it() -> None:
    car = beside_em1(NAN)
    car.run(1500)
    assert car.truth("clutch_slip") < -100.0
    assert abs(car.truth("clutch_torque")) > 0.01
    assert abs(car.truth("engine_speed")) < 1e-6
