"""Profiles: a column of a CSV text over its column of times, as rows of seconds and values."""

from __future__ import annotations

import csv
import io
import math
import re

from hev_can_emu.errors import did_you_mean
from hev_can_emu.scenario import schema
from hev_can_emu.scenario.place import Place
from hev_can_emu.units import Unit, unit

MAX_ROWS = 1_000_000
_HEADER = re.compile(r"(?P<name>.*?)\s*\[(?P<unit>[^]]*)\]")


def read_profile(
    text: str, profile: schema.Profile, own: Unit, place: Place
) -> list[tuple[float, float]]:
    """Return time in s from the profile's first row on, and value in the unit ``own``.

    The header names each column, with its unit in brackets (``speed [km/h]``); without one, times are in s
    and values in ``own``.

    Raises:
        InputError: no such column, no number, a unit that does not fit, times that do not rise.
    """
    lines = csv.reader(io.StringIO(text))
    header = next(lines, [])
    file = profile.file
    time_at, time_unit = _column(header, profile.time, unit("s"), file, place / "time")
    value_at, value_unit = _column(header, profile.column, own, file, place / "column")
    rows: list[tuple[float, float]] = []
    for cells in lines:
        where = f"line {lines.line_num} of {file}"
        if not any(cell.strip() for cell in cells):
            continue
        t_s = time_unit.to_si(_number(cells, time_at, where, place / "time"))
        value = _number(cells, value_at, where, place / "column")
        if value_unit != own:
            value = float(f"{own.from_si(value_unit.to_si(value)):.12g}")
        if rows and t_s <= rows[-1][0]:
            raise (place / "time").refuse("times that rise", f"{t_s:g} s in {where}")
        rows.append((t_s, value))
        if len(rows) > MAX_ROWS:
            raise (place / "file").refuse(f"at most {MAX_ROWS} rows", "more")
    if not rows:
        raise (place / "file").refuse("rows of numbers below the header", f"none in '{file}'")
    return rows


def _column(
    header: list[str], name: str, default: Unit, file: str, place: Place
) -> tuple[int, Unit]:
    known: dict[str, tuple[int, str | None]] = {}
    for number, cell in enumerate(header):
        match = _HEADER.fullmatch(cell.strip())
        if match is None:
            known[cell.strip()] = number, None
        else:
            known[match["name"]] = number, match["unit"]
    if name not in known:
        hint = did_you_mean(name, known) or "columns: " + ", ".join(known)
        raise place.refuse(f"a column of {file}", f"'{name}'", hint)
    number, written = known[name]
    if written is None:
        return number, default
    found = unit(written, f"{place}: unit of '{name}' in {file}")
    if found.dimension != default.dimension:
        raise place.refuse(f"a column in {default.name}", f"'{written}' in {file}")
    return number, found


def _number(cells: list[str], at: int, where: str, place: Place) -> float:
    cell = cells[at].strip() if at < len(cells) else ""
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise place.refuse("a number", f"'{cell}' in {where}") from None
    return value
