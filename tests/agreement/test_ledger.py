"""The energy ledger over a whole scenario: it closes, and each term is what the signals say it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from hev_can_emu.plant.ledger import Ledger
from hev_can_emu.resources import folder
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.playing import Playing
from hev_can_emu.runtime.scenario_runs import read_scenario
from hev_can_emu.runtime.setup import Setup, load_car
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.runtime.truth_log import TruthLog
from hev_can_emu.runtime.virtual import play_virtual

NAMES = (
    "engine_speed", "engine_torque", "fuel_flow", "em1_speed", "em1_torque", "em1_power", "em2_speed",
    "em2_torque", "em2_power", "battery_voltage", "battery_current", "vehicle_speed",
    "clutch_torque", "clutch_slip", "clutch_held", "state_of_charge",
)  # fmt: skip
HEATING_VALUE = 42.7e6  # J/kg, petrol


class Played(NamedTuple):
    """A scenario's ledger, its truth every millisecond, and the instants."""

    ledger: Ledger
    truth: dict[str, np.ndarray]
    times: np.ndarray


@pytest.fixture(scope="module")
def played() -> Played:
    document, scenario = read_scenario(folder("scenarios") / "series_parallel.yaml")
    emulator = Emulator(Setup(model="detailed", nodes=dict.fromkeys(scenario.plays, "emulated")))
    log = TruthLog(emulator, NAMES)
    play_virtual(Playing(emulator, document, scenario), [log.add], TICK_NS)
    ledger = emulator.ledger()
    assert ledger is not None
    return Played(ledger, dict(zip(NAMES, log.values.T, strict=True)), log.times)


def integral(played: Played, values: np.ndarray) -> float:
    """Means over a tick, or samples at its end, summed up."""
    return float(np.sum(values) * (played.times[1] - played.times[0]))


def mean(values: np.ndarray) -> np.ndarray:
    """Samples at the ends of ticks, as means over each."""
    return 0.5 * (values + np.concatenate([values[:1], values[:-1]]))


def test_it_closes(played: Played) -> None:
    ledger = played.ledger
    assert ledger.moved > 5e5
    assert abs(ledger.residue) < 1e-6 * ledger.moved
    # By its own means as well: what came in and went out is far more than what does not close.
    assert ledger.total("source") > 0.9 * ledger.moved


# What the order of sleeve, oil and driveline within a step makes: of either sign, and small.
LAGS = ("sleeve_chamfers", "sleeve_lag")


def test_no_heat_is_negative(played: Played) -> None:
    for term in played.ledger.terms:
        if term.name in LAGS:
            assert abs(term.energy) < 1.0, term.name
        elif term.kind == "sink":
            assert term.energy >= -1e-9, term.name


@pytest.mark.parametrize("machine", ["em1", "em2"])
def test_shaft_work_of_the_machines(played: Played, machine: str) -> None:
    truth = played.truth
    work = integral(played, truth[f"{machine}_torque"] * mean(truth[f"{machine}_speed"]))
    assert played.ledger[f"{machine}_shaft"] == pytest.approx(work, rel=2e-3)
    assert played.ledger[f"{machine}_dc"] == pytest.approx(
        integral(played, truth[f"{machine}_power"]), rel=1e-6
    )


def test_losses_of_the_machines_are_what_the_shaft_does_not_get(played: Played) -> None:
    ledger = played.ledger
    for machine in ("em1", "em2"):
        heat = sum(ledger[f"{machine}_{part}"] for part in ("copper", "iron", "drag", "inverter"))
        given = ledger[f"{machine}_dc"] - ledger[f"{machine}_shaft"]
        assert heat == pytest.approx(given - ledger[f"{machine}_magnetic"], rel=1e-9)


def test_fuel_and_engine(played: Played) -> None:
    ledger, truth = played.ledger, played.truth
    assert ledger["fuel"] == pytest.approx(ledger.fuel * HEATING_VALUE, rel=1e-9)
    # Fuel flow is told at the end of a tick.
    assert ledger.fuel == pytest.approx(integral(played, truth["fuel_flow"]), rel=5e-3)
    work = integral(played, truth["engine_torque"] * mean(truth["engine_speed"]))
    assert ledger["engine_shaft"] == pytest.approx(work, rel=5e-3)
    parts = ledger["engine_shaft"] + ledger["engine_drag"] + ledger["wall"] + ledger["exhaust"]
    assert ledger["fuel"] == pytest.approx(parts, rel=1e-9)


def test_battery(played: Played) -> None:
    ledger, truth = played.ledger, played.truth
    given = -integral(played, truth["battery_voltage"] * truth["battery_current"])
    assert ledger["battery"] - ledger["battery_resistance"] == pytest.approx(given, rel=2e-3)


def test_road_and_motion(played: Played) -> None:
    ledger, truth = played.ledger, played.truth
    parameters, machines, *_ = load_car("dai2024")
    speed = truth["vehicle_speed"]
    road = machines.road
    air = 0.5 * road.air_density * road.drag_area * mean(speed) ** 3
    assert ledger["air"] == pytest.approx(integral(played, air), rel=1e-4)
    mass = parameters.inertias["Jv"] / parameters.tyre_radius**2
    rolling = road.rolling_coefficient + road.rolling_speed_square * mean(speed) ** 2
    expected = integral(played, rolling * mass * 9.80665 * mean(speed))
    assert ledger["friction_body"] == pytest.approx(expected, rel=1e-4)
    # Most of the motion's energy is the body's.
    assert ledger["kinetic"] == pytest.approx(0.5 * mass * speed[-1] ** 2, rel=0.1)
    assert ledger["kinetic"] > 0.5 * mass * speed[-1] ** 2


def test_heat_of_c1(played: Played) -> None:
    truth = played.truth
    power = np.abs(mean(truth["clutch_torque"] * truth["clutch_slip"]))
    power[truth["clutch_held"] > 0.5] = 0.0
    heat = integral(played, power)
    assert played.ledger["friction_c1"] > 500.0
    assert played.ledger["friction_c1"] == pytest.approx(heat, rel=0.03)
