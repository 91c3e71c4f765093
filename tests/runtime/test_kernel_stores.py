"""What a kernel writes into fields of a tuple is written, whatever is inlined into it."""

import numba
import numpy as np
import pytest

from hev_can_emu import numba_stores
from hev_can_emu.jit import ready_compiler
from hev_can_emu.scenario import columns, script


def test_stores_into_fields_survive_what_is_inlined() -> None:
    table = columns.Columns()
    for signal in range(3):
        table.number(columns.Column(columns.SIGNAL, signal))
    noted = script.make_script(table, np.empty((0, 2)), 0, np.empty((0, 2)))
    perform = script.bind_perform(noted)
    noted.control[[script.ACTIVE, script.RECORDING]] = 1
    nothing = np.zeros(1)
    for t_ms in range(4):
        on_bus = np.array([1.0, 2.0, 3.0]) * t_ms
        perform(t_ms * 1_000_000, on_bus, np.zeros(3, dtype=np.int64), nothing, nothing)
    assert noted.control[script.ROWS] == 4
    assert noted.rows_ns[:4].tolist() == [0, 1_000_000, 2_000_000, 3_000_000]
    expected = [[t * 1e-3, t * 1e-3, t, 2 * t, 3 * t] for t in range(4)]
    np.testing.assert_allclose(noted.rows[:4], expected, rtol=1e-15)


def test_functions_of_others_are_as_numba_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    class Function:
        class func_id:
            modname = "somebody.elses"

    ready_compiler()
    assert numba.core.typed_passes.dead_code_elimination is numba_stores._eliminate
    seen = []
    monkeypatch.setattr(numba_stores, "_remove", lambda *given: seen.append(given))
    numba_stores._eliminate(Function, {})
    Function.func_id.modname = "hev_can_emu.made"
    numba_stores._eliminate(Function, {})
    assert len(seen) == 1
