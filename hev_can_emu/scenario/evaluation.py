"""Expressions as code for a small stack machine, run over rows of what is seen.

One machine serves every use: a step's condition inside the compiled tick, a signal that follows an
expression, and an expectation over thousands of recorded ticks in one call.  A condition is 1.0 or
0.0; what is not available is NaN, satisfies no comparison and goes through every operation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import inner_kernel, kernel

Array = npt.NDArray[np.float64]
Op = tuple[int, float]  #: an operation and its operand: a number, or a column of the row
Code = Array  #: shape (operations, 2)

CONSTANT, COLUMN = 0, 1
NEGATE, ABSOLUTE, ROOT, SIGN, NOT, AVAILABLE = range(2, 8)
ADD, SUBTRACT, MULTIPLY, DIVIDE, POWER, LEAST, GREATEST = range(8, 15)
LESS, LESS_OR_EQUAL, EQUAL, SAME, UNEQUAL, AND, OR = range(15, 22)

STACK = 1024  #: values in flight at most


def build(ops: Iterable[Op]) -> Code:
    """Return code as the machine reads it."""
    return np.array(list(ops), dtype=np.float64).reshape(-1, 2)


def depth(code: Code) -> int:
    """Return how many values are in flight at most."""
    level = most = 0
    for operation in code[:, 0]:
        level += 1 if operation <= COLUMN else -1 if operation >= ADD else 0
        most = max(most, level)
    return most


@kernel
def evaluate(code: Code, row: Array, stack: Array) -> float:
    """Return the value of ``code`` over ``row``; never raises.

    Args:
        code: shape (n, 2), from :func:`build`.
        row: what its columns hold now.
        stack: scratch, at least :func:`depth` values.
    """
    top = 0
    for i in range(code.shape[0]):
        operation = int(code[i, 0])
        if operation == CONSTANT:
            stack[top] = code[i, 1]
            top += 1
        elif operation == COLUMN:
            stack[top] = row[int(code[i, 1])]
            top += 1
        elif operation < ADD:
            stack[top - 1] = _unary(operation, stack[top - 1])
        else:
            top -= 1
            stack[top - 1] = _binary(operation, stack[top - 1], stack[top])
    return float(stack[0])


@kernel
def _unary(operation: int, x: float) -> float:
    if operation == NEGATE:
        return -x
    if operation == ABSOLUTE:
        return abs(x)
    if operation == ROOT:
        return math.sqrt(x) if x >= 0.0 else math.nan
    if operation == SIGN:
        return x if x == 0.0 or math.isnan(x) else math.copysign(1.0, x)
    if operation == NOT:
        return 1.0 - x
    return 0.0 if math.isnan(x) else 1.0


@kernel
def _binary(operation: int, a: float, b: float) -> float:
    if operation == ADD:
        return a + b
    if operation == SUBTRACT:
        return a - b
    if operation == MULTIPLY:
        return a * b
    if operation == DIVIDE:
        return a / b if b != 0.0 else math.nan
    if operation == POWER:
        return _power(a, b)
    if operation == LEAST:
        return math.nan if math.isnan(a) or math.isnan(b) else min(a, b)
    if operation == GREATEST:
        return math.nan if math.isnan(a) or math.isnan(b) else max(a, b)
    if operation == AND:
        return a * b
    if operation == OR:
        return max(a, b)
    return 1.0 if _compares(operation, a, b) else 0.0


@kernel
def _power(a: float, b: float) -> float:
    if a == 0.0 and b < 0.0:
        return math.nan
    if a < 0.0 and b != np.floor(b):  # of infinity too, where Python's own floor raises
        return math.nan
    if a != 0.0 and a != 1.0 and a != -1.0 and abs(b) * abs(math.log(abs(a))) > 709.0:
        return math.nan  # would not fit
    return float(a**b)


@kernel
def _compares(operation: int, a: float, b: float) -> bool:
    if operation == LESS:
        return a < b
    if operation == LESS_OR_EQUAL:
        return a <= b
    if operation == SAME:
        return a == b
    near = a == b or abs(a - b) <= 1e-9 * max(abs(a), abs(b))
    if operation == EQUAL:
        return near
    return not (math.isnan(a) or math.isnan(b) or near)


@inner_kernel
def _many(code: Code, rows: Array, first: int, count: int, stack: Array) -> None:
    """Do what :func:`evaluate` does for ``count`` rows from ``first`` on; ``stack[0]`` has the values."""
    top = 0
    for i in range(code.shape[0]):
        operation = int(code[i, 0])
        if operation == CONSTANT:
            for n in range(count):
                stack[top, n] = code[i, 1]
            top += 1
            continue
        if operation == COLUMN:
            column = int(code[i, 1])
            for n in range(count):
                stack[top, n] = rows[first + n, column]
            top += 1
            continue
        if operation >= ADD:
            top -= 1
        left, right = stack[top - 1], stack[top]
        # The usual ones as loops that become vector instructions.
        if operation == ABSOLUTE:
            for n in range(count):
                left[n] = abs(left[n])
        elif operation == SUBTRACT:
            for n in range(count):
                left[n] -= right[n]
        elif operation == LESS:
            for n in range(count):
                left[n] = 1.0 if left[n] < right[n] else 0.0
        elif operation == LESS_OR_EQUAL:
            for n in range(count):
                left[n] = 1.0 if left[n] <= right[n] else 0.0
        elif operation < ADD:
            for n in range(count):
                left[n] = _unary(operation, left[n])
        else:
            for n in range(count):
                left[n] = _binary(operation, left[n], right[n])


@kernel
def evaluate_rows(code: Code, rows: Array, stack: Array, out: Array) -> int:
    """Write into ``out``, shape (n,), the value of ``code`` over each of ``rows``, shape (n, columns).

    ``stack`` is scratch, shape (at least :func:`depth` and one more, any number of rows taken at once).

    Returns:
        n.
    """
    done = 0
    while done < rows.shape[0]:
        count = min(stack.shape[1], rows.shape[0] - done)
        _many(code, rows, done, count, stack)
        for n in range(count):
            out[done + n] = stack[0, n]
        done += count
    return int(rows.shape[0])
