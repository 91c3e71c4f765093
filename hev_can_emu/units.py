"""Units of measurement as DBC files and people write them, turned into SI.

``unit("km/h")`` knows that ``SI = 0.2777... * value``; ``parse_quantity("20 km/h", where)`` gives
5.555... m/s.  Spellings met in practice are understood (``Nm``, ``N*m``, ``N m``, ``N·m``; ``rpm``,
``1/min``, ``min-1``, ``U/min``); other units are products, powers and quotients of known symbols
(``kg m^2``, ``N m s/rad``, ``W/(m^2 K)``), with SI prefixes.

Angle counts as a dimension of its own, so that an angular speed (``rpm`` is ``rad/s``) is not
mistaken for a frequency (``Hz`` is ``1/s``).  Torque and energy, both ``N m``, are not told apart.
Two spellings have two meanings; alone they are read as buses use them: ``1/min`` is a
rotational speed, ``g`` is the standard acceleration of gravity.  Within a product
(``g/s``) ``g`` is the gram.

Conversion factors: BIPM, The International System of Units, 9th edition, 2019.
"""

from __future__ import annotations

import functools
import math
import re
import unicodedata
from typing import NamedTuple

from hev_can_emu.errors import InputError, did_you_mean

_BASE = ("kg", "m", "rad", "s", "A", "K")
_Powers = tuple[int, int, int, int, int, int]
_NONE: _Powers = (0, 0, 0, 0, 0, 0)


class Unit(NamedTuple):
    """A unit: ``SI = value * gain + offset``; ``dimension`` is the canonical SI unit's name."""

    name: str
    dimension: str
    gain: float
    offset: float

    def to_si(self, value: float) -> float:
        """Return ``value``, counted in this unit, in SI."""
        return value * self.gain + self.offset

    def from_si(self, value: float) -> float:
        """Return the SI ``value`` counted in this unit."""
        return (value - self.offset) / self.gain


class Quantity(NamedTuple):
    """A value with its unit, in SI; ``unit`` is the unit as it was written."""

    si_value: float
    dimension: str
    unit: str


class _Factor(NamedTuple):
    """A parsed symbol or product: powers of the base units, and the factor to SI."""

    powers: _Powers
    gain: float


_NEWTON: _Powers = (1, 1, 0, -2, 0, 0)
_JOULE: _Powers = (1, 2, 0, -2, 0, 0)
_WATT: _Powers = (1, 2, 0, -3, 0, 0)
_VOLT: _Powers = (1, 2, 0, -3, -1, 0)
_PASCAL: _Powers = (1, -1, 0, -2, 0, 0)
_OHM: _Powers = (1, 2, 0, -3, -2, 0)
_ANGLE: _Powers = (0, 0, 1, 0, 0, 0)
_TIME: _Powers = (0, 0, 0, 1, 0, 0)
_LENGTH: _Powers = (0, 1, 0, 0, 0, 0)
_SPEED: _Powers = (0, 1, 0, -1, 0, 0)

