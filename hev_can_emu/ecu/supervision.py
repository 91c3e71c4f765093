"""How the emulated units watch what they receive, and what they do when it fails.

A request message is *good* when its frame passed protection, every signal lies in its range and none but
the optional ones is "not available".  Only a good frame is obeyed and refreshes the time-out; of any other
nothing is taken.  At the first tick at which the last good frame is older than the time-out, the message is
lost: the request ports it covers follow its reaction (ramp to zero, hold), and a status port says why.  The
next good frame heals it at once.

The message of an external unit is watched too: three periods without a frame, and what it reported
(``external_*`` ports) is not available any more, so that no torque acts for ever.  What the driver and the
surroundings were last said to be stays.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports
from hev_can_emu.ecu.ties import (
    OWNER_EXTERNAL,
    REACT_HOLD,
    ROLE_CONTROLLER,
    ResolvedBindings,
    received_value,
)
from hev_can_emu.jit import kernel
from hev_can_emu.messages.protection import (
    COUNTER_JUMP,
    COUNTER_REPEATED,
    CRC_WRONG,
    LENGTH_WRONG,
    is_accepted,
)
from hev_can_emu.plant.events import note

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

GOOD = 1.0  #: share of a port whose message is good, or not watched
GONE = 0.0  #: share of a port ramped down to zero, or of an external unit that reports nothing
HELD = -1.0  #: share of a port whose message is lost and whose last value is held

# 1 for the ports that lose their value with the external unit that reports them.
LOSABLE = np.array([port.name.startswith("external_") for port in ports.REQUESTS], dtype=np.uint8)


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
def _defect(ties: ResolvedBindings, message: int, values: Array) -> int:
    """Return the REQUEST_* code of a request message's content."""
    for tie in range(ties.rx_start[message], ties.rx_start[message + 1]):
        value = values[ties.rx_signal[tie]]
        if math.isnan(value):
            if ties.rx_optional[tie] == 0:
                return ports.REQUEST_NOT_AVAILABLE
        elif value < ties.rx_low[tie] or value > ties.rx_high[tie]:
            return ports.REQUEST_RANGE
        elif ties.rx_optional[tie] == 0 and math.isnan(received_value(ties, values, tie)):
            return ports.REQUEST_NOT_AVAILABLE
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
    if code != ports.REQUEST_OK:
        state[message, REFUSED] += 1
    node = ties.message_node[message]
    asks = node >= 0 and ties.node_role[node] == ROLE_CONTROLLER
    if is_accepted(protection_code, mode):
        code = _defect(ties, message, values) if asks else ports.REQUEST_OK
    if code != ports.REQUEST_OK:
        state[message, BAD_NS] = t_ns
        state[message, BAD_CODE] = code
        return
    state[message, GOOD_NS] = t_ns
    if node < 0 or not (asks or ties.node_ownership[node] == OWNER_EXTERNAL):
        return
    for tie in range(ties.rx_start[message], ties.rx_start[message + 1]):
        port = ties.rx_port[tie]
        value = received_value(ties, values, tie)
        signal = values[ties.rx_signal[tie]]
        if signal < ties.rx_low[tie] or signal > ties.rx_high[tie]:
            value = np.nan
        # A driver's or road's quantity that is not available right now stays as it was.
        if asks or LOSABLE[port] == 1 or not math.isnan(value):
            requests[port] = value


@kernel
def _watch_unit(
    ties: ResolvedBindings,
    state: Integers,
    message: int,
    requests: Array,
    effective: Array,
    share: Array,
    t_ns: int,
) -> int:
    """Watch a message of an external unit: take away what it does not report (any more)."""
    good, limit = state[message, GOOD_NS], ties.silence_ns[message]
    status = ports.REQUEST_OK
    if good == NEVER_NS:
        status = ports.REQUEST_NEVER
    elif limit > 0 and t_ns - good > limit:
        status = _why(state, message, ports.REQUEST_TIMEOUT, limit, t_ns)
    for tie in range(ties.rx_start[message], ties.rx_start[message + 1]):
        port = ties.rx_port[tie]
        if LOSABLE[port] == 1 and (status != ports.REQUEST_OK or math.isnan(requests[port])):
            effective[port] = np.nan
            share[port] = GONE
    return status


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
        effective: out, request ports after reactions; NaN for what was never received, and for what
            an external unit does not report.
        share: out, GOOD; falling from it to GONE while a lost request ramps down; HELD for a lost one
            that is held; GONE for what an external unit does not report.
        statuses: status ports; those of the supervised messages are written.
        t_ns: now.
        events, n_events: event records.

    Returns:
        The number of supervised messages that are not good, and of event records.
    """
    for port in range(requests.shape[0]):
        effective[port] = requests[port]
        share[port] = GOOD
    failed = 0
    for message in range(state.shape[0]):
        good, limit = state[message, GOOD_NS], ties.timeout_ns[message]
        if ties.supervised[message] == 1:
            status = ports.REQUEST_OK
            if good == NEVER_NS:
                status = _why(state, message, ports.REQUEST_NEVER, limit, t_ns)
            elif t_ns - good > limit:
                status = _why(state, message, ports.REQUEST_TIMEOUT, limit, t_ns)
        elif ties.rx_start[message] < ties.rx_start[message + 1] and (
            ties.node_ownership[ties.message_node[message]] == OWNER_EXTERNAL
            and ties.node_role[ties.message_node[message]] != ROLE_CONTROLLER
        ):
            status = _watch_unit(ties, state, message, requests, effective, share, t_ns)
        else:
            continue

        lost = good != NEVER_NS and status != ports.REQUEST_OK
        first, last = ties.cover_start[message], ties.cover_start[message + 1]
        if lost and state[message, LOST_NS] == NEVER_NS:
            state[message, LOST_NS] = t_ns
            state[message, LOSSES] += 1
            for i in range(first, last):
                held[ties.cover_port[i]] = requests[ties.cover_port[i]]
            n_events = note(events, n_events, t_ns, LOST, message, float(status))
        elif not lost and state[message, LOST_NS] != NEVER_NS:
            state[message, LOST_NS] = NEVER_NS
            n_events = note(events, n_events, t_ns, HEALED, message, 0.0)

        if lost:
            keep, told = 1.0, HELD
            if ties.reaction[message] != REACT_HOLD:
                gone = t_ns - state[message, LOST_NS]
                keep = GONE
                if ties.ramp_ns[message] > 0:
                    keep = max(GONE, GOOD - gone / ties.ramp_ns[message])
                told = keep
            for i in range(first, last):
                effective[ties.cover_port[i]] = held[ties.cover_port[i]] * keep
                share[ties.cover_port[i]] = told
        elif status != ports.REQUEST_OK:
            for i in range(first, last):
                effective[ties.cover_port[i]] = np.nan
                share[ties.cover_port[i]] = GONE
        state[message, STATUS] = status
        if ties.supervised[message] == 1 and status != ports.REQUEST_OK:
            failed += 1
        if ties.status_port[message] >= 0:
            statuses[ties.status_port[message]] = status
    return failed, n_events


@kernel
def _why(state: Integers, message: int, otherwise: int, recent_ns: int, t_ns: int) -> int:
    """Return the reason of a loss: what is wrong with the frames that come, or ``otherwise``."""
    if t_ns - state[message, BAD_NS] <= recent_ns:
        return int(state[message, BAD_CODE])
    return otherwise
