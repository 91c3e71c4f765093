"""Compute the reference run and store it: python tests/reference/compute.py

Takes some minutes.  What is stored carries the hash of all that it follows from (values of the vehicle
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
from reference.car import Car  # noqa: E402
from reference.parameters import read  # noqa: E402

VEHICLE = TESTS.parent / "vehicles" / "dai2024.yaml"
STORED = Path(__file__).resolve().parent / "switch.npz"
SAMPLE = 1e-3  # s
USED = ("engine", "em1", "em2", "hydraulics", "clutch", "transmission", "rear_axle")


def prepare() -> tuple[Car, np.ndarray, np.ndarray, switch.Start]:
    """Return the car, its state at the start, the commands and the start itself."""
    start = switch.Start()
    car = Car(read(VEHICLE), start.temperature)
    return car, switch.initial(car, start), switch.commands(car, start), start


def digest() -> str:
    """Return the hash of what the run is computed from."""
    file = read(VEHICLE)
    used: dict[str, Any] = {key: file.detailed[key] for key in USED}
    used["driveline"] = {k: v for k, v in file.driveline.items() if k != "reduced_ratios"}
    used["road"] = file.machines.road
    _, _, given, start = prepare()
    found = hashlib.sha256(json.dumps(used, sort_keys=True).encode())
    found.update(repr(start).encode())
    found.update(np.round(given, 9).tobytes())
    return found.hexdigest()


def main() -> None:
    """Run the whole switch and store it."""
    car, y, given, _ = prepare()
    started = time.process_time()

    def told(t: float) -> None:
        if round(t / car.em1.p.control.period) % 500 == 0:
            print(
                f"{t:.2f} s of {switch.PERIOD * len(given):g} after {time.process_time() - started:.0f} s"
            )

    run = switch.simulate(car, y, given, SAMPLE, told=told)
    np.savez_compressed(
        STORED,
        digest=digest(),
        times=run.times,
        signals=run.signals,
        names=np.array(switch.SIGNALS),
        event_times=np.array([at for at, _ in run.events]),
        event_names=np.array([name for _, name in run.events]),
        final=run.final,
    )
    for at, name in run.events:
        if name != "half turn":
            print(f"{at:.7f} s  {name}")


if __name__ == "__main__":
    main()
