"""What stands between a torque request and the torque: delay, limits, slew, lag, switching off.

Engine, EM1 and EM2 share this kernel; :mod:`hev_can_emu.plant.engine` and
:mod:`hev_can_emu.plant.motor` put their own limits around it.  Once per control period:

    request -> delay of n periods -> [lower, upper] -> slew -> setpoint
    torque  := setpoint + (torque - setpoint)*exp(-dt/tau), then held inside [lower, upper]

The lag's step response is exact at the grid points.  A disabled source goes to zero on a straight
line and then *is* zero; its delay line is emptied, so that it starts again from nothing.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks

# Why a setpoint differs from its request.  The numbers are those of the control units' ports.
LIMIT_NONE, LIMIT_SPEED, LIMIT_VOLTAGE, LIMIT_BATTERY_POWER, LIMIT_TEMPERATURE = 0, 1, 2, 3, 4
LIMIT_SLEW, LIMIT_DISABLED = 5, 6
LIMIT_TORQUE_ON_DOGS, LIMIT_SYNC_TIMEOUT, LIMIT_FAULT, LIMIT_PEAK = 10, 11, 12, 13

MAX_DELAY_TICKS = 64

# Layout of the packed parameters.
P_DELAY_TICKS, P_SLEW_STEP, P_KEEP, P_OFF_STEP = 0, 1, 2, 3
N_PARAMETERS = 4

# Layout of the state: torque, setpoint, write position of the delay line, delay line.
X_TORQUE, X_SETPOINT, X_POSITION, X_LINE = 0, 1, 2, 3
N_STATE = X_LINE + MAX_DELAY_TICKS

# Layout of the output.
OUT_TORQUE, OUT_SETPOINT, OUT_REASON = 0, 1, 2
N_OUT = 3

_SAME = 1e-9


class TorqueSourceParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Dynamics of a torque source.

    Attributes:
        delay: dead time between request and response, s; rounded to whole periods.
        slew_rate: fastest change of the setpoint, N m/s.
        time_constant: of the first-order lag from setpoint to torque, s; 0 for none.
        off_slew_rate: how fast the torque goes to zero when disabled, N m/s.
    """

    delay: float
    slew_rate: float
    time_constant: float
    off_slew_rate: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.not_negative(where, self, "delay", "time_constant")
        checks.positive(where, self, "slew_rate", "off_slew_rate")
        if self.delay > MAX_DELAY_TICKS * 1e-3:
            raise InputError(
                f"{where}.delay", f"at most {MAX_DELAY_TICKS * 1e-3:g} s", repr(self.delay)
            )

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``, for a period of ``dt`` s."""
        ticks = round(self.delay / dt)
        if ticks > MAX_DELAY_TICKS:
            raise ValueError(f"delay of {ticks} periods: at most {MAX_DELAY_TICKS} are kept")
        keep = math.exp(-dt / self.time_constant) if self.time_constant > 0.0 else 0.0
        return np.array([ticks, self.slew_rate * dt, keep, self.off_slew_rate * dt])


@small_kernel
def torque_source_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    request: float,
    enabled: float,
    lower: float,
    upper: float,
    lower_reason: float,
    upper_reason: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one period and write the torque that acts over it.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place.
        request: N m; NaN counts as 0.
        enabled: 0 or 1.
        lower, upper: limits now, N m; ``lower <= upper``.
        lower_reason, upper_reason: the LIMIT_* code that each limit stands for.
        out: ``(N_OUT,)``: torque N m, setpoint N m, LIMIT_* code.
    """
    if math.isnan(request):
        request = 0.0
    if enabled < 0.5:
        torque = x[X_TORQUE]
        step = p[P_OFF_STEP]
        if torque > step:
            torque -= step
        elif torque < -step:
            torque += step
        else:
            torque = 0.0
        torque = min(max(torque, lower), upper)
        x[X_TORQUE] = torque
        # The ramp starts again from where the torque is, should it be enabled half way down.
        x[X_SETPOINT] = torque
        for i in range(MAX_DELAY_TICKS):
            x[X_LINE + i] = 0.0
        out[OUT_TORQUE] = torque
        out[OUT_SETPOINT] = 0.0
        out[OUT_REASON] = LIMIT_NONE if request == 0.0 else LIMIT_DISABLED
        return

    delay = int(p[P_DELAY_TICKS])
    wanted = request
    if delay > 0:
        position = int(x[X_POSITION])
        if position >= delay:
            position = 0
        wanted = x[X_LINE + position]
        x[X_LINE + position] = request
        x[X_POSITION] = position + 1

    reason = float(LIMIT_NONE)
    limited = wanted
    if limited > upper:
        limited = upper
        reason = upper_reason
    if limited < lower:
        limited = lower
        reason = lower_reason

    # From inside the limits, which bind at once: a limit that falls is not slewed after.
    before = min(max(x[X_SETPOINT], lower), upper)
    step = p[P_SLEW_STEP]
    setpoint = limited
    if limited > before + step + _SAME:
        setpoint = before + step
        reason = LIMIT_SLEW
    elif limited < before - step - _SAME:
        setpoint = before - step
        reason = LIMIT_SLEW

    torque = setpoint + (x[X_TORQUE] - setpoint) * p[P_KEEP]
    torque = min(max(torque, lower), upper)
    x[X_TORQUE] = torque
    x[X_SETPOINT] = setpoint
    out[OUT_TORQUE] = torque
    out[OUT_SETPOINT] = setpoint
    out[OUT_REASON] = reason


@small_kernel
def torque_source_hold(x: NDArray[np.float64], torque: float) -> None:
    """Replace the state's torque by what was granted, so that the lag goes on from there."""
    x[X_TORQUE] = torque
