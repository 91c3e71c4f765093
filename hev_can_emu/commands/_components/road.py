"""Road and brakes: the detailed car held on a hill, rolling back, braked, and coasting."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.plant.road import GRAVITY
from hev_can_emu.report.component_plot import Curve, Fact, Panel
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.setup import Setup

GRADE = 0.12
SINE, COSINE = GRADE / math.hypot(1.0, GRADE), 1.0 / math.hypot(1.0, GRADE)


def bench(vehicle: str) -> Bench:
    """Return the detailed car with both motors off, C1 open, in neutral."""
    stand = Bench(Setup(model="detailed", vehicle=vehicle))
    stand.command(contactor=0.0)
    return stand


def rolling_inertia(car: Car) -> float:
    """Return what turns with the wheels in neutral, as mass of the body, kg."""
    j, r = car.driveline.inertias, car.driveline.base_radii
    final = r["rfd2"] / r["rfd1"]
    motor = r["r2"] / r["rm2"]
    second = r["rg22"] / r["rg21"]
    first = r["rg12"] / r["rg11"]
    layshaft = j["Jg12"] + j["J2"] + j["Jm2"] * motor**2 + j["Jfd1"] + j["Jg22"]
    layshaft += j["Jg21"] * second**2 + j["Jg11"] * first**2
    total = j["Jv"] + j["Jlw"] + j["Jrw"] + j["Jfd2"] + layshaft * final**2
    return total / car.driveline.tyre_radius**2


def hill(vehicle: str) -> np.ndarray:
    """Hold for 4 s, let go at 4 s, brake again at 8 s; return t, speed m/s, held, brake torque N m."""
    stand = bench(vehicle)
    stand.command(grade=GRADE, brake_torque=2500.0)
    watch = ("vehicle_speed", "body_held", "brake_torque", "wheel_left_speed")
    parts = [stand.advance(4000, watch)]
    stand.command(brake_torque=0.0)
    parts.append(stand.advance(4000, watch))
    stand.command(brake_torque=2500.0)
    parts.append(stand.advance(10000, watch))
    rows = np.vstack(parts)
    return np.column_stack([1e-3 * np.arange(1, len(rows) + 1), rows])


def show(car: Car) -> Card:
    """Compute the card."""
    rows = hill(car.name)
    mass = car.driveline.inertias["Jv"] / car.driveline.tyre_radius**2
    moved = rolling_inertia(car)
    rolling = car.machines.road.rolling_coefficient
    pull = mass * GRAVITY * (SINE - rolling * COSINE) / moved
    released = (rows[:, 0] > 5.0) & (rows[:, 0] < 6.0)
    slope = float(np.polyfit(rows[released, 0], rows[released, 1], 1)[0])
    position = np.cumsum(rows[:, 1]) * 1e-3
    held = position[(rows[:, 0] > 3.0) & (rows[:, 0] < 4.0)]
    end = rows[-2000:, 1]
    braked = (rows[:, 0] > 8.15) & (rows[:, 0] < 8.6)
    radius = car.driveline.tyre_radius
    stopping = 2500.0 / radius / moved - pull
    deceleration = float(np.polyfit(rows[braked, 0], rows[braked, 1], 1)[0])
    facts = [
        Fact("held by 2500 N m: way in the fourth second", "m", 0.0, float(np.ptp(held)), 1e-9),
        Fact("rolls back: g (sin a - f cos a), turning parts counted", "m/s^2", -pull, slope, 0.01),
        Fact("caught by the brakes: deceleration", "m/s^2", stopping, deceleration, 0.03),
        Fact(
            "stands again, settled on its tyres: speed in the end", "m/s", 0.0,
            float(np.max(np.abs(end))), 1e-12,
        ),
    ]  # fmt: skip
    time = rows[:, 0]
    known = np.where(time < 4.0, 0.0, -pull * (time - 4.1))
    until = time < 7.9
    panels = [
        Panel(
            f"A hill of {100 * GRADE:g} %: held, let go at 4 s, braked at 8 s",
            "time (s)", "speed (m/s)",
            [Curve("body", time, rows[:, 1]),
             Curve("known: rolling back", time[until], np.minimum(known, 0.0)[until], True, color="#22272e")],
        ),
        Panel("Way", "time (s)", "m", [Curve("", time, position)]),
        Panel("Brakes, sum of the wheels", "time (s)", "N m", [Curve("capacity", time, rows[:, 3])]),
        Panel("The stop at 8 s: the car settles on its tyres", "time (s)", "speed (m/s)",
              [Curve("body", time[time > 8.0], rows[time > 8.0, 1]),
               Curve("front wheel", time[time > 8.0], rows[time > 8.0, 4] * radius)]),
    ]  # fmt: skip
    return Card("Road and brakes", panels, facts)
