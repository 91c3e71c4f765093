"""Measurements in SI, checked: modes and step responses."""

from __future__ import annotations

import math
from typing import NamedTuple

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.plant.structure import CONFIGURATIONS
from hev_can_emu.plant.targets import Measured, Quantity, Sample, StepTargets, TargetsFile
from hev_can_emu.units import unit

MODES_16DOF = 15
MODES_4DOF = 3
GRID = 0.01
"""Spacing of the step response, s: the paper's print interval."""


class Observation(NamedTuple):
    """Modes of one kind: ``orders`` (m,) counted from 0, ``values`` and ``tolerances`` (m,), Hz or 1."""

    model: str
    configuration: str
    quantity: Quantity
    orders: tuple[int, ...]
    values: tuple[float, ...]
    tolerances: tuple[float, ...]


class Sampled(NamedTuple):
    """A measured speed (m/s) or acceleration (m/s^2) at a grid point counted from the step."""

    quantity: str
    at: int
    value: float
    tolerance: float


class StepObservation(NamedTuple):
    """A measured step response, in SI.

    Attributes:
        configuration: its name.
        time, end: of the step and of the read-out, s.
        engine, em2: torques after the step, N m.
        values: speeds of the 16-DOF and the 4-DOF model (m/s), speeds apart (%), accelerations
            furthest apart (%), when (s); NaN where not measured.
        tolerances: likewise.
        samples: measured speeds and accelerations of the car.
        lowest: measured first natural frequency, rad/s; NaN where not needed.
    """

    configuration: str
    time: float
    end: float
    engine: float
    em2: float
    values: tuple[float, ...]
    tolerances: tuple[float, ...]
    samples: tuple[Sampled, ...]
    lowest: float


def mode_observations(file: TargetsFile, where: str) -> tuple[Observation, ...]:
    """Return the measured modes in SI, checked; ``where`` names the file in errors."""
    found: list[Observation] = []
    for index, one in enumerate(file.frequencies):
        path = f"{where}: $.frequencies[{index}]"
        check_configuration(one.configuration, path)
        most = MODES_16DOF if one.model == "16dof" else MODES_4DOF
        tolerance = convert(one.tolerance, one.unit, "Hz", path, "tolerance", False)
        ratio_tolerance = one.damping_ratio_tolerance or 0.0
        if one.damping_ratio and not ratio_tolerance > 0.0:
            got = "nothing" if one.damping_ratio_tolerance is None else f"{ratio_tolerance:g}"
            raise InputError(f"{path}.damping_ratio_tolerance", "a value > 0", got)
        kinds: tuple[tuple[Quantity, list[float | None], float], ...] = (
            ("undamped", one.undamped, tolerance),
            ("damped", one.damped, tolerance),
            ("damping_ratio", one.damping_ratio, ratio_tolerance),
        )
        for quantity, values, margin in kinds:
            if len(values) > most:
                raise InputError(
                    f"{path}.{quantity}",
                    f"at most {most} modes of the {one.model} model",
                    f"{len(values)}",
                )
            orders = tuple(order for order, value in enumerate(values) if value is not None)
            measured = [values[order] for order in orders]
            gain = "Hz" if quantity != "damping_ratio" else "1"
            given = one.unit if quantity != "damping_ratio" else "1"
            numbers = tuple(
                convert(value, given, gain, f"{path}.{quantity}[{order}]", "value", False)
                for order, value in zip(orders, measured, strict=True)
                if value is not None
            )
            if orders:
                margins = (margin,) * len(orders)
                found.append(
                    Observation(one.model, one.configuration, quantity, orders, numbers, margins)
                )
    if not any(observation.quantity == "undamped" for observation in found):
        raise InputError(f"{where}: $.frequencies", "an undamped natural frequency", "none")
    return tuple(found)


def check_configuration(name: str, path: str) -> None:
    """Raise InputError unless ``name`` is a driving configuration."""
    if name not in CONFIGURATIONS:
        raise InputError(
            f"{path}.configuration",
            f"one of {', '.join(CONFIGURATIONS)}",
            f"'{name}'",
            did_you_mean(name, CONFIGURATIONS),
        )


def convert(
    number: float, given_unit: str, wanted: str, path: str, key: str, may_be_zero: bool
) -> float:
    """Return ``number`` in SI; raises InputError for a foreign dimension or an impossible sign."""
    used = unit(given_unit, f"{path}.unit")
    if used.dimension != unit(wanted).dimension:
        raise InputError(f"{path}.unit", f"a unit of {wanted}", f"'{given_unit}'")
    value = used.to_si(number)
    if value < 0.0 or (value == 0.0 and not may_be_zero):
        bound = ">= 0" if may_be_zero else "> 0"
        raise InputError(f"{path}.{key}", f"a value {bound}", f"{number:g}")
    return value


