"""A compiled expression, and what it reads."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.native import native
from hev_can_emu.scenario.evaluation import STACK, Code, evaluate_rows
from hev_can_emu.scenario.signals import Signal
from hev_can_emu.units import Unit

Array = npt.NDArray[np.float64]

_STACK = np.empty((STACK + 1, 64))  # of so many rows at a time


class Read(NamedTuple):
    """One thing that an expression reads.

    Attributes:
        column: where in the row it stands.
        name: as a person calls it; ``source``: unmistakably, ``Message.Signal`` or ``truth.name``.
        say: puts a value into words.
    """

    column: int
    name: str
    source: str
    say: Callable[[float], str]


class Expression(NamedTuple):
    """A compiled expression.

    Attributes:
        text: as written.
        code: the value; 1.0 or 0.0 where ``boolean``.
        margin: distance by which a comparison holds (negative: fails), None where it has none.
        unit: of the value, or of the margin where ``boolean``; None for a plain number.
        reads: signals and truth that it reads, in the order of appearance.
        signal: the signal that it is, and nothing else.
    """

    text: str
    code: Code
    boolean: bool
    margin: Code | None
    unit: Unit | None
    reads: tuple[Read, ...]
    signal: Signal | None

    @property
    def unit_name(self) -> str:
        """The unit as text; empty for a plain number."""
        return "" if self.unit is None else self.unit.name

    def value(self, row: Array) -> float:
        """Return the value over a row of columns."""
        return single(self.code, row)

    def holds(self, row: Array) -> bool:
        """Return whether the condition holds."""
        return single(self.code, row) == 1.0

    def values(self, rows: Array) -> Array:
        """Return the value over each of ``rows``, shape (n, columns)."""
        return over_rows(self.code, rows)

    def observe(self, row: Array) -> str:
        """Return in words what is read."""
        return ", ".join(
            f"{each.name} = {each.say(float(row[each.column]))}" for each in self.reads
        )

    def available(self, rows: Array) -> npt.NDArray[np.bool_]:
        """Return for each of ``rows`` whether all that is read is available."""
        columns = [each.column for each in self.reads]
        return np.asarray(~np.isnan(rows[:, columns]).any(axis=1), dtype=np.bool_)


def single(code: Code, row: Array) -> float:
    """Return the value of ``code`` over one row."""
    return float(over_rows(code, row.reshape(1, -1))[0])


def over_rows(code: Code, rows: Array) -> Array:
    """Return the value of ``code`` over each of ``rows``."""
    out = np.empty(len(rows))
    native(evaluate_rows, code, rows, _STACK, out)
    return out
