"""EM1 and EM2 as torque sources: envelope, derating, losses and the direct current they take.

Envelope: peak torque, then constant power; the power (so the corner speed) scales with the DC
voltage.  Near the greatest speed the driving torque fades out, braking torque stays.  Both fade with
winding and inverter temperature, and below the least DC voltage.

Electrical power, positive consumes: ``P = w*T + k0 + k1*|w| + k2*w^2 + kc*T^2 + kx*|w*T|``.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.torque_source import TorqueSourceParameters, torque_source_step

# Layout of the packed parameters; the torque source's own come first.
P_PEAK_TORQUE = source.N_PARAMETERS
P_PEAK_POWER = P_PEAK_TORQUE + 1
P_NOMINAL_VOLTAGE = P_PEAK_TORQUE + 2
P_VOLTAGE_MIN = P_PEAK_TORQUE + 3
P_VOLTAGE_FULL = P_PEAK_TORQUE + 4
P_FADE_SPEED = P_PEAK_TORQUE + 5
P_MAX_SPEED = P_PEAK_TORQUE + 6
P_WINDING_DERATE = P_PEAK_TORQUE + 7
P_WINDING_MAX = P_PEAK_TORQUE + 8
P_INVERTER_DERATE = P_PEAK_TORQUE + 9
P_INVERTER_MAX = P_PEAK_TORQUE + 10
P_LOSS_CONSTANT = P_PEAK_TORQUE + 11
P_LOSS_SPEED = P_PEAK_TORQUE + 12
P_LOSS_SPEED_SQUARE = P_PEAK_TORQUE + 13
P_LOSS_TORQUE_SQUARE = P_PEAK_TORQUE + 14
P_LOSS_CROSS = P_PEAK_TORQUE + 15
P_INVERTER_SHARE = P_PEAK_TORQUE + 16
N_PARAMETERS = P_PEAK_TORQUE + 17

N_STATE = source.N_STATE

# Layout of the limits.
LIM_TORQUE_MIN, LIM_TORQUE_MAX, LIM_REASON_MIN, LIM_REASON_MAX = 0, 1, 2, 3
N_LIM = 4

# Layout of the output: the torque source's own, then these.
OUT_TORQUE_MIN, OUT_TORQUE_MAX = source.N_OUT, source.N_OUT + 1
OUT_DC_POWER, OUT_LOSS = source.N_OUT + 2, source.N_OUT + 3
OUT_WINDING_LOSS, OUT_INVERTER_LOSS = source.N_OUT + 4, source.N_OUT + 5
N_OUT = source.N_OUT + 6


class MotorParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An electric machine with its inverter, at the motor shaft; SI units.

    Attributes:
        source: delay, slew and lag.
        peak_torque: N m.
        peak_power: greatest shaft power at ``nominal_voltage``, W.
        nominal_voltage: DC voltage at which ``peak_power`` holds, V.
        voltage_min, voltage_full: no torque below the first, full torque above the second, V.
        fade_speed, max_speed: driving torque fades from the first to zero at the second, rad/s.
        winding_derate, winding_max: torque fades from the first to zero at the second, K.
        inverter_derate, inverter_max: alike, K.
        loss_constant: k0, W.
        loss_speed: k1, W s/rad.
        loss_speed_square: k2, W s^2/rad^2.
        loss_torque_square: kc, W/(N m)^2, copper.
        loss_cross: kx, share of the shaft power, 1.
        inverter_share: share of the loss that heats the inverter, 1; the rest heats the winding.
    """

    source: TorqueSourceParameters
    peak_torque: float
    peak_power: float
    nominal_voltage: float
    voltage_min: float
    voltage_full: float
    fade_speed: float
    max_speed: float
    winding_derate: float
    winding_max: float
    inverter_derate: float
    inverter_max: float
    loss_constant: float
    loss_speed: float
    loss_speed_square: float
    loss_torque_square: float
    loss_cross: float
    inverter_share: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        self.source.validate(f"{where}.source")
        checks.positive(
            where, self, "peak_torque", "peak_power", "nominal_voltage", "voltage_min", "fade_speed"
        )
        checks.ordered(where, self, "voltage_min", "voltage_full")
        checks.ordered(where, self, "fade_speed", "max_speed")
        checks.ordered(where, self, "winding_derate", "winding_max")
        checks.ordered(where, self, "inverter_derate", "inverter_max")
        checks.not_negative(where, self, "loss_constant", "loss_speed", "loss_speed_square")
        checks.positive(where, self, "loss_torque_square")
        checks.fraction(where, self, "loss_cross", "inverter_share")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernels' parameters, shape ``(N_PARAMETERS,)``, for a period of ``dt`` s."""
        own = [
            self.peak_torque,
            self.peak_power,
            self.nominal_voltage,
            self.voltage_min,
            self.voltage_full,
            self.fade_speed,
            self.max_speed,
            self.winding_derate,
            self.winding_max,
            self.inverter_derate,
            self.inverter_max,
            self.loss_constant,
            self.loss_speed,
            self.loss_speed_square,
            self.loss_torque_square,
            self.loss_cross,
            self.inverter_share,
        ]
        return np.concatenate([self.source.pack(dt), np.array(own)])


