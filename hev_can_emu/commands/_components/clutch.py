"""The wet clutch: two inertias that lock, friction maps, drag, heat."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.commands._components.small import Stand, two_inertias
from hev_can_emu.plant import wet_clutch
from hev_can_emu.plant.holding import LOCKED
from hev_can_emu.report.component_plot import Curve, Fact, Panel

INERTIAS, SPEEDS, CAPACITY, TORQUES = (0.2, 0.5), (200.0, 50.0), 120.0, (30.0, -10.0)
LOCK_TIME, HEAT = 0.2238806, 2014.925  # of the closed form for these

WARM = 363.15


def lock_up() -> tuple[np.ndarray, float, float]:
    """Return times and both speeds, shape (n, 3), the lock's time s and the friction's heat J."""
    stand = Stand(two_inertias(*INERTIAS), 1e-3)
    stand.x[:2] = SPEEDS
    stand.torques = TORQUES
    stand.kinetic[0] = stand.static[0] = CAPACITY
    rows, heat = [(0.0, *SPEEDS)], 0.0
    for _ in range(300):
        before = 0.5 * INERTIAS[0] * stand.x[0] ** 2 + 0.5 * INERTIAS[1] * stand.x[1] ** 2
        w = stand.x[:2].copy()
        stand.advance()
        after = 0.5 * INERTIAS[0] * stand.x[0] ** 2 + 0.5 * INERTIAS[1] * stand.x[1] ** 2
        rows.append((stand.t_ns * 1e-9, *stand.x[:2]))
        # Work of the given torques: speeds are straight lines except in the step of the lock.
        if math.isnan(stand.first(LOCKED)):
            worked = 0.5e-3 * float(np.dot(TORQUES, w + stand.x[:2]))
        else:
            break
        heat += before - after + worked
    lock = stand.first(LOCKED)
    # The rest of the last step, by the speeds at its beginning.
    left = lock - (rows[-1][0] - 1e-3)
    heat += CAPACITY * 0.5 * abs(w[0] - w[1]) * left
    for _ in range(80):
        stand.advance()
        rows.append((stand.t_ns * 1e-9, *stand.x[:2]))
    return np.array(rows), lock, heat


def show(car: Car) -> Card:
    """Compute the card."""
    rows, lock, heat = lock_up()
    j1, j2 = INERTIAS
    acceleration = (TORQUES[0] - CAPACITY) / j1 - (TORQUES[1] + CAPACITY) / j2
    time = np.array([0.0, LOCK_TIME])
    known = [np.array([w, w + LOCK_TIME * rate]) for w, rate in zip(
        SPEEDS, ((TORQUES[0] - CAPACITY) / j1, (TORQUES[1] + CAPACITY) / j2), strict=True)]  # fmt: skip
    locking = Panel(
        "Two inertias (0.2 and 0.5 kg m^2) and 120 N m",
        "time (s)", "speed (rad/s)",
        [
            Curve("first", rows[:, 0], rows[:, 1]),
            Curve("second", rows[:, 0], rows[:, 2]),
            Curve("known", time, known[0], True, color="#22272e"),
            Curve("", time, known[1], True, color="#22272e"),
        ],
    )  # fmt: skip

    plates = car.detailed.clutch
    fresh, aged = plates.pack(wear=0.0), plates.pack(wear=1.0)
    force = 2000.0
    speed = np.linspace(0.0, 8.0, 300)
    slips = speed / plates.friction_radius
    curves = []
    for name, p in (("fresh", fresh), ("aged", aged)):
        values = [wet_clutch.friction_coefficient(p, w, force, WARM) for w in slips]
        curves.append(Curve(name, speed, np.array(values)))
    friction = Panel("Friction at 90 degC and 2 kN", "sliding speed (m/s)", "coefficient", curves)
    forces = np.linspace(0.0, 6000.0, 100)
    out, x = np.zeros(wet_clutch.N_OUT), np.array([WARM])
    capacity = []
    for name, p in (("fresh", fresh), ("aged", aged)):
        found = []
        for each in forces:
            wet_clutch.capacity_step(p, x, each, plates.kiss_travel, 50.0, 353.15, out)
            found.append((out[wet_clutch.OUT_KINETIC], out[wet_clutch.OUT_STATIC]))
        both = np.array(found)
        capacity.append(Curve(f"{name}, sliding", forces, both[:, 0]))
        capacity.append(Curve(f"{name}, static", forces, both[:, 1], True))
    carries = Panel(
        "What it carries: sliding at 50 rad/s, and static",
        "force on the plates (N)",
        "torque (N m)",
        capacity,
    )
    slip = np.linspace(0.0, 400.0, 200)
    drags = []
    for piston in (0.0, 0.8, 0.98):
        travel = piston * plates.kiss_travel
        values = [wet_clutch.drag_torque(fresh, w, travel, 0.0, 353.15) for w in slip]
        drags.append(Curve(f"piston at {100 * piston:.0f} %", slip, np.array(values)))
    drag = Panel(
        "Drag of the open clutch, piston at a share of its way to the plates",
        "slip (rad/s)",
        "torque (N m)",
        drags,
    )

    hot = np.array([353.15])
    heat_out = np.zeros(wet_clutch.N_HEAT)
    for _ in range(20000):
        wet_clutch.heat_step(fresh, hot, 0.1, 0.0, 353.15, heat_out)
    tau = plates.heat_capacity / plates.still_cooling
    settled = 0.1 / 5e-5 / plates.still_cooling
    warmed = settled * (1.0 - math.exp(-1.0 / tau))
    one = plates.friction.fresh[0]
    facts = [
        Fact("lock-up", "s", LOCK_TIME, lock, 1e-6 / LOCK_TIME),
        Fact("   by dw/(dw/dt)", "s", (SPEEDS[1] - SPEEDS[0]) / acceleration, lock, 1e-6 / LOCK_TIME),
        Fact("heat: capacity times dw t/2", "J", HEAT, heat, 1e-5),
        Fact(
            "fresh coefficient at rest, at 5 bar and 90 degC", "1", one,
            wet_clutch.friction_coefficient(fresh, 0.0, 5e5 * _area(plates), WARM), 1e-9,
        ),
        Fact("2 kW for a second into the plates, oil standing", "K", warmed, float(hot[0] - 353.15), 1e-9),
    ]  # fmt: skip
    return Card("Wet clutch C1", [locking, friction, carries, drag], facts)


def _area(plates: wet_clutch.WetClutchParameters) -> float:
    """Return the lining's area of one surface without grooves, m^2."""
    ring = math.pi * (plates.outer_radius**2 - plates.inner_radius**2)
    return ring * (1.0 - plates.groove_share)
