"""Wet clutch C1: what its plates can carry, drag and heat up, from the force that presses them.

Kinetic capacity ``T = mu(v, P, T)*F*n*R`` with sliding speed ``v = |slip|*R``, lining pressure ``P = F/a``
and plate temperature; ``mu`` is a curve over speed times one factor over pressure and one over temperature.
Static capacity has its own coefficient, never below the kinetic one at rest, so that stick is a state of
the driveline and not a slope of the curve.  There are two curves: fresh (rising with speed, damps) and aged
(falling, excites judder); wear blends between them.

Open, the oil between the plates is sheared:
``T = eta(T)*n*g*(pi/2)*(ro^4 - ri^4)*slip/h``, with the gap ``h`` from the piston's travel and a
factor ``1/(1 + (slip/w_e)^2)`` for the oil thrown out at high slip.  Pressed plates squeeze the film out and
rub by the map instead: its torque fades with ``exp(-P/P_film)``.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant.tables import look_up

POINTS = 8
"""Points of each curve inside the packed parameters; shorter curves are filled up at the end."""

# Layout of the packed parameters.
P_DT, P_RADIUS, P_TORQUE_RADIUS, P_PER_AREA = 0, 1, 2, 3
P_DRAG, P_KISS, P_LEAST_GAP, P_EXPEL = 4, 5, 6, 7
P_OIL_REFERENCE, P_OIL_SLOPE = 8, 9
P_HEAT_CAPACITY, P_FLOW_HEAT, P_STILL_COOLING = 10, 11, 12
P_STATIC_FRESH, P_STATIC_AGED, P_STATIC = 13, 14, 15
P_FILM = 16
P_SPEED = 17
P_FRESH = P_SPEED + POINTS
P_AGED = P_FRESH + POINTS
P_CURVE = P_AGED + POINTS
P_PRESSURE = P_CURVE + POINTS
P_PRESSURE_FACTOR = P_PRESSURE + POINTS
P_TEMPERATURE = P_PRESSURE_FACTOR + POINTS
P_TEMPERATURE_FACTOR = P_TEMPERATURE + POINTS
N_PARAMETERS = P_TEMPERATURE_FACTOR + POINTS

# State: plate temperature, K; slip when the step before began, rad/s.
X_TEMPERATURE, X_SLIP = 0, 1
N_STATE = 2

# Output of the capacity: N m, all of them magnitudes, and the kinetic coefficient.
OUT_KINETIC, OUT_STATIC, OUT_DRAG, OUT_FRICTION = 0, 1, 2, 3
N_OUT = 4

# Output of the heat: J in this step.
HEAT_IN, HEAT_TO_OIL = 0, 1
N_HEAT = 2


class FrictionParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Friction map of a lining in oil, at most eight points per axis.

    Attributes:
        speed: axis, sliding speed, m/s, from 0.
        fresh, aged: kinetic coefficient over it, 1.
        static_fresh, static_aged: coefficient of stick, 1.
        pressure: axis, on the lining, Pa.
        pressure_factor: over it, on all coefficients, 1.
        temperature: axis, of the plates, K.
        temperature_factor: over it, on all coefficients, 1.
    """

    speed: tuple[float, ...]
    fresh: tuple[float, ...]
    aged: tuple[float, ...]
    static_fresh: float
    static_aged: float
    pressure: tuple[float, ...]
    pressure_factor: tuple[float, ...]
    temperature: tuple[float, ...]
    temperature_factor: tuple[float, ...]

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        for name in ("speed", "pressure", "temperature"):
            values = getattr(self, name)
            checks.axis(f"{where}.{name}", values)
            if len(values) > POINTS:
                raise InputError(f"{where}.{name}", f"at most {POINTS} values", str(len(values)))
        if self.speed[0] != 0.0:
            raise InputError(f"{where}.speed[0]", "0", repr(self.speed[0]))
        for name in ("fresh", "aged"):
            curve = getattr(self, name)
            checks.column(f"{where}.{name}", curve, len(self.speed), 1e-3)
            at_rest = getattr(self, f"static_{name}")
            if not (math.isfinite(at_rest) and at_rest >= curve[0]):
                raise InputError(
                    f"{where}.static_{name}", f"at least {name}[0] ({curve[0]!r})", repr(at_rest)
                )
        for name in ("pressure", "temperature"):
            factor = f"{name}_factor"
            count = len(getattr(self, name))
            checks.column(f"{where}.{factor}", getattr(self, factor), count, 1e-3)


class WetClutchParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Plates, oil film and heat; SI units.

    Attributes:
        friction: map of the linings.
        surfaces: number of friction surfaces n.
        outer_radius, inner_radius: of the linings, m.
        groove_share: of the annulus that is grooved, 1; the rest carries and shears.
        kiss_travel: of the piston, from rest to where the plates touch, m; opens n gaps.
        least_gap: oil film left in each when the plates touch, m.
        viscosity: of the oil at ``viscosity_temperature``, Pa s.
        viscosity_temperature: K.
        viscosity_slope: its logarithmic fall with temperature, 1/K.
        expulsion_slip: at which the film begins to be thrown out, rad/s.
        film_pressure: on the lining, at which the film has lost all but 1/e of its torque, Pa.
        heat_capacity: of plates and drum, J/K.
        oil_heat: density times specific heat of the oil times how well it takes it up, J/(m^3 K).
        still_cooling: without oil flow, W/K.
    """

    friction: FrictionParameters
    surfaces: float
    outer_radius: float
    inner_radius: float
    groove_share: float
    kiss_travel: float
    least_gap: float
    viscosity: float
    viscosity_temperature: float
    viscosity_slope: float
    expulsion_slip: float
    film_pressure: float
    heat_capacity: float
    oil_heat: float
    still_cooling: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        self.friction.validate(f"{where}.friction")
        checks.positive(where, self, "surfaces", "inner_radius", "kiss_travel", "least_gap")
        checks.ordered(where, self, "inner_radius", "outer_radius")
        checks.fraction(where, self, "groove_share")
        if self.groove_share == 1.0:
            raise InputError(f"{where}.groove_share", "less than 1", repr(self.groove_share))
        checks.positive(where, self, "viscosity_temperature", "expulsion_slip", "film_pressure")
        checks.positive(where, self, "heat_capacity")
        checks.not_negative(
            where, self, "viscosity", "viscosity_slope", "oil_heat", "still_cooling"
        )

    @property
    def friction_radius(self) -> float:
        """Mean radius of an evenly pressed annulus, ``2/3*(ro^3 - ri^3)/(ro^2 - ri^2)``, m."""
        ro, ri = self.outer_radius, self.inner_radius
        return 2.0 / 3.0 * (ro**3 - ri**3) / (ro**2 - ri**2)

    def pack(self, dt: float = 5e-5, wear: float = 0.0) -> NDArray[np.float64]:
        """Return the kernels' parameters, shape ``(N_PARAMETERS,)``, for a step of ``dt`` s."""
        ro, ri = self.outer_radius, self.inner_radius
        land = 1.0 - self.groove_share
        radius = self.friction_radius
        p = np.zeros(N_PARAMETERS)
        p[:P_STATIC] = [
            dt,
            radius,
            self.surfaces * radius,
            1.0 / (math.pi * (ro**2 - ri**2) * land),
            # n surfaces share the piston's travel: n/(h/n) = n^2/h
            self.viscosity * self.surfaces**2 * land * math.pi / 2.0 * (ro**4 - ri**4),
            self.kiss_travel,
            self.surfaces * self.least_gap,
            1.0 / self.expulsion_slip,
            self.viscosity_temperature,
            self.viscosity_slope,
            self.heat_capacity,
            self.oil_heat,
            self.still_cooling,
            self.friction.static_fresh,
            self.friction.static_aged,
        ]
        p[P_FILM] = p[P_PER_AREA] / self.film_pressure
        f = self.friction
        _fill_axis(p, P_SPEED, f.speed)
        _fill(p, P_FRESH, f.fresh)
        _fill(p, P_AGED, f.aged)
        _fill_axis(p, P_PRESSURE, f.pressure)
        _fill(p, P_PRESSURE_FACTOR, f.pressure_factor)
        _fill_axis(p, P_TEMPERATURE, f.temperature)
        _fill(p, P_TEMPERATURE_FACTOR, f.temperature_factor)
        set_wear(p, wear)
        return p


def _fill(p: NDArray[np.float64], at: int, values: tuple[float, ...]) -> None:
    p[at : at + POINTS] = values[-1]
    p[at : at + len(values)] = values


def _fill_axis(p: NDArray[np.float64], at: int, values: tuple[float, ...]) -> None:
    """Go on rising beyond the end, where the table stays as it is."""
    for i in range(POINTS):
        last = len(values) - 1
        p[at + i] = values[min(i, last)] + max(i - last, 0) * (values[-1] - values[0])


@kernel
def set_wear(p: NDArray[np.float64], wear: float) -> None:
    """Blend the friction curves in ``p``: 0 fresh, 1 aged; may be called at any time."""
    share = min(max(wear, 0.0), 1.0)
    for i in range(POINTS):
        p[P_CURVE + i] = p[P_FRESH + i] * (1.0 - share) + p[P_AGED + i] * share
    p[P_STATIC] = p[P_STATIC_FRESH] * (1.0 - share) + p[P_STATIC_AGED] * share