_PREFIXABLE: dict[str, _Factor] = {
    "g": _Factor((1, 0, 0, 0, 0, 0), 1e-3),
    "m": _Factor(_LENGTH, 1.0),
    "s": _Factor(_TIME, 1.0),
    "A": _Factor((0, 0, 0, 0, 1, 0), 1.0),
    "N": _Factor(_NEWTON, 1.0),
    "Nm": _Factor(_JOULE, 1.0),
    "J": _Factor(_JOULE, 1.0),
    "Wh": _Factor(_JOULE, 3600.0),
    "Ah": _Factor((0, 0, 0, 1, 1, 0), 3600.0),
    "W": _Factor(_WATT, 1.0),
    "V": _Factor(_VOLT, 1.0),
    "VA": _Factor(_WATT, 1.0),
    "Pa": _Factor(_PASCAL, 1.0),
    "bar": _Factor(_PASCAL, 1e5),
    "Hz": _Factor((0, 0, 0, -1, 0, 0), 1.0),
    "Ohm": _Factor(_OHM, 1.0),
    "F": _Factor((-1, -2, 0, 4, 2, 0), 1.0),
    "H": _Factor((1, 2, 0, -2, -2, 0), 1.0),
    "Wb": _Factor((1, 2, 0, -2, -1, 0), 1.0),
    "T": _Factor((1, 0, 0, -2, -1, 0), 1.0),
    "l": _Factor((0, 3, 0, 0, 0, 0), 1e-3),
    "L": _Factor((0, 3, 0, 0, 0, 0), 1e-3),
    "rad": _Factor(_ANGLE, 1.0),
    "K": _Factor((0, 0, 0, 0, 0, 1), 1.0),
}
_PREFIXES = {
    "n": 1e-9,
    "u": 1e-6,
    "m": 1e-3,
    "c": 1e-2,
    "d": 1e-1,
    "h": 1e2,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
}
_PLAIN: dict[str, _Factor] = {
    "%": _Factor(_NONE, 0.01),
    "percent": _Factor(_NONE, 0.01),
    "‰": _Factor(_NONE, 1e-3),
    "ppm": _Factor(_NONE, 1e-6),
    "min": _Factor(_TIME, 60.0),
    "h": _Factor(_TIME, 3600.0),
    "t": _Factor((1, 0, 0, 0, 0, 0), 1000.0),
    "deg": _Factor(_ANGLE, math.pi / 180.0),
    "rev": _Factor(_ANGLE, 2.0 * math.pi),
    "U": _Factor(_ANGLE, 2.0 * math.pi),
    "rpm": _Factor((0, 0, 1, -1, 0, 0), math.pi / 30.0),
    "kph": _Factor(_SPEED, 1.0 / 3.6),
    "kmh": _Factor(_SPEED, 1.0 / 3.6),
    "mph": _Factor(_SPEED, 0.44704),
    "Nms": _Factor((1, 2, 0, -1, 0, 0), 1.0),
    "mi": _Factor(_LENGTH, 1609.344),
    "ft": _Factor(_LENGTH, 0.3048),
    "in": _Factor(_LENGTH, 0.0254),
    "inch": _Factor(_LENGTH, 0.0254),
    "mile": _Factor(_LENGTH, 1609.344),
    "sec": _Factor(_TIME, 1.0),
    "day": _Factor(_TIME, 86400.0),
    "lbf": _Factor(_NEWTON, 4.4482216152605),
    "PS": _Factor(_WATT, 735.49875),
    "hp": _Factor(_WATT, 745.69987158227022),
    "Vs": _Factor((1, 2, 0, -2, -1, 0), 1.0),
    "psi": _Factor(_PASCAL, 6894.757293168),
}
#: Spellings of a whole unit that the grammar cannot read, or would read otherwise.
_SPELLINGS = {
    "": "1",
    "-": "1",
    "--": "1",
    "1/min": "rpm",
    "min-1": "rpm",
    "/min": "rpm",
    "r/min": "rpm",
    "RPM": "rpm",
    "km/hr": "km/h",
    "KPH": "kph",
    "Km/h": "km/h",
    "KM/H": "km/h",
    "MPH": "mph",
    "NM": "Nm",
    "kgm2": "kg m2",
    "C": "degC",
    "deg C": "degC",
    "DegC": "degC",
    "Celsius": "degC",
    "deg F": "degF",
    "Deg": "deg",
    "grad": "deg",
    "degree": "deg",
    "degrees": "deg",
    "Sec": "s",
    "deg_C": "degC",
    "Deg C": "degC",
    "N.m": "Nm",
    "N-m": "Nm",
    "lb-ft": "lbf ft",
    "lbft": "lbf ft",
    "ft-lb": "lbf ft",
    "mps": "m/s",
    "KW": "kW",
    "KWh": "kWh",
    "Bar": "bar",
    "G": "g",
    **dict.fromkeys(("Rpm", "upm", "Upm", "UPM"), "rpm"),
    **dict.fromkeys(("kmph", "Kmph", "KMPH", "km/H", "Kph"), "km/h"),
    **dict.fromkeys(("Percent", "pct", "Pct", "percentage"), "%"),
    **dict.fromkeys(("Volt", "Volts", "volt", "volts"), "V"),
    **dict.fromkeys(("Amp", "Amps", "amp", "amps", "Ampere", "ampere"), "A"),
    **dict.fromkeys(("Watt", "watt", "Watts"), "W"),
    **dict.fromkeys(("Ohms", "ohms"), "Ohm"),
    **dict.fromkeys(("Newton", "newton"), "N"),
    **dict.fromkeys(("Kelvin", "kelvin"), "K"),
    **dict.fromkeys(("second", "seconds", "Second", "Seconds"), "s"),
    **dict.fromkeys(("minute", "minutes", "Min"), "min"),
    **dict.fromkeys(("hour", "hours", "Hour"), "h"),
    **dict.fromkeys(("meter", "meters", "Meter", "metre"), "m"),
    # What a DBC calls a number without unit.
    **dict.fromkeys(
        ("unitless", "none", "None", "N/A", "bit", "bits", "Bit", "bool", "boolean"), "1"
    ),
    **dict.fromkeys(("enum", "count", "counts", "Count", "Counts", "cnt", "code"), "1"),
}
_AFFINE = {
    "degC": ("K", 1.0, 273.15),
    "degF": ("K", 5.0 / 9.0, 273.15 - 32.0 * 5.0 / 9.0),
    "g": ("m/s^2", 9.80665, 0.0),
}
#: Preferred names of dimensions; any other is spelled in base units.
_NAMED = ("N", "N m", "W", "V", "Ohm", "Pa", "N/m", "N s/m", "N m/rad", "N m s/rad", "F", "H", "Wb")
#: What a misspelt unit is compared with.
_FAMILIAR = (
    *("Nm", "rpm", "1/min", "rad/s", "km/h", "kph", "m/s", "mph", "degC", "K", "%", "V", "A", "kW"),
    *("W", "kWh", "J", "N", "kN", "m", "mm", "bar", "Pa", "s", "ms", "g", "m/s^2", "deg", "rad"),
    *("Ohm", "kg", "kg m^2", "N m/rad", "N m s/rad", "N/m", "N s/m", "l/min", "Hz", "1/K", "Ah"),
)
#: Applied after Unicode's compatibility normalization, which makes plain digits of superscripts.
_CHARACTERS = str.maketrans(
    {"·": "*", "⋅": "*", "×": "*", "μ": "u", "Ω": "Ohm", "−": "-", "°": "deg", "Â": ""}
)
_TOKEN = re.compile(
    r"\s*(?:(?P<symbol>[A-Za-z%‰]+)(?:(?:\^|\*\*)?(?P<power>-?\d+)|(?:\^|\*\*)\((?P<grouped>-?\d+)\))?"
    r"|(?P<one>1)(?![\d.])|(?P<mark>[*/()]))\s*"
)
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)


