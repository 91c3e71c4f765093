"""EM1 or EM2 as a drive: torque request to currents, machine, inverter and DC link, one inner step.

::

    request -> [limits] -> slew -> + drag -> reference currents -> current control     every control period
    voltage -> machine -> torque, energies                                             every step

What the gates do is given: BLOCKED (freewheel: the diodes conduct when the back-EMF exceeds the link),
ACTIVE (torque control) or SHORT (active short circuit of all three phases).  Speed and DC voltage
are constant over a step.  Each energy is integrated for itself; together they close:

    DC = shaft + copper + iron + drag + inverter + change of the magnetic energy
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks, current_control, freewheel, inverter, pmsm, torque_map
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.current_control import CurrentControlParameters
from hev_can_emu.plant.inverter import ACTIVE, BLOCKED, SHORT, InverterParameters
from hev_can_emu.plant.pmsm import PmsmParameters
from hev_can_emu.plant.torque_map import TorqueMapParameters

__all__ = ["ACTIVE", "BLOCKED", "SHORT", "DriveParameters", "drive_step"]

# Layout of the packed parameters: the machine's (first, so that its kernels take the array as it is),
# own values, then those of the other parts.
P_CONTROL_STEPS = pmsm.N_PARAMETERS
P_SLEW_STEP, P_COMPENSATE = P_CONTROL_STEPS + 1, P_CONTROL_STEPS + 2
P_INVERTER = P_CONTROL_STEPS + 3
P_CONTROL = P_INVERTER + inverter.N_PARAMETERS
P_MAP = P_CONTROL + current_control.N_PARAMETERS
N_PARAMETERS = P_MAP + torque_map.N_PARAMETERS

# Layout of the state: the parts' (the machine's first), electrical angle rad, steps since the last
# control period began, gates, setpoint and its reason, what the shaft gets less than the air gap N m,
# limits in the air gap.
X_CONTROL = pmsm.N_STATE
X_ANGLE = X_CONTROL + current_control.N_STATE
X_COUNT, X_GATES, X_SETPOINT, X_REASON = X_ANGLE + 1, X_ANGLE + 2, X_ANGLE + 3, X_ANGLE + 4
X_DRAG = X_ANGLE + 5
X_LIMITS = X_ANGLE + 6
N_STATE = X_LIMITS + torque_map.N_LIM

# Layout of the output: the machine's (OUT_TORQUE of pmsm is the mean torque at the shaft), then these.
OUT_SETPOINT = freewheel.N_OUT
OUT_REASON, OUT_TORQUE_MIN, OUT_TORQUE_MAX = OUT_SETPOINT + 1, OUT_SETPOINT + 2, OUT_SETPOINT + 3
OUT_REASON_MIN, OUT_REASON_MAX = OUT_SETPOINT + 4, OUT_SETPOINT + 5
OUT_DC, OUT_INVERTER = OUT_SETPOINT + 6, OUT_SETPOINT + 7
N_OUT = OUT_SETPOINT + 8

_TURN = 2.0 * math.pi
_SAME = 1e-9


class DriveParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A machine with its inverter and control; SI units.

    Attributes:
        machine, inverter, control, limits: the parts.
        slew_rate: fastest change of the torque setpoint, N m/s.
        compensate_drag: 1 counts requests and limits at the shaft (iron and drag losses are added), 0 in
            the air gap.
    """

    machine: PmsmParameters
    inverter: InverterParameters
    control: CurrentControlParameters
    limits: TorqueMapParameters
    slew_rate: float
    compensate_drag: float = 1.0

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        self.machine.validate(f"{where}.machine")
        self.inverter.validate(f"{where}.inverter")
        self.control.validate(f"{where}.control")
        self.limits.validate(f"{where}.limits")
        checks.positive(where, self, "slew_rate")
        checks.fraction(where, self, "compensate_drag")

    def pack(self, dt: float = 5e-5) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a step of ``dt`` s.

        Builds the tables of :mod:`.torque_map` (about 20 ms).  ValueError unless the control period is a
        multiple of ``dt``.
        """
        steps = self.control.steps(dt)
        own = [steps, self.slew_rate * self.control.period, self.compensate_drag]
        parts = [
            self.machine.pack(dt),
            np.array(own, dtype=np.float64),
            self.inverter.pack(dt),
            self.control.pack(self.machine),
            self.limits.pack(self.machine),
        ]
        return np.concatenate(parts)


@kernel
def _setpoint(p: NDArray[np.float64], x: NDArray[np.float64], request: float, drag: float) -> None:
    """Limit and slew the request; setpoint and reason go into the state."""
    if math.isnan(request):
        request = 0.0
    reason = float(source.LIMIT_NONE)
    lower = x[X_LIMITS + torque_map.LIM_TORQUE_MIN] - drag
    upper = x[X_LIMITS + torque_map.LIM_TORQUE_MAX] - drag
    limited = request
    if limited > upper:
        limited = upper
        reason = x[X_LIMITS + torque_map.LIM_REASON_MAX]
    if limited < lower:
        limited = lower
        reason = x[X_LIMITS + torque_map.LIM_REASON_MIN]
    before = min(max(x[X_SETPOINT], lower), upper)
    step = p[P_SLEW_STEP]
    if limited > before + step + _SAME:
        limited = before + step
        reason = float(source.LIMIT_SLEW)
    elif limited < before - step - _SAME:
        limited = before - step
        reason = float(source.LIMIT_SLEW)
    x[X_SETPOINT] = limited
    x[X_REASON] = reason


@kernel
def _control(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    request: float,
    gates: float,
    speed: float,
    link_voltage: float,
    winding_temperature: float,
    inverter_temperature: float,
) -> None:
    """One control period: limits, setpoint, reference x, voltage."""
    legs = p[P_INVERTER : P_INVERTER + inverter.N_PARAMETERS]
    limits = p[P_MAP : P_MAP + torque_map.N_PARAMETERS]
    voltage = inverter.linear_voltage(legs, link_voltage)
    torque_map.torque_limits(
        limits, speed, voltage, link_voltage, winding_temperature, inverter_temperature,
        x[X_LIMITS : X_LIMITS + torque_map.N_LIM],
    )  # fmt: skip
    i_d, i_q = x[pmsm.X_ID], x[pmsm.X_IQ]
    drag = p[P_COMPENSATE] * (
        pmsm.iron_factor(p, speed) * pmsm.flux_square(p, i_d, i_q) + pmsm.mechanical_drag(p, speed)
    )
    x[X_DRAG] = drag
    if gates != ACTIVE:
        x[X_SETPOINT] = 0.0
        idle = math.isnan(request) or request == 0.0
        x[X_REASON] = float(source.LIMIT_NONE if idle else source.LIMIT_DISABLED)
        return
    _setpoint(p, x, request, drag)
    ref_d, ref_q = torque_map.reference_currents(limits, x[X_SETPOINT] + drag, speed, voltage)
    current_control.current_control_step(
        p[P_CONTROL : P_CONTROL + current_control.N_PARAMETERS], legs,
        x[X_CONTROL : X_CONTROL + current_control.N_STATE],
        ref_d, ref_q, i_d, i_q, p[pmsm.P_POLE_PAIRS] * speed, x[X_ANGLE], link_voltage,
    )  # fmt: skip


@kernel
def drive_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    request: float,
    gates: float,
    speed: float,
    link_voltage: float,
    winding_temperature: float,
    inverter_temperature: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one step.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place; all zero at start.
        request: torque, N m; NaN counts as 0.
        gates: BLOCKED, ACTIVE or SHORT.
        speed: of the shaft, rad/s.
        link_voltage: at the start of the step, V.
        winding_temperature, inverter_temperature: K.
        out: ``(N_OUT,)``: the machine's outputs, setpoint N m and its LIMIT_* code, torque range now, N m,
            and the codes of its ends, energy taken from the DC link J, lost in the inverter J.
    """
    h = p[pmsm.P_DT]
    if gates != x[X_GATES]:
        # Control starts anew: integrators empty, a whole period ahead.
        x[X_GATES] = gates
        x[X_COUNT] = 0.0
        x[X_SETPOINT] = 0.0
        for i in range(current_control.N_STATE):
            x[X_CONTROL + i] = 0.0
    if x[X_COUNT] == 0.0:
        _control(
            p, x, request, gates, speed, link_voltage, winding_temperature, inverter_temperature
        )
    x[X_COUNT] += 1.0
    if x[X_COUNT] >= p[P_CONTROL_STEPS]:
        x[X_COUNT] = 0.0

    resistance = pmsm.phase_resistance(p, winding_temperature)
    if gates == ACTIVE:
        v_d = x[X_CONTROL + current_control.X_VD]
        v_q = x[X_CONTROL + current_control.X_VQ]
        pmsm.pmsm_step(p, x, v_d, v_q, speed, resistance, 0.0, out)
        legs = p[P_INVERTER : P_INVERTER + inverter.N_PARAMETERS]
        square = out[pmsm.OUT_CURRENT] * out[pmsm.OUT_CURRENT]
        loss = h * inverter.switching_loss(legs, out[pmsm.OUT_CURRENT], square, link_voltage)
        out[OUT_INVERTER] = loss
        out[OUT_DC] = out[pmsm.OUT_TERMINAL] + loss
    elif gates == SHORT:
        pmsm.pmsm_step(
            p, x, 0.0, 0.0, speed, resistance, p[P_INVERTER + inverter.P_DEVICE_RESISTANCE], out
        )
        out[OUT_INVERTER] = out[pmsm.OUT_SERIES]
        out[OUT_DC] = 0.0
    else:
        freewheel.freewheel_step(
            p, x, max(link_voltage, 0.0), p[P_INVERTER + inverter.P_DEVICE_VOLTAGE], speed,
            resistance, p[P_INVERTER + inverter.P_DEVICE_RESISTANCE], out,
        )  # fmt: skip
        out[OUT_INVERTER] = out[pmsm.OUT_SERIES] + out[freewheel.OUT_DIODES]
        out[OUT_DC] = -out[freewheel.OUT_LINK]

    angle = x[X_ANGLE] + h * p[pmsm.P_POLE_PAIRS] * speed
    if not 0.0 <= angle < _TURN:
        angle -= _TURN * math.floor(angle / _TURN)
    x[X_ANGLE] = angle
    out[OUT_SETPOINT] = x[X_SETPOINT]
    out[OUT_REASON] = x[X_REASON]
    out[OUT_TORQUE_MIN] = x[X_LIMITS + torque_map.LIM_TORQUE_MIN] - x[X_DRAG]
    out[OUT_TORQUE_MAX] = x[X_LIMITS + torque_map.LIM_TORQUE_MAX] - x[X_DRAG]
    out[OUT_REASON_MIN] = x[X_LIMITS + torque_map.LIM_REASON_MIN]
    out[OUT_REASON_MAX] = x[X_LIMITS + torque_map.LIM_REASON_MAX]
