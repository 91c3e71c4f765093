"""Injected faults as a table: what each row means, when a row acts, and its own random numbers.

The rooms above fill rows (:mod:`hev_can_emu.ecu.fault_rows`) and their kernels read them.  A row lives
through *waiting*, *active*, *ended*; a *prepared* row waits for a control message.  All of it is
part of the emulator's state, so a snapshot holds it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import inner_kernel, kernel
from hev_can_emu.plant.events import note

Integers = npt.NDArray[np.int64]
Array = npt.NDArray[np.float64]

SLOTS = 160  #: rows: prepared, waiting, active, and ended ones until their place is needed
MOST_PREPARED = 96  #: of them for faults that a message injects by number

# Columns of FaultTable.whole.
STATE = 0  # FREE ... ENDED
KIND = 1
MESSAGE = 2  # index, -1: none
NODE = 3  # index, -1: none
TARGET = 4  # signal, status port, machine, actuator or valve; -1: none
AFTER_NS = 5  # from injection to the first effect
DURATION_NS = 6  # 0: until cleared
START_NS = 7
END_NS = 8  # 0: open
FRAMES = 9  # so many frames at most; 0: no limit
HITS = 10  # frames, or ticks, acted on
RESUME = 11  # RESUME_* of the sender's counter
TIME_NS = 12  # delay, or jitter
NUMBER = 13  # a whole number: copies, length, offset of a counter or CRC, identifier
LATCHED = 14  # 1: LATCH or MARK holds what was there when the fault began
MARK = 15  # a counter or CRC kept
DUE_NS = 16  # time of the latest frame held back
SEED1, SEED2 = 17, 18  # where the random numbers start
RANDOM1, RANDOM2 = 19, 20  # where they are
INJECTED_NS = 21
WHOLE_COLUMNS = 22

# Columns of FaultTable.real.
VALUE = 0  # what the kind asks for
CHANCE = 1  # share of the frames that are hit
LATCH = 2  # the value when the fault began
MEMORY = 3  # of a filter
LOW, HIGH = 4, 5
REAL_COLUMNS = 6

FREE, PREPARED, WAITING, ACTIVE, ENDED = 0, 1, 2, 3, 4  #: states of a row

RESUME_RUNNING, RESUME_STOPPED = 0, 1  #: the counter went on meanwhile, or goes on where it stopped

BEGAN, OVER = 30, 31  #: kinds of events; index: the row, value: hits

LIVE = 0  # place in FaultTable.countss: rows waiting or active
HELD = 1  # frames held back
N_COUNTS = 2


class FaultTable(NamedTuple):
    """``whole``: int64 (SLOTS, WHOLE_COLUMNS); ``real``: float64 (SLOTS, REAL_COLUMNS); ``counts``: int64."""

    whole: Integers
    real: Array
    counts: Integers


# Two multiplicative generators combined: L'Ecuyer, Communications of the ACM 31 (1988) 742.  Integers below
# 2^47 only, so compiled and plain Python agree, and no platform's library takes part.
_MODULUS1, _MODULUS2 = 2147483563, 2147483399


def random_state(seed: int) -> tuple[int, int]:
    """Return the start of a row's random numbers from any whole number."""
    return seed % (_MODULUS1 - 1) + 1, seed // (_MODULUS1 - 1) % (_MODULUS2 - 1) + 1


@kernel
def uniform(whole: Integers, slot: int) -> Any:
    """Return the row's next random number between 0 and 1, both excluded."""
    one = 40014 * whole[slot, RANDOM1] % _MODULUS1
    two = 40692 * whole[slot, RANDOM2] % _MODULUS2
    whole[slot, RANDOM1], whole[slot, RANDOM2] = one, two
    mixed = one - two
    if mixed < 1:
        mixed += _MODULUS1 - 1
    return mixed / float(_MODULUS1)


@kernel
def normal(whole: Integers, slot: int) -> Any:
    """Return a random number of mean 0 and variance 1: the sum of twelve uniform ones, less six."""
    total = -6.0
    for _ in range(12):
        total += uniform(whole, slot)
    return total


@kernel
def start_row(whole: Integers, slot: int, t_ns: int) -> None:
    """Let a filled or prepared row begin its time at ``t_ns``."""
    whole[slot, STATE] = WAITING
    whole[slot, INJECTED_NS] = t_ns
    whole[slot, START_NS] = t_ns + whole[slot, AFTER_NS]
    whole[slot, END_NS] = 0
    if whole[slot, DURATION_NS] > 0:
        whole[slot, END_NS] = whole[slot, START_NS] + whole[slot, DURATION_NS]
    whole[slot, HITS] = 0
    whole[slot, LATCHED] = 0
    whole[slot, DUE_NS] = 0
    whole[slot, RANDOM1] = whole[slot, SEED1]
    whole[slot, RANDOM2] = whole[slot, SEED2]


@kernel
def clear_row(whole: Integers, slot: int, t_ns: int) -> None:
    """Let a row end at the next tick; one that has not begun never does."""
    if whole[slot, STATE] == WAITING and whole[slot, START_NS] > t_ns:
        whole[slot, STATE] = ENDED
    whole[slot, END_NS] = max(t_ns, 1)


INJECT, CLEAR, CLEAR_ALL = 1, 2, 3  #: commands of a control message

TICK_NS = 1_000_000


@inner_kernel
def control_rows(
    table: FaultTable, command: float, number: float, prepared: int, t_ns: int
) -> None:
    """Obey a control message at ``t_ns``; what it begins or ends does so at the next tick.

    Injecting what is live, or a number that is not prepared, does nothing.
    """
    whole = table.whole
    if command == CLEAR_ALL:
        for slot in range(whole.shape[0]):
            if whole[slot, STATE] in (WAITING, ACTIVE):
                clear_row(whole, slot, t_ns)
        return
    if not 0.0 <= number < prepared:
        return
    slot = int(number)
    if command == INJECT and whole[slot, STATE] in (PREPARED, ENDED):
        start_row(whole, slot, t_ns + TICK_NS)
        table.counts[LIVE] += 1
    elif command == CLEAR and whole[slot, STATE] in (WAITING, ACTIVE):
        clear_row(whole, slot, t_ns)


@inner_kernel
def advance_rows(table: FaultTable, t_ns: int, events: npt.NDArray[np.void], n_events: int) -> int:
    """Let rows begin and end with time; return the number of event records.

    A row begins at the first tick at or after its start and acts until, not at, its end.
    """
    whole = table.whole
    live = 0
    for slot in range(whole.shape[0]):
        state = whole[slot, STATE]
        if state == WAITING and t_ns >= whole[slot, START_NS]:
            whole[slot, STATE] = ACTIVE
            state = ACTIVE
            n_events = note(events, n_events, t_ns, BEGAN, slot, 0.0)
        if state == ACTIVE and whole[slot, END_NS] > 0 and t_ns >= whole[slot, END_NS]:
            n_events = end_row(table, slot, t_ns, events, n_events)
            state = ENDED
        if state in (WAITING, ACTIVE):
            live += 1
    table.counts[LIVE] = live
    return n_events


@inner_kernel
def end_row(
    table: FaultTable, slot: int, t_ns: int, events: npt.NDArray[np.void], n_events: int
) -> int:
    """End a row and tell; return the number of event records."""
    table.whole[slot, STATE] = ENDED
    table.whole[slot, END_NS] = t_ns
    return note(events, n_events, t_ns, OVER, slot, float(table.whole[slot, HITS]))