class _Unreadable(Exception):
    """The text is not a unit; the message is a hint."""


def _power(factor: _Factor, exponent: int) -> _Factor:
    kg, m, rad, s, ampere, kelvin = factor.powers
    n = exponent
    return _Factor((kg * n, m * n, rad * n, s * n, ampere * n, kelvin * n), factor.gain**n)


def _product(a: _Factor, b: _Factor) -> _Factor:
    p, q = a.powers, b.powers
    powers = (p[0] + q[0], p[1] + q[1], p[2] + q[2], p[3] + q[3], p[4] + q[4], p[5] + q[5])
    return _Factor(powers, a.gain * b.gain)


def _symbol(name: str) -> _Factor:
    if name in _PLAIN:
        return _PLAIN[name]
    if name in _PREFIXABLE:
        return _PREFIXABLE[name]
    stem = name[1:].replace("ohm", "Ohm")
    if name[0] in _PREFIXES and stem in _PREFIXABLE:
        base = _PREFIXABLE[stem]
        # Through the reciprocal where the prefix is small: 1 mm is 1/1000 m to the last bit.
        prefix = _PREFIXES[name[0]]
        gain = base.gain * prefix if prefix > 1.0 else base.gain / round(1.0 / prefix)
        if stem == "g" and prefix == 1e3:
            gain = 1.0
        return _Factor(base.powers, gain)
    if name in _AFFINE:
        raise _Unreadable(f"'{name}' cannot be part of a product; write differences in K")
    if name == "ohm":
        return _PREFIXABLE["Ohm"]
    raise _Unreadable("")


def _parse(text: str) -> _Factor:
    """Parse a product of symbols, ``text`` already translated to plain characters."""
    tokens: list[re.Match[str]] = []
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise _Unreadable("")
        tokens.append(match)
        position = match.end()
    factor, rest = _expression(tokens)
    if rest:
        raise _Unreadable("a ')' is too many")
    return factor


