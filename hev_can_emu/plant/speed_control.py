"""Speed control of a motor: a PI controller with torque bounds, at the motor shaft.

``T = kp*(b*w_ref - w) + I``, ``dI/dt = ki*(w_ref - w)`` on an inertia J gives the characteristic
``s^2 + (kp/J)*s + ki/J``; with ``kp = 2*D*w0*J`` and ``ki = w0^2*J`` its poles have natural frequency w0 and
damping D.  The set-point weight b below 1 takes the overshoot out of steps without touching the poles.
At a bound the integrator is led back so that it leaves the bound with the sign of the error
(back-calculation).  It starts from the torque that acts, so entering speed control does not jerk.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks

# Layout of the packed parameters.
P_PROPORTIONAL, P_INTEGRAL_STEP, P_WEIGHT, P_TRACK, P_INERTIA = 0, 1, 2, 3, 4
N_PARAMETERS = 5

# Layout of the state.
X_INTEGRAL, X_ACTIVE, X_INERTIA = 0, 1, 2
N_STATE = 3

# Layout of the output.
OUT_REQUEST, OUT_AT_BOUND = 0, 1
N_OUT = 2


class SpeedControlParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A speed controller; SI units.

    Attributes:
        inertia: that the gains are made for, at the motor shaft, kg m^2.
        bandwidth: natural frequency w0 of the closed loop, rad/s.
        damping: D, 1.
        setpoint_weight: b, 0 to 1.
    """

    inertia: float
    bandwidth: float
    damping: float
    setpoint_weight: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "inertia", "bandwidth", "damping")
        checks.fraction(where, self, "setpoint_weight")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a period of ``dt`` s.

        Gains are per unit of inertia; the kernel multiplies.
        """
        return np.array(
            [
                2.0 * self.damping * self.bandwidth,
                self.bandwidth * self.bandwidth * dt,
                self.setpoint_weight,
                min(self.bandwidth * dt, 1.0),
                self.inertia,
            ]
        )


@small_kernel
def speed_control_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    active: float,
    reference: float,
    speed: float,
    lower: float,
    upper: float,
    torque: float,
    inertia: float,
    out: NDArray[np.float64],
) -> None:
    """Compute the torque request of one period.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place.
        active: 1 in speed control; 0 forgets the state and requests 0.
        reference: set speed, rad/s; NaN holds the present speed.
        speed: rad/s.
        lower, upper: torque bounds, N m; when they cross, the one of smaller magnitude wins.
        torque: that acts now, N m; where a controller just switched on starts.
        inertia: that the shaft carries now, kg m^2; 0 takes the one of the parameters.
        out: ``(N_OUT,)``: torque request N m; -1, 0 or 1: at the lower, no or upper bound.
    """
    out[OUT_AT_BOUND] = 0.0
    if active < 0.5:
        x[X_ACTIVE] = 0.0
        x[X_INTEGRAL] = 0.0
        out[OUT_REQUEST] = 0.0
        return
    if math.isnan(reference):
        reference = speed
    if lower > upper:
        nearest = lower if abs(lower) < abs(upper) else upper
        lower = nearest
        upper = nearest
    scale = inertia if inertia > 0.0 else p[P_INERTIA]
    unit = p[P_PROPORTIONAL] * (p[P_WEIGHT] * reference - speed)
    proportional = scale * unit
    if x[X_ACTIVE] < 0.5:
        x[X_ACTIVE] = 1.0
        # The first request equals the acting torque, whatever the speed error.
        x[X_INTEGRAL] = torque - proportional
    else:
        # A clutch that opens or closes changes the gains, not the torque.
        x[X_INTEGRAL] += (x[X_INERTIA] - scale) * unit
        x[X_INTEGRAL] += scale * p[P_INTEGRAL_STEP] * (reference - speed)
    x[X_INERTIA] = scale
    wish = proportional + x[X_INTEGRAL]
    request = min(max(wish, lower), upper)
    if wish > upper:
        out[OUT_AT_BOUND] = 1.0
    elif wish < lower:
        out[OUT_AT_BOUND] = -1.0
    x[X_INTEGRAL] += p[P_TRACK] * (request - wish)
    out[OUT_REQUEST] = request
