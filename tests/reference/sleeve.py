"""The sleeve on its way to G1: notches, struts, ring, what the cone carries; dogs that find a gap."""

from __future__ import annotations

import math
from typing import Any


def _notch(force: float, begin: float, width: float, s: float) -> float:
    """Return the force of a notch that is climbed over ``width`` from ``begin``, N."""
    u = (s - begin) / width
    return 4.0 * force * u * (1.0 - u) if 0.0 < u < 1.0 else 0.0


class Sleeve:
    """Constants; positions count from the centre towards G1."""

    def __init__(self, p: Any) -> None:
        self.p = p
        steep, mu = math.tan(p.ring_chamfer_angle), p.chamfer_friction
        self.index_lever = p.dog_radius * (1.0 - mu * steep) / (steep + mu)
        self.cone = p.cone_friction * p.cone_radius * p.cones_g1 / math.sin(p.cone_angle)

    def struts(self, s: float) -> float:
        """Return what the struts press the ring with, N."""
        p = self.p
        return _notch(p.strut_force, p.strut_position, p.blocking_position - p.strut_position, s)

    def back(self, s: float) -> float:
        """Return the force of notches and struts back towards the centre, N."""
        p = self.p
        on = _notch(p.engaged_force, p.end_position - p.engaged_width, p.engaged_width, s)
        return _notch(p.neutral_force, 0.0, p.neutral_width, s) + self.struts(s) - on

    def dry(self, s: float, push: float, outward: bool, flanks: float) -> float:
        """Return the dry friction, N; the dogs' flanks add ``flanks``."""
        p = self.p
        size = p.guide_friction + flanks
        if p.blocking_position <= s < p.dog_position and outward and push > 0.0:
            size += p.flight_share * push
        return float(size)

    def ring_force(self, s: float, push: float, ring: float) -> float:
        """Return what presses the cone, N."""
        p = self.p
        if s < p.blocking_position:
            return self.struts(s)
        if ring < 1.0:
            return float(max(push - p.guide_friction, 0.0))
        return float(p.flight_share * max(push, 0.0))

    def ring_rate(self, push: float, carried: float) -> float:
        """Return how fast the ring turns out of the way; ``carried`` is the cone's blocking torque."""
        p = self.p
        net = push - p.guide_friction - carried / self.index_lever
        return float(max(net, 0.0) / (p.index_time * p.index_force))