def _expression(tokens: list[re.Match[str]]) -> tuple[_Factor, list[re.Match[str]]]:
    result = _Factor(_NONE, 1.0)
    divide, divided, wanted = False, False, True
    while tokens:
        token, tokens = tokens[0], tokens[1:]
        mark = token["mark"]
        if mark == ")":
            tokens = [token, *tokens]
            break
        if mark in ("*", "/"):
            if wanted:
                raise _Unreadable(f"a symbol is missing before '{mark}'")
            divide, wanted = mark == "/", True
            continue
        if mark == "(":
            factor, tokens = _expression(tokens)
            if not tokens:
                raise _Unreadable("a ')' is missing")
            tokens = tokens[1:]
        elif token["one"]:
            factor = _Factor(_NONE, 1.0)
        else:
            exponent = token["power"] or token["grouped"]
            if exponent is not None and token["symbol"] in ("Nm", "Nms"):
                raise _Unreadable("write N m apart where one of them has a power")
            factor = _power(_symbol(token["symbol"]), int(exponent or 1))
        if divided and not divide:
            raise _Unreadable("put the whole denominator in parentheses")
        result = _product(result, _power(factor, -1) if divide else factor)
        divided = divided or divide
        divide, wanted = False, False
    if wanted:
        raise _Unreadable("a symbol is missing at the end")
    return result, tokens


@functools.cache
def _names() -> dict[_Powers, str]:
    return {_parse(name).powers: name for name in _NAMED} | {_NONE: "1"}


def _dimension(powers: _Powers) -> str:
    """Return the canonical SI unit: ``kg m^2``, ``rad/s``, ``kg/(m s)``."""
    if powers in _names():
        return _names()[powers]

    def spell(name: str, power: int) -> str:
        return name if power == 1 else f"{name}^{power}"

    over = [spell(name, n) for name, n in zip(_BASE, powers, strict=True) if n > 0]
    under = [spell(name, -n) for name, n in zip(_BASE, powers, strict=True) if n < 0]
    if not under:
        return " ".join(over)
    denominator = under[0] if len(under) == 1 else f"({' '.join(under)})"
    return f"{' '.join(over) or '1'}/{denominator}"


@functools.lru_cache(maxsize=1024)
def _unit(text: str) -> Unit:
    plain = unicodedata.normalize("NFKC", text).translate(_CHARACTERS)
    plain = " ".join(plain.replace("[", "").replace("]", "").split())
    plain = _SPELLINGS.get(plain, plain)
    if plain in _AFFINE:
        base, gain, offset = _AFFINE[plain]
        return Unit(text, _dimension(_parse(base).powers), gain, offset)
    factor = _parse(plain)
    return Unit(text, _dimension(factor.powers), factor.gain, 0.0)


def unit(text: str, where: str = "") -> Unit:
    """Return the unit that ``text`` names; an empty text is the number one.

    Raises:
        InputError: not a known unit; the message begins with ``where``.
    """
    try:
        return _unit(text)
    except _Unreadable as error:
        hint = str(error) or did_you_mean(text, _FAMILIAR, 1)
        raise InputError(where or "unit", "a unit", f"'{text}'", hint) from None


def same_dimension(a: str, b: str) -> bool:
    """Tell whether values in the units ``a`` and ``b`` can be converted into each other."""
    return unit(a).dimension == unit(b).dimension


def parse_quantity(text: str, where: str = "", expect: str = "") -> Quantity:
    """Return the quantity written as a number and a unit: ``"20 km/h"``, ``"-5 degC"``, ``"0.3"``.

    Args:
        text: a decimal number, then the unit; without a unit the quantity is a pure number.
        where: begins the error message.
        expect: a unit of the dimension that is wanted; empty accepts any.

    Raises:
        InputError: no number, an unknown unit, or not the dimension of ``expect``.
    """
    wanted = f"a number with a unit such as '1 {expect}'" if expect else "a number with a unit"
    match = _QUANTITY.fullmatch(text)
    if match is None or not math.isfinite(float(match[1])):
        raise InputError(where or "quantity", wanted, f"'{text}'")
    found = unit(match[2], where)
    if expect and found.dimension != unit(expect, where).dimension:
        raise InputError(where or "quantity", wanted, f"'{text.strip()}'", "the unit does not fit")
    return Quantity(found.to_si(float(match[1])), found.dimension, match[2])
