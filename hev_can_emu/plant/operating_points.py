"""Which currents a PMSM should carry: MTPA, current limit, flux limit and MTPV in closed form.

With ``D = L_q - L_d >= 0``, peak current I and flux linkage lambda (all peak):

- most torque per ampere: ``i_d = -2*D*I^2/(psi + sqrt(psi^2 + 8*D^2*I^2))``;
- most torque per flux (per volt): ``cos(delta) = -2*D*lambda/(L_q*psi + sqrt((L_q*psi)^2 + 8*D^2*lambda^2))``
  with ``lambda_d = lambda*cos(delta)``, ``lambda_q = lambda*sin(delta)``;
- current circle against flux ellipse: ``i_d = -2*c/(b + sqrt(b^2 - 4*a*c))`` with ``a = L_d^2 - L_q^2``,
  ``b = 2*psi*L_d``, ``c = psi^2 + L_q^2*I^2 - lambda^2``.

All three forms hold for D = 0, too.  Resistance enters exactly through the identity

    v^2 = R^2*I^2 + 2*R*w_e*T/(1.5*p) + w_e^2*lambda^2

so that a voltage limit is a flux limit that depends on torque.  For use off the hot path.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.plant.pmsm import PmsmParameters

Array = NDArray[np.float64]

_BISECTIONS = 60


class OperatingPoint(NamedTuple):
    """Currents, A, peak, with the torque in the air gap, N m."""

    i_d: float
    i_q: float
    torque: float


def operating_point(machine: PmsmParameters, i_d: float, i_q: float) -> OperatingPoint:
    """Return the point of two currents, A, peak."""
    reluctance = (machine.inductance_d - machine.inductance_q) * i_d
    torque = 1.5 * machine.pole_pairs * (machine.flux + reluctance) * i_q
    return OperatingPoint(i_d, i_q, torque)


def flux_linkage(machine: PmsmParameters, point: OperatingPoint) -> float:
    """Return the stator's flux linkage, Wb, peak."""
    along = machine.flux + machine.inductance_d * point.i_d
    return math.hypot(along, machine.inductance_q * point.i_q)


def terminal_voltage(
    machine: PmsmParameters, point: OperatingPoint, electrical_speed: float
) -> float:
    """Return the voltage, V, peak, that holds a point at an electrical speed, rad/s."""
    along = machine.flux + machine.inductance_d * point.i_d
    across = machine.inductance_q * point.i_q
    v_d = machine.resistance * point.i_d - electrical_speed * across
    v_q = machine.resistance * point.i_q + electrical_speed * along
    return math.hypot(v_d, v_q)


def most_torque_per_ampere(machine: PmsmParameters, current: float) -> OperatingPoint:
    """Return the MTPA point of a current, A, peak."""
    salience = machine.inductance_q - machine.inductance_d
    square = current * current
    root = math.sqrt(machine.flux**2 + 8.0 * salience**2 * square)
    i_d = -2.0 * salience * square / (machine.flux + root)
    return operating_point(machine, i_d, math.sqrt(max(square - i_d * i_d, 0.0)))


def most_torque_per_volt(machine: PmsmParameters, flux: float) -> OperatingPoint:
    """Return the MTPV point of a flux linkage, Wb, peak."""
    salience = machine.inductance_q - machine.inductance_d
    magnet = machine.inductance_q * machine.flux
    root = math.sqrt(magnet**2 + 8.0 * (salience * flux) ** 2)
    cosine = -2.0 * salience * flux / (magnet + root)
    i_d = (flux * cosine - machine.flux) / machine.inductance_d
    return operating_point(
        machine, i_d, flux * math.sqrt(1.0 - cosine * cosine) / machine.inductance_q
    )


def on_both_limits(machine: PmsmParameters, current: float, flux: float) -> OperatingPoint:
    """Return the point with this current, A, and this flux linkage, Wb, i_q >= 0.

    Where there is none because the flux is too small: the point ``i_d = -current`` without torque.
    """
    ld, lq = machine.inductance_d, machine.inductance_q
    a = ld**2 - lq**2
    b = 2.0 * machine.flux * ld
    c = machine.flux**2 + (lq * current) ** 2 - flux**2
    i_d = max(-2.0 * c / (b + math.sqrt(max(b * b - 4.0 * a * c, 0.0))), -current)
    return operating_point(machine, i_d, math.sqrt(max(current**2 - i_d**2, 0.0)))


