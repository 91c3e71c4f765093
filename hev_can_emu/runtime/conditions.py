"""Conditions in the scenario language, asked of a running car."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.sources import sources_of
from hev_can_emu.runtime.tick import TICK_NS
from hev_can_emu.scenario import columns
from hev_can_emu.scenario.expression import Expression
from hev_can_emu.scenario.expression_compiler import Scope, compile_condition, compile_expression
from hev_can_emu.scenario.place import Place


class Question:
    """An expression, compiled once, with the row that it reads."""

    def __init__(self, emulator: Emulator, text: str, scope: Scope, expression: Expression) -> None:
        self.text = text
        self._emulator = emulator
        self._expression = expression
        kinds, values = scope.columns.tables()
        self._columns = [(*row, value) for row, value in zip(kinds.tolist(), values, strict=True)]
        self._row = np.zeros(len(self._columns))

    def holds(self, since_ns: int = 0) -> bool:
        """Return whether the condition holds now; ``since_step`` counts from ``since_ns``."""
        return self._expression.holds(self._fill(since_ns))

    def value(self, since_ns: int = 0) -> float:
        """Return the expression's value now, in its unit."""
        return self._expression.value(self._fill(since_ns))

    def observe(self, since_ns: int = 0) -> str:
        """Return in words what it reads."""
        return self._expression.observe(self._fill(since_ns)) or self.text

    def _fill(self, since_ns: int) -> npt.NDArray[np.float64]:
        emulator, row = self._emulator, self._row
        state, now_ns = emulator.state, emulator.now_ns
        for place, (kind, what, event, value) in enumerate(self._columns):
            if kind == columns.T:
                row[place] = now_ns * 1e-9
            elif kind == columns.SINCE_STEP:
                row[place] = (now_ns - since_ns) * 1e-9
            elif kind == columns.SIGNAL:
                row[place] = state.on_bus[what]
            elif kind == columns.SEEN:
                seen = state.seen_ns[what]
                row[place] = np.nan if seen < 0 else seen * 1e-9
            elif kind == columns.TRUTH:
                row[place] = state.truth[what]
            elif kind == columns.FRAME:
                row[place] = float(state.seen_ns[what] == now_ns - TICK_NS)
            else:
                row[place] = float(self._happened(what, event, value))
        return row

    def _happened(self, what: int, event: int, value: float) -> bool:
        """Return whether the last call of the emulator noted such an event."""
        records = self._emulator.state.events[: int(self._emulator.state.result[2])]
        chosen = records["kind"] == event
        if what >= 0:
            chosen &= records["index"] == what
        if value == value:
            chosen &= records["value"] == value
        return bool(chosen.any())


class Asker:
    """Compiles what a bench asks of one car; the same text is compiled once."""

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator
        self._sources = sources_of(emulator)
        self._known: dict[tuple[str, bool], Question] = {}

    def condition(self, text: str) -> Question:
        """Return a condition; raises InputError for what is none."""
        return self._question(text, condition=True)

    def expression(self, text: str) -> Question:
        """Return an expression; raises InputError for what is none."""
        return self._question(text, condition=False)

    def _question(self, text: str, *, condition: bool) -> Question:
        key = (text, condition)
        if key not in self._known:
            scope = Scope(self._sources, {}, columns.Columns())
            place = Place(lambda steps: "bench")
            compiled = (compile_condition if condition else compile_expression)(text, scope, place)
            self._known[key] = Question(self._emulator, text, scope, compiled)
        return self._known[key]
