"""Play in a mesh: two inertias that rattle in it, and the car's first gear under a change of torque."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.commands._components.small import Stand, two_inertias
from hev_can_emu.plant.holding import MESH, PARTED, TOUCHED
from hev_can_emu.report.component_plot import Curve, Fact, Panel

INERTIAS = (0.01, 0.02)
PLAY, STIFFNESS, SPEED = 0.02, 2e4, 5.0  # rad, N m/rad, rad/s
STEP = 5e-5


def rattle(damping: float, steps: int) -> tuple[np.ndarray, Stand]:
    """Return times, place within the play (deflection counted from the middle) and relative speed."""
    stand = Stand(two_inertias(*INERTIAS, STIFFNESS, damping, joined=True), STEP, 6, PLAY)
    j1, j2 = INERTIAS
    stand.x[0], stand.x[1] = SPEED * j2 / (j1 + j2), -SPEED * j1 / (j1 + j2)
    rows, place = [], 0.0
    for _ in range(steps):
        before = stand.x[0] - stand.x[1]
        rows.append((stand.t_ns * 1e-9, place, before))
        stand.advance()
        contact = stand.state[MESH]
        place = stand.x[stand.twist] + contact * 0.5 * PLAY
    return np.array(rows), stand


def show(_car: Car) -> Card:
    """Compute the card; its two inertias are no part of the car."""
    free, stand = rattle(0.0, 1200)
    damped, _ = rattle(0.6, 1200)
    j = 1.0 / (1.0 / INERTIAS[0] + 1.0 / INERTIAS[1])
    natural = math.sqrt(STIFFNESS / j)
    period = 2.0 * PLAY / SPEED + 2.0 * math.pi / natural
    touches = [e["t_ns"] * 1e-9 for e in stand.record[: stand.count] if e["kind"] == TOUCHED]
    parts = [e["t_ns"] * 1e-9 for e in stand.record[: stand.count] if e["kind"] == PARTED]
    found = (touches[-1] - touches[0]) / (len(touches) - 1) * 2.0
    contact = float(np.mean([b - a for a, b in zip(touches, parts, strict=False)]))
    deepest = float(np.max(np.abs(free[:, 1])))
    energy = 0.5 * j * free[-1, 2] ** 2
    beyond = max(abs(free[-1, 1]) - 0.5 * PLAY, 0.0)
    energy += 0.5 * STIFFNESS * beyond**2
    facts = [
        Fact("period: 2 play/v + 2 pi sqrt(J/k)", "s", period, found, 2e-3),
        Fact("contact lasts pi sqrt(J/k)", "s", math.pi / natural, contact, 5e-3),
        Fact("deepest: half the play and v sqrt(J/k)", "rad", 0.5 * PLAY + SPEED / natural, deepest, 2e-3),
        Fact("energy after 60 ms without damping", "J", 0.5 * j * SPEED**2, energy, 2e-3),
    ]  # fmt: skip
    panels = [
        Panel("Place in the play", "time (ms)", "rad",
              [Curve("undamped", 1e3 * free[:, 0], free[:, 1]),
               Curve("damped", 1e3 * damped[:, 0], damped[:, 1]),
               Curve("flanks", np.array([0.0, 60.0]), np.full(2, 0.5 * PLAY), True, color="#8a929c"),
               Curve("", np.array([0.0, 60.0]), np.full(2, -0.5 * PLAY), True, color="#8a929c")]),
        Panel("Speed over place: never adhesive", "rad", "rad/s",
              [Curve("undamped", free[:, 1], free[:, 2]), Curve("damped", damped[:, 1], damped[:, 2])]),
    ]  # fmt: skip
    return Card("Play in a mesh", panels, facts)
