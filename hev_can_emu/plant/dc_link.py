"""The DC link: one capacitor between battery, precharge, discharge and the inverters.

::

    C*dV/dt = G_s*(U - V) - G_d*V - i

with the source U behind G_s (precharge resistor, or the battery's own resistance through closed
contactors, or nothing), the discharge conductance G_d, and a load current i, constant over the step, of
that size at which the load takes exactly the energy asked for: ``i*mean(V)*h = E``, a quadratic in i.
Voltage and all energies come from the two-stage Gauss method (order 4, A-stable), so that

    source = load + source resistance + discharge + change of 1/2*C*V^2

closes to rounding.  When contactors close is decided in :mod:`hev_can_emu.plant.contactors`.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks, contactors

# Layout of the packed parameters.
P_DT, P_CAPACITANCE, P_PRECHARGE_RESISTANCE, P_DISCHARGE, P_BLEED = 0, 1, 2, 3, 4
N_PARAMETERS = 5

X_VOLTAGE = 0
N_STATE = 1

# Layout of the output: energies of the step J; mean current from the source A; voltage at the end V;
# refused energy J.
OUT_SOURCE, OUT_LOAD, OUT_RESISTANCE, OUT_DISCHARGE, OUT_STORED = 0, 1, 2, 3, 4
OUT_CURRENT, OUT_VOLTAGE, OUT_REFUSED = 5, 6, 7
N_OUT = 8

_STAGE = math.sqrt(3.0) / 6.0


class DcLinkParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The DC link; SI units.

    Attributes:
        capacitance: of both inverters together, F.
        precharge_resistance: ohm.
        discharge_resistance: empties the link while the contactors are open, ohm.
        bleed_resistance: always across the link, ohm.
    """

    capacitance: float
    precharge_resistance: float
    discharge_resistance: float
    bleed_resistance: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        names = ("capacitance", "precharge_resistance", "discharge_resistance", "bleed_resistance")
        checks.positive(where, self, *names)

    def pack(self, dt: float = 5e-5) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a step of ``dt`` s."""
        own = [
            dt,
            self.capacitance,
            self.precharge_resistance,
            1.0 / self.discharge_resistance,
            1.0 / self.bleed_resistance,
        ]
        return np.array(own)


@kernel
def link_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    phase: float,
    source_voltage: float,
    source_resistance: float,
    energy: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one step.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: voltage, V, ``(N_STATE,)``, changed in place.
        phase: of the contactors (``contactors.OPEN`` to ``FAULT``).
        source_voltage, source_resistance: the battery's open-circuit voltage, V, and resistance, ohm (> 0).
        energy: that all loads took in this step, J, negative when they give.
        out: ``(N_OUT,)``: energies of this step, J: from the source's open-circuit voltage, to the
            loads, lost in source and precharge resistance, lost in the discharge resistors; stored at the
            end, J; mean current from the source, A; voltage at the end, V; energy refused because the
            link was empty, J.
    """
    h, c = p[P_DT], p[P_CAPACITANCE]
    feed = 0.0
    drain = p[P_BLEED]
    if phase in (contactors.CLOSED, contactors.OPENING):
        feed = 1.0 / source_resistance
    elif phase == contactors.PRECHARGE:
        feed = 1.0 / (source_resistance + p[P_PRECHARGE_RESISTANCE])
    else:
        drain += p[P_DISCHARGE]
    before = x[X_VOLTAGE]

    # dV/dt = a*V + b - i/C; y = h*(rate at start)/(1 - z/2 + z^2/12), z = h*a; mean = V0 + y*(1/2 - z/12).
    z = -h * (feed + drain) / c
    gain = h / (1.0 - 0.5 * z + z * z / 12.0)
    shift = 0.5 - z / 12.0
    free = gain * (feed * source_voltage - (feed + drain) * before) / c
    mean_free = before + shift * free
    mean_slope = shift * gain / c
    square = mean_free * mean_free - 4.0 * mean_slope * energy / h
    current, given = 0.0, energy
    if energy > 0.0 and (square < 0.0 or mean_free <= 0.0):  # an empty link gives what is in it
        current = max(mean_free, 0.0) / (2.0 * mean_slope)
        given = 0.5 * h * current * max(mean_free, 0.0)
    elif energy != 0.0:
        current = 2.0 * energy / h / (mean_free + math.sqrt(square))
    y = free - gain * current / c
    middle = before + shift * y
    first, second = middle - _STAGE * y, middle + _STAGE * y
    after = before + y
    x[X_VOLTAGE] = after
    drop1, drop2 = source_voltage - first, source_voltage - second
    mean_current = feed * 0.5 * (drop1 + drop2)
    out[OUT_SOURCE] = h * source_voltage * mean_current
    out[OUT_LOAD] = h * current * middle
    out[OUT_RESISTANCE] = 0.5 * h * feed * (drop1 * drop1 + drop2 * drop2)
    out[OUT_DISCHARGE] = 0.5 * h * drain * (first * first + second * second)
    out[OUT_STORED] = 0.5 * c * after * after
    out[OUT_CURRENT] = mean_current
    out[OUT_VOLTAGE] = after
    out[OUT_REFUSED] = energy - given
