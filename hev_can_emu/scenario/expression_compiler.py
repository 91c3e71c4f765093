"""Safe expressions over what is seen: ``ClutchState == Open and VehicleSpeed > 20 km/h``.

A signal stands for its value in the database's unit, ``truth.name`` for the plant's own value in SI.
The unit is carried through additions, scalings by literal numbers, ``min``, ``max``, ``clip`` and ``abs``;
where two units meet in a comparison or a sum, they must measure the same thing, and the right one
is converted to the left one.  A number without unit takes the unit of what it meets.  Other
products are numbers without unit (no unit algebra); quotients of like quantities are ratios.
``convert(x, 'm/s')`` turns a quantity into a unit, ``number(x)`` drops the unit, ``quantity(x, 'rad/s')``
gives a number one.

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
from hev_can_emu.scenario import evaluation as machine
from hev_can_emu.scenario.columns import FRAME, SEEN, SIGNAL, SINCE_STEP, TRUTH, Column, Columns, T
from hev_can_emu.scenario.evaluation import Op
from hev_can_emu.scenario.expression import Expression, Read
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.quantities import WORDS, Parameter, take_quantities
from hev_can_emu.scenario.signals import Signal
from hev_can_emu.scenario.sources import Sources
from hev_can_emu.units import Unit, unit

MAX_LENGTH = 2000


class Scope(NamedTuple):
    """What the names of an expression mean, and where the row's columns are numbered."""

    sources: Sources
    parameters: Mapping[str, Parameter]
    columns: Columns


class _Code(NamedTuple):
    """The operations of a subexpression."""

    ops: tuple[Op, ...]
    boolean: bool = False
    unit: Unit | None = None
    plain: bool = False  #: made of bare numbers only, so that scaling by it keeps a unit
    code: bool = False  #: a label's value, which compares exactly
    signal: Signal | None = None
    margin: tuple[Op, ...] | None = None


#: Name to least and greatest number of arguments.
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
    "frame": (1, 1),
    "event": (1, 2),
}
#: Words that no parameter may be called.
RESERVED = frozenset({*FUNCTIONS, *WORDS, "t", "since_step", "end", "truth"})
_OPERATORS: dict[type[ast.operator], int] = {
    ast.Add: machine.ADD,
    ast.Sub: machine.SUBTRACT,
    ast.Mult: machine.MULTIPLY,
    ast.Div: machine.DIVIDE,
    ast.Pow: machine.POWER,
}
_COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}
_UNARY = {"abs": machine.ABSOLUTE, "sqrt": machine.ROOT, "sign": machine.SIGN}
_TIMES = {"t": Column(T), "since_step": Column(SINCE_STEP)}


def compile_expression(text: str, scope: Scope, place: Place) -> Expression:
    """Compile ``text`` once.

    Raises:
        InputError: not an expression, an unknown name, units that do not fit; told at ``place``.
    """
    return _Compiler(text, scope, place).compile()


def compile_condition(text: str, scope: Scope, place: Place) -> Expression:
    """Compile ``text``, which must be a condition; errors as :func:`compile_expression`."""
    expression = compile_expression(text, scope, place)
    if not expression.boolean:
        raise place.refuse("a condition", f"'{text}'", "compare it with something")
    return expression


