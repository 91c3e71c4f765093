"""Ripple of the gas torque: the firing pulses of four cylinders, as orders 2, 4, 6 ... of the crank.

One cylinder's cycle is worked out once, when parameters are packed: polytropic compression and expansion of
the charge drawn in, and on top of it the pressure that the heat of combustion adds,

    dp/da = -n*p/V*dV/da + (n - 1)/V*dQ/da,     Q by Wiebe: 1 - exp(-5*((a - a0)/da)^3)

which is linear in the heat.  So the torque of the four cylinders, half a turn apart, is the part of the
air under the pistons, plus a part in proportion to the intake pressure, plus a part in proportion to
the mean combustion torque; all have even orders only.  Their means stay with the mean-value map
(friction, pumping and combustion torque); what is kept here has none.

Held over a step, an order is averaged over the angle travelled, so that the work of a whole half turn
is zero to rounding however the steps fall.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks, crank
from hev_can_emu.plant.crank import CrankParameters

HARMONICS = 8  # orders 2 to 16

# Layout of the packed parameters: cosines, then sines, of the part of the surrounding air in N m, of
# the charge per Pa of intake pressure, and of combustion per N m; the j-th pair divided by j.
P_AIR = 0
P_CHARGE = 2 * HARMONICS
P_COMBUSTION = 4 * HARMONICS
N_PARAMETERS = 6 * HARMONICS

_POINTS = 4096  # per cycle of two turns
ATMOSPHERE = 101325.0  # Pa
_LEAST_TRAVEL = 1e-9  # rad: the mean over less is the value


class GasPulseParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Cylinder and cycle from which the pulses follow.

    Attributes:
        bore: m.
        compression_ratio: 1.
        exponent: polytropic, of compression and expansion, 1.
        burn_start: crank angle at which the charge begins to burn, rad after top dead centre.
        burn_duration: rad.
        closed_pressure: in the intake with the throttle closed, Pa absolute.
        leak_speed: below it the pressure part fades in proportion to speed (leakage), rad/s.
    """

    bore: float
    compression_ratio: float
    exponent: float
    burn_start: float
    burn_duration: float
    closed_pressure: float
    leak_speed: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "bore", "burn_duration", "closed_pressure", "leak_speed")
        checks.finite(where, self, "compression_ratio", "exponent", "burn_start")
        if self.compression_ratio <= 1.0:
            raise InputError(
                f"{where}.compression_ratio", "more than 1", repr(self.compression_ratio)
            )
        if not 1.0 < self.exponent <= 1.67:
            raise InputError(f"{where}.exponent", "more than 1, at most 1.67", repr(self.exponent))
        if self.burn_start < -math.pi or self.burn_start + self.burn_duration > math.pi:
            raise InputError(
                f"{where}.burn_start", "burning between the dead centres", repr(self.burn_start)
            )

    def pack(self, geometry: CrankParameters) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for this crank."""
        air, charge, heat = self._cylinder(geometry)
        heat /= crank.CYLINDERS * float(np.mean(heat))
        rows = [_orders(air), _orders(charge), _orders(heat)]
        each = 1.0 / np.arange(1.0, HARMONICS + 1.0)
        return np.concatenate([part * each for row in rows for part in (row.real, -row.imag)])

    def _cylinder(self, geometry: CrankParameters) -> tuple[NDArray[np.float64], ...]:
        """Return one cylinder's torque over two turns: of the air, per Pa of intake, of some heat.

        Angle 0 is the firing dead centre; then exhaust (at the pressure of the air, which also
        stands under the piston), intake, compression.
        """
        p = geometry.pack()
        # Bottom dead centres are grid points, so the stroke's ends need no interpolation.
        angle = 4.0 * math.pi * np.arange(_POINTS) / _POINTS
        lever = math.pi * 0.25 * self.bore**2 * np.array([crank.piston_rate(p, a) for a in angle])
        stroke = 2.0 * geometry.radius
        travel = np.array([crank.piston_travel(p, a) for a in angle])
        volume = (stroke / (self.compression_ratio - 1.0) + travel) / stroke
        closed = np.zeros(_POINTS, dtype=bool)
        closed[: _POINTS // 4 + 1] = True
        closed[3 * _POINTS // 4 :] = True
        compression = np.where(closed, (volume.max() / volume) ** self.exponent, 0.0)
        compression[_POINTS // 2 : 3 * _POINTS // 4] = 1.0  # intake stroke
        air = np.full(_POINTS, -ATMOSPHERE)
        air[_POINTS // 4 + 1 : _POINTS // 2] = 0.0
        # Heat, in the order of angles from -2 pi on, then turned to start at the firing centre.
        turned = np.where(angle >= 2.0 * math.pi, angle - 4.0 * math.pi, angle)
        burning = np.clip((turned - self.burn_start) / self.burn_duration, 0.0, 1.0)
        order = np.argsort(turned)
        burnt = -np.expm1(-5.0 * burning[order] ** 3)
        work = 0.5 * (volume[order][1:] + volume[order][:-1]) ** (self.exponent - 1.0)
        added = np.empty(_POINTS)
        added[order] = np.concatenate([[0.0], np.cumsum(work * np.diff(burnt))])
        combustion = np.where(closed & (turned <= math.pi), added / volume**self.exponent, 0.0)
        return air * lever, compression * lever, combustion * lever


def _orders(torque: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return ``c`` with ``sum(re(c_j)*cos(2ja) - im(c_j)*sin(2ja))`` the four cylinders' ripple.

    ``torque`` is one cylinder's over two turns; four of them half a turn apart cancel all but the
    even orders of the crank, every fourth of the cycle.
    """
    spectrum = np.fft.rfft(torque) / len(torque)
    picked: NDArray[np.complex128] = spectrum[4 : 4 * HARMONICS + 1 : 4]
    return 2.0 * crank.CYLINDERS * picked


@kernel
def ripple(
    p: NDArray[np.float64],
    at: int,
    angle: float,
    travel: float,
    sealed: float,
    pressure: float,
    torque: float,
) -> float:
    """Return the ripple, N m, averaged over the angles ``angle`` to ``angle + travel``.

    Args:
        p: parameters that hold those of :meth:`GasPulseParameters.pack` from index ``at`` on.
        at: see above.
        angle: of the crank, rad, 0 at a firing dead centre.
        travel: over the step, rad.
        sealed: share of the pressures that has not leaked past the rings, 0 to 1.
        pressure: in the intake, Pa absolute.
        torque: mean combustion torque, N m.
    """
    if abs(travel) < _LEAST_TRAVEL:
        travel = _LEAST_TRAVEL
    middle = 2.0 * angle + travel
    cosine, sine = math.cos(middle), math.sin(middle)
    step_cosine, step_sine = math.cos(travel), math.sin(travel)
    c, s = cosine, sine
    d, e = step_cosine, step_sine
    total = 0.0
    for j in range(HARMONICS):
        k = at + j
        even = sealed * (p[k + P_AIR] + pressure * p[k + P_CHARGE]) + torque * p[k + P_COMBUSTION]
        k += HARMONICS
        odd = sealed * (p[k + P_AIR] + pressure * p[k + P_CHARGE]) + torque * p[k + P_COMBUSTION]
        total += e * (even * c + odd * s)
        c, s = c * cosine - s * sine, s * cosine + c * sine
        d, e = d * step_cosine - e * step_sine, e * step_cosine + d * step_sine
    # The mean of cos(2j*a) over the travel is cos(j*middle)*sin(j*travel)/(j*travel); the coefficients
    # are divided by j already.
    return total / travel
