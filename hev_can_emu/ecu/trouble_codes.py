"""Trouble codes of supervision, with the status bits of ISO 14229-1, annex D.2.

A request message with a ``code`` has one trouble code per failure type (:mod:`.reasons`): ``U1101-87``
is its missing message.  What happens to a code is one table of events; an operation cycle runs from ignition
on to ignition off.
"""

from __future__ import annotations

import re
from typing import Annotated, Any

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu.reasons import FAILURES
from hev_can_emu.errors import InputError
from hev_can_emu.jit import kernel

Integers = npt.NDArray[np.int64]

# Bits of the status.
TEST_FAILED, FAILED_THIS_CYCLE, PENDING, CONFIRMED = 1, 2, 4, 8
NOT_COMPLETED_SINCE_CLEAR, FAILED_SINCE_CLEAR, NOT_COMPLETED_THIS_CYCLE = 16, 32, 64
BIT_NAMES = {
    TEST_FAILED: "testFailed",
    FAILED_THIS_CYCLE: "testFailedThisOperationCycle",
    PENDING: "pendingDTC",
    CONFIRMED: "confirmedDTC",
    NOT_COMPLETED_SINCE_CLEAR: "testNotCompletedSinceLastClear",
    FAILED_SINCE_CLEAR: "testFailedSinceLastClear",
    NOT_COMPLETED_THIS_CYCLE: "testNotCompletedThisOperationCycle",
}
CLEARED = NOT_COMPLETED_SINCE_CLEAR | NOT_COMPLETED_THIS_CYCLE

AGE_CYCLES = 40  #: cycles without a failure after which a confirmed code is forgotten

FAILED, PASSED, CYCLE_BEGINS = 0, 1, 2  #: events

# What each event sets and clears; confirming and forgetting hang on counted cycles beside.
SETS = np.array([TEST_FAILED | FAILED_THIS_CYCLE | PENDING | FAILED_SINCE_CLEAR, 0,
                 NOT_COMPLETED_THIS_CYCLE], dtype=np.int64)  # fmt: skip
CLEARS = np.array([CLEARED, TEST_FAILED | CLEARED, FAILED_THIS_CYCLE],
                  dtype=np.int64)  # fmt: skip

# Columns of a code's state; (messages, len(FAILURES), COLUMNS).
STATUS, TRIPS, AGE, OCCURRENCES, FIRST_NS, LAST_NS = 0, 1, 2, 3, 4, 5
COLUMNS = 6


@kernel
def code_event(code: Integers, event: int, confirm_cycles: int, t_ns: int) -> None:
    """Let one event happen to a code, shape (COLUMNS,)."""
    before = code[STATUS]
    code[STATUS] = (before & ~CLEARS[event]) | SETS[event]
    if event == FAILED:
        if before & TEST_FAILED == 0:
            code[OCCURRENCES] += 1
            code[LAST_NS] = t_ns
            if before & FAILED_SINCE_CLEAR == 0:
                code[FIRST_NS] = t_ns
        if before & FAILED_THIS_CYCLE == 0:
            code[TRIPS] += 1
        code[AGE] = 0
        if code[TRIPS] >= confirm_cycles:
            code[STATUS] |= CONFIRMED
    elif event == CYCLE_BEGINS and before & (FAILED_THIS_CYCLE | NOT_COMPLETED_THIS_CYCLE) == 0:
        # A whole cycle was tested, and without a failure.
        code[STATUS] &= ~PENDING
        code[TRIPS] = 0
        if code[STATUS] & CONFIRMED != 0:
            code[AGE] += 1
            if code[AGE] >= AGE_CYCLES:
                code[STATUS] &= ~CONFIRMED
                code[AGE] = 0


@kernel
def reset_codes(codes: Integers) -> None:
    """Clear every code."""
    for message in range(codes.shape[0]):
        for monitor in range(codes.shape[1]):
            for column in range(COLUMNS):
                codes[message, monitor, column] = 0
            codes[message, monitor, STATUS] = CLEARED


@kernel
def count_codes(codes: Integers) -> Any:
    """Return how many codes fail now, and how many are confirmed."""
    failing, confirmed = 0, 0
    for message in range(codes.shape[0]):
        for monitor in range(codes.shape[1]):
            status = codes[message, monitor, STATUS]
            failing += 1 if status & TEST_FAILED != 0 else 0
            confirmed += 1 if status & CONFIRMED != 0 else 0
    return failing, confirmed


_LETTERS = "PCBU"
_CODE = re.compile(r"[PCBU][0-3][0-9A-F]{3}")


def code_number(text: str, where: str) -> int:
    """Return the 24-bit number of a code without failure type: ``U1101`` is 0xD10100; raises InputError."""
    if not _CODE.fullmatch(text):
        raise InputError(where, "a trouble code such as 'U1101'", f"'{text}'")
    return (_LETTERS.index(text[0]) << 14 | int(text[1:], 16)) << 8


def code_text(number: int) -> str:
    """Return a code as people write it: 0xD10187 is ``U1101-87``."""
    return f"{_LETTERS[number >> 22]}{number >> 8 & 0x3FFF:04X}-{number & 0xFF:02X}"


_Count = Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]


class TroubleCode(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One trouble code: its status bits and how often and when it occurred (times of the run)."""

    code: str
    message: str
    status: Annotated[int, msgspec.Meta(ge=0, le=255)]
    occurrences: _Count = 0
    trips: _Count = 0
    age: _Count = 0
    first_ns: _Count = 0
    last_ns: _Count = 0

    @property
    def bits(self) -> tuple[str, ...]:
        """The names of the status bits that are set."""
        return tuple(name for bit, name in BIT_NAMES.items() if self.status & bit)


def read_codes(codes: Integers, numbers: Integers, names: tuple[str, ...]) -> list[TroubleCode]:
    """Return every code that has failed since it was cleared, or is confirmed.

    Args:
        codes: the state.
        numbers: (messages,) the codes' numbers, 0 for none.
        names: of the messages.
    """
    found = []
    for message in np.flatnonzero(numbers):
        for monitor, failure in enumerate(FAILURES):
            row = codes[message, monitor].tolist()
            if row[STATUS] & (FAILED_SINCE_CLEAR | CONFIRMED | PENDING):
                found.append(
                    TroubleCode(
                        code=code_text(int(numbers[message]) | failure),
                        message=names[message],
                        status=row[STATUS],
                        occurrences=row[OCCURRENCES],
                        trips=row[TRIPS],
                        age=row[AGE],
                        first_ns=row[FIRST_NS],
                        last_ns=row[LAST_NS],
                    )
                )
    return found


def write_codes(stored: list[TroubleCode], codes: Integers, numbers: Integers) -> list[str]:
    """Put stored codes back; return those that no message has (any more)."""
    places = {
        code_text(int(number) | failure): (message, monitor)
        for message, number in enumerate(numbers)
        for monitor, failure in enumerate(FAILURES)
        if number
    }
    strangers = []
    for each in stored:
        if each.code not in places:
            strangers.append(each.code)
            continue
        codes[places[each.code]] = [
            each.status & 0x7F, each.trips, each.age, each.occurrences, each.first_ns, each.last_ns,
        ]  # fmt: skip
    return strangers
