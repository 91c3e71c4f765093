"""An identification problem: targets in SI, parameters on a logarithmic scale, each checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.plant.structure import CONFIGURATIONS
from hev_can_emu.plant.targets import Known, Quantity, StepTargets, TargetsFile
from hev_can_emu.plant.vehicle import MESHES, RATIO_RADII, RATIO_TOLERANCE, SECTIONS, SHAFTS
from hev_can_emu.units import unit

Array = npt.NDArray[np.float64]


class Observation(NamedTuple):
    """Modes of one kind: ``orders`` (m,) counted from 0, ``values`` and ``tolerances`` (m,), Hz or 1."""

    model: str
    configuration: str
    quantity: Quantity
    orders: tuple[int, ...]
    values: tuple[float, ...]
    tolerances: tuple[float, ...]


class StepObservation(NamedTuple):
    """The step's settings in SI, then five measured values and their tolerances (m/s, %, s)."""

    configuration: str
    time: float
    end: float
    engine: float
    em2: float
    values: tuple[float, ...]
    tolerances: tuple[float, ...]


class Problem(NamedTuple):
    """An identification problem on logarithms of SI values.

    Attributes:
        names: all parameters, ``section.name``.
        base: shape (n,), logarithm of the known ones, 0 for the sought.
        spread: shape (n, p) of zeros and ones: all logarithms are ``base + spread @ sought``.
        sought: the p sought parameters' names.
        lower, upper, middle, width: shape (p,): bounds, most plausible value, its standard deviation.
        zero: parameters known to be exactly zero (damping only).
        observations: measured modes.
        step: measured step response, or None.
    """

    names: tuple[str, ...]
    base: Array
    spread: Array
    sought: tuple[str, ...]
    lower: Array
    upper: Array
    middle: Array
    width: Array
    zero: frozenset[str]
    observations: tuple[Observation, ...]
    step: StepObservation | None


UNITS: dict[str, str] = {
    **{f"inertias.{name}": "kg m^2" for name in SECTIONS["inertias"]},
    **{f"stiffness.k{name}": "N m/rad" for name in SHAFTS},
    **{f"stiffness.k{name}": "N/m" for name in MESHES},
    **{f"damping.c{name}": "N m s/rad" for name in SHAFTS},
    **{f"damping.c{name}": "N s/m" for name in MESHES},
    **{f"base_radii.{name}": "m" for name in SECTIONS["base_radii"]},
    "tyre_radius": "m",
    **{f"ratio_rounding.{name}": "1" for name in RATIO_RADII},
}
"""Every parameter and its SI unit, in the order of :attr:`Problem.names`."""

MODES_16DOF = 15
MODES_4DOF = 3


def problem(file: TargetsFile, where: str) -> Problem:
    """Return the problem a targets file poses, in SI; ``where`` names the file in errors.

    Raises:
        InputError: a missing, unknown or impossible entry, told by its path.
    """
    if file.version != 1:
        raise InputError(f"{where}: $.version", "1", str(file.version))
    entries = _entries(file, where)
    base, lower, upper, middle = {}, {}, {}, {}
    zero = set()
    for name, entry in entries.items():
        path = f"{where}: $.{name}"
        if entry.same_as is not None:
            continue
        if entry.lower is None and entry.upper is None:
            value = _si(entry.value, entry.unit, name, path, "value")
            if value == 0.0 and name.startswith("damping."):
                zero.add(name)
                base[name] = 0.0
            else:
                base[name] = math.log(value)
            continue
        low = _si(entry.lower, entry.unit, name, path, "lower")
        high = _si(entry.upper, entry.unit, name, path, "upper")
        if not 0.0 < low < high:
            raise InputError(f"{path}.upper", f"more than lower ({low:g})", f"{high:g}")
        centre = math.sqrt(low * high)
        if entry.value is not None:
            centre = _si(entry.value, entry.unit, name, path, "value")
            if not low <= centre <= high:
                raise InputError(
                    f"{path}.value", f"a value from {low:g} to {high:g}", f"{centre:g}"
                )
        if name.startswith("ratio_rounding."):
            for key, bound in (("lower", low), ("upper", high)):
                if abs(bound - 1.0) > RATIO_TOLERANCE:
                    wanted = f"1 within {RATIO_TOLERANCE:g}"
                    raise InputError(f"{path}.{key}", wanted, f"{bound:g}")
        lower[name], upper[name], middle[name] = math.log(low), math.log(high), math.log(centre)
    if not lower:
        raise InputError(f"{where}: $", "a parameter with lower and upper", "none to be sought")
    sought = tuple(lower)
    spread = np.zeros((len(UNITS), len(sought)))
    all_base = np.zeros(len(UNITS))
    for row, name in enumerate(UNITS):
        source = _tied_to(entries, name, where)
        if source in lower:
            spread[row, sought.index(source)] = 1.0
        else:
            all_base[row] = base[source]
            if source in zero:
                zero.add(name)
    low_log, high_log = np.array(list(lower.values())), np.array(list(upper.values()))
    return Problem(
        tuple(UNITS),
        all_base,
        spread,
        sought,
        low_log,
        high_log,
        np.array(list(middle.values())),
        (high_log - low_log) / 4.0,  # the range as plus and minus two standard deviations
        frozenset(zero),
        _observations(file, where),
        _step(file.step_response, where),
    )


