"""A machine behind blocked switches: the inverter's diodes as a six-pulse rectifier into the DC link.

The diodes hold the terminal voltage against the current.  In the mean over a period its fundamental, in
motor convention, is ``-k*(V_dc + 2*V_f)`` along the current vector, turned ahead by an angle phi.  k is
2/pi when the diodes conduct without a gap, and 1/sqrt(3) at the edge of conduction, where the
line-to-line back-EMF just reaches the link; phi belongs to the gaps in between.  With the current
in units of ``(V_dc + 2*V_f)/(|w_e|*L)``, L the mean inductance::

    k = 1/sqrt(3) + (2/pi - 1/sqrt(3))*i/(i + 0.015)        sin(phi) = 0.21*2*u/(1 + u^2), u = i/0.15

(fitted to a switched bridge).  This is dry friction in two dimensions: currents flow against it or rest
at zero.  While they flow the step is the implicit midpoint rule (order 2, closes the energy balance
exactly); the last step of a dying current is a straight line to zero whose length follows from its energy.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import pmsm

_EDGE = 1.0 / math.sqrt(3.0)
_GAPLESS = 2.0 / math.pi
_GAP = 0.015
_TURNED, _TURNED_AT = 0.21, 0.15
_ROUNDS = 40  # a handful is enough; bounded so that a step always ends
_CLOSE = 1e-12
_NOTHING = 1e-18  # A^2; less is no current
_LEAST = 1e-3  # V; the least rectifier voltage, for ideal diodes into an empty link

# Layout of the output behind the machine's own: energies of the step, J.
OUT_LINK, OUT_DIODES = pmsm.N_OUT, pmsm.N_OUT + 1
N_OUT = pmsm.N_OUT + 2


@kernel
def _friction(voltage: float, current: float, unit: float, sign: float) -> tuple[float, float]:
    """Return what the terminal voltage is along and across the current, over the current, ohm."""
    share = current / unit
    size = voltage * (_EDGE + (_GAPLESS - _EDGE) * share / (share + _GAP)) / current
    u = share / _TURNED_AT
    sine = _TURNED * 2.0 * u / (1.0 + u * u)
    return size * math.sqrt(1.0 - sine * sine), sign * size * sine


@kernel
def _against(
    d: float,
    q: float,
    own_d: float,
    own_q: float,
    cross_d: float,
    cross_q: float,
    along: float,
    across: float,
) -> tuple[float, float]:
    """Solve ``[[own_d + along, cross_d - across], [cross_q + across, own_q + along]] * i = (d, q)``."""
    own_d += along
    own_q += along
    cross_d -= across
    cross_q += across
    scale = 1.0 / (own_d * own_q - cross_d * cross_q)
    return scale * (own_q * d - cross_d * q), scale * (own_d * q - cross_q * d)


@kernel
def freewheel_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    link_voltage: float,
    diode_voltage: float,
    speed: float,
    resistance: float,
    series_resistance: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one step with all switches blocked.

    Args:
        p: parameters of the machine, ``(pmsm.N_PARAMETERS,)``.
        x: its state, ``(pmsm.N_STATE,)``, changed in place.
        link_voltage: not negative, V.
        diode_voltage: forward voltage of one diode, V.
        speed: of the shaft, rad/s.
        resistance: of one phase, ohm.
        series_resistance: of one diode, ohm.
        out: ``(N_OUT,)``: as :func:`hev_can_emu.plant.pmsm.pmsm_step` (``OUT_TERMINAL`` is negative: what
            leaves the machine), then the energies given to the link and lost in the diodes' forward voltage.
    """
    h = p[pmsm.P_DT]
    ld, lq, psi = p[pmsm.P_LD], p[pmsm.P_LQ], p[pmsm.P_FLUX]
    electrical = p[pmsm.P_POLE_PAIRS] * speed
    id0, iq0 = x[pmsm.X_ID], x[pmsm.X_IQ]
    r = resistance + series_resistance
    voltage = max(link_voltage + 2.0 * diode_voltage, _LEAST)
    edge = _EDGE * voltage
    emf = electrical * psi
    at_rest = id0 * id0 + iq0 * iq0 < _NOTHING
    blocked = abs(emf) <= edge
    if at_rest and blocked:
        x[pmsm.X_ID] = 0.0
        x[pmsm.X_IQ] = 0.0
        _write(
            p, speed, 0.0, 0.0, 0.0, resistance, series_resistance, 0.0, psi * psi, out
        )  # fmt: skip
        out[pmsm.OUT_MAGNETIC] = 0.0
        _share(out, link_voltage, voltage)
        return

    # Midpoint: (2/h*L + R + w_e*L*J + friction)*i = 2/h*L*i0 - emf.
    own_d, own_q = 2.0 * ld / h + r, 2.0 * lq / h + r
    cross_d, cross_q = -electrical * lq, electrical * ld
    push_d, push_q = 2.0 * ld / h * id0, 2.0 * lq / h * iq0 - emf
    if not at_rest:
        # The power that empties the inductances if the currents go to zero on a straight line.
        size = math.sqrt(id0 * id0 + iq0 * iq0)
        pull = 1.5 * p[pmsm.P_POLE_PAIRS] * (0.5 * psi * iq0 + (ld - lq) * id0 * iq0 / 3.0)
        diodes = 0.75 * edge * size
        square = size * size / 3.0
        stored = pmsm.magnetic_energy(p, id0, iq0)
        power = diodes + 1.5 * r * square + pull * speed
        held = blocked or math.sqrt(push_d * push_d + push_q * push_q) <= edge
        if held and power * h >= stored:
            share = stored / (power * h)  # of the step
            flux = psi * psi + share * (
                psi * ld * id0 + (ld * ld * id0 * id0 + lq * lq * iq0 * iq0) / 3.0
            )
            x[pmsm.X_ID] = 0.0
            x[pmsm.X_IQ] = 0.0
            _write(
                p, speed, share * pull, -share * h * diodes, share * square, resistance,
                series_resistance, 0.5 * share * size, flux, out,
            )  # fmt: skip
            out[pmsm.OUT_MAGNETIC] = 0.0
            _share(out, link_voltage, voltage)
            return

    unit = voltage / (max(abs(electrical), 1.0) * 0.5 * (ld + lq))
    sign = 1.0 if electrical >= 0.0 else -1.0
    # Root of size/|i(friction(size))| - 1, nearly a straight line: regula falsi (Illinois).
    push = math.sqrt(push_d * push_d + push_q * push_q)
    mean_d, mean_q, along = 0.0, 0.0, 0.0
    if push > edge:
        mean_d, mean_q = _against(push_d, push_q, own_d, own_q, cross_d, cross_q, 0.0, 0.0)
        low, at_low = 0.0, edge / push - 1.0
        high = math.sqrt(mean_d * mean_d + mean_q * mean_q)
        along, across = _friction(voltage, high, unit, sign)
        mean_d, mean_q = _against(push_d, push_q, own_d, own_q, cross_d, cross_q, along, across)
        at_high = high / math.sqrt(mean_d * mean_d + mean_q * mean_q) - 1.0
        side = 0
        for _ in range(_ROUNDS):
            if not at_high > at_low:
                break
            size = (low * at_high - high * at_low) / (at_high - at_low)
            along, across = _friction(voltage, size, unit, sign)
            mean_d, mean_q = _against(push_d, push_q, own_d, own_q, cross_d, cross_q, along, across)
            here = size / math.sqrt(mean_d * mean_d + mean_q * mean_q) - 1.0
            if abs(here) < _CLOSE:
                break
            if here < 0.0:
                low, at_low = size, here
                if side < 0:
                    at_high *= 0.5
                side = -1
            else:
                high, at_high = size, here
                if side > 0:
                    at_low *= 0.5
                side = 1
    x[pmsm.X_ID] = 2.0 * mean_d - id0
    x[pmsm.X_IQ] = 2.0 * mean_q - iq0
    square = mean_d * mean_d + mean_q * mean_q
    _write(
        p, speed, pmsm.air_gap_torque(p, mean_d, mean_q), -1.5 * h * along * square,
        square, resistance, series_resistance, math.sqrt(square),
        pmsm.flux_square(p, mean_d, mean_q), out,
    )  # fmt: skip
    out[pmsm.OUT_MAGNETIC] = pmsm.magnetic_energy(p, x[pmsm.X_ID], x[pmsm.X_IQ])
    _share(out, link_voltage, voltage)


