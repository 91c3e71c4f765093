"""From torque request to reference currents: MTPA, field weakening, MTPV, as tables and a kernel.

The voltage limit v is a limit of flux linkage that depends on torque (:mod:`.operating_points`):
``w_e^2*lambda^2 = v^2 - R^2*I_max^2 - 2*R*w_e*T/(1.5*p)``.  Three tables are built off the hot path:

- i_d of MTPA over torque;
- the greatest torque over *ratio* = 1/lambda (electrical speed over voltage), from MTPA at full current
  through the current limit into MTPV;
- i_d of field weakening over ratio and ``s = 1 - sqrt(1 - T/T_max)``; so stretched it has no
  infinite slope at the MTPV edge.

The kernel takes the smaller (more negative) of both i_d, because the field must be weakened where the
MTPA point lies outside the flux limit, and computes i_q from the torque equation: interpolation never
costs torque.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.motor import fade
from hev_can_emu.plant.operating_points import (
    flux_linkage,
    most_torque,
    most_torque_per_ampere,
    weakened,
)
from hev_can_emu.plant.pmsm import PmsmParameters

# Layout of the packed parameters; then the tables: MTPA, greatest torque, weakening by rows of ratio.
P_POLE_PAIRS, P_FLUX, P_SALIENCE, P_CURRENT_DROP, P_TORQUE_DROP, P_PEAK_TORQUE = 0, 1, 2, 3, 4, 5
P_MARGIN, P_RATIO_START, P_ROW_PER_RATIO, P_ROW_PER_TORQUE = 6, 7, 8, 9
P_VOLTAGE_MIN, P_VOLTAGE_FULL, P_FADE_SPEED, P_MAX_SPEED = 10, 11, 12, 13
P_WINDING_DERATE, P_WINDING_MAX, P_INVERTER_DERATE, P_INVERTER_MAX = 14, 15, 16, 17
P_MTPA = 18
N_MTPA, N_RATIO, N_SHARE = 129, 129, 33
P_GREATEST = P_MTPA + N_MTPA
P_WEAKENING = P_GREATEST + N_RATIO
N_PARAMETERS = P_WEAKENING + N_RATIO * N_SHARE

# Layout of the limits: torques in the air gap, N m, and the LIMIT_* codes of both.
LIM_TORQUE_MIN, LIM_TORQUE_MAX, LIM_REASON_MIN, LIM_REASON_MAX = 0, 1, 2, 3
N_LIM = 4

_ROUNDS = 2  # of the torque's part in the voltage, a contraction of a few percent each


class TorqueMapParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of a drive; SI units.

    Attributes:
        current_rms: greatest phase current, RMS, A.
        voltage_margin: share of the linear voltage that the references use, 0 to 1; the rest is
            left to the current controllers.
        voltage_min, voltage_full: no torque below the first DC voltage, full torque above the second, V.
        fade_speed, max_speed: driving torque fades from the first to zero at the second, rad/s.
        winding_derate, winding_max: torque fades from the first to zero at the second, K.
        inverter_derate, inverter_max: alike, K.
    """

    current_rms: float
    voltage_margin: float
    voltage_min: float
    voltage_full: float
    fade_speed: float
    max_speed: float
    winding_derate: float
    winding_max: float
    inverter_derate: float
    inverter_max: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "current_rms", "voltage_margin", "voltage_min", "fade_speed")
        checks.fraction(where, self, "voltage_margin")
        checks.ordered(where, self, "voltage_min", "voltage_full")
        checks.ordered(where, self, "fade_speed", "max_speed")
        checks.ordered(where, self, "winding_derate", "winding_max")
        checks.ordered(where, self, "inverter_derate", "inverter_max")

    def pack(self, machine: PmsmParameters) -> NDArray[np.float64]:
        """Return the kernels' parameters with the tables of ``machine``, shape ``(N_PARAMETERS,)``.

        The tables reach from the corner to the greatest speed at ``voltage_min``; beyond, and where full
        current can no longer weaken the field enough, there is no torque.
        """
        current = math.sqrt(2.0) * self.current_rms
        peak = most_torque_per_ampere(machine, current)
        start = 1.0 / flux_linkage(machine, peak)
        lowest = self.voltage_margin * self.voltage_min / math.sqrt(3.0)
        end = max(machine.pole_pairs * self.max_speed / lowest, 1.01 * start)
        step = (end - start) / (N_RATIO - 1)
        own = [
            machine.pole_pairs,
            machine.flux,
            machine.inductance_q - machine.inductance_d,
            (machine.resistance * current) ** 2,
            2.0 * machine.resistance / (1.5 * machine.pole_pairs),
            peak.torque,
            self.voltage_margin,
            start,
            1.0 / step,
            (N_MTPA - 1) / peak.torque,
            self.voltage_min,
            self.voltage_full,
            self.fade_speed,
            self.max_speed,
            self.winding_derate,
            self.winding_max,
            self.inverter_derate,
            self.inverter_max,
        ]
        torques = np.linspace(0.0, peak.torque, N_MTPA)
        mtpa = [_mtpa_for(machine, torque, current) for torque in torques]
        fluxes = np.array([1.0 / (start + step * row) for row in range(N_RATIO)])
        greatest = np.array([most_torque(machine, current, flux).torque for flux in fluxes])
        shares = 1.0 - (1.0 - np.arange(N_SHARE) / (N_SHARE - 1)) ** 2
        weakening = weakened(machine, greatest[:, None] * shares, fluxes[:, None])
        weakening = np.maximum(weakening, -current)
        return np.concatenate([own, mtpa, greatest, weakening.ravel()])


