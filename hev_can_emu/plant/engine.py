"""The engine as a torque source: full load, drag, idle governor, fuel cut, starting and stalling.

Torque at the crankshaft after friction is ``combustion - drag``.  The torque source acts on the
combustion torque (0 when not fuelled); drag acts at once and depends on speed alone, so the engine
brakes when the fuel is cut and its torque vanishes with its speed at standstill.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.engine_control import RUNNING, check_speeds, govern_idle, next_phase
from hev_can_emu.plant.motor import fade
from hev_can_emu.plant.tables import look_up
from hev_can_emu.plant.torque_source import TorqueSourceParameters, torque_source_step

# Layout of the packed parameters; the torque source's own come first, the tables last.
P_DRAG_FADE = source.N_PARAMETERS
P_CRANK_SPEED = P_DRAG_FADE + 1
P_STALL_SPEED = P_DRAG_FADE + 2
P_IDLE_SPEED = P_DRAG_FADE + 3
P_IDLE_GAIN = P_DRAG_FADE + 4
P_IDLE_INTEGRAL_STEP = P_DRAG_FADE + 5
P_IDLE_TORQUE_MAX = P_DRAG_FADE + 6
P_FADE_SPEED = P_DRAG_FADE + 7
P_MAX_SPEED = P_DRAG_FADE + 8
P_CUT_SPEED = P_DRAG_FADE + 9
P_RESUME_SPEED = P_DRAG_FADE + 10
P_HEAT_RATIO = P_DRAG_FADE + 11
P_COUNT = P_DRAG_FADE + 12
P_TABLES = P_DRAG_FADE + 13

# Layout of the state: the torque source's own, then these.
X_PHASE, X_FUEL_CUT, X_IDLE_INTEGRAL = source.N_STATE, source.N_STATE + 1, source.N_STATE + 2
N_STATE = source.N_STATE + 3

# Layout of the limits.
LIM_TORQUE_MIN, LIM_TORQUE_MAX, LIM_REASON_MAX = 0, 1, 2
N_LIM = 3

# Layout of the output: the torque source's own, then these.
OUT_TORQUE_MIN, OUT_TORQUE_MAX, OUT_PHASE = source.N_OUT, source.N_OUT + 1, source.N_OUT + 2
OUT_COMBUSTION, OUT_HEAT = source.N_OUT + 3, source.N_OUT + 4
N_OUT = source.N_OUT + 5

_TOLERANCE = 1e-6
_IDLE_FORGET = 0.998  # per ms: the governor forgets an idle load in half a second once off idle


class EngineParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A combustion engine with its control unit, at the crankshaft; SI units.

    Attributes:
        source: delay, slew and lag of the combustion torque.
        speed: axis of the two tables, rad/s, rising.
        full_load: greatest torque after friction at each speed, N m.
        drag: torque that turns the unfuelled engine at each speed, N m, positive.
        drag_fade_speed: below it drag falls in proportion to speed, rad/s.
        crank_speed: the engine fires from here on, rad/s.
        stall_speed: and stalls below this, rad/s.
        idle_speed: rad/s.
        idle_gain: of the idle governor, N m s/rad.
        idle_integral_gain: N m/rad.
        idle_torque_max: most combustion torque the governor asks for, N m.
        fade_speed, max_speed: full load fades from the first to zero at the second, rad/s.
        cut_speed, resume_speed: fuel is cut above the first until below the second, rad/s.
        coolant_heat_ratio: heat into the coolant per combustion power, 1.
    """

    source: TorqueSourceParameters
    speed: tuple[float, ...]
    full_load: tuple[float, ...]
    drag: tuple[float, ...]
    drag_fade_speed: float
    crank_speed: float
    stall_speed: float
    idle_speed: float
    idle_gain: float
    idle_integral_gain: float
    idle_torque_max: float
    fade_speed: float
    max_speed: float
    cut_speed: float
    resume_speed: float
    coolant_heat_ratio: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        self.source.validate(f"{where}.source")
        checks.axis(f"{where}.speed", self.speed)
        checks.column(f"{where}.full_load", self.full_load, len(self.speed), 0.0)
        checks.column(f"{where}.drag", self.drag, len(self.speed), 0.0)
        check_speeds(where, self)
        checks.not_negative(where, self, "coolant_heat_ratio")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernels' parameters for a period of ``dt`` s; shape depends on the tables."""
        own = [
            self.drag_fade_speed,
            self.crank_speed,
            self.stall_speed,
            self.idle_speed,
            self.idle_gain,
            self.idle_integral_gain * dt,
            self.idle_torque_max,
            self.fade_speed,
            self.max_speed,
            self.cut_speed,
            self.resume_speed,
            self.coolant_heat_ratio,
            float(len(self.speed)),
        ]
        tables = [*self.speed, *self.full_load, *self.drag]
        return np.concatenate([self.source.pack(dt), np.array(own), np.array(tables)])


