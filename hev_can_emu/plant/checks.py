"""Checks that the machines' parameter records share: one line, where and what, for every bad value."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

from hev_can_emu.errors import InputError


def finite(where: str, record: Any, *names: str) -> None:
    """Raise :class:`InputError` unless each named attribute of ``record`` is a finite number."""
    for name in names:
        value = getattr(record, name)
        if not math.isfinite(value):
            raise InputError(f"{where}.{name}", "a finite number", repr(value))


def positive(where: str, record: Any, *names: str) -> None:
    """Raise :class:`InputError` unless each named attribute is finite and greater than zero."""
    finite(where, record, *names)
    for name in names:
        value = getattr(record, name)
        if value <= 0.0:
            raise InputError(f"{where}.{name}", "a number greater than 0", repr(value))


def not_negative(where: str, record: Any, *names: str) -> None:
    """Raise :class:`InputError` unless each named attribute is finite and at least zero."""
    finite(where, record, *names)
    for name in names:
        value = getattr(record, name)
        if value < 0.0:
            raise InputError(f"{where}.{name}", "a number of at least 0", repr(value))


def fraction(where: str, record: Any, *names: str) -> None:
    """Raise :class:`InputError` unless each named attribute lies in 0 to 1."""
    finite(where, record, *names)
    for name in names:
        value = getattr(record, name)
        if not 0.0 <= value <= 1.0:
            raise InputError(f"{where}.{name}", "a number from 0 to 1", repr(value))


def ordered(where: str, record: Any, *names: str) -> None:
    """Raise :class:`InputError` unless the named attributes strictly increase in the order given."""
    finite(where, record, *names)
    for lower, upper in itertools.pairwise(names):
        low, high = getattr(record, lower), getattr(record, upper)
        if high <= low:
            raise InputError(f"{where}.{upper}", f"more than {lower} ({low!r})", repr(high))


def axis(where: str, values: Sequence[float], least: int = 2) -> None:
    """Raise :class:`InputError` unless ``values`` is finite, strictly rising and long enough."""
    if len(values) < least:
        raise InputError(where, f"at least {least} values", str(len(values)))
    for index, value in enumerate(values):
        if not math.isfinite(value):
            raise InputError(f"{where}[{index}]", "a finite number", repr(value))
        if index and value <= values[index - 1]:
            raise InputError(
                f"{where}[{index}]",
                f"more than the value before it ({values[index - 1]!r})",
                repr(value),
            )


def column(where: str, values: Sequence[float], count: int, least: float) -> None:
    """Raise :class:`InputError` unless there are ``count`` finite values, none below ``least``."""
    if len(values) != count:
        raise InputError(where, f"{count} values, one per entry of its axis", str(len(values)))
    for index, value in enumerate(values):
        if not math.isfinite(value) or value < least:
            raise InputError(f"{where}[{index}]", f"a number of at least {least:g}", repr(value))


def grid(
    where: str, rows: Sequence[Sequence[float]], row_count: int, column_count: int, least: float
) -> None:
    """Raise :class:`InputError` unless ``rows`` is a full table of numbers, none below ``least``."""
    if len(rows) != row_count:
        raise InputError(
            where, f"{row_count} rows, one per entry of the first axis", str(len(rows))
        )
    for index, row in enumerate(rows):
        column(f"{where}[{index}]", row, column_count, least)
