"""A switch to parallel, and its parts: against the independent reference.

The reference's whole runs are stored (tests/reference/compute.py takes minutes); here they are checked to
belong to these inputs, a stretch of one is computed anew, and the product is held against all of them.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
from measures import (
    LOCKS,
    STEPS_NS,
    Stored,
    figures,
    load,
    ours,
    product,
    row,
    shift_figures,
    shift_row,
)
from product import SIGNALS, Run, changes
from reference import compute, switch

from hev_can_emu.plant import driveline, structure

STRETCH = 30  # ms
LOCK_WITHIN = 10e-6  # s
TORQUE_WITHIN = 1e-3
PAGE = Path(__file__).parents[2] / "docs" / "detailed" / "agreement.md"


@pytest.fixture(scope="module")
def stored() -> Stored:
    return load("close")


@functools.cache
def run(step_ns: int, name: str = "close") -> Run:
    return product(name, step_ns)


@pytest.mark.parametrize("name", switch.MANOEUVRES)
def test_the_stored_run_is_of_these_inputs(name: str) -> None:
    assert load(name).digest == compute.digest(name), "run tests/reference/compute.py"


def test_a_stretch_computed_anew_is_the_stored_one(stored: Stored) -> None:
    car, y, given, _ = compute.prepare("close")
    end = STRETCH * switch.PERIOD
    again = switch.simulate(car, y, given, compute.SAMPLE, end)
    for name, values in zip(switch.SIGNALS, again.signals.T, strict=True):
        kept = stored.signals[name]
        # The same steps on the same machine; elsewhere they may differ within Radau's tolerance.
        size = max(np.abs(kept).max(), 1e-12)
        assert np.abs(values - kept[: STRETCH + 1]).max() < 1e-7 * size, name
    kept_events = stored.events[: len(again.events)]
    assert [name for _, name in again.events] == [name for _, name in kept_events]
    times = [at for at, _ in kept_events]
    assert [at for at, _ in again.events] == pytest.approx(times, abs=1e-7)


@pytest.mark.parametrize("name", LOCKS)
def test_c1_opens_and_locks_as_in_the_reference(name: str) -> None:
    expected = [(at, event) for at, event in load(name).events if event.startswith("C1")]
    found = changes(run(50_000, name), structure.C1)
    assert len(expected) >= 2
    assert len(found) == len(expected)
    for event, (at, what) in zip(found, expected, strict=True):
        if event.kind == driveline.LOCKED:
            assert what == "C1 slip"
            assert event.time == pytest.approx(at, abs=LOCK_WITHIN)
        else:
            # Capacity is held over an inner step, so it releases at the beginning of one.
            assert what == "C1 releases"
            assert event.time == pytest.approx(at, abs=50e-6)


@pytest.mark.parametrize("name", LOCKS)
def test_shaft_torques_and_heat(name: str) -> None:
    stored = load(name)
    found = figures(run(50_000, name), stored)
    for what, value in found._asdict().items():
        if what != "lock":
            assert abs(value) < TORQUE_WITHIN, what
    # Nothing of it is small because nothing happens.
    assert np.abs(stored.signals["half_shaft_torque"]).max() > 100.0
    assert np.abs(stored.signals["input_shaft_torque"]).max() > 50.0
    assert stored.signals["clutch_heat"][-1] > 20.0


def test_in_the_whole_switch_the_dogs_go_in_and_c1_closes_on_them() -> None:
    reference = load("switch").events
    order = ("C1 releases", "sleeve at ring", "ring turned", "sleeve at dogs", "C1 slip")
    places = [[name for _, name in reference].index(name) for name in order]
    assert places == sorted(places)
    close = run(50_000, "switch")
    lock = next(e.time for e in changes(close, structure.C1) if e.kind == driveline.LOCKED)
    touches = [e for e in close.events if e.index == structure.G1 and e.time < lock]
    known = [(at, name) for at, name in reference if name.startswith("dogs") and at < lock]
    # They bounce within their play some times, each a little otherwise, then stay pressed ahead.
    assert touches[-1].kind == driveline.TOUCHED
    assert known[-1][1] == "dogs meet ahead"
    first = next(e.time for e in touches if e.kind == driveline.TOUCHED)
    assert first == pytest.approx(known[0][0], abs=1e-3)
    assert touches[-1].time == pytest.approx(known[-1][0], abs=1e-3)
    assert close.signals[-1, SIGNALS.index("sleeve_position")] == pytest.approx(9e-3, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "within"),
    [("engine_speed", 1e-4), ("input_speed", 1e-3), ("em2_speed", 1e-4), ("body_speed", 1e-6)],
)
def test_speeds_all_the_way(name: str, within: float, stored: Stored) -> None:
    expected = stored.signals[name]
    assert np.abs(ours(run(50_000), name) - expected).max() < within * np.abs(expected).max()


def test_a_late_event_after_many_still_falls_with_the_inner_step() -> None:
    apart = [figures(run(step_ns, "switch"), load("switch")).lock for step_ns in STEPS_NS]
    assert abs(apart[0]) > 1.5 * abs(apart[1]) > 2.25 * abs(apart[2])


@pytest.mark.parametrize("name", ["clutch_slip", "em2_speed", "half_shaft_torque"])
def test_errors_fall_with_the_inner_step(name: str, stored: Stored) -> None:
    errors = [
        np.sqrt(np.mean((ours(run(step_ns), name) - stored.signals[name]) ** 2))
        for step_ns in STEPS_NS
    ]
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    # First order, as the coupling of machines, oil and driveline is.
    assert orders.min() > 0.7, errors


def test_the_sleeve_synchronises_g1_turns_the_ring_and_flies_on_as_in_the_reference() -> None:
    reference = load("shift")
    found = shift_figures(run(50_000, "shift"), reference)
    assert found.cone < 50e-6
    assert found.sleeve < 5e-6
    assert found.flight < 1e-4
    names = [name for _, name in reference.events]
    assert "sleeve at ring" in names
    assert names.count("cone slip") >= 2


def told(line: str) -> list[float]:
    """Return the figures in a row of the page's tables."""
    return [float(cell.split()[0]) for cell in line.split("|")[2:-1]]


def page_row(begin: str) -> list[float]:
    (line,) = [line for line in PAGE.read_text().splitlines() if line.startswith(begin)]
    return told(line)


# Of both tables about the size only: they are differences of nearly equal numbers.
@pytest.mark.parametrize("name", LOCKS)
@pytest.mark.parametrize("step_ns", STEPS_NS)
def test_the_page_tells_the_figures_of_the_lock(step_ns: int, name: str) -> None:
    lock, *shares = page_row(f"| {name}, {step_ns // 1000} us |")
    fresh, *others = told(row(name, step_ns, figures(run(step_ns, name), load(name))))
    assert lock == pytest.approx(fresh, abs=1.0)
    assert shares == pytest.approx(others, rel=0.5, abs=2e-5)


@pytest.mark.parametrize("step_ns", STEPS_NS)
def test_the_page_tells_the_figures_of_the_shift(step_ns: int) -> None:
    cone, way, flight = page_row(f"| at {step_ns // 1000} us |")
    fresh, other, speed = told(
        shift_row(step_ns, shift_figures(run(step_ns, "shift"), load("shift")))
    )
    assert cone == pytest.approx(fresh, rel=0.5, abs=10.0)
    assert way == pytest.approx(other, rel=0.5, abs=0.5)
    assert flight == pytest.approx(speed, rel=0.5, abs=1e-5)
