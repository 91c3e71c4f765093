from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenario_bench import EVENTS, TRUTHS

from hev_can_emu.errors import InputError
from hev_can_emu.scenario import columns as kinds
from hev_can_emu.scenario import evaluation as machine
from hev_can_emu.scenario.columns import Columns
from hev_can_emu.scenario.expression import Expression, over_rows
from hev_can_emu.scenario.expression_compiler import Scope, compile_expression
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.quantities import Parameter
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.scenario.sources import Sources

pytestmark = pytest.mark.kernels

NAN = math.nan
PARAMETERS = {
    "ratio": Parameter(9.0, ""),
    "rolling_radius": Parameter(0.3, "m"),
    "limit": Parameter(10.0, "m/s"),
}


def compiled(text: str, signals: Signals, columns: Columns | None = None) -> Expression:
    scope = Scope(Sources(signals, TRUTHS, EVENTS), PARAMETERS, columns or Columns())
    return compile_expression(text, scope, Place())


def row_of(columns: Columns, signals: Signals, t: float, since_step: float, **given: float) -> Any:
    """Return what the columns hold where only ``given`` signals were seen, at 0.5 s."""
    known = {}
    for name, number in given.items():
        signal = signals.find(name)
        assert signal is not None
        known[signal.index] = number
    row = []
    for kind, what, _ in columns.tables()[0]:
        fixed = {kinds.T: t, kinds.SINCE_STEP: since_step}
        number = known.get(int(what), NAN)
        row.append(fixed.get(kind, 0.5 if kind == kinds.SEEN and number == number else number))
    return np.array(row)


def value(text: str, signals: Signals, **given: float) -> Any:
    columns = Columns()
    expression = compiled(text, signals, columns)
    row = row_of(columns, signals, 2.0, 0.5, **given)
    found = expression.holds(row) if expression.boolean else expression.value(row)
    # Over many rows it is the same.
    many = expression.values(np.array([row, row]))
    assert np.array_equal(many, [float(found)] * 2, equal_nan=True)
    return found


@pytest.mark.parametrize(
    ("text", "given", "expected"),
    [
        ("1 + 2 * 3 ** 2 - -4 / 8", {}, 19.5),
        ("t + since_step", {}, 2.5),
        ("abs(-3) + min(4, 2, 3) + max(1, 5) + clip(9, 0, 1) + sqrt(16) + sign(-2)", {}, 14.0),
        ("WheelSpeedFL / 3.6 / rolling_radius * ratio", {"WheelSpeedFL": 36.0}, 300.0),
        ("MCU1_Status.EM1Speed", {"EM1Speed": 7.0}, 7.0),
        ("1e-3", {}, 0.001),
        ("VehicleSpeed > 20 km/h", {"VehicleSpeed": 20.5}, True),
        ("VehicleSpeed > 20 km/h", {"VehicleSpeed": 20.0}, False),
        ("VehicleSpeed >= 10 m/s", {"VehicleSpeed": 36.0}, True),
        ("10m/s<VehicleSpeed", {"VehicleSpeed": 36.5}, True),
        ("VehicleSpeed < limit", {"VehicleSpeed": 35.0}, True),
        ("VehicleSpeed < limit", {"VehicleSpeed": 37.0}, False),
        ("0 < VehicleSpeed <= 5 m/s", {"VehicleSpeed": 18.0}, True),
        ("0 < VehicleSpeed <= 5 m/s", {"VehicleSpeed": 0.0}, False),
        ("VehicleSpeed > 2 * 5 m/s", {"VehicleSpeed": 35.0}, False),
        ("VehicleSpeed - 5 m/s", {"VehicleSpeed": 20.0}, 2.0),
        ("EM1Speed > 100 1/min and EM1Speed < 1e3 rpm", {"EM1Speed": 500.0}, True),
        ("EM1Speed < 10.5 rad/s", {"EM1Speed": 100.0}, True),
        ("AcceleratorPedal == 0.3", {"AcceleratorPedal": 0.3}, True),
        ("AcceleratorPedal > 30 %", {"AcceleratorPedal": 31.0}, True),
        ("AcceleratorPedal == 0.1 + 0.2", {"AcceleratorPedal": 0.3}, True),
        ("MCU1_Status.Temperature > 300 K", {"MCU1_Status.Temperature": 26.8}, False),
        ("MCU1_Status.Temperature > 300 K", {"MCU1_Status.Temperature": 26.9}, True),
        (
            "MCU1_Status.Temperature > AmbientTemperature + 5 K",
            {"MCU1_Status.Temperature": 26.0, "AmbientTemperature": 20.0},
            True,
        ),
        ("EM1Speed / 2 rpm", {"EM1Speed": 6.0}, 3.0),
        ("min(VehicleSpeed, 5 m/s)", {"VehicleSpeed": 20.0}, 18.0),
        ("ClutchState == Locked", {"ClutchState": 2.0}, True),
        ("Locked != ClutchState", {"ClutchState": 2.0}, False),
        ("DrivingMode == 'Parallel G2'", {"DrivingMode": 3.0}, True),
        ("not ClutchState == Open", {"ClutchState": 1.0}, True),
        ("ClutchState == Open or EM1Speed > 1 rpm", {"ClutchState": 1.0, "EM1Speed": 2.0}, True),
        ("convert(VehicleSpeed, 'm/s')", {"VehicleSpeed": 36.0}, 10.0),
        ("quantity(ratio, 'rad/s') > 80 rpm", {}, True),
        ("number(VehicleSpeed) + 1 rpm", {"VehicleSpeed": 2.0}, 3.0),
        ("available(EM1Speed)", {}, False),
        ("available(EM1Speed)", {"EM1Speed": 0.0}, True),
        ("age(EM1Speed)", {"EM1Speed": 0.0}, 1.5),
        ("age(EM1Speed) > 1500 ms - 1 us", {"EM1Speed": 0.0}, True),
    ],
)
def test_values(text: str, given: dict[str, float], expected: Any, signals: Signals) -> None:
    found = value(text, signals, **given)
    assert found == pytest.approx(expected, rel=1e-12)
    assert type(found) is type(expected)


