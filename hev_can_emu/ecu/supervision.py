"""How the emulated units watch what they receive, and what they do when it fails.

A request is *good* when its frame passed protection and carries no "not available".  Only a good frame
refreshes the time-out.  When a supervised message has had no good frame for longer than its
time-out, it is lost: the request ports it covers follow its reaction (ramp to zero, hold), and a status port
says why.  The next good frame heals it at once.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports
from hev_can_emu.ecu.ties import REACT_HOLD, ResolvedBindings, requests_from_signals
from hev_can_emu.jit import kernel
from hev_can_emu.messages.protection import (
    COUNTER_JUMP,
    COUNTER_REPEATED,
    CRC_WRONG,
    LENGTH_WRONG,
    is_accepted,
)

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# Columns of the state, one row per message.
GOOD_NS = 0  # time of the last good frame, NEVER before the first
LOST_NS = 1  # since when the message is lost, NEVER while it is not
BAD_NS = 2  # time of the last frame that was not good
BAD_CODE = 3  # REQUEST_* code of that frame
STATUS = 4  # REQUEST_* code now
LOSSES = 5  # times lost
REFUSED = 6  # frames refused
COLUMNS = 7

NEVER_NS = -(1 << 62)

LOST, HEALED = 10, 11  #: kinds of events; index: the message, value: REQUEST_* code


@kernel
def reset_supervision(state: Integers) -> None:
    """Forget everything received; ``state``: shape (messages, COLUMNS)."""
    for message in range(state.shape[0]):
        for column in range(COLUMNS):
            state[message, column] = 0
        state[message, GOOD_NS] = NEVER_NS
        state[message, LOST_NS] = NEVER_NS
        state[message, BAD_NS] = NEVER_NS
        state[message, STATUS] = ports.REQUEST_NEVER


@kernel
def request_code(protection_code: int) -> int:
    """Return the REQUEST_* code of a protection code."""
    if protection_code == CRC_WRONG:
        return ports.REQUEST_CRC
    if protection_code in (COUNTER_REPEATED, COUNTER_JUMP):
        return ports.REQUEST_COUNTER
    if protection_code == LENGTH_WRONG:
        return ports.REQUEST_LENGTH
    return ports.REQUEST_OK


@kernel
def take_message(
    ties: ResolvedBindings,
    state: Integers,
    message: int,
    protection_code: int,
    mode: int,
    values: Array,
    requests: Array,
    t_ns: int,
) -> None:
    """Take one received message into account.

    Args:
        ties: the bindings.
        state: shape (messages, COLUMNS).
        message: its index.
        protection_code: what the receiver concluded.
        mode: protection mode.
        values: decoded signals.
        requests: request ports as received, written where the frame may be used.
        t_ns: now.
    """
    code = request_code(protection_code)
    if not is_accepted(protection_code, mode):
        state[message, BAD_NS] = t_ns
        state[message, BAD_CODE] = code
        state[message, REFUSED] += 1
        return
    requests_from_signals(ties, message, values, requests)
    for tie in range(ties.rx_start[message], ties.rx_start[message + 1]):
        if ties.rx_optional[tie] == 0 and math.isnan(requests[ties.rx_port[tie]]):
            state[message, BAD_NS] = t_ns
            state[message, BAD_CODE] = ports.REQUEST_NOT_AVAILABLE
            return
    state[message, GOOD_NS] = t_ns


@kernel
def _note(
    events: npt.NDArray[np.void], n_events: int, t_ns: int, kind: int, index: int, value: float
) -> int:
    if n_events < events.shape[0]:
        events[n_events]["t_ns"] = t_ns
        events[n_events]["kind"] = kind
        events[n_events]["index"] = index
        events[n_events]["value"] = value
        return n_events + 1
    return n_events


@kernel
def watch(
    ties: ResolvedBindings,
    state: Integers,
    requests: Array,
    held: Array,
    effective: Array,
    share: Array,
    statuses: Array,
    t_ns: int,
    events: npt.NDArray[np.void],
    n_events: int,
) -> Any:
    """Look for time-outs and write what the units act on.

    Args:
        ties: the bindings.
        state: shape (messages, COLUMNS), changed in place.
        requests: request ports as received.
        held: request ports at the moment of their loss, changed in place.
        effective: out, request ports after reactions; NaN for what was never received.
        share: out, 1 for good requests, falling to 0 while a lost one ramps down.
        statuses: status ports; those of the supervised messages are written.
        t_ns: now.
        events, n_events: event records.

    Returns:
        The number of supervised messages that are not good, and of event records.
    """
    for port in range(requests.shape[0]):
        effective[port] = requests[port]
        share[port] = 1.0
    failed = 0
    for message in range(state.shape[0]):
        if ties.supervised[message] == 0:
            continue
        good = state[message, GOOD_NS]
        status = ports.REQUEST_OK
        first, last = ties.cover_start[message], ties.cover_start[message + 1]
        if good == NEVER_NS:
            status = ports.REQUEST_NEVER
            if state[message, BAD_NS] != NEVER_NS:
                status = state[message, BAD_CODE]
            for i in range(first, last):
                effective[ties.cover_port[i]] = np.nan
        elif t_ns - good > ties.timeout_ns[message]:
            if state[message, LOST_NS] == NEVER_NS:
                state[message, LOST_NS] = t_ns
                state[message, LOSSES] += 1
                for i in range(first, last):
                    held[ties.cover_port[i]] = requests[ties.cover_port[i]]
                status = _why(state, message, good)
                n_events = _note(events, n_events, t_ns, LOST, message, float(status))
            status = _why(state, message, good)
            factor = 1.0
            if ties.reaction[message] != REACT_HOLD:
                gone = t_ns - state[message, LOST_NS]
                factor = 0.0
                if ties.ramp_ns[message] > 0:
                    factor = max(0.0, 1.0 - gone / ties.ramp_ns[message])
            for i in range(first, last):
                port = ties.cover_port[i]
                effective[port] = held[port] * factor
                share[port] = factor
        elif state[message, LOST_NS] != NEVER_NS:
            state[message, LOST_NS] = NEVER_NS
            n_events = _note(events, n_events, t_ns, HEALED, message, 0.0)
        state[message, STATUS] = status
        if status != ports.REQUEST_OK:
            failed += 1
        if ties.status_port[message] >= 0:
            statuses[ties.status_port[message]] = status
    return failed, n_events


@kernel
def _why(state: Integers, message: int, good: int) -> int:
    """Return the reason of a loss: what was wrong with the frames since the last good one, if any came."""
    if state[message, BAD_NS] > good:
        return int(state[message, BAD_CODE])
    return ports.REQUEST_TIMEOUT
