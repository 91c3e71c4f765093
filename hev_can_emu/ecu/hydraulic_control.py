"""The TCU's own control: from capacity and shift force asked for to currents of the three valves.

Clutch: capacity -> force by the inverse friction map at the present slip and temperature -> set pressure.
From rest the cylinder is filled with the valve wide open until an observer of its volume (valve flow,
integrated) says that the plates are about to touch; then pressure is controlled: feed-forward of the
spool position that holds the set pressure (both edges of the valve as a pressure divider), plus PI
whose output is a flow, turned into spool travel at the pressure drop of the edge that passes it.

Shift: set pressure from force and the back pressure of the other side; the same feed-forward and a slow
integrator that learns only while the sleeve stands.  More would overshoot: a standing sleeve leaves
the chamber so little to fill that the divider's own answer is faster than the control period.

Both integrators compare the pressure with a reference that rises as the loop is meant to, not with the
step itself: a step leaves them alone, a wrong feed-forward does not.

One call per control period (1 ms).  The control knows nominal parameters, not the plant's state: it sees
pressures, slip, plate temperature and sleeve position.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant.hydraulic_parameters import HydraulicsParameters, ValveParameters
from hev_can_emu.plant.wet_clutch import P_TORQUE_RADIUS, friction_coefficient

# Layout of the packed parameters.
P_DT, P_AREA, P_KISS_PRESSURE, P_REST_PRESSURE, P_FILL_VOLUME = 0, 1, 2, 3, 4
P_FILL_SHARE, P_TOUCH_MARGIN, P_FLOW_PER_PRESSURE, P_INTEGRAL, P_INTEGRAL_MAX = 5, 6, 7, 8, 9
P_LEAST_CAPACITY, P_PRESSURE_SHARE = 10, 11
P_SHIFT_AREA1, P_SHIFT_AREA2, P_SHIFT_INTEGRAL, P_TOUCH_RATE = 12, 13, 14, 15
P_LEAST_FORCE, P_STANDING, P_SPEED_SHARE = 16, 17, 18
P_PUMP_ON, P_PUMP_OFF, P_SPOOL_LAG = 19, 20, 21
P_REFERENCE_SHARE, P_SHIFT_REFERENCE_SHARE = 22, 23
P_CLUTCH_VALVE, P_SHIFT_VALVE = 24, 28
V_FLOW, V_UNDERLAP, V_CURRENT, V_SPOOL_SHARE = 0, 1, 2, 3
N_PARAMETERS = 32

# Phases of the clutch.
OPEN, FILL, CLOSED_LOOP = 0, 1, 2

# Layout of the state.
X_PHASE, X_VOLUME, X_SPOOL, X_INTEGRAL = 0, 1, 2, 3
X_SHIFT_INTEGRAL, X_SHIFT_SIDE, X_SLEEVE, X_SLEEVE_SPEED, X_PUMP = 4, 5, 6, 7, 8
X_REFERENCE, X_SHIFT_REFERENCE, X_SPOOL_LEAD = 9, 10, 11
N_STATE = 12

# Layout of the inputs.
IN_CAPACITY, IN_FORCE = 0, 1  # N m; N, positive towards G1
IN_SUPPLY, IN_CLUTCH, IN_SHIFT1, IN_SHIFT2 = 2, 3, 4, 5  # measured, Pa
IN_SLIP, IN_TEMPERATURE, IN_SLEEVE = 6, 7, 8  # rad/s, K, m
N_IN = 9

# Layout of the output.
OUT_CURRENT_CLUTCH, OUT_CURRENT_SHIFT1, OUT_CURRENT_SHIFT2, OUT_PUMP = 0, 1, 2, 3  # A; 0 or 1
OUT_PRESSURE, OUT_SHIFT_PRESSURE, OUT_PHASE = 4, 5, 6  # set pressures Pa; phase of the clutch
N_OUT = 7

_REFERENCE_TIME = 0.7  # of the loop, times its bandwidth: the valve itself helps
_LEARN_BAND = 2e4  # Pa
_LEAST_DROP = 2e4  # Pa: below it an edge's flow is no longer inverted


class HydraulicControlParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Tuning; SI units.  The defaults are for the default car; docs/detailed/hydraulics.md shows them step.

    Attributes:
        bandwidth: of the clutch pressure loop, rad/s.
        integral_time: of its PI, s.
        integral_share: bound of the integrator as a share of the proportional band of 1 MPa, 1.
        fill_share: share of the kiss volume at which the fast fill ends, 1.
        touch_time: with which the rest of the volume comes after the fast fill, s.
        touch_margin: pressure above the kiss point that ends the fast fill in any case, Pa.
        least_capacity: below it the clutch is opened, N m.
        pressure_share: greatest set pressure as a share of the supply's, 1.
        shift_bandwidth: of the shift pressure's integrator, rad/s.
        least_force: below it both shift chambers are vented, N.
        standing_speed: sleeve speed below which the integrator learns, m/s.
        speed_time: filter of the sleeve's speed, s.
        pump_on, pump_off: supply pressures between which the pump works, Pa.
    """

    bandwidth: float = 100.0
    integral_time: float = 0.15
    integral_share: float = 0.1
    fill_share: float = 0.92
    touch_time: float = 0.008
    touch_margin: float = 3e4
    least_capacity: float = 0.5
    pressure_share: float = 0.95
    shift_bandwidth: float = 4.0
    least_force: float = 20.0
    standing_speed: float = 0.01
    speed_time: float = 0.002
    pump_on: float = 4.2e6
    pump_off: float = 5.5e6

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "bandwidth", "integral_time", "fill_share", "touch_margin")
        checks.positive(where, self, "pressure_share", "standing_speed", "speed_time", "pump_on")
        checks.not_negative(where, self, "least_capacity", "least_force", "shift_bandwidth")
        checks.positive(where, self, "touch_time")
        checks.fraction(where, self, "fill_share", "integral_share", "pressure_share")
        checks.ordered(where, self, "pump_on", "pump_off")

    def pack(self, hydraulics: HydraulicsParameters, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return shape ``(N_PARAMETERS,)`` for a control period of ``dt`` s and a nominal circuit."""
        clutch, shift, oil = hydraulics.clutch, hydraulics.shift, hydraulics.oil
        compliance = clutch.area**2 / clutch.pack + clutch.volume / oil.bulk_modulus
        gain = self.bandwidth * compliance
        spool = hydraulics.clutch_valve
        lag = 2.0 * spool.damping / spool.natural_frequency
        shift_spool = hydraulics.shift_valve
        shift_lag = 2.0 * shift_spool.damping / shift_spool.natural_frequency + 1.5 * dt
        own = [
            dt,
            clutch.area,
            clutch.kiss_pressure,
            clutch.preload / clutch.area,
            clutch.area * clutch.kiss_travel,
            self.fill_share,
            self.touch_margin,
            gain,
            dt / self.integral_time,
            self.integral_share * gain * 1e6,
            self.least_capacity,
            self.pressure_share,
            shift.area1,
            shift.area2,
            dt * self.shift_bandwidth,
            1.0 / self.touch_time,
            self.least_force,
            self.standing_speed,
            -math.expm1(-dt / self.speed_time),
            self.pump_on,
            self.pump_off,
            lag,
            -math.expm1(-dt * self.bandwidth / _REFERENCE_TIME),
            -math.expm1(-dt / shift_lag),
        ]

        def pack_valve(valve: ValveParameters) -> list[float]:
            per_stroke = oil.flow_factor(valve.area) / (1.0 + valve.underlap)
            keep = -math.expm1(-dt * valve.natural_frequency / valve.damping)
            return [per_stroke, valve.underlap, valve.full_current, keep]

        return np.array(
            [*own, *pack_valve(hydraulics.clutch_valve), *pack_valve(hydraulics.shift_valve)]
        )


@kernel
def control_start(x: NDArray[np.float64], sleeve: float) -> None:
    """Set the state to open and at rest, the sleeve at ``sleeve`` m; shape ``(N_STATE,)``."""
    for i in range(N_STATE):
        x[i] = 0.0
    x[X_SPOOL] = x[X_SPOOL_LEAD] = -1.0
    x[X_SLEEVE] = sleeve


@kernel
def holding_spool(underlap: float, pressure: float, supply: float) -> float:
    """Return the spool position at which both edges pass the same flow at ``pressure``, share."""
    if pressure <= 0.0:
        return -underlap
    ratio = math.sqrt(pressure / max(supply - pressure, 1e3))
    return underlap * (ratio - 1.0) / (ratio + 1.0)


@kernel
def divider_slope(underlap: float, spool: float, supply: float) -> float:
    """Return the steady slope of pressure over spool position of the divider, Pa."""
    bounded = min(max(spool, -0.9 * underlap), 0.9 * underlap)
    a, b = underlap + bounded, underlap - bounded
    square = a * a + b * b
    return 4.0 * a * b * underlap * supply / (square * square)


@kernel
def set_pressure(
    p: NDArray[np.float64],
    clutch: NDArray[np.float64],
    capacity: float,
    slip: float,
    temperature: float,
) -> float:
    """Return the pressure that gives a capacity by the friction map ``clutch`` (packed), Pa."""
    force = 0.0
    for _ in range(4):  # the coefficient depends weakly on the force: a factor of 30 each time
        force = capacity / (
            clutch[P_TORQUE_RADIUS] * friction_coefficient(clutch, slip, force, temperature)
        )
    return float(p[P_KISS_PRESSURE] + force / p[P_AREA])


@kernel
def _current(p: NDArray[np.float64], valve: int, spool: float) -> float:
    """Return the current that holds the spool there, A."""
    return float(0.5 * (min(max(spool, -1.0), 1.0) + 1.0) * p[valve + V_CURRENT])


@kernel
def _spool_for_flow(
    p: NDArray[np.float64], valve: int, flow: float, supply: float, pressure: float
) -> float:
    """Return the spool travel that passes ``flow`` m^3/s more into the chamber."""
    drop = supply - pressure if flow > 0.0 else pressure
    return float(flow / (p[valve + V_FLOW] * math.sqrt(max(drop, _LEAST_DROP))))


@kernel
def _clutch(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    clutch: NDArray[np.float64],
    inputs: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    capacity = inputs[IN_CAPACITY]
    supply, pressure = inputs[IN_SUPPLY], inputs[IN_CLUTCH]
    valve = P_CLUTCH_VALVE
    underlap = p[valve + V_UNDERLAP]

    # Observer: flow past both edges at the spool that the last command led to.
    spool = x[X_SPOOL]
    into = max(spool + underlap, 0.0) * math.sqrt(max(supply - pressure, 0.0))
    back = max(underlap - spool, 0.0) * math.sqrt(max(pressure, 0.0))
    flow = p[valve + V_FLOW] * (into - back)
    volume = x[X_VOLUME] + p[P_DT] * flow
    # Below the margin it may be the seal's friction on the way.
    touching = pressure > p[P_KISS_PRESSURE] + p[P_TOUCH_MARGIN]
    if touching:
        volume = max(volume, p[P_FILL_VOLUME])
    elif pressure < 0.8 * p[P_REST_PRESSURE] and flow <= 0.0:
        volume = 0.0
    volume = min(max(volume, 0.0), p[P_FILL_VOLUME])
    x[X_VOLUME] = volume

    target = 0.0
    if not capacity > p[P_LEAST_CAPACITY]:
        x[X_PHASE] = OPEN
        x[X_INTEGRAL] = 0.0
        wanted = -1.0
    else:
        target = set_pressure(p, clutch, capacity, inputs[IN_SLIP], inputs[IN_TEMPERATURE])
        target = min(target, p[P_PRESSURE_SHARE] * supply)
        if x[X_PHASE] == OPEN:
            x[X_PHASE] = FILL
        wanted = 1.0
        # What still comes while the spool returns counts already.
        coming = volume + max(flow, 0.0) * p[P_SPOOL_LAG]
        filled = touching or coming >= p[P_FILL_SHARE] * p[P_FILL_VOLUME]
        if x[X_PHASE] == FILL and filled:
            x[X_PHASE] = CLOSED_LOOP
        if x[X_PHASE] == CLOSED_LOOP:
            error = target - pressure
            proportional = p[P_FLOW_PER_PRESSURE] * error
            demand = proportional + x[X_INTEGRAL]
            if error <= 0.0:
                x[X_VOLUME] = p[P_FILL_VOLUME]  # as full as this aim needs it
            elif not touching:
                demand = max(demand, (p[P_FILL_VOLUME] - coming) * p[P_TOUCH_RATE])
            wanted = holding_spool(underlap, target, supply)
            wanted += _spool_for_flow(p, valve, demand, supply, pressure)
            if not touching:
                x[X_REFERENCE] = p[P_KISS_PRESSURE]
            x[X_REFERENCE] += (target - x[X_REFERENCE]) * p[P_REFERENCE_SHARE]
            # Bounded, so that a large step, which no reference foretells well, teaches little.
            behind = min(max(x[X_REFERENCE] - pressure, -_LEARN_BAND), _LEARN_BAND)
            missing = p[P_FLOW_PER_PRESSURE] * behind
            grown = x[X_INTEGRAL] + p[P_INTEGRAL] * missing
            # Learn only in contact, and never further into saturation.
            learns = touching and (-1.0 < wanted < 1.0 or missing * wanted < 0.0)
            if learns:
                x[X_INTEGRAL] = min(max(grown, -p[P_INTEGRAL_MAX]), p[P_INTEGRAL_MAX])
    wanted = min(max(wanted, -1.0), 1.0)
    # The spool as two equal lags.
    x[X_SPOOL] += (x[X_SPOOL_LEAD] - x[X_SPOOL]) * p[valve + V_SPOOL_SHARE]
    x[X_SPOOL_LEAD] += (wanted - x[X_SPOOL_LEAD]) * p[valve + V_SPOOL_SHARE]
    out[OUT_CURRENT_CLUTCH] = _current(p, valve, wanted)
    out[OUT_PRESSURE] = target
    out[OUT_PHASE] = x[X_PHASE]


@kernel
def _shift(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    inputs: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    valve = P_SHIFT_VALVE
    underlap = p[valve + V_UNDERLAP]
    supply = inputs[IN_SUPPLY]
    raw = (inputs[IN_SLEEVE] - x[X_SLEEVE]) / p[P_DT]
    x[X_SLEEVE] = inputs[IN_SLEEVE]
    x[X_SLEEVE_SPEED] += (raw - x[X_SLEEVE_SPEED]) * p[P_SPEED_SHARE]
    out[OUT_CURRENT_SHIFT1] = out[OUT_CURRENT_SHIFT2] = out[OUT_SHIFT_PRESSURE] = 0.0
    force = inputs[IN_FORCE]
    if not abs(force) > p[P_LEAST_FORCE]:
        x[X_SHIFT_INTEGRAL] = x[X_SHIFT_SIDE] = x[X_SHIFT_REFERENCE] = 0.0
        return
    side = 1.0 if force > 0.0 else -1.0
    if side != x[X_SHIFT_SIDE]:
        x[X_SHIFT_INTEGRAL] = x[X_SHIFT_REFERENCE] = 0.0
        x[X_SHIFT_SIDE] = side
    pressure, opposite = inputs[IN_SHIFT1], inputs[IN_SHIFT2]
    area, other = p[P_SHIFT_AREA1], p[P_SHIFT_AREA2]
    if side < 0.0:
        pressure, opposite = opposite, pressure
        area, other = other, area
    target = (abs(force) + other * max(opposite, 0.0)) / area
    target = min(target, p[P_PRESSURE_SHARE] * supply)
    speed = side * x[X_SLEEVE_SPEED]
    hold = holding_spool(underlap, target, supply)
    if abs(speed) < p[P_STANDING]:
        x[X_SHIFT_REFERENCE] += (target - x[X_SHIFT_REFERENCE]) * p[P_SHIFT_REFERENCE_SHARE]
        error = (x[X_SHIFT_REFERENCE] - pressure) / divider_slope(underlap, hold, supply)
        grown = x[X_SHIFT_INTEGRAL] + p[P_SHIFT_INTEGRAL] * error
        x[X_SHIFT_INTEGRAL] = min(max(grown, -0.5 * underlap), 0.5 * underlap)
    else:
        x[X_SHIFT_REFERENCE] = pressure
    wanted = hold + x[X_SHIFT_INTEGRAL]
    current = _current(p, valve, wanted)
    if side > 0.0:
        out[OUT_CURRENT_SHIFT1] = current
    else:
        out[OUT_CURRENT_SHIFT2] = current
    out[OUT_SHIFT_PRESSURE] = target


@kernel
def hydraulic_control_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    clutch: NDArray[np.float64],
    inputs: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Act once per control period.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place; see :func:`control_start`.
        clutch: packed parameters of :mod:`hev_can_emu.plant.wet_clutch`, the map that the unit believes.
        inputs: ``(N_IN,)``: requests and measured values; NaN requests count as 0.
        out: ``(N_OUT,)``: currents A, pump, set pressures Pa, phase of the clutch.
    """
    _clutch(p, x, clutch, inputs, out)
    _shift(p, x, inputs, out)
    if inputs[IN_SUPPLY] < p[P_PUMP_ON]:
        x[X_PUMP] = 1.0
    elif inputs[IN_SUPPLY] > p[P_PUMP_OFF]:
        x[X_PUMP] = 0.0
    out[OUT_PUMP] = x[X_PUMP]
