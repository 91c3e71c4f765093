"""Slider-crank of the four-cylinder engine: piston motion, inertia over angle, inertial torque.

A piston at crank angle ``a`` (0 at top dead centre) has moved down by
``x = R + L - (R*cos(a) + L*sqrt(1 - k^2*sin(a)^2))``, ``k = R/L``; the truncated rod keeps
``x = R*(1 + k/4 - cos(a) - k/4*cos(2*a))``.  Pistons 1 and 4 move at ``a``, 2 and 3 at ``a + pi``, so
that the reciprocating inertia, four times ``m*(dx/da)^2`` on average, is with ``s = sin(a)^2``

    I(a) = 4*m*R^2*(s + k^2*s*(1 - s)/(1 - k^2*s))          (truncated: denominator 1)

The inertia given for the engine holds the mean of ``I`` already; only ``dJ(a) = I(a) - mean`` acts in
addition, with the kinetic energy ``dJ*w^2/2`` and therefore the torque ``-dJ*w' - dJ'(a)*w^2/2``.

:func:`crank_torque` gives the constant torque whose work over a step equals the loss of that energy,
to rounding and for any step: torques taken from the beginning of the step, or with the acceleration
of the step before, feed the crank energy that is not there (docs/detailed/engine.md has the figures).
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks

# Layout of the packed parameters.
P_RADIUS, P_ROD, P_RATIO_SQUARE, P_BEND, P_AMPLITUDE, P_MEAN, P_THROTTLED = 0, 1, 2, 3, 4, 5, 6
N_PARAMETERS = 7

CYLINDERS = 4
_TURN = 2.0 * math.pi
_C3, _C5, _C7, _C9 = 1.0 / 6.0, 1.0 / 120.0, 1.0 / 5040.0, 1.0 / 362880.0
_ROUNDS = 2  # each gains about five digits: the travel hardly depends on the torque


class CrankParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Crank, rods and pistons of four cylinders in line, crank pins at 0, 180, 180 and 0 degrees.

    Attributes:
        reciprocating_mass: of one cylinder, kg: piston, rings, pin and the rod's reciprocating share.
        radius: of the crank, half the stroke, m.
        rod_length: between the rod's eyes, m.
        exact_rod: the exact rod, or the form truncated after the second order.
        throttled: multiply the inertial torque by the throttle opening, as Dai et al. (2024) do.  A
            piston's inertia does not depend on the throttle; so off by default.
    """

    reciprocating_mass: float
    radius: float
    rod_length: float
    exact_rod: bool = True
    throttled: bool = False

    @property
    def ratio(self) -> float:
        """Crank radius per rod length, 1."""
        return self.radius / self.rod_length

    @property
    def mean_inertia(self) -> float:
        """Mean of the reciprocating inertia over the angle, kg m^2, which the engine's own holds.

        Truncated ``2*m*R^2*(1 + k^2/4)``; exact ``2*m*R^2*(1 + (k/(1 + sqrt(1 - k^2)))^2)``.
        """
        k = self.ratio
        share = k / (1.0 + math.sqrt(1.0 - k * k)) if self.exact_rod else 0.5 * k
        return 2.0 * self.reciprocating_mass * self.radius**2 * (1.0 + share * share)

    @property
    def greatest_inertia(self) -> float:
        """Upper bound of the reciprocating inertia at any angle, kg m^2."""
        return 4.0 * self.reciprocating_mass * self.radius**2 * (1.0 + self.ratio**2)

    def validate(self, where: str, engine_inertia: float | None = None) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense.

        Args:
            where: place of the record.
            engine_inertia: mean inertia at the crank, kg m^2, which must hold the reciprocating one.
        """
        checks.positive(where, self, "reciprocating_mass", "radius", "rod_length")
        if self.rod_length < 2.0 * self.radius:
            raise InputError(
                f"{where}.rod_length",
                f"at least twice the radius ({self.radius!r})",
                repr(self.rod_length),
            )
        if engine_inertia is not None and self.greatest_inertia > engine_inertia:
            raise InputError(
                f"{where}.reciprocating_mass",
                f"a reciprocating inertia below the engine's {engine_inertia:g} kg m^2",
                f"{self.greatest_inertia:g} kg m^2",
            )

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernels' parameters, shape ``(N_PARAMETERS,)``; they hold for any step ``dt``."""
        square = self.ratio**2
        return np.array(
            [
                self.radius,
                self.rod_length,
                square,
                square if self.exact_rod else 0.0,
                CYLINDERS * self.reciprocating_mass * self.radius**2,
                self.mean_inertia,
                1.0 if self.throttled else 0.0,
            ]
        )


