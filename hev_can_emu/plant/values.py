"""A value as a vehicle file writes it: number, unit, source; and its way into SI."""

from __future__ import annotations

import math

import msgspec

from hev_can_emu.errors import InputError
from hev_can_emu.units import Unit, unit


class Value(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A number, a column or a grid of numbers, with its unit and where it comes from."""

    value: float | list[float | list[float]]
    unit: str
    source: str
    note: str = ""


def si_number(given: Value, expected_unit: str, where: str) -> float:
    """Return a single value in SI; raises InputError for a table, a non-number or a foreign dimension."""
    if isinstance(given.value, list):
        raise InputError(where, f"one number in {expected_unit}", f"a list of {len(given.value)}")
    return _finite(given.value, _unit(given, expected_unit, where), where)


def si_list(given: Value, expected_unit: str, where: str) -> tuple[float, ...]:
    """Return a column in SI; raises InputError as :func:`si_number`."""
    used = _unit(given, expected_unit, where)
    if not isinstance(given.value, list):
        raise InputError(where, f"a list of numbers in {expected_unit}", f"{given.value:g}")
    values = []
    for index, value in enumerate(given.value):
        place = f"{where}.value[{index}]"
        if isinstance(value, list):
            raise InputError(place, f"a number in {expected_unit}", f"a list of {len(value)}")
        values.append(_finite(value, used, place))
    return tuple(values)


def si_table(given: Value, expected_unit: str, where: str) -> tuple[tuple[float, ...], ...]:
    """Return a grid (rows of columns) in SI; raises InputError as :func:`si_number`."""
    used = _unit(given, expected_unit, where)
    expected = f"a list of rows of numbers in {expected_unit}"
    if not isinstance(given.value, list):
        raise InputError(where, expected, f"{given.value:g}")
    rows = []
    for index, row in enumerate(given.value):
        place = f"{where}.value[{index}]"
        if not isinstance(row, list):
            raise InputError(place, "a row of numbers", f"{row:g}")
        rows.append(tuple(_finite(value, used, place) for value in row))
    return tuple(rows)


def _unit(given: Value, expected_unit: str, where: str) -> Unit:
    used = unit(given.unit, f"{where}.unit")
    if used.dimension != unit(expected_unit).dimension:
        raise InputError(f"{where}.unit", f"a unit of {expected_unit}", f"'{given.unit}'")
    return used


def _finite(value: float, used: Unit, where: str) -> float:
    if not math.isfinite(value):
        raise InputError(f"{where}.value", "a finite number", str(value))
    return used.to_si(value)
