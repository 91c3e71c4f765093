"""Numbers with units inside an expression's text: ``20 km/h`` becomes a placeholder name."""

from __future__ import annotations

import re
from typing import NamedTuple

from hev_can_emu.errors import InputError
from hev_can_emu.scenario.place import Place
from hev_can_emu.units import unit


class Parameter(NamedTuple):
    """A named constant; ``unit`` is empty for a plain number."""

    value: float
    unit: str


_NUMBER = re.compile(r"(?<![\w.])(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_UNIT = re.compile(r"\s*(N m\b|1/[A-Za-z]+|[A-Za-zµμΩ°%‰][\w%]*(?:[·/][A-Za-z][\w]*)*)")
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
WORDS = {"and", "or", "not", "in", "is", "if", "else"}
_PLACEHOLDER = "_quantity_"


def take_quantities(text: str, place: Place) -> tuple[str, dict[str, Parameter]]:
    """Return ``text`` with a name in place of every number with a unit, and what the names mean.

    Raises:
        InputError: a number is followed by a word that is no unit.
    """
    quantities: dict[str, Parameter] = {}
    parts: list[str] = []
    position = 0
    quoted = [match.span() for match in _QUOTED.finditer(text)]
    for match in _NUMBER.finditer(text):
        inside = any(a <= match.start() < b for a, b in quoted)
        if match.start() < position or inside:
            continue
        found = _unit_at(text, match.end(), place)
        if found is None:
            continue
        name, end = found
        placeholder = f"{_PLACEHOLDER}{len(quantities)}"
        parts += [text[position : match.start()], placeholder]
        quantities[placeholder] = Parameter(float(match.group()), name)
        position = end
    return "".join(parts) + text[position:], quantities


def _unit_at(text: str, start: int, place: Place) -> tuple[str, int] | None:
    match = _UNIT.match(text, start)
    if match is None or match[1] in WORDS:
        return None
    name = match[1]
    while True:  # "3 Nm/ratio" is a torque divided by a parameter
        try:
            unit(name)
        except InputError:
            if "/" not in name:
                break
            name = name.rpartition("/")[0]
        else:
            return name, match.start(1) + len(name)
    raise place.refuse("a unit", f"'{match[1]}'", _unit_hint(match[1]))


def _unit_hint(name: str) -> str:
    try:
        unit(name)
    except InputError as error:
        return error.hint
    return ""