@kernel
def wrap(angle: float) -> float:
    """Return ``angle``, rad, within one turn: at least 0 and less than 2 pi."""
    wrapped = angle - math.floor(angle / _TURN) * _TURN
    if wrapped >= _TURN or wrapped < 0.0:  # a hair below zero rounds up to a whole turn
        wrapped = 0.0
    return wrapped


@kernel
def piston_travel(p: NDArray[np.float64], angle: float) -> float:
    """Return how far the piston has moved down from top dead centre, m."""
    s = math.sin(angle) ** 2
    radius, rod = p[P_RADIUS], p[P_ROD]
    # 1 - cos and 1 - sqrt written without cancellation.
    lift: float = 2.0 * radius * math.sin(0.5 * angle) ** 2
    bent = p[P_BEND] * s
    lift += rod * p[P_RATIO_SQUARE] * s / (1.0 + math.sqrt(1.0 - bent))
    return lift


@kernel
def piston_rate(p: NDArray[np.float64], angle: float) -> float:
    """Return the piston's travel per crank angle, m/rad."""
    sine, cosine = math.sin(angle), math.cos(angle)
    swing = p[P_RATIO_SQUARE] * p[P_ROD] * cosine / math.sqrt(1.0 - p[P_BEND] * sine * sine)
    rate: float = sine * (p[P_RADIUS] + swing)
    return rate


@kernel
def piston_curvature(p: NDArray[np.float64], angle: float) -> float:
    """Return the second derivative of the piston's travel by the crank angle, m/rad^2."""
    sine, cosine = math.sin(angle), math.cos(angle)
    s, bend = sine * sine, p[P_BEND]
    root = math.sqrt(1.0 - bend * s)
    swing = (1.0 - 2.0 * s + bend * s * s) / (root * root * root)
    curvature: float = p[P_RADIUS] * cosine + p[P_RATIO_SQUARE] * p[P_ROD] * swing
    return curvature


@kernel
def extra_inertia(p: NDArray[np.float64], angle: float) -> float:
    """Return dJ, kg m^2: the reciprocating inertia at this angle less its mean."""
    s = math.sin(angle) ** 2
    shape = s * (1.0 + p[P_RATIO_SQUARE] * (1.0 - s) / (1.0 - p[P_BEND] * s))
    inertia: float = p[P_AMPLITUDE] * shape - p[P_MEAN]
    return inertia


@kernel
def extra_inertia_rate(p: NDArray[np.float64], angle: float) -> float:
    """Return the derivative of :func:`extra_inertia` by the angle, kg m^2/rad."""
    s, bend = math.sin(angle) ** 2, p[P_BEND]
    root = 1.0 - bend * s
    shape = 1.0 + p[P_RATIO_SQUARE] * (1.0 - 2.0 * s + bend * s * s) / (root * root)
    rate: float = p[P_AMPLITUDE] * math.sin(2.0 * angle) * shape
    return rate


@kernel
def inertial_torque(
    p: NDArray[np.float64], angle: float, speed: float, acceleration: float
) -> float:
    """Return the inertial torque on the crank at one instant, N m, beyond the mean inertia's.

    ``acceleration`` is the crank's own, rad/s^2; 0 leaves the velocity torque ``-dJ'(a)*w^2/2``.
    """
    torque: float = -extra_inertia(p, angle) * acceleration
    return torque - 0.5 * extra_inertia_rate(p, angle) * speed * speed


