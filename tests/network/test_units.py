"""Units as DBCs and people write them."""

from __future__ import annotations

import math

import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.units import parse_quantity, same_dimension, unit

RPM = math.pi / 30.0


@pytest.mark.parametrize(
    ("text", "dimension", "gain", "offset"),
    [
        *[(text, "N m", 1.0, 0.0) for text in ("Nm", "N*m", "N m", "N·m", "J", "W s")],
        *[(text, "rad/s", RPM, 0.0) for text in ("rpm", "1/min", "U/min", "min-1", "rev/min")],
        *[(text, "rad/s", RPM, 0.0) for text in ("r/min", "RPM", "min⁻¹")],
        *[(text, "m/s", 1 / 3.6, 0.0) for text in ("km/h", "kph", "Km/h")],
        *[(text, "K", 1.0, 273.15) for text in ("degC", "°C", "C", "Â°C")],
        *[(text, "1", 1.0, 0.0) for text in ("", "-", "1")],
        *[(text, "m/s^2", 1.0, 0.0) for text in ("m/s^2", "m/s2", "m/s²", "m/s/s", "m s-2")],
        *[(text, "kg m^2", 1.0, 0.0) for text in ("kg m^2", "kgm2", "kg*m^2", "kgm²")],
        *[(text, "N m s/rad", 1.0, 0.0) for text in ("N m s/rad", "Nms/rad", "N*m*s/rad")],
        *[(text, "N m/rad", 1.0, 0.0) for text in ("N m/rad", "Nm/rad")],
        *[(text, "Ohm", 1.0, 0.0) for text in ("Ohm", "ohm", "Ω", "V/A")],
        *[(text, "N m", 1.0, 0.0) for text in ("N.m", "N-m", "NM")],
        *[(text, "rad/s", RPM, 0.0) for text in ("Rpm", "upm", "/min")],
        *[(text, "m/s", 1 / 3.6, 0.0) for text in ("kmph", "KPH", "kmh", "km/hr")],
        *[(text, "1", 0.01, 0.0) for text in ("Percent", "pct", "percent")],
        *[(text, "1", 1.0, 0.0) for text in ("unitless", "none", "bit", "counts", "enum")],
        *[(text, "K", 1.0, 273.15) for text in ("deg_C", "Deg C", "Celsius")],
        *[(text, "rad/s", math.pi / 180, 0.0) for text in ("°/sec", "deg/sec")],
        *[(text, "V", 1.0, 0.0) for text in ("Volt", "Volts")],
        *[("Ampere", "A", 1.0, 0.0), ("Kelvin", "K", 1.0, 0.0), ("Ohms", "Ohm", 1.0, 0.0)],
        *[("PS", "W", 735.49875, 0.0), ("hp", "W", 745.69987158227022, 0.0)],
        *[("kVA", "W", 1000.0, 0.0), ("hPa", "Pa", 100.0, 0.0), ("KW", "W", 1000.0, 0.0)],
        *[("lb-ft", "N m", 4.4482216152605 * 0.3048, 0.0), ("day", "s", 86400.0, 0.0)],
        ("g", "m/s^2", 9.80665, 0.0),
        ("g/s", "N s/m", 1e-3, 0.0),
        ("%", "1", 0.01, 0.0),
        ("mph", "m/s", 0.44704, 0.0),
        ("K", "K", 1.0, 0.0),
        ("kW", "W", 1000.0, 0.0),
        ("kWh", "N m", 3.6e6, 0.0),
        ("kN", "N", 1000.0, 0.0),
        ("kNm", "N m", 1000.0, 0.0),
        ("mm", "m", 1e-3, 0.0),
        ("ms", "s", 1e-3, 0.0),
        ("us", "s", 1e-6, 0.0),
        ("µs", "s", 1e-6, 0.0),
        ("min", "s", 60.0, 0.0),
        ("bar", "Pa", 1e5, 0.0),
        ("kg", "kg", 1.0, 0.0),
        ("g/kWh", "s^2/m^2", 1e-3 / 3.6e6, 0.0),
        ("N/m", "N/m", 1.0, 0.0),
        ("kN/mm", "N/m", 1e6, 0.0),
        ("N s/m", "N s/m", 1.0, 0.0),
        ("m^2", "m^2", 1.0, 0.0),
        ("l/min", "m^3/s", 1e-3 / 60, 0.0),
        ("mH", "H", 1e-3, 0.0),
        ("mOhm", "Ohm", 1e-3, 0.0),
        ("uF", "F", 1e-6, 0.0),
        ("Wb", "Wb", 1.0, 0.0),
        ("V s", "Wb", 1.0, 0.0),
        ("Hz", "1/s", 1.0, 0.0),
        ("1/K", "1/K", 1.0, 0.0),
        ("%/s", "1/s", 0.01, 0.0),
        ("deg/s", "rad/s", math.pi / 180, 0.0),
        ("°/s", "rad/s", math.pi / 180, 0.0),
        ("Ah", "s A", 3600.0, 0.0),
        ("kg/m^3", "kg/m^3", 1.0, 0.0),
        ("W/(m^2 K)", "kg/(s^3 K)", 1.0, 0.0),
        ("Pa s", "kg/(m s)", 1.0, 0.0),
    ],
)
def test_spellings(text: str, dimension: str, gain: float, offset: float) -> None:
    found = unit(text)
    assert found.name == text
    assert found.dimension == dimension
    assert found.gain == pytest.approx(gain, rel=1e-15)
    assert found.offset == offset


