"""The permanent-magnet synchronous machine in rotor (dq) coordinates, peak-valued amplitudes.

::

    L_d*di_d/dt = v_d - R*i_d + w_e*L_q*i_q            w_e = p*w
    L_q*di_q/dt = v_q - R*i_q - w_e*(L_d*i_d + psi)
    T           = 1.5*p*(psi*i_q + (L_d - L_q)*i_d*i_q)
    T_iron      = p*(k_h*sgn(w) + k_e*|w_e|*sgn(w))*(lambda_d^2 + lambda_q^2)      brakes
    T_drag      = (c_0 + c_2*w^2)*sgn(w)                                           brakes

Speed and voltages are constant over a step (the voltage vector turns with the rotor).  The step is
the two-stage Gauss method: order 4, A-stable, and it keeps quadratic balances exactly, so copper
loss, shaft work, electrical energy and the change of the magnetic energy, each taken by the same
two-point quadrature, close to rounding.  For a linear system it needs one 2x2 solve:
with ``z = h*A`` and ``y = (1 - z/2 + z^2/12)^-1 * di/dt(0)`` the currents are
``i0 + h*((1/2 -+ s)*y - z*y/12)`` at the two stages, ``s = sqrt(3)/6``, and ``i0 + h*y`` at the end.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks

# Layout of the packed parameters.
P_DT, P_POLE_PAIRS, P_FLUX, P_LD, P_LQ, P_RESISTANCE, P_COPPER_COEFFICIENT = 0, 1, 2, 3, 4, 5, 6
P_COPPER_REFERENCE, P_HYSTERESIS, P_EDDY, P_DRAG, P_WINDAGE = 7, 8, 9, 10, 11
P_STEP_D, P_STEP_Q = 12, 13  # dt over inductance
N_PARAMETERS = 14

# Layout of the state: currents in A, peak.
X_ID, X_IQ = 0, 1
N_STATE = 2

# Layout of the output: mean torques N m; energies of the step J; mean current A; stored energy J.
OUT_TORQUE, OUT_AIR_GAP = 0, 1
OUT_TERMINAL, OUT_SHAFT, OUT_COPPER, OUT_SERIES, OUT_IRON, OUT_DRAG = 2, 3, 4, 5, 6, 7
OUT_CURRENT, OUT_MAGNETIC = 8, 9
N_OUT = 10

_STAGE = math.sqrt(3.0) / 6.0
_TWELFTH = 1.0 / 12.0
_STILL = 2.0  # rad/s; below, braking torques of constant size fade to zero at standstill


class PmsmParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A permanent-magnet synchronous machine; SI units, peak-valued amplitudes.

    Attributes:
        pole_pairs: 1.
        flux: of the magnets, linked with one phase, peak, Wb.
        inductance_d, inductance_q: H; ``inductance_q`` is the greater or equal one.
        resistance: of one phase at ``copper_reference``, ohm.
        copper_coefficient: rise of the resistance, 1/K.
        copper_reference: winding temperature at which ``resistance`` holds, K.
        hysteresis: k_h, iron loss over electrical speed and flux linkage squared, W s/Wb^2.
        eddy: k_e, iron loss over electrical speed squared and flux linkage squared, W s^2/Wb^2.
        drag: c_0, of bearings and seals, N m.
        windage: c_2, N m s^2.
    """

    pole_pairs: float
    flux: float
    inductance_d: float
    inductance_q: float
    resistance: float
    copper_coefficient: float
    copper_reference: float
    hysteresis: float
    eddy: float
    drag: float
    windage: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(
            where, self, "pole_pairs", "flux", "inductance_d", "inductance_q", "copper_reference"
        )
        checks.not_negative(
            where, self, "resistance", "copper_coefficient", "hysteresis", "eddy", "drag", "windage"
        )
        if self.pole_pairs != round(self.pole_pairs):
            raise InputError(f"{where}.pole_pairs", "a whole number", repr(self.pole_pairs))
        if self.inductance_q < self.inductance_d:
            raise InputError(
                f"{where}.inductance_q",
                f"at least inductance_d ({self.inductance_d!r})",
                repr(self.inductance_q),
                "d is the axis of the magnets",
            )

    def pack(self, dt: float = 5e-5) -> NDArray[np.float64]:
        """Return the kernels' parameters, shape ``(N_PARAMETERS,)``, for a step of ``dt`` s."""
        own = [
            dt,
            self.pole_pairs,
            self.flux,
            self.inductance_d,
            self.inductance_q,
            self.resistance,
            self.copper_coefficient,
            self.copper_reference,
            self.hysteresis,
            self.eddy,
            self.drag,
            self.windage,
            dt / self.inductance_d,
            dt / self.inductance_q,
        ]
        return np.array(own)


@kernel
def air_gap_torque(p: NDArray[np.float64], i_d: float, i_q: float) -> float:
    """Return the torque of the field on the rotor, N m, for currents in A, peak."""
    torque: float = 1.5 * p[P_POLE_PAIRS] * (p[P_FLUX] + (p[P_LD] - p[P_LQ]) * i_d) * i_q
    return torque


@kernel
def magnetic_energy(p: NDArray[np.float64], i_d: float, i_q: float) -> float:
    """Return what the currents store in the inductances, J (the magnets' own part left out)."""
    energy: float = 0.75 * (p[P_LD] * i_d * i_d + p[P_LQ] * i_q * i_q)
    return energy