class _Compiler:
    def __init__(self, text: str, scope: Scope, place: Place) -> None:
        self._text = text
        self._sources, self._parameters, self._columns = scope
        self._signals = self._sources.signals
        self._place = place
        self._quantities: dict[str, Parameter] = {}
        self._reads: dict[int, Read] = {}

    def compile(self) -> Expression:
        code = self._node(self._parse())
        built = machine.build(code.ops)
        margin = None if code.margin is None else machine.build(code.margin)
        for each in (built, margin):
            if each is not None and machine.depth(each) > machine.STACK:
                raise self._place.refuse("a flatter expression", f"'{self._text}'")
        reads = tuple(self._reads.values())
        return Expression(self._text, built, code.boolean, margin, code.unit, reads, code.signal)

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
                return _Code((*self._boolean(node.operand).ops, (machine.NOT, 0.0)), boolean=True)
            case ast.UnaryOp(op=ast.UAdd()):
                return self._number(node.operand)._replace(signal=None)
            case ast.UnaryOp(op=ast.USub()):
                code = self._number(node.operand)
                return _Code((*code.ops, (machine.NEGATE, 0.0)), unit=code.unit, plain=code.plain)
            case ast.BinOp() if type(node.op) in _OPERATORS:
                return self._arithmetic(node)
            case ast.Compare():
                return self._comparison(node)
            case ast.Call(func=ast.Name(id=name), keywords=[]):
                return self._call(name, node.args)
            case ast.Constant(value=bool()):
                pass
            case ast.Constant(value=int() | float() as value):
                return _Code(_literal(float(value)), plain=True)
            case ast.Name(id=name):
                return self._name(name)
            case ast.Attribute(value=ast.Name(id="truth"), attr=name):
                return self._truth(name)
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
        word = machine.AND if isinstance(node.op, ast.And) else machine.OR
        return _Code(
            _folded(word, [self._boolean(value).ops for value in node.values]), boolean=True
        )

    # Names

    def _name(self, name: str) -> _Code:
        if name in self._quantities:
            value, written = self._quantities[name]
            return _Code(_literal(value), unit=unit(written))
        if name in _TIMES:
            return _Code(self._column(_TIMES[name]), unit=unit("s"))
        if name in self._parameters:
            parameter = self._parameters[name]
            own = unit(parameter.unit) if parameter.unit else None
            return _Code(_literal(parameter.value), unit=own)
        signal = self._signals.find(name)
        if signal is None:
            others = [*self._parameters, *FUNCTIONS, *_TIMES]
            expected, got, hint = self._signals.complain(name, others)
            if expected == "a signal":
                expected = "a signal or parameter"
            raise self._place.refuse(expected, f"{got} in '{self._text}'", hint)
        own = signal.known_unit(self._place) if signal.unit else None
        ops = self._column(Column(SIGNAL, signal.index))
        number = int(ops[0][1])
        source = f"{signal.message}.{signal.name}"
        self._reads[number] = Read(number, signal.name, source, signal.say)
        return _Code(ops, unit=own, signal=signal)

    def _truth(self, name: str) -> _Code:
        truth = self._sources.truth(name, self._text, self._place)
        ops = self._column(Column(TRUTH, truth.place))
        number = int(ops[0][1])
        shown = "" if truth.unit is None else truth.unit.name

        def say(value: float) -> str:
            return f"{value:.6g} {shown}".strip()

        self._reads[number] = Read(number, f"truth.{name}", f"truth.{name}", say)
        return _Code(ops, unit=truth.unit)

    def _column(self, column: Column) -> tuple[Op, ...]:
        return ((machine.COLUMN, float(self._columns.number(column))),)

    # Arithmetic and comparisons

    def _arithmetic(self, node: ast.BinOp) -> _Code:
        left, right = self._number(node.left), self._number(node.right)
        operation = _OPERATORS[type(node.op)]
        both_plain = left.plain and right.plain
        common: Unit | None = None
        second = right.ops
        if operation in (machine.ADD, machine.SUBTRACT):
            common, second = self._bring(left, right, difference=True)
        elif operation == machine.MULTIPLY:
            common = left.unit if right.plain else right.unit if left.plain else None
        elif operation == machine.DIVIDE:
            if left.unit and right.unit and left.unit.dimension == right.unit.dimension:
                second = _converted(right, left.unit)
            elif right.plain:
                common = left.unit
        return _Code((*left.ops, *second, (operation, 0.0)), unit=common, plain=both_plain)

    def _bring(
        self, left: _Code, right: _Code, difference: bool = False
    ) -> tuple[Unit | None, tuple[Op, ...]]:
        """Return the common unit of two operands and the right one's operations in it."""
        if left.unit is None or right.unit is None:
            return left.unit or right.unit, right.ops
        if left.unit.dimension != right.unit.dimension:
            got = f"{left.unit.name} and {right.unit.name} in '{self._text}'"
            raise self._place.refuse("quantities of one kind", got)
        if difference and left.unit.offset != right.unit.offset:
            # A temperature in degC plus a difference in K: only the size of the degree counts.
            return left.unit, _scaled(right.ops, right.unit.gain / left.unit.gain)
        return left.unit, _converted(right, left.unit)

    def _comparison(self, node: ast.Compare) -> _Code:
        operands = [node.left, *node.comparators]
        tests: list[tuple[Op, ...]] = []
        margins: list[tuple[Op, ...]] = []
        common: Unit | None = None
        for index, op in enumerate(node.ops):
            mark = _COMPARISONS.get(type(op))
            if mark is None:
                raise self._place.refuse("a comparison", f"'{self._text}'", "use < <= > >= == !=")
            left, right = self._pair(operands[index], operands[index + 1])
            shared, second = self._bring(left, right)
            if index == 0:
                common = shared
            if mark in ("==", "!="):
                exact = left.code or right.code
                equal = machine.SAME if exact else machine.EQUAL
                operation = equal if mark == "==" else machine.UNEQUAL
                tests.append((*left.ops, *second, (operation, 0.0)))
                continue
            low, high = (left.ops, second) if "<" in mark else (second, left.ops)
            operation = machine.LESS_OR_EQUAL if "=" in mark else machine.LESS
            tests.append((*low, *high, (operation, 0.0)))
            margins.append((*high, *low, (machine.SUBTRACT, 0.0)))
        margin = _folded(machine.LEAST, margins) if len(margins) == len(tests) else None
        return _Code(_folded(machine.AND, tests), boolean=True, unit=common, margin=margin)

    def _pair(self, left: ast.expr, right: ast.expr) -> tuple[_Code, _Code]:
        """Compile both sides; a label is looked up in the value table of the other side."""
        left_label, right_label = _label(left), _label(right)
        if right_label is not None and not self._is_known(right_label, right):
            first = self._number(left)
            return first, self._labelled(right_label, first)
        if left_label is not None and not self._is_known(left_label, left):
            second = self._number(right)
            return self._labelled(left_label, second), second
        first, second = self._number(left), self._number(right)
        # A label that is also a signal's or parameter's name means the label here.
        if first.signal is not None and right_label in first.signal.labels:
            second = self._labelled(str(right_label), first)
        elif second.signal is not None and left_label in second.signal.labels:
            first = self._labelled(str(left_label), second)
        return first, second

    def _is_known(self, name: str, node: ast.expr) -> bool:
        if not isinstance(node, ast.Name):
            return False
        special = name in self._quantities or name in _TIMES
        return special or name in self._parameters or self._signals.find(name) is not None

    def _labelled(self, label: str, code: _Code) -> _Code:
        if code.signal is None or not code.signal.labels:
            return self._name(label)
        if math.isnan(code.signal.labels.get(label, 0.0)):
            hint = f"write 'not available({code.signal.name})'"
            raise self._place.refuse("a value to compare with", f"'{label}'", hint)
        if label in code.signal.labels:
            return _Code(_literal(code.signal.labels[label]), code=True)
        hint = did_you_mean(label, code.signal.labels) or "labels: " + ", ".join(code.signal.labels)
        raise self._place.refuse(
            f"a label of {code.signal.name}", f"'{label}' in '{self._text}'", hint
        )

    # Functions

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
        if name in ("frame", "event"):
            return self._happening(name, nodes)
        codes = [self._number(node) for node in nodes]
        first = codes[0]
        if name in ("available", "age"):
            return self._reception(name, first, nodes[0])
        if name == "number":
            return _Code(first.ops)
        if name in _UNARY:
            own = first.unit if name == "abs" else None
            return _Code((*first.ops, (_UNARY[name], 0.0)), unit=own)
        leader = next((code for code in codes if code.unit is not None), first)
        brought = [self._bring(leader, code)[1] for code in codes]
        if name == "clip":
            value, low, high = brought
            ops = _folded(machine.GREATEST, [low, _folded(machine.LEAST, [value, high])])
        else:
            ops = _folded(machine.LEAST if name == "min" else machine.GREATEST, brought)
        return _Code(ops, unit=leader.unit)

    def _reception(self, name: str, code: _Code, node: ast.expr) -> _Code:
        if code.signal is None:
            raise self._place.refuse("a signal", f"'{ast.unparse(node)}' in {name}()")
        if name == "available":
            return _Code((*code.ops, (machine.AVAILABLE, 0.0)), boolean=True)
        now, seen = self._column(Column(T)), self._column(Column(SEEN, code.signal.index))
        return _Code((*now, *seen, (machine.SUBTRACT, 0.0)), unit=unit("s"))

    def _happening(self, name: str, nodes: list[ast.expr]) -> _Code:
        words = [_label(node) for node in nodes]
        for word, node in zip(words, nodes, strict=True):
            if word is None:
                raise self._place.refuse("a name", f"'{ast.unparse(node)}' in {name}()")
        if name == "frame":
            message = self._signals.require_message(str(words[0]), self._place)
            first = self._signals.first_signal(message)
            if first < 0:
                raise self._place.refuse("a message with signals", f"'{message}' in frame()")
            column = Column(FRAME, first)
        else:
            what = str(words[1]) if len(words) > 1 else None
            column = self._sources.event(str(words[0]), what, self._text, self._place)
        return _Code(self._column(column), boolean=True)

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
            return _Code(code.ops, unit=wanted)
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


def _literal(value: float) -> tuple[Op, ...]:
    return ((machine.CONSTANT, value),)


def _folded(operation: int, parts: list[tuple[Op, ...]]) -> tuple[Op, ...]:
    """Return ``parts`` joined pairwise, from the left."""
    ops = list(parts[0])
    for part in parts[1:]:
        ops += [*part, (operation, 0.0)]
    return tuple(ops)


def _scaled(ops: tuple[Op, ...], gain: float) -> tuple[Op, ...]:
    return (*ops, (machine.CONSTANT, gain), (machine.MULTIPLY, 0.0))


def _converted(code: _Code, wanted: Unit) -> tuple[Op, ...]:
    have = code.unit
    if have is None or (have.gain == wanted.gain and have.offset == wanted.offset):
        return code.ops
    scaled = _scaled(code.ops, have.gain / wanted.gain)
    offset = (have.offset - wanted.offset) / wanted.gain
    return (*scaled, (machine.CONSTANT, offset), (machine.ADD, 0.0)) if offset else scaled
