"""Rotating inertias, shafts and meshes, the slider-crank, and what holds them together.

Written from the equations of the paper's full-order model: ``J*w' = sum of branch torques + ports``, each
branch ``k*q + c*q'`` with ``q' = r_a*w_a - r_b*w_b``; coordinates turn forward with the car.  What is
held is a constraint, solved for its torque with Lagrange multipliers.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

NAMES = [
    "Je", "Jc1", "Jc2", "Jm1", "Jid", "J1", "Jm2", "J2", "Jsleeve", "Jg11", "Jg12", "Jfd1", "Jg22",
    "Jg21", "Jfd2", "Jlw", "Jrw", "Jv", "Jrear",
]  # fmt: skip
N = len(NAMES)
AT = {name: index for index, name in enumerate(NAMES)}

SHAFTS = [
    ("1", "Je", "Jc1"), ("2", "Jc2", "J1"), ("3", "J1", "Jsleeve"), ("6", "J2", "Jg12"),
    ("5", "Jg12", "Jfd1"), ("4", "Jfd1", "Jg22"), ("lh", "Jfd2", "Jlw"), ("rh", "Jfd2", "Jrw"),
    ("lw", "Jlw", "Jv"), ("rw", "Jrw", "Jv"), ("rear", "Jrear", "Jv"),
]  # fmt: skip
MESHES = [
    ("m1", "Jm1", "rm1", "Jid", "rid"), ("id", "Jid", "rid", "J1", "r1"),
    ("m2", "Jm2", "rm2", "J2", "r2"), ("g1", "Jg11", "rg11", "Jg12", "rg12"),
    ("g2", "Jg21", "rg21", "Jg22", "rg22"), ("fd", "Jfd1", "rfd1", "Jfd2", "rfd2"),
]  # fmt: skip
BRANCHES = [name for name, *_ in SHAFTS] + [name for name, *_ in MESHES]
NB = len(BRANCHES)

# What can be held: torque counts on the first, against the second.
PAIRS = {"C1": ("Jc1", "Jc2"), "G1": ("Jsleeve", "Jg11"), "G2": ("Jsleeve", "Jg21")}


class Chain:
    """The driveline's constants."""

    def __init__(self, driveline: Any, rear: Any) -> None:
        self.inertia = np.array([driveline.inertias.get(name, 0.0) for name in NAMES])
        self.inertia[AT["Jrear"]] = rear.inertia
        self.inertia[AT["Jv"]] -= rear.inertia
        self.reach = np.zeros((NB, N))
        stiffness = {key[1:]: value for key, value in driveline.stiffness.items()}
        damping = {key[1:]: value for key, value in driveline.damping.items()}
        stiffness["rear"], damping["rear"] = rear.stiffness, rear.damping
        for row, (_, start, end) in enumerate(SHAFTS):
            self.reach[row, AT[start]], self.reach[row, AT[end]] = 1.0, -1.0
        for row, (_, start, r_start, end, r_end) in enumerate(MESHES, len(SHAFTS)):
            self.reach[row, AT[start]] = driveline.base_radii[r_start]
            self.reach[row, AT[end]] = -driveline.base_radii[r_end]
        self.k = np.array([stiffness[name] for name in BRANCHES])
        self.c = np.array([damping[name] for name in BRANCHES])
        self.pair = {name: self._row(*ends) for name, ends in PAIRS.items()}

    def _row(self, start: str, end: str) -> np.ndarray:
        row = np.zeros(N)
        row[AT[start]], row[AT[end]] = 1.0, -1.0
        return row

    def branch_torque(self, speeds: np.ndarray, twists: np.ndarray) -> np.ndarray:
        """Return what every branch carries, N m (meshes: N)."""
        torque: np.ndarray = self.k * twists + self.c * (self.reach @ speeds)
        return torque

    def accelerate(
        self, speeds: np.ndarray, twists: np.ndarray, torques: np.ndarray, extra_inertia: float,
        held: list[str],
    ) -> tuple[np.ndarray, list[float]]:  # fmt: skip
        """Return angular accelerations, and the torques that hold what is held.

        ``torques`` act on the inertias; ``extra_inertia`` is the crank's beyond Je.
        """
        mass = self.inertia.copy()
        mass[0] += extra_inertia
        free = (torques - self.branch_torque(speeds, twists) @ self.reach) / mass
        if not held:
            return free, []
        if len(held) == 1:
            row = self.pair[held[0]]
            spread = row / mass
            torque = -float(row @ free) / float(row @ spread)
            return free + torque * spread, [torque]
        rows = np.array([self.pair[name] for name in held])
        hold = -np.linalg.solve(rows / mass @ rows.T, rows @ free)
        return free + (hold @ rows) / mass, hold.tolist()


class Pistons:
    """Four pistons on one crank: kinetic energy ``(I(a) - mean)*w^2/2`` beyond what Je holds."""

    def __init__(self, crank: Any) -> None:
        self.mass, self.r, self.rod = crank.reciprocating_mass, crank.radius, crank.rod_length
        self.exact = bool(crank.get("exact_rod", True))
        k = self.r / self.rod
        share = k / (1.0 + math.sqrt(1.0 - k * k)) if self.exact else k / 2.0
        self.mean = 2.0 * self.mass * self.r**2 * (1.0 + share * share)

    def _slope(self, a: float) -> tuple[float, float]:
        """Return dx/da and d2x/da2 of one piston."""
        r, rod, s, c = self.r, self.rod, math.sin(a), math.cos(a)
        k = r / rod
        if not self.exact:
            return r * (s + k / 2.0 * math.sin(2.0 * a)), r * (c + k * math.cos(2.0 * a))
        root = math.sqrt(rod * rod - r * r * s * s)
        first = r * s + r * r * s * c / root
        second = r * c + r * r * (c * c - s * s) / root + r**4 * s * s * c * c / root**3
        return first, second

    def inertia(self, a: float) -> tuple[float, float]:
        """Return what they add to the mean inertia at crank angle ``a``, and its derivative."""
        total = slope = 0.0
        for shift in (0.0, math.pi):
            first, second = self._slope(a + shift)
            total += 2.0 * self.mass * first * first
            slope += 4.0 * self.mass * first * second
        return total - self.mean, slope
