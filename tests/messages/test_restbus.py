"""The send schedule: exact periods, phases, changes, repetitions, catch-up."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from hev_can_emu.messages.codec import build_codec
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.definitions import MessageDef, SendType, SignalDef
from hev_can_emu.messages.restbus import (
    R_PHASE,
    T_COLUMNS,
    T_MISSED,
    arbitration_key,
    build_restbus,
    due,
    reset_restbus,
    restbus_state_size,
    trigger,
)

MS = 1_000_000


def network(*messages: dict) -> Database:
    made = []
    for index, fields in enumerate(messages):
        name = fields.setdefault("name", f"M{index}")
        signal = SignalDef(
            index=index, message_index=index, name="S", message=name, start=0, length=8, initial=7
        )
        fields.setdefault("can_id", 0x100 + index)
        made.append(MessageDef(index=index, length=8, signals=(signal,), **fields))
    return Database(path=Path("test.dbc"), nodes=("A",), messages=tuple(made))


class Run:
    """A schedule with its arrays; pretends to send what is due."""

    def __init__(self, *messages: dict, start: int = 0) -> None:
        self.database = network(*messages)
        self.restbus, self.codec = build_restbus(self.database), build_codec(self.database)
        count = len(messages)
        self.state = np.zeros(restbus_state_size(self.restbus), dtype=np.int64)
        self.enabled = np.ones(count, dtype=np.uint8)
        self.values = np.full(count, 7.0)
        self.on_bus = np.full(count, 7.0)
        self.out = np.zeros(count, dtype=np.int64)
        reset_restbus(self.restbus, self.state, start)

    def at(self, t_ns: int) -> list[int]:
        count = due(
            self.restbus,
            self.codec,
            self.state,
            self.enabled,
            self.values,
            self.on_bus,
            t_ns,
            self.out,
        )
        sent = self.out[:count].tolist()
        for message in sent:
            self.on_bus[message] = self.values[message]
        return sent

    def times(self, message: int, until_ms: int, step_ms: int = 1) -> list[int]:
        return [t for t in range(0, until_ms, step_ms) if message in self.at(t * MS)]


def cyclic(period_ms: int, **fields) -> dict:
    return {"send_type": SendType.CYCLIC, "cycle_time_ns": period_ms * MS, **fields}


def test_mean_period_is_exact_on_ticks_that_do_not_divide_it() -> None:
    run = Run(cyclic(10, start_delay_ns=0))
    times = [t for t in range(0, 100_000, 3) if run.at(t * MS)]
    assert len(times) == 10_000
    assert all(0 <= t - 10 * n < 3 for n, t in enumerate(times)), "no drift"


def test_phases_spread_the_load() -> None:
    run = Run(*(cyclic(10) for _ in range(20)))
    per_tick = Counter(int(phase) // MS for phase in run.restbus.schedule[:, R_PHASE])
    assert per_tick == dict.fromkeys(range(10), 2)
    again = build_restbus(run.database)
    assert np.array_equal(again.schedule, run.restbus.schedule)


def test_mixed_periods_keep_the_peak_low() -> None:
    run = Run(*(cyclic(period) for period in (10, 10, 10, 10, 20, 20, 20, 20, 50, 100)))
    peak = max(len(run.at(t * MS)) for t in range(200))
    assert peak == 1, "0.4 + 0.2 + 0.02 + 0.01 messages a tick fit one by one"


def test_start_delay_is_kept() -> None:
    run = Run(cyclic(10, start_delay_ns=4 * MS), cyclic(10))
    assert run.times(0, 30) == [4, 14, 24]
    assert run.restbus.schedule[1, R_PHASE] != 4 * MS


def test_a_late_call_sends_once_and_counts_the_rest() -> None:
    run = Run(cyclic(10, start_delay_ns=0))
    assert run.at(0) == [0]
    assert run.at(57 * MS) == [0]
    assert run.state[T_MISSED] == 4, "10, 20, 30, 40 gave way to 50"
    assert run.at(59 * MS) == []
    assert run.at(60 * MS) == [0], "the grid stays"


def test_going_back_in_time_waits_for_the_grid() -> None:
    run = Run(cyclic(10, start_delay_ns=0), start=100 * MS)
    assert run.at(100 * MS) == [0]
    assert run.at(50 * MS) == []
    assert run.at(110 * MS) == [0]


def test_start_of_the_grid() -> None:
    assert Run(cyclic(10, start_delay_ns=0), start=5 * MS).times(0, 40) == [5, 15, 25, 35]


def test_disabled_messages_are_silent_and_do_not_burst() -> None:
    run = Run(cyclic(10, start_delay_ns=0))
    run.enabled[0] = 0
    assert run.times(0, 100) == []
    run.enabled[0] = 1
    assert [t for t in range(100, 130) if run.at(t * MS)] == [100, 110, 120]
    assert run.state[T_MISSED] == 0


def test_on_change_sees_the_bus_value() -> None:
    run = Run({"send_type": SendType.ON_CHANGE})
    assert run.at(0) == []
    run.values[0] = 7.3
    assert run.at(1 * MS) == [], "the same raw value"
    run.values[0] = 7.8
    assert run.at(2 * MS) == [0]
    run.on_bus[0] = 8.0  # as encoded
    assert run.at(3 * MS) == []


def test_event_with_repetitions() -> None:
    run = Run({"send_type": SendType.EVENT, "repetitions": 2, "fast_cycle_time_ns": 5 * MS})
    assert run.times(0, 10) == []
    run.values[0] = 9.0
    assert [t for t in range(10, 60) if run.at(t * MS)] == [10, 15, 20]
    trigger(run.state, 0)
    assert [t for t in range(60, 100) if run.at(t * MS)] == [60, 65, 70]


def test_minimum_delay_postpones_but_never_drops() -> None:
    run = Run({"send_type": SendType.ON_CHANGE, "delay_ns": 10 * MS})
    sent = []
    for t in range(100):
        run.values[0] = 10.0 + min(t, 25)
        if run.at(t * MS):
            sent.append((t, run.on_bus[0]))
    assert sent == [(0, 10.0), (10, 20.0), (20, 30.0), (30, 35.0)]


def test_cyclic_and_change_keeps_its_grid() -> None:
    run = Run(
        {
            "send_type": SendType.CYCLIC_AND_CHANGE,
            "cycle_time_ns": 20 * MS,
            "start_delay_ns": 0,
        }
    )
    sent = []
    for t in range(60):
        if t == 13:
            run.values[0] = 50.0
        if run.at(t * MS):
            sent.append(t)
    assert sent == [0, 13, 20, 40]


@pytest.mark.parametrize(
    ("fast_ms", "expected"),
    [(0, [20, 40, 60]), (5, [0, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 90])],
)
def test_cyclic_if_active(fast_ms: int, expected: list[int]) -> None:
    run = Run(
        {
            "send_type": SendType.CYCLIC_IF_ACTIVE,
            "cycle_time_ns": 20 * MS,
            "fast_cycle_time_ns": fast_ms * MS,
            "start_delay_ns": 0,
        }
    )
    sent = []
    for t in range(100):
        run.values[0] = 8.0 if 20 <= t < 70 else 7.0
        if run.at(t * MS):
            sent.append(t)
    assert sent == expected


def test_trigger_sends_what_has_no_send_type() -> None:
    run = Run({})
    assert run.times(0, 50) == []
    trigger(run.state, 0)
    assert run.at(50 * MS) == [0]
    assert run.at(51 * MS) == []


def test_priority_is_that_of_the_bus() -> None:
    run = Run(
        cyclic(10, can_id=0x300, start_delay_ns=0),
        cyclic(10, can_id=0x100 << 18 | 5, extended=True, start_delay_ns=0),
        cyclic(10, can_id=0x100, start_delay_ns=0),
        cyclic(10, can_id=0x0FF << 18 | 0x3FFFF, extended=True, start_delay_ns=0),
    )
    assert run.at(0) == [3, 2, 1, 0]
    keys = [arbitration_key(message) for message in run.database.messages]
    assert len(set(keys)) == 4


def test_what_finds_no_room_stays_due() -> None:
    run = Run(*(cyclic(10, start_delay_ns=0) for _ in range(3)))
    run.out = np.zeros(2, dtype=np.int64)
    assert run.at(0) == [0, 1]
    assert run.at(1 * MS) == [2]
    assert run.state.reshape(3, T_COLUMNS)[:, T_MISSED].tolist() == [0, 0, 0]
