"""What is due at a time: the send schedule of all messages as a table, and the kernels that read it.

Rules (t is the time of the call; calls come at any times, in practice each tick):

- *cyclic*: deadlines lie on an absolute grid ``start + phase + k * period``.  A message is due at the
  first call at or after a deadline.  Deadlines passed in the meantime are skipped and counted, never sent
  in a burst; the grid stays, so the mean period is exact.  Going back in time sends nothing until the next
  deadline is reached again.
- *on change*, *event*: due when a value changes as seen on the bus (after quantisation), or when
  triggered; then repeated ``repetitions`` times at the fast period.  A minimum delay to the message's last
  frame postpones, never drops.  The first values after a start count as a change.
- *cyclic and on change*: both; the grid is not moved by changes.
- *cyclic if active*: while any value differs from its initial one, at the fast period where there is one,
  else at the normal period.  While inactive: at the normal period if there is a fast one, else silent.
  Each change of activity starts a new grid: active at once, inactive one period later.
- A trigger sends any message once, even one without send type.
- A disabled message's grid runs on silently; enabling it neither bursts nor shifts.

Messages due at the same call go out in the order of bus arbitration.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from hev_can_emu.jit import inlined_kernel, kernel, small_kernel
from hev_can_emu.messages.codec import Codec, to_pattern, to_physical
from hev_can_emu.messages.columns import (
    M_COUNT,
    M_FIRST,
    S_INITIAL,
    S_KIND,
    S_LENGTH,
    S_PARENT,
    S_PROTECTED,
    S_RANGE_COUNT,
    S_RANGES,
)
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.definitions import MessageDef, SendType
from hev_can_emu.messages.quick import lowest, reached
from hev_can_emu.messages.raw import SIGNED, signed_value

_TYPES = list(SendType)
_NONE = _TYPES.index(SendType.NONE)
_CYCLIC = _TYPES.index(SendType.CYCLIC)
_CYCLIC_AND_CHANGE = _TYPES.index(SendType.CYCLIC_AND_CHANGE)
_CYCLIC_IF_ACTIVE = _TYPES.index(SendType.CYCLIC_IF_ACTIVE)
_ON_CHANGE = _TYPES.index(SendType.ON_CHANGE)
_EVENT = _TYPES.index(SendType.EVENT)

# Columns of Restbus.schedule, one row per message; times in ns.
R_TYPE = 0
R_PERIOD = 1
R_PHASE = 2
R_FAST = 3
R_REPETITIONS = 4
R_DELAY = 5
R_COLUMNS = 6

# Columns of the state, T_COLUMNS per message.
T_NEXT = 0  # next deadline of the grid
T_LAST = 1  # time of the last transmission
T_REPEATS = 2  # repetitions left
T_REPEAT_AT = 3  # time of the next one
T_TRIGGER = 4  # 1: to be sent once
T_ACTIVE = 5  # 1: a value differed from its initial one at the last call
T_COUNTER = 6  # protection counter of the next transmission, before the modulus
T_SENT = 7  # frames sent
T_MISSED = 8  # grid deadlines skipped
T_SATURATED = 9  # values saturated in sent frames
T_COLUMNS = 10

_LONG_AGO = -(1 << 62)
_NEVER = (1 << 63) - 1
_BLOCK = 8  # messages whose times are compared at once
_SLOT_NS = 1_000_000
#: Slots over which phases are spread: enough for periods up to 10 s without a long search.
_MOST_SLOTS = 10_000


class Restbus(NamedTuple):
    """The schedule.

    ``schedule``: int64 (messages, R_COLUMNS); ``order``: int64, messages by bus priority; ``place``:
    int64 (messages), the place of each in that order.
    """

    schedule: np.ndarray
    order: np.ndarray
    place: np.ndarray


def build_restbus(database: Database) -> Restbus:
    """Return the send schedule of a database, with phases spread over the periods."""
    schedule = np.zeros((len(database.messages), R_COLUMNS), dtype=np.int64)
    for message, phase in zip(database.messages, spread_phases(database), strict=True):
        schedule[message.index] = [
            _TYPES.index(message.send_type),
            message.cycle_time_ns,
            phase,
            message.fast_cycle_time_ns,
            message.repetitions,
            message.delay_ns,
        ]
    order = [message.index for message in sorted(database.messages, key=arbitration_key)]
    place = np.zeros(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return Restbus(schedule, np.array(order, dtype=np.int64), place)


def arbitration_key(message: MessageDef) -> int:
    """Return a number that is smaller for the message that wins bus arbitration.

    A standard identifier wins over an extended one with the same leading 11 bits (ISO 11898-1: the
    latter's SRR and IDE bits are recessive).
    """
    if not message.extended:
        return message.can_id << 19
    return (message.can_id >> 18) << 19 | 1 << 18 | message.can_id & 0x3FFFF


def spread_phases(database: Database) -> list[int]:
    """Return each message's phase in ns: GenMsgStartDelayTime, or where the 1 ms slots are least loaded.

    Shorter periods choose first, ties by identifier and then the earliest slot, so that equal databases
    give equal phases.
    """
    periods = [max(message.cycle_time_ns // _SLOT_NS, 1) for message in database.messages]
    slots = min(math.lcm(*periods, 1), _MOST_SLOTS)
    load = np.zeros(slots)
    phases = [message.start_delay_ns or 0 for message in database.messages]
    cyclic = [message for message in database.messages if message.cycle_time_ns > 0]
    fixed_first = sorted(
        cyclic, key=lambda m: (m.start_delay_ns is None, m.cycle_time_ns, arbitration_key(m))
    )
    for message in fixed_first:
        period = periods[message.index]
        weight = 50.0 + 8.0 * message.wire_length
        phase = phases[message.index] // _SLOT_NS
        if message.start_delay_ns is None:
            width = min(period, slots)
            peaks = [float(load[slot::period].max()) for slot in range(width)]
            phase = peaks.index(min(peaks))
            phases[message.index] = phase * _SLOT_NS
        load[phase % period :: period] += weight
    return phases


def restbus_state_size(restbus: Restbus) -> int:
    """Return how many int64 the scheduler's state takes."""
    return int(restbus.schedule.shape[0]) * T_COLUMNS


@kernel
def reset_restbus(restbus: Restbus, state: np.ndarray, t_ns: int) -> None:
    """Start the grid of every message at ``t_ns`` and forget counters and statistics."""
    for m in range(restbus.schedule.shape[0]):
        base = m * T_COLUMNS
        for n in range(T_COLUMNS):
            state[base + n] = 0
        state[base + T_NEXT] = t_ns + restbus.schedule[m, R_PHASE]
        state[base + T_LAST] = _LONG_AGO


@kernel
def trigger(state: np.ndarray, message: int) -> None:
    """Have a message sent at the next call."""
    state[message * T_COLUMNS + T_TRIGGER] = 1


@kernel
def _is_selected(codec: Codec, s: int, values: np.ndarray) -> bool:
    """Whether the multiplexers' values select signal ``s``."""
    parent = codec.signals[s, S_PARENT]
    while parent >= 0:
        pattern, _ = to_pattern(codec.signals, codec.scaling, codec.lists, parent, values[parent])
        selector = np.int64(pattern)
        if codec.signals[parent, S_KIND] == SIGNED:
            selector = signed_value(pattern, codec.signals[parent, S_LENGTH])
        start = codec.signals[s, S_RANGES]
        found = False
        for n in range(codec.signals[s, S_RANGE_COUNT]):
            if codec.lists[start + 2 * n] <= selector <= codec.lists[start + 2 * n + 1]:
                found = True
        if not found:
            return False
        s = parent
        parent = codec.signals[s, S_PARENT]
    return True


@kernel
def _has_changed(codec: Codec, message: int, values: np.ndarray, on_bus_values: np.ndarray) -> bool:
    """Whether a receiver would see another value than in the last frame."""
    first = codec.messages[message, M_FIRST]
    for s in range(first, first + codec.messages[message, M_COUNT]):
        if codec.signals[s, S_PROTECTED] == 0 and _is_selected(codec, s, values):
            pattern, _ = to_pattern(codec.signals, codec.scaling, codec.lists, s, values[s])
            new = to_physical(codec.signals, codec.scaling, s, pattern)
            old = on_bus_values[s]
            if new != old and not (np.isnan(new) and np.isnan(old)):
                return True
    return False


@kernel
def _differs_from_initial(codec: Codec, message: int, values: np.ndarray) -> bool:
    first = codec.messages[message, M_FIRST]
    for s in range(first, first + codec.messages[message, M_COUNT]):
        if codec.signals[s, S_PROTECTED] == 0 and not np.isnan(values[s]):
            pattern, _ = to_pattern(codec.signals, codec.scaling, codec.lists, s, values[s])
            if np.int64(pattern) != codec.signals[s, S_INITIAL]:
                return True
    return False


@kernel
def is_idle(kind: int, state: np.ndarray, message: int, t_ns: int) -> bool:
    """Whether a message is plainly not due, without a look at its values."""
    base = message * T_COLUMNS
    return (
        kind in (_CYCLIC, _NONE)
        and t_ns < state[base + T_NEXT]
        and state[base + T_TRIGGER] == 0
        and state[base + T_REPEATS] == 0
    )


def new_wake(messages: int) -> np.ndarray:
    """Return, int64, when to look at each message: at once; it is filled up with entries of no message."""
    wake = np.full(-(-messages // _BLOCK) * _BLOCK, _NEVER, dtype=np.int64)
    wake[:messages] = _LONG_AGO
    return wake


@small_kernel
def wake_at(restbus: Restbus, state: np.ndarray, message: int) -> int:
    """Return from when on a message may be due, after :func:`is_due` was asked; triggers aside."""
    base = message * T_COLUMNS
    kind = restbus.schedule[message, R_TYPE]
    if kind not in (_CYCLIC, _NONE) or state[base + T_REPEATS] != 0 or state[base + T_TRIGGER] != 0:
        return _LONG_AGO
    if kind == _NONE or restbus.schedule[message, R_PERIOD] == 0:
        return _NEVER
    return int(state[base + T_NEXT])


@inlined_kernel
def awake(restbus: Restbus, wake: np.ndarray, t_ns: int, messages: np.ndarray) -> Any:
    """Write into ``messages``, int64, those to look at at ``t_ns``, by priority; return how many.

    ``wake``: see :func:`new_wake`.
    """
    count: Any = np.int64(0)
    for start in range(0, wake.shape[0], _BLOCK):
        bits: Any = reached(wake, start, t_ns)
        while bits != 0:
            m = start + lowest(bits)
            bits &= bits - 1
            at = count
            while at > 0 and restbus.place[messages[at - 1]] > restbus.place[m]:
                messages[at] = messages[at - 1]
                at -= 1
            messages[at] = m
            count += 1
    return count


@inlined_kernel
def is_due(
    restbus: Restbus,
    codec: Codec,
    state: np.ndarray,
    enabled: np.ndarray,
    values: np.ndarray,
    on_bus_values: np.ndarray,
    message: int,
    t_ns: int,
) -> bool:
    """Whether one message is due at ``t_ns``; its deadlines in ``state`` advance accordingly.

    The caller must send it then.  ``state``: int64; ``enabled``: uint8 (messages); ``values`` and
    ``on_bus_values``: float64 (signals), the latter as of each message's last transmission.
    """
    row = restbus.schedule[message]
    own = state[message * T_COLUMNS : (message + 1) * T_COLUMNS]
    kind = row[R_TYPE]
    period = row[R_PERIOD]
    on = enabled[message] != 0
    if on and kind == _CYCLIC and own[T_TRIGGER] == 0 and own[T_REPEATS] == 0:
        # By far the most: nothing but the grid, and no deadline passed.
        late = t_ns - own[T_NEXT]
        if 0 <= late < period:
            own[T_NEXT] += period
            own[T_LAST] = t_ns
            return True
    if kind == _CYCLIC_IF_ACTIVE and on:
        active = 1 if _differs_from_initial(codec, message, values) else 0
        if row[R_FAST] > 0:
            period = row[R_FAST] if active == 1 else row[R_PERIOD]
        elif active == 0:
            period = 0
        if active != own[T_ACTIVE]:
            own[T_ACTIVE] = active
            own[T_NEXT] = t_ns if active == 1 else t_ns + period
    due = False
    if period > 0 and kind in (_CYCLIC, _CYCLIC_AND_CHANGE, _CYCLIC_IF_ACTIVE):
        late = t_ns - own[T_NEXT]
        if late >= 0:
            skipped = late // period
            own[T_NEXT] += (skipped + 1) * period
            due = True
            if on:
                own[T_MISSED] += skipped
    if not on:
        own[T_TRIGGER] = 0
        own[T_REPEATS] = 0
        return False
    fresh = own[T_TRIGGER] != 0
    if not fresh and kind in (_ON_CHANGE, _EVENT, _CYCLIC_AND_CHANGE):
        fresh = _has_changed(codec, message, values, on_bus_values)
    if fresh and (due or t_ns - own[T_LAST] >= row[R_DELAY]):
        due = True
        own[T_REPEATS] = row[R_REPETITIONS]
        own[T_REPEAT_AT] = t_ns + max(row[R_FAST], row[R_DELAY])
    elif own[T_REPEATS] > 0 and t_ns >= own[T_REPEAT_AT]:
        due = True
        own[T_REPEATS] -= 1
        own[T_REPEAT_AT] = t_ns + max(row[R_FAST], row[R_DELAY])
    if due:
        own[T_TRIGGER] = 0
        own[T_LAST] = t_ns
    return due


@kernel
def due(
    restbus: Restbus,
    codec: Codec,
    state: np.ndarray,
    enabled: np.ndarray,
    values: np.ndarray,
    on_bus_values: np.ndarray,
    t_ns: int,
    out_indices: np.ndarray,
) -> Any:
    """Write the messages due at ``t_ns`` into ``out_indices`` (int64) in priority order; return their count.

    What finds no room stays due.  See :func:`is_due` for the arrays.
    """
    count = 0
    for place in range(restbus.order.shape[0]):
        if count == out_indices.shape[0]:
            break
        message = restbus.order[place]
        if is_idle(restbus.schedule[message, R_TYPE], state, message, t_ns):
            continue
        if is_due(restbus, codec, state, enabled, values, on_bus_values, message, t_ns):
            out_indices[count] = message
            count += 1
    return count
