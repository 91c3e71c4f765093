"""Compute the reference's runs and store them: python tests/reference/compute.py [NAME ...]

Takes some minutes each.  What is stored carries the hash of all that it follows from (values of the vehicle
file, start, commands), so that a test can tell a stale one; another computes a stretch of it anew.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

TESTS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(TESTS))

from reference import switch  # noqa: E402
from reference.car import GAP, Car  # noqa: E402
from reference.parameters import read  # noqa: E402

VEHICLE = TESTS.parent / "vehicles" / "dai2024.yaml"
FOLDER = Path(__file__).resolve().parent
SAMPLE = 1e-3  # s
USED = ("engine", "em1", "em2", "hydraulics", "clutch", "transmission", "rear_axle", "sleeve")


def stored(name: str) -> Path:
    """Return where the run of a manoeuvre is kept."""
    return FOLDER / f"{name}.npz"


def prepare(name: str) -> tuple[Car, np.ndarray, np.ndarray, switch.Start]:
    """Return the car, its state at the start, the commands of a manoeuvre and the start itself."""
    start = switch.Start()
    car = Car(read(VEHICLE), start.temperature)
    return (
        car,
        switch.initial(car, start, switch.MANOEUVRES[name]),
        switch.commands(car, start, switch.MANOEUVRES[name]),
        start,
    )


def digest(name: str) -> str:
    """Return the hash of what the run is computed from."""
    file = read(VEHICLE)
    used: dict[str, Any] = {key: file.detailed[key] for key in USED}
    used["driveline"] = {k: v for k, v in file.driveline.items() if k != "reduced_ratios"}
    # The engine runs all the time.
    used["engine"] = {k: v for k, v in file.detailed.engine.items() if k != "breakaway"}
    used["road"] = file.machines.road
    _, y, given, start = prepare(name)
    found = hashlib.sha256(json.dumps(used, sort_keys=True).encode())
    found.update(repr(start).encode())
    found.update(np.round(given, 9).tobytes())
    found.update(np.round(y[GAP], 9).tobytes())
    return found.hexdigest()


def run(name: str) -> None:
    """Run a manoeuvre and store it."""
    car, y, given, _ = prepare(name)
    started = time.process_time()

    def told(t: float) -> None:
        if round(t / car.em1.p.control.period) % 500 == 0:
            print(
                f"{t:.2f} s of {switch.PERIOD * len(given):g} after {time.process_time() - started:.0f} s"
            )

    found = switch.simulate(car, y, given, SAMPLE, told=told)
    np.savez_compressed(
        stored(name),
        digest=digest(name),
        times=found.times,
        signals=found.signals,
        names=np.array(switch.SIGNALS),
        event_times=np.array([at for at, _ in found.events]),
        event_names=np.array([what for _, what in found.events]),
        final=found.final,
    )
    for at, what in found.events:
        if what != "half turn":
            print(f"{at:.7f} s  {what}")


if __name__ == "__main__":
    for manoeuvre in sys.argv[1:] or switch.MANOEUVRES:
        run(manoeuvre)