def most_torque(machine: PmsmParameters, current: float, flux: float) -> OperatingPoint:
    """Return the point of greatest torque within a current, A, and a flux linkage, Wb."""
    point = most_torque_per_ampere(machine, current)
    if flux_linkage(machine, point) <= flux:
        return point
    point = most_torque_per_volt(machine, flux)
    if math.hypot(point.i_d, point.i_q) <= current:
        return point
    return on_both_limits(machine, current, flux)


def weakened(machine: PmsmParameters, torque: Array, flux: Array) -> Array:
    """Return the i_d, A, that gives a torque >= 0, N m, at exactly a flux linkage, Wb.

    Of the two such points the one of smaller current; the MTPV point where the torque is beyond it.
    ``torque`` and ``flux`` are arrays that broadcast.  Solved by bisection over the cosine of the flux
    vector's angle, along which torque rises up to the MTPV point; nothing but square roots, so that the
    result is the same on every processor.
    """
    ld, lq, psi = machine.inductance_d, machine.inductance_q, machine.flux
    salience = lq - ld
    root = np.sqrt((lq * psi) ** 2 + 8.0 * (salience * flux) ** 2)
    low = np.broadcast_to(-2.0 * salience * flux / (lq * psi + root), np.shape(torque * flux))
    high = np.ones_like(low)
    for _ in range(_BISECTIONS):
        cosine = 0.5 * (low + high)
        i_d = (flux * cosine - psi) / ld
        i_q = flux * np.sqrt(1.0 - cosine * cosine) / lq
        enough = 1.5 * machine.pole_pairs * (psi - salience * i_d) * i_q >= torque
        low = np.where(enough, cosine, low)
        high = np.where(enough, high, cosine)
    i_d_found: Array = (flux * low - psi) / ld
    return i_d_found


def corner_speed(machine: PmsmParameters, current: float, voltage: float) -> float:
    """Return the electrical speed, rad/s, up to which full MTPA torque is driven within a voltage, V."""
    point = most_torque_per_ampere(machine, current)
    flux = flux_linkage(machine, point)
    drop = machine.resistance * point.torque / (1.5 * machine.pole_pairs)
    rest = max(voltage**2 - (machine.resistance * current) ** 2, 0.0)
    return rest / (drop + math.sqrt(drop**2 + flux**2 * rest))


def voltage_limit_entry(machine: PmsmParameters, current: float, voltage: float) -> float:
    """Return the electrical speed, rad/s, from which MTPV gives most torque, resistance left out.

    Infinite where the magnets' flux cannot be cancelled by ``current``, A (no MTPV range).
    """
    if machine.flux / machine.inductance_d >= current:
        return math.inf
    low, high = 0.0, machine.flux
    while _mtpv_current(machine, high) < current:
        high *= 2.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if _mtpv_current(machine, middle) < current:
            low = middle
        else:
            high = middle
    return voltage / low


def _mtpv_current(machine: PmsmParameters, flux: float) -> float:
    point = most_torque_per_volt(machine, flux)
    return math.hypot(point.i_d, point.i_q)


def most_torque_at(
    machine: PmsmParameters, current: float, voltage: float, electrical_speed: float, sign: float
) -> OperatingPoint:
    """Return the greatest torque within current, A, and voltage, V, with the resistance.

    ``sign`` is +1 for driving (torque along the speed), -1 for braking: the sign of torque and i_q of the
    returned point.  ``electrical_speed`` > 0, rad/s.  Solved by bisection over the flux linkage.
    """
    best = most_torque_per_ampere(machine, current)
    low, high = 0.0, flux_linkage(machine, best)
    point = _signed(best, sign)
    if terminal_voltage(machine, point, electrical_speed) <= voltage:
        return point
    for _ in range(_BISECTIONS):
        flux = 0.5 * (low + high)
        point = _signed(most_torque(machine, current, flux), sign)
        if terminal_voltage(machine, point, electrical_speed) > voltage:
            high = flux
        else:
            low = flux
    return point


def _signed(point: OperatingPoint, sign: float) -> OperatingPoint:
    return OperatingPoint(point.i_d, sign * point.i_q, sign * point.torque)
