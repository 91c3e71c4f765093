"""How far the product is from the reference, as figures: python tests/agreement/measures.py"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "agreement")]

from product import SIGNALS, Product, Run, changes  # noqa: E402
from reference import compute  # noqa: E402
from scipy.signal import butter, sosfiltfilt  # noqa: E402

from hev_can_emu.plant import driveline, structure  # noqa: E402

STEPS_NS = (100_000, 50_000, 25_000)
LOCKS = ("close", "switch")  # manoeuvres in which C1 locks


class Stored(NamedTuple):
    """The reference's run: a column per signal, one row per millisecond; (time, name) of events."""

    digest: str
    signals: dict[str, np.ndarray]
    events: list[tuple[float, str]]


class Figures(NamedTuple):
    """Distances from the reference: of the lock's instant in s, of all else as shares."""

    lock: float
    half_shaft_peak: float
    half_shaft_rms: float
    input_shaft_peak: float
    input_shaft_rms: float
    heat: float


def load(name: str) -> Stored:
    """Return the stored run of a manoeuvre."""
    with np.load(compute.stored(name)) as file:
        columns = dict(zip(file["names"].tolist(), file["signals"].T, strict=True))
        told = zip(file["event_times"].tolist(), file["event_names"].tolist(), strict=True)
        return Stored(str(file["digest"]), columns, list(told))


def product(name: str, step_ns: int) -> Run:
    """Return the product's run of a manoeuvre with an inner step."""
    car, y, given, start = compute.prepare(name)
    return Product(start, car, y, step_ns).run(given)


def ours(run: Run, name: str) -> np.ndarray:
    """Return one signal of the product."""
    column: np.ndarray = run.signals[:, SIGNALS.index(name)]
    return column


def rms_below_300_hz(torque: np.ndarray) -> float:
    """Return the RMS of a torque behind a low-pass filter without phase shift."""
    smooth = sosfiltfilt(butter(4, 300.0, fs=1.0 / compute.SAMPLE, output="sos"), torque)
    return float(np.sqrt(np.mean(smooth**2)))


def figures(run: Run, stored: Stored) -> Figures:
    """Return the distances of one run."""
    first = next(at for at, name in stored.events if name == "C1 slip")
    locks = [e.time for e in changes(run, structure.C1) if e.kind == driveline.LOCKED]

    def peak(name: str) -> float:
        return float(np.abs(ours(run, name)).max() / np.abs(stored.signals[name]).max() - 1.0)

    def rms(name: str) -> float:
        return rms_below_300_hz(ours(run, name)) / rms_below_300_hz(stored.signals[name]) - 1.0

    half, shaft = "half_shaft_torque", "input_shaft_torque"
    heat = ours(run, "clutch_heat")[-1] / stored.signals["clutch_heat"][-1] - 1.0
    return Figures(locks[0] - first, peak(half), rms(half), peak(shaft), rms(shaft), float(heat))


def row(name: str, step_ns: int, found: Figures) -> str:
    """Return a row of the page's table."""
    shares = " | ".join(f"{value:.1e}" for value in found[1:])
    return f"| {name}, {step_ns // 1000} us | {1e6 * found.lock:.1f} us | {shares} |"


class ShiftFigures(NamedTuple):
    """Distances from the reference.

    Of the instants at which the cone catches and lets go until the ring has turned, s; of the sleeve's
    place all the way, m; of its speed behind the ring, as a share.
    """

    cone: float
    sleeve: float
    flight: float


def shift_figures(run: Run, stored: Stored) -> ShiftFigures:
    """Return the largest distances of a run."""
    end = next(at for at, name in stored.events if name == "ring turned")
    told = {"cone slip": driveline.LOCKED, "cone lets go": driveline.RELEASED}
    # While the sleeve is at the centre nothing presses the cone.
    expected = [(at, told[name]) for at, name in stored.events if name in told and 0.22 < at < end]
    found = [event for event in changes(run, structure.G1) if event.time < end]
    assert [event.kind for event in found] == [kind for _, kind in expected]
    apart = [abs(event.time - at) for event, (at, _) in zip(found, expected, strict=True)]
    place, known = ours(run, "sleeve_position"), stored.signals["sleeve_position"]
    flight = slice(math.ceil(end / compute.SAMPLE) + 1, None)
    speed, expected_speed = np.diff(place[flight]), np.diff(known[flight])
    assert len(speed) >= 10
    return ShiftFigures(
        max(apart),
        float(np.abs(place - known).max()),
        float(np.abs(speed / expected_speed - 1.0).max()),
    )


def shift_row(step_ns: int, found: ShiftFigures) -> str:
    """Return a row of the page's second table."""
    cone, way = 1e6 * found.cone, 1e6 * found.sleeve
    return f"| at {step_ns // 1000} us | {cone:.0f} us | {way:.1f} um | {found.flight:.1e} |"


if __name__ == "__main__":
    for manoeuvre in LOCKS:
        reference = load(manoeuvre)
        for step in STEPS_NS:
            print(row(manoeuvre, step, figures(product(manoeuvre, step), reference)))
    reference = load("shift")
    for step in STEPS_NS:
        print(shift_row(step, shift_figures(product("shift", step), reference)))
