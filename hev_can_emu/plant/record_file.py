"""How a record of parameters stands in the vehicle file, and its way into SI.

The file's shape is made from the record itself: where the record holds a number or a table, the file
holds ``{value, unit, source}``, whose unit must be of the dimension that a table of units names; a
choice (yes or no) stands plainly, numbers by name are such values by name; an optional part may be missing.
"""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from typing import Any

import msgspec

from hev_can_emu.errors import InputError
from hev_can_emu.plant.values import Value, si_list, si_number, si_table

Units = Mapping[type, Mapping[str, str]]


def part_of(kind: Any) -> tuple[type[msgspec.Struct] | None, bool]:
    """Return the record that a field holds, or None, and whether it may be missing."""
    if isinstance(kind, types.UnionType):
        inner = [each for each in typing.get_args(kind) if each is not type(None)]
        return part_of(inner[0])[0], True
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return kind, False
    return None, False


def file_type(record: type[msgspec.Struct]) -> type[msgspec.Struct]:
    """Return the file's shape of a record."""
    fields: list[Any] = []
    kinds = typing.get_type_hints(record)
    for field in msgspec.structs.fields(record):
        kind = kinds[field.name]
        part, optional = part_of(kind)
        if part is not None:
            shape = file_type(part)
            optional = optional or field.default is not msgspec.NODEFAULT
            fields.append((field.name, shape | None, None) if optional else (field.name, shape))
        elif typing.get_origin(kind) is Mapping:
            fields.append((field.name, dict[str, Value], {}))
        elif kind is bool:
            fields.append((field.name, bool, field.default))
        elif field.default is not msgspec.NODEFAULT:
            fields.append((field.name, Value | None, None))
        else:
            fields.append((field.name, Value))
    return msgspec.defstruct(
        record.__name__ + "File", fields, frozen=True, kw_only=True, forbid_unknown_fields=True
    )


def from_file(record: type[msgspec.Struct], given: Any, units: Units, where: str) -> Any:
    """Return the record in SI; raises InputError for a value of foreign dimension or shape."""
    values: dict[str, Any] = {}
    for name, kind in typing.get_type_hints(record).items():
        place = f"{where}.{name}"
        part, _ = part_of(kind)
        value = getattr(given, name)
        if value is None:
            continue
        if part is not None:
            values[name] = from_file(part, value, units, place)
        elif kind is bool:
            values[name] = value
        elif typing.get_origin(kind) is Mapping:
            unit = units[record][name]
            values[name] = {key: si_number(n, unit, f"{place}.{key}") for key, n in value.items()}
        else:
            values[name] = _number(kind, value, units[record][name], place)
    return record(**values)


def validate(record: Any, where: str) -> None:
    """Check a record, or all of its parts; raises InputError."""
    if hasattr(record, "validate"):
        record.validate(where)
        return
    for name in typing.get_type_hints(type(record)):
        validate(getattr(record, name), f"{where}.{name}")


def _number(kind: Any, given: Value, unit: str, where: str) -> Any:
    """Read a float, a whole number, a column or a grid, as the record's field asks for."""
    if kind is float:
        return si_number(given, unit, where)
    if kind is int:
        number = si_number(given, unit, where)
        if number != round(number):
            raise InputError(f"{where}.value", "a whole number", f"{number:g}")
        return round(number)
    inner = typing.get_args(kind)[0]
    if isinstance(inner, types.GenericAlias):
        return si_table(given, unit, where)
    if isinstance(given.value, list) and any(isinstance(row, list) for row in given.value):
        raise InputError(where, f"a list of numbers in {unit}", "a list of lists")
    return si_list(given, unit, where)
