"""The three-phase inverter, averaged over its switching period.

What its legs can give: a voltage vector inside the hexagon of the DC link, whose inner circle has the radius
``V_dc/sqrt(3)`` (peak; ``V_dc/sqrt(6)`` RMS).  By default the reference is held inside that circle (and
inside the greatest RMS voltage of the machine); with overmodulation the circle is the outer one and
the legs clip to the hexagon.  The zero component that centres the three legs (that of space-vector
modulation) does not reach the machine.

Loss, for the peak phase current i: ``P_0 + (6/pi)*(V_0 + e*f*V_dc)*i + 1.5*r*i^2``: each phase current, mean
``2*i/pi``, always flows through one device; e is switching energy per volt and ampere.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant.transforms import clarke, inverse_clarke, inverse_park, park

# What the gates do.
BLOCKED, ACTIVE, SHORT = 0, 1, 2

# Layout of the packed parameters.
P_DT, P_PEAK_VOLTAGE, P_OVERMODULATION, P_FIXED_LOSS, P_DEVICE_VOLTAGE = 0, 1, 2, 3, 4
P_DEVICE_RESISTANCE, P_SWITCHING = 5, 6
N_PARAMETERS = 7

_INNER = 1.0 / math.sqrt(3.0)
_LEG_MEAN = 6.0 / math.pi  # three legs, each with the mean of a rectified sine of peak 1


class InverterParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A three-phase inverter; SI units.

    Attributes:
        voltage_rms: greatest phase voltage (fundamental, RMS), V, whatever the DC link would allow.
        overmodulation: 0 holds the voltage inside the hexagon's inner circle, 1 uses the hexagon.
        fixed_loss: while switching, W.
        device_voltage: forward voltage of transistor or diode at no current, V.
        device_resistance: slope of the forward characteristic, ohm.
        switching_energy: of one device, on and off, per volt of the link and ampere, J/(V A).
        switching_frequency: Hz.
    """

    voltage_rms: float
    overmodulation: float
    fixed_loss: float
    device_voltage: float
    device_resistance: float
    switching_energy: float
    switching_frequency: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "voltage_rms", "switching_frequency")
        checks.fraction(where, self, "overmodulation")
        checks.not_negative(
            where, self, "fixed_loss", "device_voltage", "device_resistance", "switching_energy"
        )

    def pack(self, dt: float = 5e-5) -> NDArray[np.float64]:
        """Return the kernels' parameters, shape ``(N_PARAMETERS,)``, for a step of ``dt`` s."""
        own = [
            dt,
            math.sqrt(2.0) * self.voltage_rms,
            self.overmodulation,
            self.fixed_loss,
            self.device_voltage,
            self.device_resistance,
            self.switching_energy * self.switching_frequency,
        ]
        return np.array(own)


@kernel
def linear_voltage(p: NDArray[np.float64], link_voltage: float) -> float:
    """Return the greatest undistorted phase voltage, V, peak, at a DC link voltage, V."""
    limit: float = min(p[P_PEAK_VOLTAGE], max(link_voltage, 0.0) * _INNER)
    return limit


@kernel
def to_circle(v_d: float, v_q: float, radius: float) -> tuple[float, float]:
    """Return the vector, shortened to ``radius`` where it is longer."""
    square = v_d * v_d + v_q * v_q
    if square <= radius * radius:
        return v_d, v_q
    share = radius / math.sqrt(square)
    return v_d * share, v_q * share


@kernel
def leg_duties(alpha: float, beta: float, link_voltage: float) -> tuple[float, float, float]:
    """Return the duties, 0 to 1, of the three legs for a voltage vector at rest, V.

    Centred between the rails; what the link cannot give is clipped leg by leg.
    """
    if link_voltage <= 0.0:
        return 0.5, 0.5, 0.5
    a, b, c = inverse_clarke(alpha, beta, 0.0)
    middle = 0.5 * (max(a, b, c) + min(a, b, c))
    return (
        min(max(0.5 + (a - middle) / link_voltage, 0.0), 1.0),
        min(max(0.5 + (b - middle) / link_voltage, 0.0), 1.0),
        min(max(0.5 + (c - middle) / link_voltage, 0.0), 1.0),
    )


@kernel
def terminal_voltage(
    p: NDArray[np.float64], v_d: float, v_q: float, angle: float, link_voltage: float
) -> tuple[float, float]:
    """Return the dq voltage, V, peak, that the inverter really gives.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        v_d, v_q: reference, V, peak.
        angle: electrical angle of the rotor, rad, in the middle of the step.
        link_voltage: V.

    Inside the inner circle legs and transforms give back the reference, so they are left out.
    """
    inner = linear_voltage(p, link_voltage)
    if p[P_OVERMODULATION] < 0.5 or v_d * v_d + v_q * v_q <= inner * inner:
        return to_circle(v_d, v_q, inner)
    v_d, v_q = to_circle(v_d, v_q, p[P_PEAK_VOLTAGE])
    alpha, beta = inverse_park(v_d, v_q, angle)
    a, b, c = leg_duties(alpha, beta, link_voltage)
    alpha, beta, _ = clarke(a * link_voltage, b * link_voltage, c * link_voltage)
    return park(alpha, beta, angle)


@kernel
def switching_loss(
    p: NDArray[np.float64], current: float, current_square: float, link_voltage: float
) -> float:
    """Return the loss while switching, W, at a mean current, A, and mean square, A^2 (peak values)."""
    drop = p[P_DEVICE_VOLTAGE] + p[P_SWITCHING] * max(link_voltage, 0.0)
    loss: float = (
        p[P_FIXED_LOSS] + _LEG_MEAN * drop * current + 1.5 * p[P_DEVICE_RESISTANCE] * current_square
    )
    return loss
