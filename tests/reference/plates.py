"""The plates of C1: friction map, drag of the oil film, heat."""

from __future__ import annotations

import math
from typing import Any

from reference.parameters import line


class Plates:
    """Constants; all torques are magnitudes."""

    def __init__(self, p: Any, wear: float = 0.0) -> None:
        self.p = p
        f = p.friction
        ro, ri = p.outer_radius, p.inner_radius
        self.radius = 2.0 / 3.0 * (ro**3 - ri**3) / (ro**2 - ri**2)
        self.area = math.pi * (ro**2 - ri**2) * (1.0 - p.groove_share)
        self.curve = [(1.0 - wear) * a + wear * b for a, b in zip(f.fresh, f.aged, strict=True)]
        self.static = (1.0 - wear) * f.static_fresh + wear * f.static_aged

    def _factor(self, force: float, temperature: float) -> float:
        f = self.p.friction
        by_pressure = line(force / self.area, f.pressure, f.pressure_factor)
        return by_pressure * line(temperature, f.temperature, f.temperature_factor)

    def kinetic(self, slip: float, force: float, temperature: float) -> float:
        """Return the capacity while they slide, N m."""
        mu = line(abs(slip) * self.radius, self.p.friction.speed, self.curve)
        return float(mu * self._factor(force, temperature) * force * self.p.surfaces * self.radius)

    def holding(self, force: float, temperature: float) -> float:
        """Return the static capacity, N m."""
        lever = self.p.surfaces * self.radius
        return float(self.static * self._factor(force, temperature) * force * lever)

    def drag(self, slip: float, piston: float, force: float, oil_temperature: float) -> float:
        """Return the shear torque of the oil film, N m, as far as ``force`` leaves one."""
        p = self.p
        thin = math.exp(-p.viscosity_slope * (oil_temperature - p.viscosity_temperature))
        gap = max(p.kiss_travel - piston, 0.0) / p.surfaces + p.least_gap
        moment = math.pi / 2.0 * (p.outer_radius**4 - p.inner_radius**4) * (1.0 - p.groove_share)
        shear = p.viscosity * thin * p.surfaces * moment * abs(slip) / gap
        film = math.exp(-force / self.area / p.film_pressure)
        return float(film * shear / (1.0 + (slip / p.expulsion_slip) ** 2))

    def cooling(self, flow: float) -> float:
        """Return the heat flow per kelvin above the oil, W/K."""
        return float(self.p.still_cooling + self.p.oil_heat * flow)