def step_observation(
    file: TargetsFile, modes: tuple[Observation, ...], where: str
) -> StepObservation | None:
    """Return the measured step response in SI, checked; None where the file has none."""
    given = file.step_response
    if given is None:
        return None
    path = f"{where}: $.step_response"
    check_configuration(given.configuration, path)
    time, end, engine, em2 = (
        convert(one.value, one.unit, wanted, f"{path}.{name}", "value", True)
        for name, one, wanted in (
            ("step_time", given.step_time, "s"),
            ("read_out_time", given.read_out_time, "s"),
            ("engine_torque", given.engine_torque, "N m"),
            ("em2_torque", given.em2_torque, "N m"),
        )
    )
    if end <= time:
        raise InputError(f"{path}.read_out_time", "a time after the step", f"{end:g} s")
    for name, instant in (("step_time", time), ("read_out_time", end)):
        if abs(round(instant / GRID) * GRID - instant) > 1e-9:
            raise InputError(f"{path}.{name}", f"a multiple of {GRID:g} s", f"{instant:g} s")
    values, tolerances = [], []
    for name, one, wanted, scale in (
        ("velocity_16dof", given.velocity_16dof, "m/s", 1.0),
        ("velocity_4dof", given.velocity_4dof, "m/s", 1.0),
        ("velocity_difference", given.velocity_difference, "%", 100.0),
        ("acceleration_difference", given.acceleration_difference, "%", 100.0),
        ("acceleration_difference_time", given.acceleration_difference_time, "s", 1.0),
    ):
        value, tolerance = _measured(one, wanted, f"{path}.{name}")
        values.append(scale * value)
        tolerances.append(scale * tolerance)
    samples = tuple(
        _sampled(one, time, end, f"{path}.samples[{index}]")
        for index, one in enumerate(given.samples)
    )
    if not samples and all(math.isnan(value) for value in values):
        raise InputError(path, "a measured number", "none")
    lowest = _lowest(given, time, end, modes, path)
    return StepObservation(
        given.configuration,
        time,
        end,
        engine,
        em2,
        tuple(values),
        tuple(tolerances),
        samples,
        lowest,
    )


def _measured(one: Measured | None, wanted: str, path: str) -> tuple[float, float]:
    if one is None:
        return math.nan, math.nan
    return (
        convert(one.value, one.unit, wanted, path, "value", False),
        convert(one.tolerance, one.unit, wanted, path, "tolerance", False),
    )


def _sampled(one: Sample, time: float, end: float, path: str) -> Sampled:
    if not time <= one.time <= end:
        raise InputError(f"{path}.time", f"a time from {time:g} to {end:g} s", f"{one.time:g} s")
    at = round((one.time - time) / GRID)
    if abs(time + at * GRID - one.time) > 1e-6:
        raise InputError(
            f"{path}.time", f"the step's time plus a multiple of {GRID:g} s", f"{one.time:g} s"
        )
    wanted = "m/s" if one.quantity == "vehicle_speed" else "m/s^2"
    size = convert(abs(one.value), one.unit, wanted, path, "value", True)
    tolerance = convert(one.tolerance, one.unit, wanted, path, "tolerance", False)
    return Sampled(one.quantity, at, math.copysign(size, one.value), tolerance)


def _lowest(
    given: StepTargets, time: float, end: float, modes: tuple[Observation, ...], path: str
) -> float:
    """Return the measured first natural frequency, which the differences' half-waves follow."""
    when = given.acceleration_difference_time
    if (when is None) != (given.acceleration_difference is None):
        name = "acceleration_difference" + ("_time" if when is None else "")
        raise InputError(path, f"the key '{name}'", "only its counterpart")
    if when is None:
        return math.nan
    at = f"{path}.acceleration_difference_time"
    instant = convert(when.value, when.unit, "s", at, "value", True)
    if not time < instant < end:
        raise InputError(f"{at}.value", f"a time between {time:g} and {end:g} s", f"{instant:g} s")
    for one in modes:
        if one[:3] == ("16dof", given.configuration, "undamped") and 0 in one.orders:
            return 2.0 * math.pi * one.values[one.orders.index(0)]
    raise InputError(at, "the first undamped mode of 16dof in that configuration too", "none")