def test_small_prefixes_are_exact() -> None:
    assert unit("mm").gain == 0.001
    assert unit("kg").gain == 1.0
    assert unit("mm").to_si(7.0) == 7.0 * 0.001


def test_a_canonical_dimension_reads_back_as_itself() -> None:
    for text in ("N m s/rad", "g/kWh", "W/(m^2 K)", "Pa s", "Ah", "l/min", "kN/mm", "T", "Wh/km"):
        dimension = unit(text).dimension
        assert unit(dimension) == (dimension, dimension, 1.0, 0.0)


def test_angular_speed_is_no_frequency() -> None:
    assert not same_dimension("rpm", "Hz")
    assert not same_dimension("N m s", "N m s/rad")
    assert same_dimension("U/min", "deg/s")


def test_offset_goes_both_ways() -> None:
    assert unit("degF").to_si(212.0) == pytest.approx(373.15)
    assert unit("degC").from_si(unit("degC").to_si(-40.0)) == pytest.approx(-40.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Nmm", "a.dbc: expected a unit, got 'Nmm'; did you mean 'Nm'?"),
        ("rmp", "a.dbc: expected a unit, got 'rmp'; did you mean 'rpm'?"),
        ("furlong", "a.dbc: expected a unit, got 'furlong'"),
        ("W/m^2 K", "a.dbc: expected a unit, got 'W/m^2 K'; "
         "put the whole denominator in parentheses"),
        ("W/degC", "a.dbc: expected a unit, got 'W/degC'; 'degC' cannot be part of a product; "
         "write differences in K"),
        ("Nm^2", "a.dbc: expected a unit, got 'Nm^2'; "
         "write N m apart where one of them has a power"),
        ("m/", "a.dbc: expected a unit, got 'm/'; a symbol is missing at the end"),
        ("W/(m K", "a.dbc: expected a unit, got 'W/(m K'; a ')' is missing"),
        ("m)", "a.dbc: expected a unit, got 'm)'; a ')' is too many"),
        ("m//s", "a.dbc: expected a unit, got 'm//s'; a symbol is missing before '/'"),
        ("?", "a.dbc: expected a unit, got '?'"),
    ],
)  # fmt: skip
def test_unknown_units(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        unit(text, "a.dbc")
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("text", "value", "dimension"),
    [
        ("20 km/h", 20 / 3.6, "m/s"),
        ("20km/h", 20 / 3.6, "m/s"),
        ("-5 degC", 268.15, "K"),
        ("1e-3 m", 1e-3, "m"),
        (".5 %", 0.005, "1"),
        ("3000 1/min", 3000 * RPM, "rad/s"),
        (" 0.3 ", 0.3, "1"),
    ],
)
def test_quantities(text: str, value: float, dimension: str) -> None:
    found = parse_quantity(text, "here")
    assert found.si_value == pytest.approx(value, rel=1e-15)
    assert found.dimension == dimension


@pytest.mark.parametrize(
    ("text", "expect", "message"),
    [
        ("fast", "m/s", "here: expected a number with a unit such as '1 m/s', got 'fast'"),
        ("20", "m/s", "here: expected a number with a unit such as '1 m/s', got '20'; "
         "the unit does not fit"),
        ("1,5 m", "", "here: expected a unit, got ',5 m'"),
        ("1e999 m", "", "here: expected a number with a unit, got '1e999 m'"),
        ("nan m", "", "here: expected a number with a unit, got 'nan m'"),
        ("20 kmh/", "", "here: expected a unit, got 'kmh/'; a symbol is missing at the end"),
    ],
)  # fmt: skip
def test_unusable_quantities(text: str, expect: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_quantity(text, "here", expect)
    assert str(caught.value) == message
