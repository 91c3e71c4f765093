"""Clutch C1 as a capacity that follows its request through the actuator's delay, slew and lag."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.plant import checks
from hev_can_emu.plant.torque_source import TorqueSourceParameters


class ClutchParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A friction clutch; SI units.

    Attributes:
        source: delay, slew and lag of the torque capacity.
        max_capacity: greatest capacity while slipping, N m.
        static_ratio: static over kinetic capacity, 1 or more.
    """

    source: TorqueSourceParameters
    max_capacity: float
    static_ratio: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        self.source.validate(f"{where}.source")
        checks.positive(where, self, "max_capacity")
        if not self.static_ratio >= 1.0:
            raise InputError(f"{where}.static_ratio", "1 or more", repr(self.static_ratio))

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernel's parameters for a period of ``dt`` s."""
        return np.concatenate([self.source.pack(dt), [self.max_capacity, self.static_ratio]])


class ShortCircuitParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Steady braking of an actively short-circuited motor; SI units.

    Attributes:
        peak_torque: greatest braking torque, N m.
        speed: at which it occurs, rad/s.
    """

    peak_torque: float
    speed: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "peak_torque", "speed")
