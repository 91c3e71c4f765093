"""The high-voltage contactors and the DC link behind them.

State machine (``close`` is the request)::

    OPEN      -> PRECHARGE  close
    PRECHARGE -> CLOSED     link voltage >= share of the battery's     PRECHARGE -> OPEN  not close
    PRECHARGE -> FAULT      time-out (a load or a short on the link)
    CLOSED    -> OPENING    not close
    OPENING   -> OPEN       after the opening time: the inverters end their torque in it
    OPENING   -> CLOSED     close again
    FAULT     -> OPEN       not close

While precharging, the link charges through the precharge resistor; while open, it discharges through
the discharge resistor, which is switched off otherwise.  Both are first order and exact; a leak
(conductance) across the link is part of both.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks

OPEN, PRECHARGE, CLOSED, OPENING, FAULT = 0, 1, 2, 3, 4

# Layout of the packed parameters.
P_DT, P_PRECHARGE_CONDUCTANCE, P_DISCHARGE_CONDUCTANCE, P_LINK_CAPACITANCE = 0, 1, 2, 3
P_PRECHARGE_SHARE, P_PRECHARGE_TIMEOUT, P_OPENING_TIME = 4, 5, 6
N_PARAMETERS = 7

# Layout of the state.
X_PHASE, X_LINK_VOLTAGE, X_TIMER = 0, 1, 2
N_STATE = 3

_HALF_NS = 5e-10


class ContactorParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Contactors, precharge and DC link; SI units.

    Attributes:
        precharge_resistance: ohm.
        discharge_resistance: empties the link while open, ohm.
        link_capacitance: of both inverters together, F.
        precharge_share: close at this share of the battery voltage, 1.
        precharge_timeout: give up after this time, s.
        opening_time: from the request to open contacts, s.
    """

    precharge_resistance: float
    discharge_resistance: float
    link_capacitance: float
    precharge_share: float
    precharge_timeout: float
    opening_time: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        names = ("precharge_resistance", "discharge_resistance", "link_capacitance")
        checks.positive(where, self, *names, "precharge_share", "precharge_timeout")
        checks.fraction(where, self, "precharge_share")
        checks.not_negative(where, self, "opening_time")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a period of ``dt`` s."""
        return np.array(
            [
                dt,
                1.0 / self.precharge_resistance,
                1.0 / self.discharge_resistance,
                self.link_capacitance,
                self.precharge_share,
                self.precharge_timeout,
                self.opening_time,
            ]
        )


@small_kernel
def contactor_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    close: float,
    battery_voltage: float,
    link_leak: float,
) -> None:
    """Advance one period; the result is the state: phase and link voltage.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place; all zero is open and discharged.
        close: request, 0 or 1.
        battery_voltage: terminal voltage while closed, open-circuit voltage otherwise, V.
        link_leak: conductance across the link that should not be there, S; 0 when sound.
    """
    phase = x[X_PHASE]
    wanted = close > 0.5
    timer = x[X_TIMER] + p[P_DT]
    before = phase
    if phase == OPEN and wanted:
        phase = float(PRECHARGE)
    elif phase == PRECHARGE:
        if not wanted:
            phase = float(OPEN)
        elif x[X_LINK_VOLTAGE] >= p[P_PRECHARGE_SHARE] * battery_voltage:
            phase = float(CLOSED)
        elif timer > p[P_PRECHARGE_TIMEOUT] + _HALF_NS:
            phase = float(FAULT)
    elif phase == CLOSED and not wanted:
        phase = float(OPENING)
    elif phase == OPENING:
        if wanted:
            phase = float(CLOSED)
        elif timer >= p[P_OPENING_TIME] - _HALF_NS:
            phase = float(OPEN)
    elif phase == FAULT and not wanted:
        phase = float(OPEN)
    x[X_PHASE] = phase
    x[X_TIMER] = timer if phase == before else 0.0

    if phase in (CLOSED, OPENING):
        x[X_LINK_VOLTAGE] = battery_voltage
        return
    feed = 0.0
    drain = link_leak
    if phase == PRECHARGE:
        feed = p[P_PRECHARGE_CONDUCTANCE]
    else:
        drain += p[P_DISCHARGE_CONDUCTANCE]
    settled = battery_voltage * feed / (feed + drain)
    keep = math.exp(-p[P_DT] * (feed + drain) / p[P_LINK_CAPACITANCE])
    x[X_LINK_VOLTAGE] = settled + (x[X_LINK_VOLTAGE] - settled) * keep