def _mtpa_for(machine: PmsmParameters, torque: float, current: float) -> float:
    """Return i_d, A, of the MTPA point of a torque, N m, at most that of ``current``, A."""
    low, high = 0.0, current
    for _ in range(60):
        middle = 0.5 * (low + high)
        if most_torque_per_ampere(machine, middle).torque < torque:
            low = middle
        else:
            high = middle
    return most_torque_per_ampere(machine, high).i_d


@kernel
def flux_ratio(
    p: NDArray[np.float64], electrical_speed: float, voltage: float, torque: float
) -> float:
    """Return the inverse of the flux linkage, 1/Wb, that a voltage, V, leaves at a torque, N m."""
    square = voltage * voltage - p[P_CURRENT_DROP] - p[P_TORQUE_DROP] * electrical_speed * torque
    if square <= 0.0:
        return math.inf
    return abs(electrical_speed) / math.sqrt(square)


@kernel
def greatest_torque(p: NDArray[np.float64], ratio: float) -> float:
    """Return the greatest torque, N m, at a ratio, 1/Wb."""
    peak: float = p[P_PEAK_TORQUE]
    place = (ratio - p[P_RATIO_START]) * p[P_ROW_PER_RATIO]
    if place <= 0.0:
        return peak
    if place > N_RATIO - 1:
        return 0.0
    row = min(int(place), N_RATIO - 2)
    rest = place - row
    at = P_GREATEST + row
    torque: float = p[at] * (1.0 - rest) + p[at + 1] * rest
    return torque


@kernel
def _available(
    p: NDArray[np.float64], electrical_speed: float, voltage: float, torque: float
) -> float:
    """Return the greatest torque of one sign, N m, from a first guess of that sign."""
    sign = math.copysign(1.0, torque)
    for _ in range(_ROUNDS):
        torque = sign * greatest_torque(p, flux_ratio(p, electrical_speed, voltage, torque))
    return torque


