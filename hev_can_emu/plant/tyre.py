"""Tyre slip: what of a tyre's twist runs off over the road.

The tyre of the driveline is a spring and a damper between wheel and body.  In series with them the
contact patch creeps: ``q' = w_wheel - w_body - w_slip`` and ``T = k*q + c*q'``.  The slip is that of the
brush model, ``T/T_max = 1 - (1 - C*s/(3*T_max))^3`` for ``s = w_slip/|w_body|`` up to ``3*T_max/C``, and
beyond it whatever keeps the torque at ``T_max = mu*N*r``.  At standstill nothing creeps below that, so
a car that stands on a hill stays there.

The driveline's step knows no slip.  After it, :func:`tyre_step` lets the patch creep over the same time, by
the torque at the end of the step (implicit; order 1): twist runs off, and what the damper would have
carried of the creep is given back to wheel and body.  Slip heat and the damper's correction are exactly
the energy that goes.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks

# Layout of the packed parameters.
P_DT, P_STIFFNESS, P_DAMPING, P_SLIP_STIFFNESS, P_LIMIT = 0, 1, 2, 3, 4
P_WHEEL_INERTIA, P_BODY_INERTIA = 5, 6
N_PARAMETERS = 7

# Layout of the output: slip speed rad/s, torque N m, then J in this step.
OUT_SLIP, OUT_TORQUE, OUT_SLIP_LOSS, OUT_DAMPER_CHANGE = 0, 1, 2, 3
N_OUT = 4

_ROUNDS = 60


class TyreSlipParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Slip of one tyre, or of an axle's tyres together.

    Attributes:
        slip_stiffness: longitudinal force over slip at small slip, as a share of the load, 1.
        friction: greatest longitudinal force over load, mu, 1.
    """

    slip_stiffness: float
    friction: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "slip_stiffness", "friction")

    def pack(
        self,
        load: float,
        radius: float,
        stiffness: float,
        damping: float,
        wheel_inertia: float,
        body_inertia: float,
        dt: float = 5e-5,
    ) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``.

        Args:
            load: of the tyre, N.
            radius: m.
            stiffness, damping: of its branch of the driveline, N m/rad and N m s/rad.
            wheel_inertia, body_inertia: of the branch's ends, kg m^2.
            dt: inner step, s.
        """
        grip = load * radius
        return np.array(
            [
                dt,
                stiffness,
                damping,
                self.slip_stiffness * grip,
                self.friction * grip,
                wheel_inertia,
                body_inertia,
            ]
        )


@kernel
def slip_share(torque: float, slip_stiffness: float, limit: float) -> float:
    """Return the slip over rolling speed at a torque within ``limit``: the brush model, inverted."""
    left = max(1.0 - abs(torque) / limit, 0.0)
    size = 3.0 * limit / slip_stiffness * (1.0 - left ** (1.0 / 3.0))
    return float(size if torque >= 0.0 else -size)


@kernel
def tyre_step(
    p: NDArray[np.float64],
    state: NDArray[np.float64],
    wheel_held: float,
    body_held: float,
    out: NDArray[np.float64],
) -> None:
    """Let the contact patch creep over the step that the driveline has just made.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        state: twist rad, wheel and body speed rad/s, ``(3,)``, changed in place.
        wheel_held, body_held: 1 where a brake, or rest, holds that end: its speed stays.
        out: ``(N_OUT,)``.
    """
    dt, k, c = p[P_DT], p[P_STIFFNESS], p[P_DAMPING]
    twist, wheel, body = state[0], state[1], state[2]
    ease_wheel = 0.0 if wheel_held > 0.5 else 1.0 / p[P_WHEEL_INERTIA]
    ease_body = 0.0 if body_held > 0.5 else 1.0 / p[P_BODY_INERTIA]
    rate = wheel - body
    # Torque at the end: falls by ``give`` per slip speed.
    free = k * twist + c * rate
    give = k * dt + c - c * c * dt * (ease_wheel + ease_body)
    limit = p[P_LIMIT]
    roll = abs(body)
    size = abs(free)
    if size == 0.0 or (roll == 0.0 and size <= limit):
        out[OUT_SLIP], out[OUT_TORQUE] = 0.0, free
        out[OUT_SLIP_LOSS] = out[OUT_DAMPER_CHANGE] = 0.0
        return
    # With z = (1 - T/T_max)^(1/3), slip = reach*(1 - z): a cubic in z that rises from 0 to 1.
    reach = 3.0 * limit / p[P_SLIP_STIFFNESS] * roll
    slip = (size - limit) / give
    if slip < reach:
        low, high = 0.0, 1.0
        z = 1.0
        for _ in range(_ROUNDS):
            value = size - give * reach * (1.0 - z) - limit * (1.0 - z * z * z)
            if value > 0.0:
                high = z
            else:
                low = z
            slope = give * reach + 3.0 * limit * z * z
            new = z - value / slope
            if not low < new < high:
                new = 0.5 * (low + high)
            if abs(new - z) <= 1e-16 + 1e-15 * abs(z):
                z = new
                break
            z = new
        slip = reach * (1.0 - z)
    if free < 0.0:
        slip = -slip
    crept = slip * dt
    state[0] = twist - crept
    state[1] = wheel + c * crept * ease_wheel
    state[2] = body - c * crept * ease_body
    mean_twist = twist - 0.5 * crept
    mean_rate = rate + 0.5 * c * crept * (ease_wheel + ease_body)
    out[OUT_SLIP], out[OUT_TORQUE] = slip, free - give * slip
    out[OUT_SLIP_LOSS] = (k * mean_twist + c * (mean_rate - slip)) * crept
    out[OUT_DAMPER_CHANGE] = -c * crept * (2.0 * mean_rate - slip)
