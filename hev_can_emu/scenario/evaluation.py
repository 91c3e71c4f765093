"""What compiled expressions are made of: functions that never raise, and the step from text to code."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

Item = Callable[[int], float]
#: ``(values.item, seen_ns.item, t_s, since_step_s)`` to a number or a truth value
Function = Callable[[Item, Item, float, float], Any]


def _divide(a: float, b: float) -> float:
    return a / b if b else math.nan


def _power(a: float, b: float) -> float:
    try:
        result = a**b
    except (ZeroDivisionError, OverflowError):
        return math.nan
    return math.nan if isinstance(result, complex) else result


def _root(a: float) -> float:
    return math.sqrt(a) if a >= 0.0 else math.nan


def _sign(a: float) -> float:
    return a if a != a or a == 0.0 else math.copysign(1.0, a)


def _least(*values: float) -> float:
    return math.nan if any(value != value for value in values) else min(values)


def _greatest(*values: float) -> float:
    return math.nan if any(value != value for value in values) else max(values)


def _clip(value: float, low: float, high: float) -> float:
    return _greatest(low, _least(value, high))


def _equal(a: float, b: float) -> bool:
    return a == b or abs(a - b) <= 1e-9 * max(abs(a), abs(b))


def _unequal(a: float, b: float) -> bool:
    return a == a and b == b and not _equal(a, b)


def _age(t: float, seen_ns: float) -> float:
    return t - seen_ns * 1e-9 if seen_ns >= 0 else math.nan


_NAMESPACE = {
    "__builtins__": {},
    "abs": abs,
    "_divide": _divide,
    "_power": _power,
    "_root": _root,
    "_sign": _sign,
    "_least": _least,
    "_greatest": _greatest,
    "_clip": _clip,
    "_equal": _equal,
    "_unequal": _unequal,
    "_age": _age,
    "_nan": math.nan,
}


def literal(value: float) -> str:
    """Return a number as Python source."""
    return "_nan" if math.isnan(value) else f"({value!r})"


def build(source: str) -> Function:
    """Return the function behind the Python source that the compiler made."""
    code = compile(f"lambda item, seen, t, since_step: {source}", "<expression>", "eval")
    function: Function = eval(code, dict(_NAMESPACE))  # source made above of whitelisted parts only
    return function
