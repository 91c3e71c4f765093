"""An identification problem: targets in SI, parameters on a logarithmic scale, each checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.plant.observations import (
    Observation,
    StepObservation,
    convert,
    mode_observations,
    step_observation,
)
from hev_can_emu.plant.targets import Known, TargetsFile
from hev_can_emu.plant.vehicle import MESHES, RATIO_RADII, RATIO_TOLERANCE, SECTIONS, SHAFTS

Array = npt.NDArray[np.float64]


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
    observations = mode_observations(file, where)
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
        observations,
        step_observation(file, observations, where),
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
    return convert(number, given_unit, UNITS[name], path, key, name.startswith("damping."))