@kernel
def reciprocating_energy(p: NDArray[np.float64], angle: float, speed: float) -> float:
    """Return the kinetic energy beyond the mean inertia's, ``dJ*w^2/2``, J; may be negative."""
    energy: float = 0.5 * extra_inertia(p, angle) * speed * speed
    return energy


@kernel
def _small_sine(x: float) -> float:
    """Return sin(x), by its series below 0.15, which is faster."""
    if abs(x) > 0.15:
        return math.sin(x)
    q = x * x
    return x * (1.0 - q * (_C3 - q * (_C5 - q * (_C7 - q * _C9))))


@kernel
def crank_torque(
    p: NDArray[np.float64],
    angle: float,
    speed: float,
    end_speed: float,
    travel: float,
    speed_gain: float,
    travel_gain: float,
    step: float,
    throttle: float,
) -> float:
    """Return the inertial torque, N m, to hold over one step so that its work is the energy's loss.

    The linear driveline answers a held torque T at the crank with the speed ``end_speed +
    speed_gain*T`` at the end of the step and the travel ``travel + travel_gain*T`` over it.  T solves
    ``T*travel(T) = E(begin) - E(end(T))``, E of :func:`reciprocating_energy`: a discrete gradient,
    second order in the step.

    Args:
        p: parameters of :meth:`CrankParameters.pack`.
        angle: of the crank at the beginning, rad.
        speed: at the beginning, rad/s.
        end_speed: without inertial torque, all other torques included, rad/s.
        travel: of the crank over the step without inertial torque, rad.
        speed_gain: rad/s per N m; for a crank of inertia J alone ``step/J``.
        travel_gain: rad per N m; for a crank alone ``step^2/(2*J)``.
        step: s, above 0; any part of an inner step, such as the rest after an event, will do.
        throttle: opening, 0 to 1; counts only with ``throttled``.
    """
    sine, cosine = math.sin(angle), math.cos(angle)
    s0 = sine * sine
    twice_sine, twice_cosine = 2.0 * sine * cosine, 1.0 - 2.0 * s0
    ratio, bend, amplitude, mean = p[P_RATIO_SQUARE], p[P_BEND], p[P_AMPLITUDE], p[P_MEAN]
    root0 = 1.0 - bend * s0
    inertia0 = amplitude * s0 * (1.0 + ratio * (1.0 - s0) / root0) - mean
    factor = throttle if p[P_THROTTLED] > 0.5 else 1.0

    torque = 0.0
    for rounds in range(_ROUNDS):
        # Inertia at the end, and its divided difference over the travel, free of cancellation.
        moved = travel + travel_gain * torque
        moved_sine, half_sine = _small_sine(moved), _small_sine(0.5 * moved)
        moved_cosine = 1.0 - 2.0 * half_sine * half_sine
        end_sine = sine * moved_cosine + cosine * moved_sine
        s1 = end_sine * end_sine
        root1 = 1.0 - bend * s1
        inertia1 = amplitude * s1 * (1.0 + ratio * (1.0 - s1) / root1) - mean
        chord = moved_sine / moved if abs(moved) > 1e-5 else 1.0
        chord *= twice_sine * moved_cosine + twice_cosine * moved_sine
        chord *= 1.0 + ratio * (1.0 - s0 - s1 + bend * s0 * s1) / (root0 * root1)
        slope = amplitude * chord
        half_inertia = 0.25 * (inertia0 + inertia1)
        for _ in range(_ROUNDS - rounds):  # Newton on what is, for a given travel, a square
            last = end_speed + speed_gain * torque
            total = speed + last
            rate = 2.0 / step  # where it turns round in this step
            if abs(moved - 0.5 * step * total) < 0.1 * abs(moved):
                rate = total / moved
            gap = 0.25 * slope * (speed * speed + last * last)
            gap = torque + factor * (gap + half_inertia * (last - speed) * rate)
            steepness = 1.0 + factor * speed_gain * (0.5 * slope * last + half_inertia * rate)
            torque -= gap / steepness
    return torque
