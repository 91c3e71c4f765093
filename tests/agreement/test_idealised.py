"""Without its finer effects the detailed plant is the 16-DOF one."""

from __future__ import annotations

import numpy as np
import pytest

from hev_can_emu.plant import driveline, structure
from hev_can_emu.plant.detailed_parameters import Effects
from hev_can_emu.runtime.bench import Bench, BenchEvent
from hev_can_emu.runtime.setup import Setup

IDEAL = Effects(pistons=False, dog_play=False, rear_wheels=False)
SPEEDS = (
    "engine_speed", "em1_speed", "em2_speed", "wheel_left_speed", "wheel_right_speed", "body_speed",
)  # fmt: skip
WATCHED = (*SPEEDS, "clutch_torque", "acceleration", "clutch_slip")


def bench(model: str) -> Bench:
    made = Bench(Setup(model=model), IDEAL if model == "detailed" else None)
    made.command(external_battery_voltage=350.0)
    return made


def driven(model: str) -> np.ndarray:
    """Drive off in parallel G1 and step the torques of all machines; one row per millisecond."""
    car = bench(model)
    parts = []
    for milliseconds, engine, em1, em2 in (
        (500, 0.0, 0.0, 0.0), (1500, 60.0, 10.0, 80.0), (700, -20.0, 0.0, -60.0),
        (700, 100.0, 40.0, 150.0),
    ):  # fmt: skip
        car.command(
            external_engine_torque=engine, external_em1_torque=em1, external_em2_torque=em2,
            external_clutch_capacity=400.0, external_gear=1.0,
        )  # fmt: skip
        parts.append(car.advance(milliseconds, WATCHED))
    return np.vstack(parts)


def test_parallel_driving_is_the_same() -> None:
    simple, detailed = driven("16dof"), driven("detailed")
    size = np.abs(simple).max(axis=0)
    apart = np.abs(detailed - simple).max(axis=0) / size
    for name in (*SPEEDS, "clutch_torque"):
        assert apart[WATCHED.index(name)] < 1e-6, name
        assert size[WATCHED.index(name)] > 5.0, name
    # Air drag follows the speed at each inner step in one, at each millisecond in the other.
    assert apart[WATCHED.index("acceleration")] < 2e-6


def closed(model: str) -> tuple[BenchEvent, np.ndarray]:
    """Let C1 slip and lock in neutral; return its lock and the speeds 80 ms later."""
    car = bench(model)
    car.command(
        external_engine_torque=0.0, external_em1_torque=20.0, external_em2_torque=0.0,
        external_clutch_capacity=0.0, external_gear=0.0,
    )  # fmt: skip
    car.advance(800)
    car.command(
        external_engine_torque=80.0, external_em1_torque=-10.0, external_clutch_capacity=90.0
    )
    while car.truth("clutch_held") == 0.0:
        car.advance(1)
        assert car.t_ns < 2_000_000_000
    (lock,) = [event for event in car.events if event.which == structure.C1]
    car.command(external_clutch_capacity=400.0)  # lest the ringing tears it open again
    return lock, car.advance(80, SPEEDS)[-1]


def test_c1_locks_at_the_same_instant_with_the_same_momentum() -> None:
    (lock, simple), (same, detailed) = closed("16dof"), closed("detailed")
    assert lock.kind == same.kind == driveline.LOCKED
    # Each finds the instant on a grid of its own, of 1 ms / 1024 and 50 us / 64.
    assert same.t_ns == pytest.approx(lock.t_ns, abs=1000)
    assert detailed == pytest.approx(simple, rel=1e-5, abs=1e-9)
