"""Safe expressions over signals: ``ClutchState == Open and VehicleSpeed > 20 km/h``.

A signal stands for its value in the database's unit.  That unit is carried through additions,
scalings by literal numbers, ``min``, ``max``, ``clip`` and ``abs``; where two units meet in a comparison
or a sum, they must measure the same thing, and the right one is converted to the left one.  A
number without unit takes the unit of what it meets.  Other products are numbers without unit (no
unit algebra); quotients of like quantities are ratios.  ``convert(x, 'm/s')`` turns a quantity
into a unit, ``number(x)`` drops the unit, ``quantity(x, 'rad/s')`` gives a number one.

A value that is not available (NaN), a division by zero or a root of a negative number makes every
comparison that it enters false.  ``==`` allows one part in 1e9.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from hev_can_emu.errors import did_you_mean
from hev_can_emu.scenario.evaluation import Function, Item, build, literal
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.quantities import WORDS, Parameter, take_quantities
from hev_can_emu.scenario.signals import Signal, Signals
from hev_can_emu.units import Unit, unit

MAX_LENGTH = 2000


class Expression(NamedTuple):
    """A compiled expression.

    Attributes:
        text: as written.
        function: the value: float, or bool where ``boolean``.
        margin: distance by which a comparison holds (negative: fails), None where it has none.
        unit: of the value, or of the margin where ``boolean``; None for a plain number.
        signals: the signals that it reads, in the order of appearance.
    """

    text: str
    function: Function
    boolean: bool
    margin: Function | None
    unit: Unit | None
    signals: tuple[Signal, ...]

    @property
    def reads(self) -> tuple[str, ...]:
        """What it looks at, as ``Message.Signal``."""
        return tuple(f"{each.message}.{each.name}" for each in self.signals)

    def observe(self, item: Item) -> str:
        """Return the signals' present values in words."""
        return ", ".join(f"{each.name} = {each.say(item(each.index))}" for each in self.signals)


class _Code(NamedTuple):
    """Python source of a subexpression."""

    source: str
    boolean: bool = False
    unit: Unit | None = None
    plain: bool = False  #: made of bare numbers only, so that scaling by it keeps a unit
    code: bool = False  #: a label's value, which compares exactly
    signal: Signal | None = None
    margin: str | None = None


FUNCTIONS = {
    "abs": (1, 1),
    "min": (2, 8),
    "max": (2, 8),
    "clip": (3, 3),
    "sqrt": (1, 1),
    "sign": (1, 1),
    "convert": (2, 2),
    "quantity": (2, 2),
    "number": (1, 1),
    "available": (1, 1),
    "age": (1, 1),
}
#: Words that no parameter may be called.
RESERVED = frozenset({*FUNCTIONS, *WORDS, "t", "since_step", "end"})
_OPERATORS: dict[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}
_COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}


def compile_expression(
    text: str, signals: Signals, parameters: Mapping[str, Parameter], place: Place
) -> Expression:
    """Compile ``text`` once.

    Raises:
        InputError: not an expression, an unknown name, units that do not fit; told at ``place``.
    """
    return _Compiler(text, signals, parameters, place).compile()


def compile_condition(
    text: str, signals: Signals, parameters: Mapping[str, Parameter], place: Place
) -> Expression:
    """Compile ``text``, which must be a condition; errors as :func:`compile_expression`."""
    expression = compile_expression(text, signals, parameters, place)
    if not expression.boolean:
        raise place.refuse("a condition", f"'{text}'", "compare it with something")
    return expression


