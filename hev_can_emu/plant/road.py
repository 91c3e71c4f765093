"""Road load: rolling resistance as a friction capacity, air and grade as a torque on the body.

The body's coordinate is the wheel's angle, so forces are multiplied by the wheel radius.  Rolling
resistance cannot move a standing car, hence a capacity: the driveline lets it stick.  Air drag and
grade can, hence a torque.  The slope is rise over run, positive uphill.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks

GRAVITY = 9.80665
"""Standard gravity, m/s^2."""

# Layout of the packed parameters.
P_ROLLING, P_ROLLING_SQUARE, P_AIR, P_WEIGHT = 0, 1, 2, 3
N_PARAMETERS = 4

# Layout of the output.
OUT_ROLLING_CAPACITY, OUT_BODY_TORQUE, OUT_AIR_TORQUE, OUT_GRADE_TORQUE = 0, 1, 2, 3
N_OUT = 4


class RoadParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Resistance of road and air; SI units.

    Attributes:
        rolling_coefficient: force per weight at standstill, 1.
        rolling_speed_square: its rise with speed squared, s^2/m^2.
        drag_area: drag coefficient times frontal area, m^2.
        air_density: kg/m^3.
    """

    rolling_coefficient: float
    rolling_speed_square: float
    drag_area: float
    air_density: float

    def validate(self, where: str) -> None:
        """Raise :class:`hev_can_emu.errors.InputError` naming the first value that makes no sense."""
        names = ("rolling_coefficient", "rolling_speed_square", "drag_area", "air_density")
        checks.not_negative(where, self, *names)

    def pack(self, mass: float, wheel_radius: float) -> NDArray[np.float64]:
        """Return the kernel's parameters, shape ``(N_PARAMETERS,)``; kg, m."""
        weight = mass * GRAVITY * wheel_radius
        return np.array(
            [
                weight * self.rolling_coefficient,
                weight * self.rolling_speed_square,
                0.5 * self.air_density * self.drag_area * wheel_radius,
                weight,
            ]
        )


@small_kernel
def sine_of_grade(grade: float) -> float:
    """Return the sine of the slope's angle for ``grade``, rise over run."""
    if grade == 0.0:
        return grade  # the same, without root and division
    return grade / math.sqrt(1.0 + grade * grade)


@small_kernel
def road_load(
    p: NDArray[np.float64],
    vehicle_speed: float,
    grade: float,
    head_wind: float,
    out: NDArray[np.float64],
) -> None:
    """Write the resistances at the wheel.

    Args:
        p: parameters, ``(N_PARAMETERS,)``.
        vehicle_speed: m/s.
        grade: rise over run, positive uphill; NaN counts as level.
        head_wind: speed of the air against the car, m/s.
        out: ``(N_OUT,)``: rolling resistance as a capacity N m; torque on the body N m, positive
            accelerates forward, which is the sum of the two that follow: air, grade N m.
    """
    if math.isnan(grade):
        grade = 0.0
    sine = sine_of_grade(grade)
    cosine = 1.0 if sine == 0.0 else math.sqrt(1.0 - sine * sine)
    air_speed = vehicle_speed + head_wind
    rolling = p[P_ROLLING] + p[P_ROLLING_SQUARE] * vehicle_speed * vehicle_speed
    out[OUT_ROLLING_CAPACITY] = rolling * cosine
    out[OUT_AIR_TORQUE] = -p[P_AIR] * air_speed * abs(air_speed)
    out[OUT_GRADE_TORQUE] = -p[P_WEIGHT] * sine
    out[OUT_BODY_TORQUE] = out[OUT_AIR_TORQUE] + out[OUT_GRADE_TORQUE]


@small_kernel
def accelerometer(acceleration: float, grade: float) -> float:
    """Return what a longitudinal accelerometer reads, m/s^2: ``dv/dt + g*sin(slope)``."""
    if math.isnan(grade):
        grade = 0.0
    return acceleration + GRAVITY * sine_of_grade(grade)
