"""The vehicle file, read by itself: values in SI, by the names that the file gives them."""

from __future__ import annotations

import bisect
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

# Factor and offset to SI of every unit that the vehicle file uses.
UNITS: dict[str, tuple[float, float]] = {
    "1": (1.0, 0.0),
    "%": (0.01, 0.0),
    "rpm": (math.pi / 30.0, 0.0),
    "deg": (math.pi / 180.0, 0.0),
    "degC": (1.0, 273.15),
    "ms": (1e-3, 0.0),
    "us": (1e-6, 0.0),
    "mm": (1e-3, 0.0),
    "mm/s": (1e-3, 0.0),
    "mm^2": (1e-6, 0.0),
    "cm^2": (1e-4, 0.0),
    "cm^3": (1e-6, 0.0),
    "kW": (1e3, 0.0),
    "kN": (1e3, 0.0),
    "kPa": (1e3, 0.0),
    "MPa": (1e6, 0.0),
    "GPa": (1e9, 0.0),
    "bar": (1e5, 0.0),
    "mH": (1e-3, 0.0),
    "mOhm": (1e-3, 0.0),
    "mWb": (1e-3, 0.0),
    "kHz": (1e3, 0.0),
    "Ah": (3600.0, 0.0),
    "MJ/kg": (1e6, 0.0),
    "mF": (1e-3, 0.0),
    "mPa s": (1e-3, 0.0),
    "um": (1e-6, 0.0),
    "g": (1e-3, 0.0),
    "l/min": (1e-3 / 60.0, 0.0),
}
# Units that are SI already, whatever they are made of.
PLAIN = {
    "kg", "m", "s", "N", "Pa", "V", "A", "W", "J", "K", "H", "F", "Hz", "Ohm", "Wb", "rad",
}  # fmt: skip


def si(value: Any, unit: str) -> Any:
    """Return a number, or nested lists of numbers, in SI."""
    if isinstance(value, list):
        return [si(one, unit) for one in value]
    if unit in UNITS:
        factor, offset = UNITS[unit]
        return float(value) * factor + offset
    parts = unit.replace("(", " ").replace(")", " ").replace("/", " ").split()
    if all(part.partition("^")[0] in PLAIN for part in parts if part != "1"):
        return float(value)
    raise ValueError(f"no conversion of {unit!r} to SI")


class Values(dict[str, Any]):
    """Nested values by attribute."""

    def __init__(self, values: dict[str, Any]) -> None:
        super().__init__(values)
        self.__dict__ = self

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return the value of that name."""


def line(x: float, axis: list[float], values: list[float]) -> float:
    """Return the table at ``x``: straight between its points, level beyond them."""
    i = bisect.bisect_right(axis, x)
    if i == 0:
        return values[0]
    if i == len(axis):
        return values[-1]
    share = (x - axis[i - 1]) / (axis[i] - axis[i - 1])
    return values[i - 1] + share * (values[i] - values[i - 1])


def read(path: Path) -> Values:
    """Return what the file says, each ``{value, unit}`` as a number in SI."""

    def convert(node: Any) -> Any:
        if isinstance(node, dict):
            if "value" in node:
                return si(node["value"], node.get("unit", "1"))
            return Values({key: convert(one) for key, one in node.items()})
        return node

    loaded: Values = convert(yaml.safe_load(path.read_text(encoding="utf-8")))
    return loaded