def _entries(file: TargetsFile, where: str) -> dict[str, Known]:
    sections: dict[str, Mapping[str, Known]] = {
        "inertias": file.inertias,
        "stiffness": file.stiffness,
        "damping": file.damping,
        "base_radii": file.base_radii,
        "ratio_rounding": file.ratio_rounding,
    }
    entries: dict[str, Known] = {"tyre_radius": file.tyre_radius}
    for section, given in sections.items():
        known = [name.partition(".")[2] for name in UNITS if name.startswith(f"{section}.")]
        for name, entry in given.items():
            if name not in known:
                raise InputError(
                    f"{where}: $.{section}",
                    f"one of {', '.join(known)}",
                    f"'{name}'",
                    did_you_mean(name, known),
                )
            entries[f"{section}.{name}"] = entry
    for name in UNITS:
        if name not in entries:
            if not name.startswith("ratio_rounding."):
                raise InputError(f"{where}: $.{name}", "a value or a range", "nothing")
            entries[name] = Known(value=1.0, unit="1")
    return {name: entries[name] for name in UNITS}


def _tied_to(entries: dict[str, Known], name: str, where: str) -> str:
    """Follow ``same_as`` one step (a tie must end at a value or a range)."""
    entry = entries[name]
    if entry.same_as is None:
        return name
    path = f"{where}: $.{name}.same_as"
    section = name.rpartition(".")[0]
    target = f"{section}.{entry.same_as}" if section else entry.same_as
    if target not in entries or UNITS[target] != UNITS[name]:
        known = [
            key.rpartition(".")[2]
            for key in UNITS
            if key.startswith(f"{section}.") and UNITS[key] == UNITS[name] and key != name
        ]
        raise InputError(
            path,
            "a parameter of the same kind",
            f"'{entry.same_as}'",
            did_you_mean(entry.same_as, known),
        )
    if entries[target].same_as is not None:
        raise InputError(path, "a parameter with a value or a range", f"'{entry.same_as}', tied")
    if entry.value is not None or entry.lower is not None or entry.upper is not None:
        raise InputError(path, "nothing beside it", "a value or a range as well")
    return target


def _si(number: float | None, given_unit: str | None, name: str, path: str, key: str) -> float:
    if number is None:
        raise InputError(path, f"the key '{key}'", "nothing")
    if given_unit is None:
        raise InputError(path, "the key 'unit'", "a value without unit", f"SI: {UNITS[name]}")
    return _convert(number, given_unit, UNITS[name], path, key, name.startswith("damping."))


def _convert(
    number: float, given_unit: str, wanted: str, path: str, key: str, may_be_zero: bool
) -> float:
    used = unit(given_unit, f"{path}.unit")
    if used.dimension != unit(wanted).dimension:
        raise InputError(f"{path}.unit", f"a unit of {wanted}", f"'{given_unit}'")
    value = used.to_si(number)
    if value < 0.0 or (value == 0.0 and not may_be_zero):
        bound = ">= 0" if may_be_zero else "> 0"
        raise InputError(f"{path}.{key}", f"a value {bound}", f"{number:g}")
    return value


def _observations(file: TargetsFile, where: str) -> tuple[Observation, ...]:
    found: list[Observation] = []
    for index, one in enumerate(file.frequencies):
        path = f"{where}: $.frequencies[{index}]"
        _check_configuration(one.configuration, path)
        most = MODES_16DOF if one.model == "16dof" else MODES_4DOF
        tolerance = _convert(one.tolerance, one.unit, "Hz", path, "tolerance", False)
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
                _convert(value, given, gain, f"{path}.{quantity}[{order}]", "value", False)
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


def _check_configuration(name: str, path: str) -> None:
    if name not in CONFIGURATIONS:
        raise InputError(
            f"{path}.configuration",
            f"one of {', '.join(CONFIGURATIONS)}",
            f"'{name}'",
            did_you_mean(name, CONFIGURATIONS),
        )


def _step(given: StepTargets | None, where: str) -> StepObservation | None:
    if given is None:
        return None
    path = f"{where}: $.step_response"
    _check_configuration(given.configuration, path)
    settings = [
        _convert(one.value, one.unit, wanted, f"{path}.{name}", "value", True)
        for name, one, wanted in (
            ("step_time", given.step_time, "s"),
            ("read_out_time", given.read_out_time, "s"),
            ("engine_torque", given.engine_torque, "N m"),
            ("em2_torque", given.em2_torque, "N m"),
        )
    ]
    if settings[1] <= settings[0]:
        raise InputError(f"{path}.read_out_time", "a time after the step", f"{settings[1]:g} s")
    when = given.acceleration_difference_time
    instant = _convert(
        when.value, when.unit, "s", f"{path}.acceleration_difference_time", "value", True
    )
    if not settings[0] < instant < settings[1]:
        raise InputError(
            f"{path}.acceleration_difference_time.value",
            f"a time between {settings[0]:g} and {settings[1]:g} s",
            f"{instant:g} s",
        )
    values, tolerances = [], []
    for name, one, wanted, scale in (
        ("velocity_16dof", given.velocity_16dof, "m/s", 1.0),
        ("velocity_4dof", given.velocity_4dof, "m/s", 1.0),
        ("velocity_difference", given.velocity_difference, "%", 100.0),
        ("acceleration_difference", given.acceleration_difference, "%", 100.0),
        ("acceleration_difference_time", given.acceleration_difference_time, "s", 1.0),
    ):
        at = f"{path}.{name}"
        values.append(scale * _convert(one.value, one.unit, wanted, at, "value", False))
        tolerances.append(scale * _convert(one.tolerance, one.unit, wanted, at, "tolerance", False))
    time, end, engine, em2 = settings
    return StepObservation(
        given.configuration, time, end, engine, em2, tuple(values), tuple(tolerances)
    )
