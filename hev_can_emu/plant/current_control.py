"""Current control in dq: PI with decoupling, active damping, voltage limit and anti-windup.

Per control period T, with the closed loop's pole ``a = exp(-bandwidth*T)`` and ``k = L*(1 - a)/T`` per axis::

    u   = k*(i_ref - i) - (k - R)*i + I            PI with active damping
    v*  = u + decoupling(i + T/(2*L)*(u - R*i))    at the current in the middle of the coming period
    v   = what the inverter gives of v*, at the angle in the middle of the coming period
    I  := I + k*(1 - a)*(i_ref - i + (v - v*)/k)   back-calculation: I knows what was really given

Without limit and with true parameters the response to a reference is first order with that pole on
both axes, at any speed, and a disturbance dies with a double pole at a.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant.inverter import terminal_voltage
from hev_can_emu.plant.pmsm import PmsmParameters

# Layout of the packed parameters.
P_LD, P_LQ, P_FLUX, P_RESISTANCE, P_GAIN_D, P_GAIN_Q, P_RESET = 0, 1, 2, 3, 4, 5, 6
P_HALF_PERIOD, P_AHEAD_D, P_AHEAD_Q = 7, 8, 9  # half a period, and over the inductances
N_PARAMETERS = 10

# Layout of the state: integrators, then the voltage reference that holds until the next period, V.
X_INTEGRAL_D, X_INTEGRAL_Q, X_VD, X_VQ = 0, 1, 2, 3
N_STATE = 4


class CurrentControlParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The current controller; SI units.

    Attributes:
        period: of control, s; a whole multiple of the step.
        bandwidth: of the closed current loops, rad/s.
    """

    period: float
    bandwidth: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "period", "bandwidth")

    def steps(self, dt: float) -> int:
        """Return the steps of ``dt`` s in one control period; ValueError unless they are whole."""
        count = round(self.period / dt)
        if count < 1 or abs(count * dt - self.period) > 1e-9 * self.period:
            raise ValueError(f"control period {self.period!r} s: not a multiple of {dt!r} s")
        return count

    def pack(self, machine: PmsmParameters) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, tuned for ``machine``."""
        closed = 1.0 - math.exp(-self.bandwidth * self.period)
        own = [
            machine.inductance_d,
            machine.inductance_q,
            machine.flux,
            machine.resistance,
            machine.inductance_d * closed / self.period,
            machine.inductance_q * closed / self.period,
            closed,
            0.5 * self.period,
            0.5 * self.period / machine.inductance_d,
            0.5 * self.period / machine.inductance_q,
        ]
        return np.array(own)


@kernel
def current_control_step(
    p: NDArray[np.float64],
    inverter: NDArray[np.float64],
    x: NDArray[np.float64],
    ref_d: float,
    ref_q: float,
    i_d: float,
    i_q: float,
    electrical_speed: float,
    angle: float,
    link_voltage: float,
) -> None:
    """Compute the voltage reference of one control period into ``x[X_VD]``, ``x[X_VQ]``.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        inverter: parameters of :mod:`hev_can_emu.plant.inverter`.
        x: state, ``(N_STATE,)``, changed in place; all zero at start.
        ref_d, ref_q: reference currents, A, peak.
        i_d, i_q: measured currents, A, peak.
        electrical_speed: rad/s.
        angle: electrical angle of the rotor now, rad.
        link_voltage: measured at the DC link, V.
    """
    ld, lq, r = p[P_LD], p[P_LQ], p[P_RESISTANCE]
    error_d, error_q = ref_d - i_d, ref_q - i_q
    u_d = p[P_GAIN_D] * (error_d - i_d) + r * i_d + x[X_INTEGRAL_D]
    u_q = p[P_GAIN_Q] * (error_q - i_q) + r * i_q + x[X_INTEGRAL_Q]
    middle_d = i_d + p[P_AHEAD_D] * (u_d - r * i_d)
    middle_q = i_q + p[P_AHEAD_Q] * (u_q - r * i_q)
    wish_d = u_d - electrical_speed * lq * middle_q
    wish_q = u_q + electrical_speed * (ld * middle_d + p[P_FLUX])
    middle = angle + electrical_speed * p[P_HALF_PERIOD]
    v_d, v_q = terminal_voltage(inverter, wish_d, wish_q, middle, link_voltage)
    x[X_VD] = v_d
    x[X_VQ] = v_q
    x[X_INTEGRAL_D] += p[P_RESET] * (p[P_GAIN_D] * error_d + v_d - wish_d)
    x[X_INTEGRAL_Q] += p[P_RESET] * (p[P_GAIN_Q] * error_q + v_q - wish_q)
