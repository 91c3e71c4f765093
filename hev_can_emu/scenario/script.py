"""What a scenario does at every tick, as tables that the compiled tick reads.

At a tick, before anything else happens in it: fill the row of what is seen; if the awaited condition
has held long enough, stop, so that the player takes its step; else note the row for the expectations, and
let the running stimuli set what is sent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import inlined_kernel, inner_kernel, kernel
from hev_can_emu.moves import fill, move
from hev_can_emu.native import Bound
from hev_can_emu.scenario import columns
from hev_can_emu.scenario.evaluation import STACK, Code, evaluate

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# Places in ``control``.
(
    ACTIVE, RECORDING, ROWS, CONDITION_FIRST, CONDITION_STOP, HELD_NS, ARMED_NS, TRUE_SINCE_NS,
    TIMEOUT_NS, LAST_STEP_NS, ORIGIN_NS, STOPPED, FOLLOWING, EVENTS,
) = range(14)  # fmt: skip
# Why :func:`perform` stops.
GO_ON, TRIGGERED, TIMED_OUT, FULL = 0, 1, 2, 3
# Kinds of shapes.
IDLE, LINE, WAVE, CHIRP, TRAIN, TABLE, FOLLOW = range(7)
# Places in a shape's integers: kind, signal, when it began, its length, and a span of code or samples.
KIND, SIGNAL, BEGIN_NS, LENGTH_NS, FIRST, COUNT, MODE = range(7)

TICK_NS = 1_000_000
ROWS_KEPT = 4096  #: ticks between two looks of the expectations, at most


class Script(NamedTuple):
    """Tables and state; all arrays.

    Attributes:
        columns: shape (n, 3), kind, index and event of each column of the row.
        column_values: shape (n,), the number an event must carry, NaN for any.
        pulses: shape (n,), 1.0 where such an event was noted since the last row.
        row: shape (n,), what is seen now.
        rows, rows_ns: shape (ROWS_KEPT, n) and (ROWS_KEPT,), what was seen, and when.
        code: shape (m, 2), all programs one after the other.
        stack: scratch.
        shapes: shape (s, 7), integers of the running stimuli; see KIND and so on.
        shape_values: shape (s, 4), numbers of the running stimuli.
        samples: shape (p, 2), time in s and value of all tables.
        control: shape (14,), see ACTIVE and so on.
    """

    columns: Integers
    column_values: Array
    pulses: Array
    row: Array
    rows: Array
    rows_ns: Integers
    code: Code
    stack: Array
    shapes: Integers
    shape_values: Array
    samples: Array
    control: Integers


def make_script(
    table: columns.Columns, code: Code, shapes: int, samples: Array, kept: int = ROWS_KEPT
) -> Script:
    """Return a script at rest, with room for ``shapes`` stimuli and ``kept`` rows."""
    kinds, values = table.tables()
    n = len(kinds)
    control = np.zeros(EVENTS + 1, dtype=np.int64)
    control[EVENTS] = int((kinds[:, 0] == columns.EVENT).sum())
    return Script(
        columns=kinds,
        column_values=values,
        pulses=np.zeros(n),
        row=np.full(n, np.nan),
        rows=np.empty((kept, n)),
        rows_ns=np.zeros(kept, dtype=np.int64),
        code=code.reshape(-1, 2),
        stack=np.empty(STACK),
        shapes=np.zeros((shapes, MODE + 1), dtype=np.int64),
        shape_values=np.zeros((shapes, 4)),
        samples=samples.reshape(-1, 2),
        control=control,
    )


def no_script() -> Script:
    """Return a script that does nothing."""
    return make_script(columns.Columns(), np.empty((0, 2)), 0, np.empty((0, 2)), 1)


@inlined_kernel
def perform(
    script: Script, t_ns: int, on_bus: Array, seen_ns: Integers, truth: Array, values: Array
) -> int:
    """Look and act at tick ``t_ns``, before the tick itself.

    Args:
        script: tables and state.
        t_ns: the tick's time.
        on_bus, seen_ns: signals as last received, and when (-1 never).
        truth: of the plant.
        values: what is sent; running stimuli write into it.

    Returns:
        GO_ON, or why the tick must wait: TRIGGERED (the step's condition has come), TIMED_OUT (it has not
        come in time) or FULL (the rows must be looked at first); also left in ``control``.
    """
    control = script.control
    if control[ACTIVE] == 0:
        return GO_ON
    control[STOPPED] = _perform(script, t_ns, on_bus, seen_ns, truth, values)
    return int(control[STOPPED])


def bind_perform(script: Script) -> Bound:
    """Return :func:`perform` for one script, to be called with the rest of its arguments."""
    nothing, never = np.zeros(1), np.zeros(1, dtype=np.int64)
    return Bound(perform, (script,), (0, nothing, never, nothing, nothing))


@inlined_kernel
def _perform(
    script: Script, t_ns: int, on_bus: Array, seen_ns: Integers, truth: Array, values: Array
) -> int:
    control = script.control
    recording = control[RECORDING] != 0
    if recording and control[ROWS] >= script.rows.shape[0]:
        return FULL
    waiting = control[CONDITION_STOP] > control[CONDITION_FIRST] and t_ns > control[ARMED_NS]
    if recording or waiting or control[FOLLOWING] > 0:
        _fill(script, t_ns, on_bus, seen_ns, truth)
    if waiting:
        if _has_come(control, script.code, script.row, script.stack, t_ns):
            return TRIGGERED
        if t_ns >= control[TIMEOUT_NS]:
            return TIMED_OUT
    fill(script.pulses, 0, script.pulses.shape[0], 0.0)
    if recording:
        at = control[ROWS]
        script.rows_ns[at] = t_ns
        move(script.row, 0, script.rows[at], 0, script.row.shape[0])
        control[ROWS] = at + 1
    for shape in range(script.shapes.shape[0]):
        if script.shapes[shape, KIND] != IDLE:
            value = _shape(
                script.shapes[shape], script.shape_values[shape], script.code, script.row,
                script.stack, script.samples, t_ns,
            )  # fmt: skip
            if not math.isnan(value):
                values[script.shapes[shape, SIGNAL]] = value
    return GO_ON


@inlined_kernel
def _fill(script: Script, t_ns: int, on_bus: Array, seen_ns: Integers, truth: Array) -> None:
    origin = script.control[ORIGIN_NS]
    for i in range(script.columns.shape[0]):
        kind, index = script.columns[i, 0], script.columns[i, 1]
        if kind == columns.SIGNAL:
            script.row[i] = on_bus[index]
        elif kind == columns.TRUTH:
            script.row[i] = truth[index]
        elif kind == columns.T:
            script.row[i] = (t_ns - origin) * 1e-9
        elif kind == columns.SINCE_STEP:
            script.row[i] = (t_ns - script.control[LAST_STEP_NS]) * 1e-9
        elif kind == columns.SEEN:
            seen = seen_ns[index]
            script.row[i] = (seen - origin) * 1e-9 if seen >= 0 else math.nan
        elif kind == columns.EVENT:
            script.row[i] = script.pulses[i]
        else:  # a frame handled in the tick before
            seen = seen_ns[index]
            script.row[i] = 1.0 if seen >= 0 and seen >= t_ns - TICK_NS else 0.0


@inner_kernel
def _has_come(control: Integers, code: Code, row: Array, stack: Array, t_ns: int) -> bool:
    """Return whether the awaited condition has held for as long as it must."""
    awaited = code[control[CONDITION_FIRST] : control[CONDITION_STOP]]
    if evaluate(awaited, row, stack) != 1.0:
        control[TRUE_SINCE_NS] = -1
        return False
    if control[TRUE_SINCE_NS] < 0:
        control[TRUE_SINCE_NS] = t_ns
    return bool(t_ns - control[TRUE_SINCE_NS] >= control[HELD_NS])


@inner_kernel
def _shape(
    whole: Integers, parts: Array, code: Code, row: Array, stack: Array, samples: Array, t_ns: int
) -> float:
    """Return a running stimulus's value now; NaN leaves the one before.  What has ended becomes idle.

    ``whole``, ``parts``: its row of ``shapes`` and of ``shape_values``; the rest as in :class:`Script`.
    """
    kind = whole[KIND]
    elapsed = t_ns - whole[BEGIN_NS]
    length = whole[LENGTH_NS]
    if kind == FOLLOW:
        span = code[whole[FIRST] : whole[FIRST] + whole[COUNT]]
        value = evaluate(span, row, stack) * parts[0] + parts[1]
        return value if math.isfinite(value) else math.nan
    if kind == WAVE:
        return float(parts[0] + parts[1] * math.sin(parts[2] * (elapsed * 1e-9) + parts[3]))
    if kind == LINE:
        if elapsed >= length:
            whole[KIND] = IDLE
            return float(parts[1])
        return float(parts[0] + (parts[1] - parts[0]) * (elapsed / length))
    if kind == CHIRP:
        if elapsed >= length:
            whole[KIND] = IDLE
            return float(parts[0])
        phase = _swept(elapsed * 1e-9, length * 1e-9, parts[2], parts[3], whole[MODE])
        return float(parts[0] + parts[1] * math.sin(phase))
    if kind == TRAIN:
        number = elapsed // length
        if number >= whole[COUNT] * whole[MODE] - 1:
            whole[KIND] = IDLE
            number = whole[COUNT] * whole[MODE] - 1
        return float(samples[whole[FIRST] + number % whole[COUNT], 1])
    return _looked_up(samples, whole, elapsed * 1e-9)


@inner_kernel
def _swept(t: float, length: float, low: float, high: float, logarithmic: int) -> float:
    """Return the phase of a sweep, rad."""
    if logarithmic != 0 and low != high:
        rate = math.log(high / low) / length
        return 2.0 * math.pi * low * (math.exp(rate * t) - 1.0) / rate
    return 2.0 * math.pi * (low * t + 0.5 * (high - low) / length * t * t)


@inner_kernel
def _looked_up(samples: Array, whole: Integers, t: float) -> float:
    """Return a table's value at ``t``, s: the last row's up to then, or on the line to the next one."""
    low, high = whole[FIRST], whole[FIRST] + whole[COUNT]  # the last row at or before t
    if t < samples[low, 0]:
        return math.nan
    while high - low > 1:
        middle = (low + high) // 2
        if samples[middle, 0] <= t:
            low = middle
        else:
            high = middle
    if low == whole[FIRST] + whole[COUNT] - 1:
        whole[KIND] = IDLE
        return float(samples[low, 1])
    if whole[MODE] == 0:
        return float(samples[low, 1])
    share = (t - samples[low, 0]) / (samples[low + 1, 0] - samples[low, 0])
    return float(samples[low, 1] + (samples[low + 1, 1] - samples[low, 1]) * share)


@kernel
def mark_events(script: Script, events: npt.NDArray[np.void], first: int, stop: int) -> None:
    """Note which awaited events are among ``events[first:stop]``."""
    for i in range(script.columns.shape[0]):
        if script.columns[i, 0] != columns.EVENT:
            continue
        for k in range(first, stop):
            if (
                events[k]["kind"] == script.columns[i, 2]
                and (script.columns[i, 1] < 0 or events[k]["index"] == script.columns[i, 1])
                and (
                    math.isnan(script.column_values[i])
                    or events[k]["value"] == script.column_values[i]
                )
            ):
                script.pulses[i] = 1.0
