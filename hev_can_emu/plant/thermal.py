"""Temperatures of a machine: winding and inverter, one node each against the coolant.

``C*dT/dt = loss - (T - T_coolant)/R``, stepped exactly for a loss constant over the period:
``T := T_end + (T - T_end)*exp(-dt/(R*C))`` with ``T_end = T_coolant + R*loss``.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks

# Layout of one packed node.
P_RESISTANCE, P_KEEP = 0, 1
N_NODE = 2

# Layout of a packed machine: the winding's node, then the inverter's.
P_WINDING, P_INVERTER = 0, N_NODE
N_PARAMETERS = 2 * N_NODE

# Layout of a machine's state, K.
X_WINDING, X_INVERTER = 0, 1
N_STATE = 2


class ThermalNode(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One heat capacity cooled through one resistance.

    Attributes:
        capacity: J/K.
        resistance: to the coolant, K/W.
    """

    capacity: float
    resistance: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "capacity", "resistance")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the node's parameters, shape ``(N_NODE,)``, for a period of ``dt`` s."""
        return np.array([self.resistance, math.exp(-dt / (self.capacity * self.resistance))])


class ThermalParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Winding and inverter of one machine."""

    winding: ThermalNode
    inverter: ThermalNode

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        self.winding.validate(f"{where}.winding")
        self.inverter.validate(f"{where}.inverter")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a period of ``dt`` s."""
        return np.concatenate([self.winding.pack(dt), self.inverter.pack(dt)])


@small_kernel
def node_step(
    p: NDArray[np.float64], offset: int, temperature: float, loss: float, coolant: float
) -> float:
    """Return the temperature, K, of the node packed at ``p[offset:]`` after one period of ``loss``, W."""
    settled: float = coolant + p[offset + P_RESISTANCE] * loss
    keep: float = p[offset + P_KEEP]
    return settled + (temperature - settled) * keep


@small_kernel
def thermal_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    winding_loss: float,
    inverter_loss: float,
    coolant: float,
) -> None:
    """Advance a machine's temperatures one period.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: winding and inverter temperature, K, ``(N_STATE,)``, changed in place.
        winding_loss, inverter_loss: W.
        coolant: temperature of coolant or surroundings, K.
    """
    x[X_WINDING] = node_step(p, P_WINDING, x[X_WINDING], winding_loss, coolant)
    x[X_INVERTER] = node_step(p, P_INVERTER, x[X_INVERTER], inverter_loss, coolant)