class _Compiler:
    def __init__(
        self, text: str, signals: Signals, parameters: Mapping[str, Parameter], place: Place
    ) -> None:
        self._text = text
        self._signals = signals
        self._parameters = parameters
        self._place = place
        self._quantities: dict[str, Parameter] = {}
        self._read: dict[int, Signal] = {}

    def compile(self) -> Expression:
        code = self._node(self._parse())
        return Expression(
            text=self._text,
            function=build(code.source),
            boolean=code.boolean,
            margin=None if code.margin is None else build(code.margin),
            unit=code.unit,
            signals=tuple(self._read.values()),
        )

    def _parse(self) -> ast.expr:
        if len(self._text) > MAX_LENGTH:
            got = f"{len(self._text)} characters"
            raise self._place.refuse(f"an expression of at most {MAX_LENGTH} characters", got)
        plain, self._quantities = take_quantities(" ".join(self._text.split()), self._place)
        try:
            return ast.parse(plain, mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            hint = ""
            if re.search(r"(?<![<>=!])=(?!=)", self._text):
                hint = "compare with '=='"
            elif "&" in self._text or "|" in self._text or "!" in self._text.replace("!=", ""):
                hint = "write 'and', 'or', 'not'"
            raise self._place.refuse("an expression", f"'{self._text}'", hint) from error

    def _node(self, node: ast.expr) -> _Code:
        match node:
            case ast.BoolOp():
                return self._logic(node)
            case ast.UnaryOp(op=ast.Not()):
                return _Code(f"(not {self._boolean(node.operand).source})", boolean=True)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd()):
                code = self._number(node.operand)
                mark = "-" if isinstance(node.op, ast.USub) else "+"
                return _Code(f"({mark}{code.source})", unit=code.unit, plain=code.plain)
            case ast.BinOp() if type(node.op) in _OPERATORS:
                return self._arithmetic(node)
            case ast.Compare():
                return self._comparison(node)
            case ast.Call(func=ast.Name(id=name), keywords=[]):
                return self._call(name, node.args)
            case ast.Constant(value=bool()):
                pass
            case ast.Constant(value=int() | float() as value):
                return _Code(literal(float(value)), plain=True)
            case ast.Name(id=name):
                return self._name(name)
            case ast.Attribute(value=ast.Name(id=message), attr=name):
                return self._name(f"{message}.{name}")
            case _:
                pass
        got = f"'{ast.unparse(node)}' in '{self._text}'"
        raise self._place.refuse("an expression of signals, numbers and functions", got)

    def _number(self, node: ast.expr) -> _Code:
        code = self._node(node)
        if code.boolean:
            raise self._place.refuse("a number", f"the condition '{ast.unparse(node)}'")
        return code

    def _boolean(self, node: ast.expr) -> _Code:
        code = self._node(node)
        if not code.boolean:
            got = f"'{ast.unparse(node)}'"
            raise self._place.refuse("a condition", got, "compare it with something")
        return code

    def _logic(self, node: ast.BoolOp) -> _Code:
        word = " and " if isinstance(node.op, ast.And) else " or "
        parts = [self._boolean(value).source for value in node.values]
        return _Code(f"({word.join(parts)})", boolean=True)

    def _name(self, name: str) -> _Code:
        if name in self._quantities:
            value, written = self._quantities[name]
            return _Code(literal(value), unit=unit(written))
        if name == "t" or name == "since_step":
            return _Code(name, unit=unit("s"))
        if name in self._parameters:
            parameter = self._parameters[name]
            own = unit(parameter.unit) if parameter.unit else None
            return _Code(literal(parameter.value), unit=own)
        signal = self._signals.find(name)
        if signal is None:
            others = [*self._parameters, *FUNCTIONS, "t", "since_step"]
            expected, got, hint = self._signals.complain(name, others)
            if expected == "a signal":
                expected = "a signal or parameter"
            raise self._place.refuse(expected, f"{got} in '{self._text}'", hint)
        self._read[signal.index] = signal
        own = signal.known_unit(self._place) if signal.unit else None
        return _Code(f"item({signal.index})", unit=own, signal=signal)

    def _arithmetic(self, node: ast.BinOp) -> _Code:
        left, right = self._number(node.left), self._number(node.right)
        mark = _OPERATORS[type(node.op)]
        both_plain = left.plain and right.plain
        if mark in "+-":
            common, source = self._bring(left, right, node, difference=True)
            return _Code(f"({left.source} {mark} {source})", unit=common, plain=both_plain)
        if mark == "*":
            scaled = left.unit if right.plain else right.unit if left.plain else None
            return _Code(f"({left.source} * {right.source})", unit=scaled, plain=both_plain)
        if mark == "/":
            if left.unit and right.unit and left.unit.dimension == right.unit.dimension:
                return _Code(f"_divide({left.source}, {_converted(right, left.unit)})")
            scaled = left.unit if right.plain else None
            return _Code(f"_divide({left.source}, {right.source})", unit=scaled, plain=both_plain)
        return _Code(f"_power({left.source}, {right.source})", plain=both_plain)

    def _bring(
        self, left: _Code, right: _Code, node: ast.expr, difference: bool = False
    ) -> tuple[Unit | None, str]:
        """Return the common unit of two operands and the right one's source in it."""
        if left.unit is None or right.unit is None:
            return left.unit or right.unit, right.source
        if left.unit.dimension != right.unit.dimension:
            got = f"{left.unit.name} and {right.unit.name} in '{self._text}'"
            raise self._place.refuse("quantities of one kind", got)
        if difference and left.unit.offset != right.unit.offset:
            # A temperature in degC plus a difference in K: only the size of the degree counts.
            return left.unit, f"({right.source} * {right.unit.gain / left.unit.gain!r})"
        return left.unit, _converted(right, left.unit)

    def _comparison(self, node: ast.Compare) -> _Code:
        operands = [node.left, *node.comparators]
        tests: list[str] = []
        margins: list[str] = []
        common: Unit | None = None
        for index, op in enumerate(node.ops):
            mark = _COMPARISONS.get(type(op))
            if mark is None:
                raise self._place.refuse("a comparison", f"'{self._text}'", "use < <= > >= == !=")
            left, right = self._pair(operands[index], operands[index + 1])
            shared, source = self._bring(left, right, node)
            if index == 0:
                common = shared
            if mark == "==" and (left.code or right.code):
                tests.append(f"{left.source} == {source}")
            elif mark == "==":
                tests.append(f"_equal({left.source}, {source})")
            elif mark == "!=":
                tests.append(f"_unequal({left.source}, {source})")
            else:
                tests.append(f"{left.source} {mark} {source}")
                low, high = (left.source, source) if "<" in mark else (source, left.source)
                margins.append(f"({high} - {low})")
        margin = None
        if len(margins) == len(tests):
            margin = margins[0] if len(margins) == 1 else f"_least({', '.join(margins)})"
        source = f"({' and '.join(tests)})"
        return _Code(source, boolean=True, unit=common, margin=margin)

    def _pair(self, left: ast.expr, right: ast.expr) -> tuple[_Code, _Code]:
        """Compile both sides; a label is looked up in the value table of the other side."""
        left_label, right_label = _label(left), _label(right)
        if right_label is not None and not self._is_known(right_label, right):
            first = self._number(left)
            return first, self._labelled(right_label, first, left)
        if left_label is not None and not self._is_known(left_label, left):
            second = self._number(right)
            return self._labelled(left_label, second, right), second
        first, second = self._number(left), self._number(right)
        # A label that is also a signal's or parameter's name means the label here.
        if first.signal is not None and right_label in first.signal.labels:
            second = self._labelled(str(right_label), first, left)
        elif second.signal is not None and left_label in second.signal.labels:
            first = self._labelled(str(left_label), second, right)
        return first, second

    def _is_known(self, name: str, node: ast.expr) -> bool:
        if not isinstance(node, ast.Name):
            return False
        special = name in self._quantities or name in ("t", "since_step")
        return special or name in self._parameters or self._signals.find(name) is not None

    def _labelled(self, label: str, code: _Code, node: ast.expr) -> _Code:
        if code.signal is None or not code.signal.labels:
            return self._name(label)
        if math.isnan(code.signal.labels.get(label, 0.0)):
            hint = f"write 'not available({code.signal.name})'"
            raise self._place.refuse("a value to compare with", f"'{label}'", hint)
        if label in code.signal.labels:
            return _Code(literal(code.signal.labels[label]), code=True)
        hint = did_you_mean(label, code.signal.labels) or "labels: " + ", ".join(code.signal.labels)
        raise self._place.refuse(
            f"a label of {code.signal.name}", f"'{label}' in '{self._text}'", hint
        )

    def _call(self, name: str, nodes: list[ast.expr]) -> _Code:
        if name not in FUNCTIONS:
            hint = did_you_mean(name, FUNCTIONS) or "known: " + ", ".join(FUNCTIONS)
            raise self._place.refuse("a function", f"'{name}' in '{self._text}'", hint)
        least, most = FUNCTIONS[name]
        if not least <= len(nodes) <= most:
            wanted = str(least) if least == most else f"{least} to {most}"
            expected = f"{wanted} arguments to {name}" if most > 1 else f"1 argument to {name}"
            raise self._place.refuse(expected, f"{len(nodes)} in '{self._text}'")
        if name in ("convert", "quantity"):
            return self._unit_call(name, nodes)
        codes = [self._number(node) for node in nodes]
        first = codes[0]
        if name in ("available", "age"):
            if first.signal is None:
                raise self._place.refuse("a signal", f"'{ast.unparse(nodes[0])}' in {name}()")
            if name == "age":
                return _Code(f"_age(t, seen({first.signal.index}))", unit=unit("s"))
            return _Code(f"({first.source} == {first.source})", boolean=True)
        if name == "number":
            return _Code(first.source)
        if name == "sqrt":
            return _Code(f"_root({first.source})")
        if name == "sign":
            return _Code(f"_sign({first.source})")
        if name == "abs":
            return _Code(f"abs({first.source})", unit=first.unit)
        leader = next((code for code in codes if code.unit is not None), first)
        sources = [self._bring(leader, code, nodes[0])[1] for code in codes]
        function = {"min": "_least", "max": "_greatest", "clip": "_clip"}[name]
        return _Code(f"{function}({', '.join(sources)})", unit=leader.unit)

    def _unit_call(self, name: str, nodes: list[ast.expr]) -> _Code:
        code = self._number(nodes[0])
        if not (isinstance(nodes[1], ast.Constant) and isinstance(nodes[1].value, str)):
            raise self._place.refuse(
                "a unit in quotes", f"'{ast.unparse(nodes[1])}' in '{self._text}'"
            )
        wanted = unit(nodes[1].value, str(self._place))
        if name == "quantity":
            if code.unit is not None:
                got = f"a quantity in {code.unit.name}"
                raise self._place.refuse("a plain number", got, "use convert(), or number() before")
            return _Code(code.source, unit=wanted)
        if code.unit is None:
            got = f"the plain number '{ast.unparse(nodes[0])}'"
            raise self._place.refuse("a quantity", got, "use quantity()")
        if code.unit.dimension != wanted.dimension:
            got = f"{code.unit.name} and {wanted.name} in '{self._text}'"
            raise self._place.refuse("quantities of one kind", got)
        return _Code(_converted(code, wanted), unit=wanted)


def _label(node: ast.expr) -> str | None:
    """Return the text of what could be a label: a bare name or a quoted text."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    return None


def _converted(code: _Code, wanted: Unit) -> str:
    have = code.unit
    if have is None or (have.gain == wanted.gain and have.offset == wanted.offset):
        return code.source
    gain = have.gain / wanted.gain
    offset = (have.offset - wanted.offset) / wanted.gain
    scaled = f"{code.source} * {gain!r}"
    return f"({scaled} + {offset!r})" if offset else f"({scaled})"
