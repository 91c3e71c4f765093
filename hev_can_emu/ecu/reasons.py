"""Why a received request is not good: names, what the bus is told, which failure type a trouble code has.

Failure types: SAE J2012-DA, the third byte of a trouble code of ISO 15031-6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hev_can_emu.ecu import ports
from hev_can_emu.jit import kernel
from hev_can_emu.messages.protection import (
    COUNTER_JUMP,
    COUNTER_REPEATED,
    CRC_WRONG,
    LENGTH_WRONG,
)


class Reason(NamedTuple):
    """One reason: ``text`` for people, ``status`` the REQUEST_* code, ``failure`` the type, 0 none."""

    text: str
    status: int
    failure: int


(
    R_OK, R_NEVER, R_TIMEOUT, R_CRC, R_FROZEN, R_JUMP, R_LENGTH, R_LOW, R_HIGH, R_NOT_AVAILABLE,
    R_SLEW, R_IMPLAUSIBLE,
) = range(12)  # fmt: skip

REASONS = (
    Reason("ok", ports.REQUEST_OK, 0),
    Reason("never received", ports.REQUEST_NEVER, 0),
    Reason("timed out", ports.REQUEST_TIMEOUT, 0x87),  # missing message
    Reason(
        "wrong CRC", ports.REQUEST_CRC, 0x83
    ),  # value of signal protection calculation incorrect
    Reason("counter frozen", ports.REQUEST_COUNTER, 0x82),  # alive / sequence counter incorrect
    Reason("counter jumped", ports.REQUEST_COUNTER, 0x82),
    Reason("wrong length", ports.REQUEST_LENGTH, 0x81),  # invalid serial data received
    Reason("below its range", ports.REQUEST_RANGE, 0x84),  # signal below allowable range
    Reason("above its range", ports.REQUEST_RANGE, 0x85),  # signal above allowable range
    Reason("not available", ports.REQUEST_NOT_AVAILABLE, 0x86),  # signal invalid
    Reason(
        "changed too fast", ports.REQUEST_CHANGED_TOO_FAST, 0x27
    ),  # rate of change above threshold
    Reason("implausible", ports.REQUEST_IMPLAUSIBLE, 0x64),  # signal plausibility failure
)
N_REASONS = len(REASONS)

FAILURES = tuple(dict.fromkeys(reason.failure for reason in REASONS if reason.failure))
"""The failure types that a message's trouble codes can have: one monitor each."""

STATUS_OF = np.array([reason.status for reason in REASONS], dtype=np.int64)
MONITOR_OF = np.array(
    [FAILURES.index(reason.failure) if reason.failure else -1 for reason in REASONS],
    dtype=np.int64,
)


@kernel
def reason_of(protection_code: int) -> int:
    """Return the reason behind what the receiver concluded."""
    if protection_code == CRC_WRONG:
        return R_CRC
    if protection_code == COUNTER_REPEATED:
        return R_FROZEN
    if protection_code == COUNTER_JUMP:
        return R_JUMP
    if protection_code == LENGTH_WRONG:
        return R_LENGTH
    return R_OK