@kernel
def direction(speed: float) -> float:
    """Return the sign of ``speed``, rad/s, blended through zero around standstill."""
    return min(max(speed / _STILL, -1.0), 1.0)


@kernel
def iron_factor(p: NDArray[np.float64], speed: float) -> float:
    """Return the iron's braking torque over flux linkage squared at a shaft speed, N m/Wb^2."""
    pairs: float = p[P_POLE_PAIRS]
    factor: float = p[P_HYSTERESIS] * direction(speed) + p[P_EDDY] * pairs * speed
    return pairs * factor


@kernel
def flux_square(p: NDArray[np.float64], i_d: float, i_q: float) -> float:
    """Return the square of the stator's flux linkage, Wb^2."""
    along = p[P_FLUX] + p[P_LD] * i_d
    across = p[P_LQ] * i_q
    square: float = along * along + across * across
    return square


@kernel
def mechanical_drag(p: NDArray[np.float64], speed: float) -> float:
    """Return the braking torque of bearings and air, N m, of the sign of ``speed``, rad/s."""
    torque: float = p[P_DRAG] * direction(speed) + p[P_WINDAGE] * speed * abs(speed)
    return torque


@kernel
def phase_resistance(p: NDArray[np.float64], winding_temperature: float) -> float:
    """Return the resistance of one phase, ohm, at a winding temperature, K."""
    warmer = winding_temperature - p[P_COPPER_REFERENCE]
    resistance: float = p[P_RESISTANCE] * (1.0 + p[P_COPPER_COEFFICIENT] * warmer)
    return resistance


@kernel
def pmsm_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    v_d: float,
    v_q: float,
    speed: float,
    resistance: float,
    series_resistance: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one step under a given terminal voltage.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place.
        v_d, v_q: voltage behind ``series_resistance``, V, peak.
        speed: of the shaft, rad/s.
        resistance: of one phase now, ohm.
        series_resistance: of what stands between voltage and machine (shorting switches), ohm.
        out: ``(N_OUT,)``: mean torque at the shaft and in the air gap, N m; energies of this step, J:
            taken from the voltage, given to the shaft, lost in copper, in the series resistance, in
            the iron and by drag; mean current, A, peak; stored energy at the end, J.
    """
    h = p[P_DT]
    ld, lq, psi = p[P_LD], p[P_LQ], p[P_FLUX]
    electrical = p[P_POLE_PAIRS] * speed
    r = resistance + series_resistance
    id0, iq0 = x[X_ID], x[X_IQ]

    # z = h*A; m = 1 - z/2 + z^2/12, solved by Cramer's rule.
    step_d, step_q = p[P_STEP_D], p[P_STEP_Q]
    z_dd, z_dq = -step_d * r, step_d * electrical * lq
    z_qd, z_qq = -step_q * electrical * ld, -step_q * r
    cross = z_dq * z_qd
    mixed = (z_dd + z_qq) * _TWELFTH - 0.5
    m_dd = 1.0 - 0.5 * z_dd + (z_dd * z_dd + cross) * _TWELFTH
    m_qq = 1.0 - 0.5 * z_qq + (z_qq * z_qq + cross) * _TWELFTH
    m_dq, m_qd = z_dq * mixed, z_qd * mixed
    rise_d = step_d * (v_d - r * id0 + electrical * lq * iq0)
    rise_q = step_q * (v_q - r * iq0 - electrical * (ld * id0 + psi))
    scale = 1.0 / (m_dd * m_qq - m_dq * m_qd)
    y_d = scale * (m_qq * rise_d - m_dq * rise_q)
    y_q = scale * (m_dd * rise_q - m_qd * rise_d)
    middle_d = id0 + 0.5 * y_d - (z_dd * y_d + z_dq * y_q) * _TWELFTH
    middle_q = iq0 + 0.5 * y_q - (z_qd * y_d + z_qq * y_q) * _TWELFTH
    id1, iq1 = middle_d - _STAGE * y_d, middle_q - _STAGE * y_q
    id2, iq2 = middle_d + _STAGE * y_d, middle_q + _STAGE * y_q
    x[X_ID] = id0 + y_d
    x[X_IQ] = iq0 + y_q

    square1 = id1 * id1 + iq1 * iq1
    square2 = id2 * id2 + iq2 * iq2
    square = 0.5 * (square1 + square2)
    air_gap = 0.5 * (air_gap_torque(p, id1, iq1) + air_gap_torque(p, id2, iq2))
    flux = 0.5 * (flux_square(p, id1, iq1) + flux_square(p, id2, iq2))
    iron = iron_factor(p, speed) * flux
    drag = mechanical_drag(p, speed)
    torque = air_gap - iron - drag
    out[OUT_TORQUE] = torque
    out[OUT_AIR_GAP] = air_gap
    out[OUT_TERMINAL] = 1.5 * h * (v_d * middle_d + v_q * middle_q)
    out[OUT_SHAFT] = h * speed * torque
    out[OUT_COPPER] = 1.5 * h * resistance * square
    out[OUT_SERIES] = 1.5 * h * series_resistance * square
    out[OUT_IRON] = h * speed * iron
    out[OUT_DRAG] = h * speed * drag
    out[OUT_CURRENT] = 0.5 * (math.sqrt(square1) + math.sqrt(square2))
    out[OUT_MAGNETIC] = magnetic_energy(p, x[X_ID], x[X_IQ])