@pytest.mark.parametrize("mark", ["<", "<=", ">", ">=", "==", "!="])
def test_what_is_not_available_satisfies_no_comparison(mark: str, signals: Signals) -> None:
    assert value(f"EM1Speed {mark} 0", signals) is False
    assert value(f"EM1Speed {mark} EM2Speed", signals, EM2Speed=1.0) is False
    assert value(f"min(EM1Speed, 1) {mark} 1", signals) is False
    assert value(f"1 / EM1Speed {mark} 1", signals, EM1Speed=0.0) is False
    assert value(f"sqrt(EM1Speed) {mark} 1", signals, EM1Speed=-1.0) is False
    assert value(f"EM1Speed ** 0.5 {mark} 1", signals, EM1Speed=-1.0) is False


def test_huge_powers_give_no_traceback(signals: Signals) -> None:
    assert math.isnan(value("10 ** 10 ** 10", signals))
    assert math.isnan(value("0 ** -1", signals))


def test_margin_is_the_distance_to_failing_in_the_left_unit(signals: Signals) -> None:
    for text, margin in [
        ("VehicleSpeed < 10 m/s", 6.0),
        ("VehicleSpeed > 10 m/s", -6.0),
        ("20 < VehicleSpeed < 33", 3.0),
    ]:
        columns = Columns()
        expression = compiled(text, signals, columns)
        row = row_of(columns, signals, 0.0, 0.0, VehicleSpeed=30.0)
        assert expression.margin is not None
        assert expression.unit is not None
        assert over_rows(expression.margin, row[None, :])[0] == pytest.approx(margin)
        assert expression.unit.name == "km/h" or text.startswith("20 <")
    assert compiled("VehicleSpeed == 3", signals).margin is None
    assert compiled("VehicleSpeed > 3 and EM1Speed > 4", signals).margin is None