@kernel
def friction_factor(p: NDArray[np.float64], force: float, temperature: float) -> float:
    """Return what pressure and temperature make of every coefficient, 1; ``force`` N presses."""
    return look_up(p, P_PRESSURE, POINTS, P_PRESSURE_FACTOR, force * p[P_PER_AREA]) * look_up(
        p, P_TEMPERATURE, POINTS, P_TEMPERATURE_FACTOR, temperature
    )


@kernel
def friction_coefficient(
    p: NDArray[np.float64], slip: float, force: float, temperature: float
) -> float:
    """Return the kinetic coefficient at ``slip`` rad/s, 1."""
    return look_up(p, P_SPEED, POINTS, P_CURVE, abs(slip) * p[P_RADIUS]) * friction_factor(
        p, force, temperature
    )


@kernel
def drag_torque(
    p: NDArray[np.float64], slip: float, piston: float, force: float, oil_temperature: float
) -> float:
    """Return the magnitude of the oil's shear torque, N m.

    At piston travel ``piston`` m, the plates pressed with ``force`` N (not negative).
    """
    if slip == 0.0:
        return 0.0
    gap = max(p[P_KISS] - piston, 0.0) + p[P_LEAST_GAP]
    thin = math.exp(-p[P_OIL_SLOPE] * (oil_temperature - p[P_OIL_REFERENCE]) - p[P_FILM] * force)
    ratio = slip * p[P_EXPEL]
    torque: float = p[P_DRAG] * thin * abs(slip) / (gap * (1.0 + ratio * ratio))
    return torque


@kernel
def foreseen_slip(x: NDArray[np.float64], slip: float) -> float:
    """Return the slip half way through the coming step, rad/s, from that now and the step before's."""
    middle = slip + 0.5 * (slip - x[X_SLIP])
    x[X_SLIP] = slip
    return float(middle) if middle * slip > 0.0 else 0.0


@kernel
def capacity_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    force: float,
    piston: float,
    slip: float,
    oil_temperature: float,
    out: NDArray[np.float64],
) -> None:
    """Write what the clutch can carry in this step.

    For the driveline: kinetic capacity plus drag while it slides, static capacity while it holds (no
    drag then: no slip).

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``.
        force: on the pack, N, as :mod:`hev_can_emu.plant.hydraulics` gives it.
        piston: its travel, m.
        slip: engine side minus transmission side, rad/s.
        oil_temperature: K.
        out: ``(N_OUT,)``: kinetic and static capacity, drag torque, N m; kinetic coefficient.
    """
    load = max(force, 0.0)
    temperature = x[X_TEMPERATURE]
    factor = friction_factor(p, load, temperature)
    kinetic = look_up(p, P_SPEED, POINTS, P_CURVE, abs(slip) * p[P_RADIUS]) * factor
    out[OUT_FRICTION] = kinetic
    out[OUT_KINETIC] = kinetic * load * p[P_TORQUE_RADIUS]
    out[OUT_STATIC] = p[P_STATIC] * factor * load * p[P_TORQUE_RADIUS]
    out[OUT_DRAG] = drag_torque(p, slip, piston, load, oil_temperature)


@kernel
def heat_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    heat: float,
    cooling_flow: float,
    oil_temperature: float,
    out: NDArray[np.float64],
) -> None:
    """Warm the plates by the heat of this step, cool them by the oil: exact for an even heat flow.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        x: state, ``(N_STATE,)``, changed in place.
        heat: friction torque times slip, integrated over the step by the driveline, J.
        cooling_flow: oil through the plates, m^3/s.
        oil_temperature: where the oil comes in, K.
        out: ``(N_HEAT,)``: heat taken in and given to the oil, J.
    """
    dt = p[P_DT]
    capacity = p[P_HEAT_CAPACITY]
    cooling = p[P_STILL_COOLING] + p[P_FLOW_HEAT] * max(cooling_flow, 0.0)
    exponent = cooling * dt / capacity
    above = x[X_TEMPERATURE] - oil_temperature
    out[HEAT_IN] = heat
    # With s = (1 - exp(-a))/a: the mean of a decaying start is s, that of a rising end is 1 - s.
    if exponent > 0.0:
        left = -math.expm1(-exponent)
        mean = left / exponent
        # (1 - mean)/a by its series where the difference would cancel
        rise = 0.5 - exponent / 6.0 + exponent * exponent / 24.0
        if exponent > 1e-3:
            rise = (1.0 - mean) / exponent
        out[HEAT_TO_OIL] = cooling * dt * (above * mean) + exponent * rise * heat
        x[X_TEMPERATURE] += mean * heat / capacity - above * left
    else:
        out[HEAT_TO_OIL] = 0.0
        x[X_TEMPERATURE] += heat / capacity