@kernel
def _write(
    p: NDArray[np.float64],
    speed: float,
    air_gap: float,
    terminal: float,
    square: float,
    resistance: float,
    series_resistance: float,
    current: float,
    flux: float,
    out: NDArray[np.float64],
) -> None:
    """Enter torques and energies; ``square``, ``flux``: mean squares of current and flux linkage."""
    h = p[pmsm.P_DT]
    iron = pmsm.iron_factor(p, speed) * flux
    drag = pmsm.mechanical_drag(p, speed)
    out[pmsm.OUT_TORQUE] = air_gap - iron - drag
    out[pmsm.OUT_AIR_GAP] = air_gap
    out[pmsm.OUT_TERMINAL] = terminal
    out[pmsm.OUT_SHAFT] = h * speed * out[pmsm.OUT_TORQUE]
    out[pmsm.OUT_COPPER] = 1.5 * h * resistance * square
    out[pmsm.OUT_SERIES] = 1.5 * h * series_resistance * square
    out[pmsm.OUT_IRON] = h * speed * iron
    out[pmsm.OUT_DRAG] = h * speed * drag
    out[pmsm.OUT_CURRENT] = current


@kernel
def _share(out: NDArray[np.float64], link_voltage: float, voltage: float) -> None:
    """Divide what leaves the machine between the link and the diodes' forward voltage."""
    given = -out[pmsm.OUT_TERMINAL]
    out[OUT_LINK] = given * link_voltage / voltage if voltage > 0.0 else 0.0
    out[OUT_DIODES] = given * (voltage - link_voltage) / voltage if voltage > 0.0 else 0.0