@kernel
def torque_limits(
    p: NDArray[np.float64],
    speed: float,
    voltage: float,
    link_voltage: float,
    winding_temperature: float,
    inverter_temperature: float,
    out: NDArray[np.float64],
) -> None:
    """Write the range of air-gap torque available now, and why it is no wider.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        speed: of the shaft, rad/s.
        voltage: greatest linear phase voltage, V, peak (:func:`.inverter.linear_voltage`).
        link_voltage: V.
        winding_temperature, inverter_temperature: K.
        out: ``(N_LIM,)``.
    """
    electrical = p[P_POLE_PAIRS] * speed
    usable = p[P_MARGIN] * voltage
    upper: float = p[P_PEAK_TORQUE]
    lower: float = p[P_PEAK_TORQUE]
    if flux_ratio(p, abs(electrical), usable, upper) > p[P_RATIO_START]:
        first = greatest_torque(p, flux_ratio(p, electrical, usable, 0.0))
        upper = _available(p, electrical, usable, first)
        lower = -_available(p, electrical, usable, -first)
    peak = p[P_PEAK_TORQUE] * (1.0 - 1e-9)
    reason_max = float(source.LIMIT_VOLTAGE if upper < peak else source.LIMIT_PEAK)
    reason_min = float(source.LIMIT_VOLTAGE if lower < peak else source.LIMIT_PEAK)
    share = 1.0 - fade(link_voltage, p[P_VOLTAGE_MIN], p[P_VOLTAGE_FULL])
    if share < 1.0:
        reason_max = reason_min = float(source.LIMIT_VOLTAGE)
    derating = min(
        fade(winding_temperature, p[P_WINDING_DERATE], p[P_WINDING_MAX]),
        fade(inverter_temperature, p[P_INVERTER_DERATE], p[P_INVERTER_MAX]),
    )
    if derating < 1.0:
        share *= derating
        reason_max = reason_min = float(source.LIMIT_TEMPERATURE)
    upper *= share
    lower *= share
    driving = fade(abs(speed), p[P_FADE_SPEED], p[P_MAX_SPEED])
    if driving < 1.0:
        if speed > 0.0:
            upper *= driving
            reason_max = float(source.LIMIT_SPEED)
        else:
            lower *= driving
            reason_min = float(source.LIMIT_SPEED)
    out[LIM_TORQUE_MIN] = -lower
    out[LIM_TORQUE_MAX] = upper
    out[LIM_REASON_MIN] = reason_min
    out[LIM_REASON_MAX] = reason_max


@kernel
def reference_currents(
    p: NDArray[np.float64], torque: float, speed: float, voltage: float
) -> tuple[float, float]:
    """Return the reference i_d and i_q, A, peak, of an air-gap torque.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        torque: inside the limits of :func:`torque_limits`, N m.
        speed: of the shaft, rad/s.
        voltage: greatest linear phase voltage, V, peak.
    """
    size = abs(torque)
    place = min(size * p[P_ROW_PER_TORQUE], N_MTPA - 1.0)
    row = min(int(place), N_MTPA - 2)
    rest = place - row
    at = P_MTPA + row
    i_d: float = p[at] * (1.0 - rest) + p[at + 1] * rest
    ratio = flux_ratio(p, p[P_POLE_PAIRS] * speed, p[P_MARGIN] * voltage, torque)
    place = (ratio - p[P_RATIO_START]) * p[P_ROW_PER_RATIO]
    if place > 0.0:
        place = min(place, N_RATIO - 1.0)
        row = min(int(place), N_RATIO - 2)
        rest = place - row
        at = P_GREATEST + row
        greatest = p[at] * (1.0 - rest) + p[at + 1] * rest
        share = min(size / greatest, 1.0) if greatest > 0.0 else 1.0
        along = (1.0 - math.sqrt(1.0 - share)) * (N_SHARE - 1)
        column = min(int(along), N_SHARE - 2)
        side = along - column
        at = P_WEAKENING + row * N_SHARE + column
        below = p[at] * (1.0 - side) + p[at + 1] * side
        at += N_SHARE
        above = p[at] * (1.0 - side) + p[at + 1] * side
        i_d = min(i_d, below * (1.0 - rest) + above * rest)
    i_q = torque / (1.5 * p[P_POLE_PAIRS] * (p[P_FLUX] - p[P_SALIENCE] * i_d))
    return i_d, i_q