@small_kernel
def fade(value: float, full: float, none: float) -> float:
    """Return 1 up to ``full``, 0 from ``none`` on, and the straight line between."""
    if value <= full:
        return 1.0
    if value >= none:
        return 0.0
    return (none - value) / (none - full)


@small_kernel
def motor_limits(
    p: NDArray[np.float64],
    speed: float,
    dc_voltage: float,
    winding_temperature: float,
    inverter_temperature: float,
    out: NDArray[np.float64],
) -> None:
    """Write the torque range available now, and why it is no wider.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        speed: of the shaft, rad/s.
        dc_voltage: at the DC link, V.
        winding_temperature, inverter_temperature: K.
        out: ``(N_LIM,)``: torque min and max N m, LIMIT_* code of min and max.
    """
    magnitude = abs(speed)
    voltage_ratio = max(dc_voltage, 0.0) / p[P_NOMINAL_VOLTAGE]
    power = p[P_PEAK_POWER] * voltage_ratio
    torque = p[P_PEAK_TORQUE]
    reason = float(source.LIMIT_PEAK)
    if magnitude * torque > power:
        torque = power / magnitude
        reason = source.LIMIT_VOLTAGE if voltage_ratio < 1.0 else source.LIMIT_SPEED
    undervoltage = 1.0 - fade(dc_voltage, p[P_VOLTAGE_MIN], p[P_VOLTAGE_FULL])
    if undervoltage < 1.0:
        torque *= undervoltage
        reason = source.LIMIT_VOLTAGE
    derating = min(
        fade(winding_temperature, p[P_WINDING_DERATE], p[P_WINDING_MAX]),
        fade(inverter_temperature, p[P_INVERTER_DERATE], p[P_INVERTER_MAX]),
    )
    if derating < 1.0:
        torque *= derating
        reason = source.LIMIT_TEMPERATURE
    out[LIM_TORQUE_MAX] = torque
    out[LIM_TORQUE_MIN] = -torque
    out[LIM_REASON_MAX] = reason
    out[LIM_REASON_MIN] = reason
    driving = fade(magnitude, p[P_FADE_SPEED], p[P_MAX_SPEED])
    if driving < 1.0:
        if speed > 0.0:
            out[LIM_TORQUE_MAX] = torque * driving
            out[LIM_REASON_MAX] = source.LIMIT_SPEED
        else:
            out[LIM_TORQUE_MIN] = -torque * driving
            out[LIM_REASON_MIN] = source.LIMIT_SPEED


@small_kernel
def idle_loss(p: NDArray[np.float64], speed: float) -> float:
    """Return the loss at zero torque with the inverter switching, W."""
    w = abs(speed)
    loss: float = p[P_LOSS_CONSTANT] + p[P_LOSS_SPEED] * w + p[P_LOSS_SPEED_SQUARE] * w * w
    return loss


@small_kernel
def motor_loss(p: NDArray[np.float64], torque: float, speed: float) -> float:
    """Return the loss of motor and inverter with the inverter switching, W."""
    copper: float = p[P_LOSS_TORQUE_SQUARE] * torque * torque
    cross: float = p[P_LOSS_CROSS] * abs(torque * speed)
    return idle_loss(p, speed) + copper + cross


