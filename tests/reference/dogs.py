"""The dogs of G1 once they overlap: free in their play, and pressed against one end of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from reference.hybrid import Crossing


class Dogs:
    """Constants, and modes: whether they are in, and at which end they touch.

    Attributes:
        near: whether the sleeve has passed their tips.
        inside: whether they overlap.
        side: of the play at which they touch: 1 where the sleeve pushes the gear on, -1, or 0.
    """

    def __init__(self, p: Any) -> None:
        self.pitch = 2.0 * math.pi / p.dog_teeth
        self.half = p.half_clearance
        self.grip = p.dog_friction / p.dog_radius
        self.tips = p.dog_position - p.chamfer_depth
        self.slip = p.dog_slip
        self.near, self.inside, self.side = False, False, 0

    def place(self, angle: float, slip: float) -> float:
        """Return from the gap's middle an angle of the sleeve against the gear.

        Raises:
            RuntimeError: for dogs that meet: chamfers and grating are not part of this reference.
        """
        found = angle - self.pitch * round(angle / self.pitch)
        if abs(found) > self.half or abs(slip) > self.slip:
            where = f"{1e3 * found:.3f} mrad off the middle of a gap"
            raise RuntimeError(f"the dogs meet {where} at {slip:.3f} rad/s")
        return found

    def crossings(self, gap: int, slip: Any, carried: Any) -> list[Crossing]:
        """Return what may change; ``gap`` is the place of their angle in the state.

        ``slip(y)`` is the sleeve's against the gear, ``carried(y)`` what holds the sleeve, N m.
        """
        if self.side:
            return [Crossing("dogs part", lambda t, y: carried(y) * self.side)]

        def beyond(y: np.ndarray, side: float) -> float:
            # Once out of the play only as long as that goes on: they have just parted.
            away = side * float(y[gap]) - self.half
            return away if away < 0.0 or side * slip(y) > 0.0 else -1e-15

        return [
            Crossing("dogs meet ahead", lambda t, y: beyond(y, 1.0)),
            Crossing("dogs meet behind", lambda t, y: beyond(y, -1.0)),
        ]

    def meet(self, ahead: bool, first: float, second: float, speeds: tuple[float, float]) -> float:
        """Let them touch without a bounce; return the speed of both inertias then."""
        self.side = 1 if ahead else -1
        return (first * speeds[0] + second * speeds[1]) / (first + second)
