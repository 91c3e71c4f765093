"""Friction brakes: the request becomes friction *capacities* at the four wheels.

A brake does not push; it resists.  So what leaves this module is the torque that each brake can
transmit; the driveline decides whether the wheel slips against it or stands still.  The
actuator is a torque source of its own (delay, slew, lag), released to exactly zero.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.torque_source import TorqueSourceParameters, torque_source_step

# Layout of the packed parameters; the torque source's own come first.
P_MAX_TORQUE, P_FRONT_SHARE = source.N_PARAMETERS, source.N_PARAMETERS + 1
N_PARAMETERS = source.N_PARAMETERS + 2

N_STATE = source.N_STATE

# Layout of the output: the torque source's own, then the wheels' capacities.
OUT_FL, OUT_FR = source.N_OUT, source.N_OUT + 1
OUT_RL, OUT_RR = source.N_OUT + 2, source.N_OUT + 3
N_OUT = source.N_OUT + 4

_RELEASED = 0.1  # N m over all wheels: pads are lifted off below this


class BrakeParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Hydraulic brakes; SI units.

    Attributes:
        source: delay, slew and lag of the torque, sum of the four wheels.
        max_torque: sum of the four wheels, N m.
        front_share: share of the front axle, 1; left and right are equal.
    """

    source: TorqueSourceParameters
    max_torque: float
    front_share: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        self.source.validate(f"{where}.source")
        checks.positive(where, self, "max_torque")
        checks.fraction(where, self, "front_share")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a period of ``dt`` s."""
        return np.concatenate([self.source.pack(dt), [self.max_torque, self.front_share]])


@small_kernel
def brake_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    request: float,
    enabled: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one period.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place.
        request: brake torque, sum of the four wheels, N m; negative or NaN counts as 0.
        enabled: 0 releases the brakes.
        out: ``(N_OUT,)``: torque capacity N m, setpoint N m, LIMIT_* code, then the capacities
            front left, front right, rear left, rear right N m.
    """
    peak = float(source.LIMIT_PEAK)
    torque_source_step(p, x, request, enabled, 0.0, p[P_MAX_TORQUE], peak, peak, out)
    total = out[source.OUT_TORQUE]
    if total < _RELEASED and out[source.OUT_SETPOINT] <= 0.0:
        total = 0.0
        x[source.X_TORQUE] = 0.0
        out[source.OUT_TORQUE] = 0.0
    front = 0.5 * p[P_FRONT_SHARE] * total
    rear = 0.5 * total - front
    out[OUT_FL] = front
    out[OUT_FR] = front
    out[OUT_RL] = rear
    out[OUT_RR] = rear