@small_kernel
def torque_for_power(p: NDArray[np.float64], speed: float, power: float, direction: float) -> float:
    """Return the torque at which the machine takes ``power`` from the DC link, W.

    ``direction`` +1 looks at positive torques, -1 at negative ones.  Of two such torques the one of
    larger magnitude is returned when driving, of smaller magnitude when generating: the one reached
    first, coming from the allowed side.  Where the power cannot be reached, the torque of
    least power (driving) or of most regenerated power (generating) is returned.
    """
    # With T = direction*m, m >= 0: P = L0 + a*m + c*m^2.
    a: float = direction * speed + p[P_LOSS_CROSS] * abs(speed)
    c: float = p[P_LOSS_TORQUE_SQUARE]
    rest = power - idle_loss(p, speed)
    square = a * a + 4.0 * c * rest
    root = math.sqrt(max(square, 0.0))
    if rest >= 0.0:
        magnitude = (root - a) / (2.0 * c) if a <= 0.0 else 2.0 * rest / (a + root)
    elif a >= 0.0:
        magnitude = 0.0
    elif square > 0.0:
        magnitude = 2.0 * rest / (a - root)
    else:
        magnitude = -a / (2.0 * c)
    return direction * magnitude


@small_kernel
def motor_power(
    p: NDArray[np.float64],
    torque: float,
    speed: float,
    active: float,
    out: NDArray[np.float64],
) -> None:
    """Write power and losses of a full output vector ``out`` (``N_OUT``) for a torque and speed.

    ``active`` 0 or 1: an inverter that does not switch and gives no torque takes no power.
    """
    loss = 0.0
    if active > 0.5 or torque != 0.0:
        loss = motor_loss(p, torque, speed)
    out[source.OUT_TORQUE] = torque
    out[OUT_DC_POWER] = torque * speed + loss
    out[OUT_LOSS] = loss
    out[OUT_INVERTER_LOSS] = loss * p[P_INVERTER_SHARE]
    out[OUT_WINDING_LOSS] = loss - out[OUT_INVERTER_LOSS]


@small_kernel
def motor_grant(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    torque: float,
    speed: float,
    active: float,
    reason: float,
    out: NDArray[np.float64],
) -> None:
    """Replace the torque that :func:`motor_step` gave by the smaller one that the battery grants.

    State and output follow: the lag goes on from the granted torque, the setpoint is told no larger
    than it, ``reason`` is the LIMIT_* code told, and power and losses are those of the granted torque.
    """
    source.torque_source_hold(x, torque)
    if abs(x[source.X_SETPOINT]) > abs(torque):
        x[source.X_SETPOINT] = torque
        if active > 0.5:
            out[source.OUT_SETPOINT] = torque
    out[source.OUT_REASON] = reason
    motor_power(p, torque, speed, active, out)


@small_kernel
def motor_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    request: float,
    enabled: float,
    speed: float,
    dc_voltage: float,
    winding_temperature: float,
    inverter_temperature: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one period: limits, torque source, power and losses.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place.
        request: shaft torque, N m; NaN counts as 0.
        enabled: 0 or 1.
        speed: of the shaft, rad/s.
        dc_voltage: V.
        winding_temperature, inverter_temperature: K.
        out: ``(N_OUT,)``: shaft torque that acts over the period N m, setpoint N m, LIMIT_* code,
            torque min and max available (also
            told while disabled) N m, DC power W (positive consumes), loss, winding and inverter loss W.
    """
    motor_limits(
        p, speed, dc_voltage, winding_temperature, inverter_temperature, out[source.N_OUT :]
    )
    motor_step_within(p, x, request, enabled, speed, out)


@small_kernel
def motor_step_within(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    request: float,
    enabled: float,
    speed: float,
    out: NDArray[np.float64],
) -> None:
    """As :func:`motor_step`, with what :func:`motor_limits` wrote into ``out[torque_source.N_OUT:]``."""
    # Least and greatest torque stand in their final place, the two codes are overwritten below.
    limits = out[source.N_OUT :]
    low, high = limits[LIM_TORQUE_MIN], limits[LIM_TORQUE_MAX]
    torque_source_step(
        p, x, request, enabled, low, high, limits[LIM_REASON_MIN], limits[LIM_REASON_MAX], out
    )
    motor_power(p, out[source.OUT_TORQUE], speed, enabled, out)