def test_observation_names_values_labels_and_units(signals: Signals) -> None:
    columns = Columns()
    text = "ClutchState == Open and EM1Speed > 3 or EM2Speed < 2"
    expression = compiled(text, signals, columns)
    row = row_of(columns, signals, 0.0, 0.0, ClutchState=1.0, EM1Speed=2.5)
    told = "ClutchState = Slipping, EM1Speed = 2.5 rpm, EM2Speed = not available"
    assert expression.observe(row) == told


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "VehicleSped > 3",
            "expected a signal or parameter, got 'VehicleSped' in 'VehicleSped > 3'; "
            "did you mean 'VehicleSpeed' or 'EM2Speed' or 'EM1Speed'?",
        ),
        (
            "Temperature > 3",
            "expected one signal, got 'Temperature' of 2 messages in 'Temperature > 3'; "
            "write 'MCU1_Status.Temperature' or 'MCU2_Status.Temperature'",
        ),
        (
            "MCU1_Status.EM2Speed > 3",
            "expected a signal or parameter, got 'MCU1_Status.EM2Speed' in "
            "'MCU1_Status.EM2Speed > 3'; did you mean 'MCU2_Status.EM2Speed' or "
            "'MCU1_Status.EM1Speed' or 'MCU1_Status.Temperature'?",
        ),
        (
            "ClutchState == Lockd",
            "expected a label of ClutchState, got 'Lockd' in 'ClutchState == Lockd'; "
            "did you mean 'Locked'?",
        ),
        (
            "EM2ControlMode == NotAvailable",
            "expected a value to compare with, got 'NotAvailable'; "
            "write 'not available(EM2ControlMode)'",
        ),
        (
            "VehicleSpeed > 3 rpm",
            "expected quantities of one kind, got km/h and rpm in 'VehicleSpeed > 3 rpm'",
        ),
        (
            "VehicleSpeed + EM1Speed",
            "expected quantities of one kind, got km/h and rpm in 'VehicleSpeed + EM1Speed'",
        ),
        ("VehicleSpeed > 3 kmh2x", "expected a unit, got 'kmh2x'; did you mean 'km/h'?"),
        ("EM1Speed = 3", "expected an expression, got 'EM1Speed = 3'; compare with '=='"),
        (
            "EM1Speed > 3 && t > 1",
            "expected an expression, got 'EM1Speed > 3 && t > 1'; write 'and', 'or', 'not'",
        ),
        ("EM1Speed >", "expected an expression, got 'EM1Speed >'"),
        ("", "expected an expression, got ''"),
        ("(" * 250, f"expected an expression, got '{'(' * 250}'"),
        (
            "foo(3)",
            "expected a function, got 'foo' in 'foo(3)'; known: abs, min, max, clip, sqrt, sign, "
            "convert, quantity, number, available, age, frame, event",
        ),
        ("clip(3)", "expected 3 arguments to clip, got 1 in 'clip(3)'"),
        ("abs(1 < 2)", "expected a number, got the condition '1 < 2'"),
        ("t and 3 > 2", "expected a condition, got 't'; compare it with something"),
        ("age(3)", "expected a signal, got '3' in age()"),
        ("convert(3, 'm')", "expected a quantity, got the plain number '3'; use quantity()"),
        (
            "Odd > 1",
            "unit of VEH_Driver.Odd: expected a unit, got 'furlong'",
        ),
        ("x" * 2001, "expected an expression of at most 2000 characters, got 2001 characters"),
    ],
)
def test_what_is_no_expression(text: str, message: str, signals: Signals) -> None:
    with pytest.raises(InputError) as caught:
        compiled(text, signals)
    assert str(caught.value) == f"$: {message}"


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "().__class__",
        "EM1Speed.real.imag",
        "[x for x in (1, 2)]",
        "lambda: 1",
        "f'{1}'",
        "EM1Speed[0]",
        "abs(x=3)",
        "(1).real",
        "1 if t > 1 else 2",
        "t // 2",
        "t in (1, 2)",
        "True",
        "item(3)",
        "_divide(1, 0)",
        "_quantity_0 + 1",
        "(y := 3)",
        "'text'",
        "1j",
        "await t",
        "min(*t, 3)",
    ],
)
def test_only_the_whitelist_compiles(text: str, signals: Signals) -> None:
    with pytest.raises(InputError):
        compiled(text, signals)


@given(
    st.text(st.sampled_from(list("tEM1 .()+-*/<>=!'\"_0e%andorjkmh[]{}:,&|^\n\\#@")), max_size=40)
)
def test_any_text_compiles_or_is_refused(text: str) -> None:
    columns = Columns()
    try:
        expression = compiled(text, Signals([]), columns)
    except InputError:
        return
    expression.value(np.ones(len(columns)))


def programs() -> st.SearchStrategy[list[tuple[int, float]]]:
    leaf = st.one_of(
        st.tuples(st.just(machine.CONSTANT), st.floats(-3.0, 3.0)),
        st.tuples(st.just(machine.COLUMN), st.integers(0, 2).map(float)),
    ).map(lambda op: [op])
    return st.recursive(
        leaf,
        lambda inner: st.one_of(
            st.builds(
                lambda x, op: [*x, (op, 0.0)], inner, st.integers(machine.NEGATE, machine.AVAILABLE)
            ),
            st.builds(
                lambda x, y, op: [*x, *y, (op, 0.0)],
                inner,
                inner,
                st.integers(machine.ADD, machine.OR),
            ),
        ),
        max_leaves=12,
    )


@given(program=programs(), count=st.sampled_from([1, 63, 64, 65, 200]), seed=st.integers(0, 99))
def test_many_rows_at_a_time_give_what_one_row_gives(
    program: list[tuple[int, float]], count: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    rows = random.choice([NAN, 0.0, -0.0, 1.0, 2.5, -1.5, math.inf], size=(count, 3))
    code, stack = machine.build(program), np.empty(machine.STACK)
    with np.errstate(all="ignore"):  # run as plain Python, NumPy warns where infinities meet
        expected = np.array([machine.evaluate(code, row, stack) for row in rows])
        found = over_rows(code, rows)
    assert np.array_equal(found, expected, equal_nan=True)
    assert np.array_equal(np.signbit(found), np.signbit(expected)) or np.isnan(expected).any()