@small_kernel
def engine_drag(p: NDArray[np.float64], speed: float) -> float:
    """Return the drag torque, N m, of the sign of ``speed`` and in proportion to it near zero."""
    count = int(p[P_COUNT])
    magnitude = abs(speed)
    drag: float = look_up(p, P_TABLES, count, P_TABLES + 2 * count, magnitude)
    drag *= min(magnitude / p[P_DRAG_FADE], 1.0)
    return drag if speed >= 0.0 else -drag


@small_kernel
def engine_limits(
    p: NDArray[np.float64], speed: float, phase: float, out: NDArray[np.float64]
) -> None:
    """Write the range of torque after friction available now, ``(N_LIM,)``: min, max N m, code."""
    drag = engine_drag(p, speed)
    out[LIM_TORQUE_MIN] = -drag
    out[LIM_TORQUE_MAX] = -drag
    out[LIM_REASON_MAX] = source.LIMIT_DISABLED
    if phase == RUNNING:
        count = int(p[P_COUNT])
        share = fade(speed, p[P_FADE_SPEED], p[P_MAX_SPEED])
        full = look_up(p, P_TABLES, count, P_TABLES + count, speed)
        out[LIM_TORQUE_MAX] = max(full * share, -drag)
        out[LIM_REASON_MAX] = source.LIMIT_SPEED if share < 1.0 else source.LIMIT_PEAK


@small_kernel
def engine_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    torque_request: float,
    run_request: float,
    healthy: float,
    speed: float,
    out: NDArray[np.float64],
) -> None:
    """Advance one period: state machine, idle governor, limits, torque source.

    Args:
        p: parameters of :meth:`EngineParameters.pack`.
        x: state, ``(N_STATE,)``, changed in place; all zero is an engine at rest, off.
        torque_request: at the crankshaft after friction, N m; NaN counts as 0.
        run_request: 0 or 1.
        healthy: 1; 0 forces the state FAULT and cuts the fuel.
        speed: of the crankshaft, rad/s.
        out: ``(N_OUT,)``: torque after friction that acts over the period N m, setpoint N m, LIMIT_*
            code, torque min and max N m, phase, combustion torque N m, heat into the coolant W.
    """
    if math.isnan(torque_request):
        torque_request = 0.0
    phase = next_phase(x[X_PHASE], run_request, healthy, speed, p[P_CRANK_SPEED], p[P_STALL_SPEED])
    x[X_PHASE] = phase
    if speed >= p[P_CUT_SPEED]:
        x[X_FUEL_CUT] = 1.0
    elif speed <= p[P_RESUME_SPEED]:
        x[X_FUEL_CUT] = 0.0
    fuelled = 1.0 if phase == RUNNING and x[X_FUEL_CUT] == 0.0 else 0.0

    limits = out[source.N_OUT :]  # min and max in their final place, the code overwritten below
    engine_limits(p, speed, phase, limits)
    reason_max = limits[LIM_REASON_MAX]
    low, high = limits[LIM_TORQUE_MIN], limits[LIM_TORQUE_MAX]
    drag = -low
    upper = high + drag

    combustion = max(torque_request + drag, 0.0)
    if fuelled > 0.5:
        error = p[P_IDLE_SPEED] - speed
        combustion = govern_idle(
            x, X_IDLE_INTEGRAL, combustion, torque_request, error,
            engine_drag(p, p[P_IDLE_SPEED]) + p[P_IDLE_GAIN] * error, p[P_IDLE_INTEGRAL_STEP],
            _IDLE_FORGET, min(p[P_IDLE_TORQUE_MAX], upper),
        )  # fmt: skip
    else:
        x[X_IDLE_INTEGRAL] = 0.0
    torque_source_step(p, x, combustion, fuelled, 0.0, upper, source.LIMIT_PEAK, reason_max, out)
    out[OUT_COMBUSTION] = out[source.OUT_TORQUE]
    out[OUT_HEAT] = p[P_HEAT_RATIO] * out[OUT_COMBUSTION] * max(speed, 0.0)
    out[source.OUT_TORQUE] -= drag
    out[source.OUT_SETPOINT] -= drag
    out[OUT_PHASE] = phase

    if abs(out[source.OUT_SETPOINT] - torque_request) <= _TOLERANCE:
        out[source.OUT_REASON] = source.LIMIT_NONE
    elif phase != RUNNING:
        out[source.OUT_REASON] = source.LIMIT_DISABLED
    elif fuelled < 0.5 or combustion != max(torque_request + drag, 0.0):
        out[source.OUT_REASON] = source.LIMIT_SPEED  # overspeed cut, or the idle governor
    elif torque_request < low:
        out[source.OUT_REASON] = source.LIMIT_PEAK
