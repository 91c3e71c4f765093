"""What the numbers, quantities, names and expressions of a scenario mean, parameters included."""

from __future__ import annotations

import contextlib
import keyword
import re
from collections.abc import Iterator, Mapping

from hev_can_emu.scenario.columns import Columns
from hev_can_emu.scenario.expectation_schema import Value
from hev_can_emu.scenario.expression import Expression
from hev_can_emu.scenario.expression_compiler import (
    RESERVED,
    Scope,
    compile_condition,
    compile_expression,
)
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.quantities import Parameter
from hev_can_emu.scenario.sources import Sources
from hev_can_emu.units import parse_quantity, unit

_WORD = re.compile(r"\w+")


class Values:
    """Reads values against a network.

    Raises (here and in every method):
        InputError: what is written at the place cannot be read, or does not fit.
    """

    def __init__(self, sources: Sources, parameters: Mapping[str, Value], place: Place) -> None:
        self.signals = sources.signals
        self.parameters: dict[str, Parameter] = {}
        self.scope = Scope(sources, self.parameters, Columns())
        for name, value in parameters.items():
            self.parameters[name] = self._parameter(name, value, place / name)
        self.unused = set(self.parameters)  #: parameters that nothing has asked for yet

    def _parameter(self, name: str, value: Value, place: Place) -> Parameter:
        if not name.isidentifier() or keyword.iskeyword(name):
            raise place.refuse("a name of letters, digits and _", f"'{name}'")
        if name in RESERVED:
            raise place.refuse("a name of its own", f"'{name}'", "expressions have a word for this")
        if self.signals.find(name) is not None:
            raise place.refuse("a name of its own", f"'{name}'", "a signal is called so")
        if isinstance(value, bool):
            raise place.refuse("a number or quantity", str(value).lower())
        if not isinstance(value, str):
            return Parameter(float(value), "")
        quantity = parse_quantity(value, str(place))
        own = unit(quantity.unit)
        return Parameter(float(f"{own.from_si(quantity.si_value):.15g}"), quantity.unit)

    @contextlib.contextmanager
    def given(self, values: Mapping[str, Value], place: Place, check_use: bool) -> Iterator[None]:
        """Let more names stand for values meanwhile; with ``check_use`` each must be used."""
        for name, value in values.items():
            if name in self.parameters:
                got = f"'{name}'"
                raise (place / name).refuse("a name of its own", got, "a parameter is called so")
            self.parameters[name] = self._parameter(name, value, place / name)
            self.unused.add(name)
        try:
            yield
        finally:
            unused = self.unused & set(values)
            for name in values:
                del self.parameters[name]
            self.unused -= set(values)
        if check_use and unused:
            name = min(unused)
            raise (place / name).refuse("a name in use", f"'{name}'", "remove it")

    def resolve(self, value: Value) -> Value:
        """Return a parameter's quantity where ``value`` is its name."""
        if isinstance(value, str) and value in self.parameters:
            self.unused.discard(value)
            parameter = self.parameters[value]
            return f"{parameter.value!r} {parameter.unit}" if parameter.unit else parameter.value
        return value

    def si(self, value: Value, expect: str, place: Place) -> float:
        """Return a quantity of the kind ``expect`` in SI; 0 needs no unit."""
        value = self.resolve(value)
        if value == 0 and not isinstance(value, bool):
            return 0.0
        text = str(value).lower() if isinstance(value, bool) else str(value)
        return parse_quantity(text, str(place), expect).si_value

    def time(self, value: Value, place: Place) -> int:
        """Return a time in ns, rounded."""
        seconds = self.si(value, "s", place)
        if not 0.0 <= seconds < 1e9:
            raise place.refuse("a time of 0 s or more", f"'{value}'")
        return round(seconds * 1e9)

    def difference(self, value: Value, own: str, place: Place) -> float:
        """Return a band, tolerance or amplitude, counted in the unit ``own``."""
        value = self.resolve(value)
        if isinstance(value, bool):
            raise place.refuse("a number", str(value).lower())
        if not isinstance(value, str):
            result = float(value)
        else:
            quantity = parse_quantity(value, str(place), own)
            size = quantity.si_value - unit(quantity.unit).offset
            result = float(f"{size / unit(own).gain:.12g}")
        if result < 0.0:
            raise place.refuse("a number of 0 or more", f"{value}")
        return result

    def of(self, expression: Expression, value: Value, place: Place) -> float:
        """Return a value with which ``expression`` is compared, in its unit."""
        value = self.resolve(value)
        if expression.signal is not None:
            return expression.signal.parse(value, place)
        if isinstance(value, bool):
            raise place.refuse("a number", str(value).lower())
        if not isinstance(value, str):
            return float(value)
        own = expression.unit_name
        quantity = parse_quantity(value, str(place), own)
        return float(f"{unit(own).from_si(quantity.si_value):.12g}")

    def expression(self, text: str, place: Place) -> Expression:
        """Return ``text`` compiled, which must be a number."""
        self._note(text)
        expression = compile_expression(text, self.scope, place)
        if expression.boolean:
            raise place.refuse("a number", f"the condition '{text}'")
        return expression

    def condition(self, text: str, place: Place) -> Expression:
        """Return ``text`` compiled, which must be a condition."""
        self._note(text)
        return compile_condition(text, self.scope, place)

    def _note(self, text: str) -> None:
        self.unused.difference_update(_WORD.findall(text))
