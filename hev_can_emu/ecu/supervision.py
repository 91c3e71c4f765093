"""How the emulated units watch what they receive, and what they do when it fails.

A request message is *good* when its frame passed protection, every signal lies in its range and none but
the optional ones is "not available", it changed no faster than declared, and the plant does not
contradict it.  Only a good frame is obeyed and refreshes the time-out; of any other nothing is taken.  The
message is *lost* at the first tick at which the last good frame is older than the time-out, or when as many
bad frames as declared came in a row: the request ports it covers follow its reaction, and a status
port says why.  As many good frames as declared heal it.  :data:`NEXT` is the whole of it as a table.

The message of an external unit is watched too: three periods without a frame, and what it reported
(``external_*`` ports) is not available any more, so that no torque acts for ever.  What the driver and the
surroundings were last said to be stays.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports, trouble_codes
from hev_can_emu.ecu.frame_checks import defect
from hev_can_emu.ecu.reactions import GONE, GOOD, open_clutch, react
from hev_can_emu.ecu.reasons import (
    MONITOR_OF,
    N_REASONS,
    R_NEVER,
    R_OK,
    R_TIMEOUT,
    STATUS_OF,
    reason_of,
)
from hev_can_emu.ecu.rules import Rules
from hev_can_emu.ecu.ties import (
    OWNER_EXTERNAL,
    ROLE_CONTROLLER,
    ResolvedBindings,
    received_value,
)
from hev_can_emu.ecu.trouble_codes import code_event
from hev_can_emu.jit import inlined_kernel, kernel
from hev_can_emu.messages.protection import is_accepted
from hev_can_emu.plant.events import note

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.uint8]

# Columns of the state, one row per message; the counts of bad frames by reason follow.
GOOD_NS = 0  # time of the last good frame, NEVER before the first
LOST_NS = 1  # since when the message is lost, NEVER while it is not
BAD_NS = 2  # time of the last frame that was not good
BAD_REASON = 3  # of that frame
STATUS = 4  # REQUEST_* code now
LOSSES = 5  # times lost
REFUSED = 6  # frames with a wrong length, CRC or counter
PHASE = 7
GOOD_RUN = 8  # good frames in a row, since the loss
BAD_RUN = 9  # bad frames in a row
TOLD = 10  # what the trouble codes know in this operation cycle: NOTHING, PASSED, FAILED
REASON = 11  # of the loss
CALM_NS = 12  # until then nothing about the message changes, unless a frame of it comes
COUNTS = 13
COLUMNS = COUNTS + N_REASONS

NEVER_NS = -(1 << 62)
EVER_NS = (1 << 63) - 1

NEVER, WELL, SUSPECT, LOST_PHASE, HEALING = range(5)  #: phases of a message
PHASE_NAMES = ("never received", "good", "suspect", "lost", "healing")

# What a tick sees of a message.
(
    E_NOTHING,  # no frame yet, or since the loss
    E_GOOD,  # the last frame was good
    E_BAD,  # it was not
    E_FAILED,  # so many bad ones in a row that the message is lost
    E_HEALED,  # so many good ones in a row that it is not any more
    E_SILENT,  # the last good one is older than the time-out
) = range(6)

NEXT = np.zeros((5, 6), dtype=np.int64)  #: (phase, event) -> phase
# Events in the order above.  NEVER sees another event than the first only once a good frame has come.
NEXT[NEVER] = (NEVER, WELL, SUSPECT, LOST_PHASE, WELL, LOST_PHASE)
NEXT[WELL] = (WELL, WELL, SUSPECT, LOST_PHASE, WELL, LOST_PHASE)
NEXT[SUSPECT] = (SUSPECT, WELL, SUSPECT, LOST_PHASE, WELL, LOST_PHASE)
NEXT[LOST_PHASE] = (LOST_PHASE, HEALING, LOST_PHASE, LOST_PHASE, WELL, LOST_PHASE)
NEXT[HEALING] = (HEALING, HEALING, LOST_PHASE, LOST_PHASE, WELL, LOST_PHASE)

_NOTHING, _PASSED, _FAILED = 0, 1, 2

LOST, HEALED = 10, 11  #: kinds of events; index: the message, value of LOST: reason, reaction
REACTION_STEP = (
    100  #: the value is reason + REACTION_STEP * (reaction + 1), without the latter for a unit
)

TICK_S = 1e-3  #: between two calls of :func:`watch`, s

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
        state[message, CALM_NS] = NEVER_NS
        state[message, STATUS] = ports.REQUEST_NEVER


@kernel
def is_taken(rules: Rules, message: int, protection_code: int, mode: int) -> bool:
    """Whether a frame's content may be looked at: by the protection mode, or because told to ignore."""
    if is_accepted(protection_code, mode):
        return True
    return bool(rules.ignored[message, reason_of(protection_code)] == 1)


@kernel
def take_message(
    ties: ResolvedBindings,
    rules: Rules,
    state: Integers,
    message: int,
    protection_code: int,
    mode: int,
    values: Array,
    requests: Array,
    statuses: Array,
    t_ns: int,
) -> Any:
    """Take one received message into account.

    Args:
        ties, rules: the bindings.
        state: shape (messages, COLUMNS).
        message: its index.
        protection_code: what the receiver concluded.
        mode: protection mode.
        values: decoded signals.
        requests: request ports as received, written where the frame may be used.
        statuses: status ports, with which a request must agree.
        t_ns: now.

    Returns:
        Whether :func:`watch` has anything new to see: not when one more frame asks what was asked before,
        where all was well.
    """
    reason = reason_of(protection_code)
    if reason != R_OK:
        state[message, REFUSED] += 1
    node = ties.message_node[message]
    asks = node >= 0 and ties.node_role[node] == ROLE_CONTROLLER
    if is_taken(rules, message, protection_code, mode):
        reason = R_OK
        if asks:
            since = t_ns - state[message, GOOD_NS] if state[message, GOOD_NS] != NEVER_NS else -1
            reason = defect(ties, rules, message, values, requests, statuses, since)
    calm = asks and reason == R_OK and state[message, CALM_NS] != NEVER_NS
    state[message, CALM_NS] = t_ns + ties.timeout_ns[message] if calm else NEVER_NS
    if reason != R_OK:
        state[message, BAD_NS] = t_ns
        state[message, BAD_REASON] = reason
        state[message, BAD_RUN] += 1
        state[message, GOOD_RUN] = 0
        state[message, COUNTS + reason] += 1
        return True
    state[message, GOOD_NS] = t_ns
    state[message, GOOD_RUN] += 1
    state[message, BAD_RUN] = 0
    news = not calm
    if node < 0 or not (asks or ties.node_ownership[node] == OWNER_EXTERNAL):
        return news
    for tie in range(ties.rx_start[message], ties.rx_start[message + 1]):
        port = ties.rx_port[tie]
        value = received_value(ties, values, tie)
        signal = values[ties.rx_signal[tie]]
        if not asks and (signal < ties.rx_low[tie] or signal > ties.rx_high[tie]):
            value = np.nan
        # A driver's or road's quantity that is not available right now stays as it was.
        if asks or LOSABLE[port] == 1 or not math.isnan(value):
            before = requests[port]
            news |= value != before and not (math.isnan(value) and math.isnan(before))
            requests[port] = value
    return news


@kernel
def _why(state: Integers, message: int, otherwise: int, recent_ns: int, t_ns: int) -> int:
    """Return the reason of a loss: what is wrong with the frames that come, or ``otherwise``."""
    if t_ns - state[message, BAD_NS] <= recent_ns:
        return int(state[message, BAD_REASON])
    return otherwise


@kernel
def _event_of(rules: Rules, state: Integers, message: int, limit_ns: int, t_ns: int) -> int:
    """Return what this tick sees of a supervised message."""
    phase = state[message, PHASE]
    good_ns = state[message, GOOD_NS]
    if good_ns == NEVER_NS:
        return E_NOTHING
    if t_ns - good_ns > limit_ns:
        return E_SILENT
    bad, good = state[message, BAD_RUN], state[message, GOOD_RUN]
    if phase in (LOST_PHASE, HEALING):
        if good >= rules.healed[message]:
            return E_HEALED
    elif rules.failed[message] > 0 and bad >= rules.failed[message]:
        return E_FAILED
    if bad > 0:
        return E_BAD
    return E_GOOD if good > 0 else E_NOTHING


@kernel
def _tell_codes(
    rules: Rules, state: Integers, codes: Integers, message: int, reason: int, t_ns: int
) -> bool:
    """Let a message's trouble codes know how it fares; return whether one of them changed."""
    if rules.number[message] == 0:
        return False
    phase = state[message, PHASE]
    if phase in (WELL, SUSPECT):
        if state[message, TOLD] == _PASSED:
            return False
        state[message, TOLD] = _PASSED
        for monitor in range(codes.shape[1]):
            code_event(codes[message, monitor], trouble_codes.PASSED, 1, t_ns)
        return True
    if phase == NEVER or state[message, TOLD] == _FAILED:
        return False
    state[message, TOLD] = _FAILED
    monitor = MONITOR_OF[reason]
    if monitor >= 0:
        code_event(codes[message, monitor], trouble_codes.FAILED, rules.confirm[message], t_ns)
    return True


@kernel
def begin_cycle(state: Integers, codes: Integers, t_ns: int) -> None:
    """Begin an operation cycle: the ignition was switched on."""
    for message in range(state.shape[0]):
        state[message, TOLD] = _NOTHING
        state[message, CALM_NS] = NEVER_NS
        for monitor in range(codes.shape[1]):
            code_event(codes[message, monitor], trouble_codes.CYCLE_BEGINS, 1, t_ns)


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
    """Watch a message of an external unit: take away what it does not report (any more); return why."""
    good, limit = state[message, GOOD_NS], ties.silence_ns[message]
    status = R_OK
    if good == NEVER_NS:
        status = R_NEVER
    elif limit > 0 and t_ns - good > limit:
        status = _why(state, message, R_TIMEOUT, limit, t_ns)
    for tie in range(ties.rx_start[message], ties.rx_start[message + 1]):
        port = ties.rx_port[tie]
        if LOSABLE[port] == 1 and (status != R_OK or math.isnan(requests[port])):
            effective[port] = np.nan
            share[port] = GONE
    return status


@kernel
def _calm_until(
    ties: ResolvedBindings,
    rules: Rules,
    state: Integers,
    message: int,
    requests: Array,
    operating: bool,
) -> int:
    """Return until when nothing about a message that is not lost can change without a frame of it."""
    good = state[message, GOOD_NS]
    if ties.supervised[message] == 1:
        known = rules.number[message] == 0 or not operating or state[message, TOLD] == _PASSED
        if state[message, PHASE] == WELL and state[message, BAD_RUN] == 0 and known:
            return int(good + ties.timeout_ns[message])
        return NEVER_NS
    for tie in range(ties.rx_start[message], ties.rx_start[message + 1]):
        port = ties.rx_port[tie]
        if LOSABLE[port] == 1 and math.isnan(requests[port]):
            return NEVER_NS
    return int(good + ties.silence_ns[message]) if ties.silence_ns[message] > 0 else EVER_NS


@inlined_kernel
def watch(
    ties: ResolvedBindings,
    rules: Rules,
    state: Integers,
    requests: Array,
    kept: Array,
    effective: Array,
    share: Array,
    limited: Array,
    slewed: Array,
    statuses: Array,
    codes: Integers,
    operating: bool,
    t_ns: int,
    events: npt.NDArray[np.void],
    n_events: int,
) -> Any:
    """Look for time-outs and write what the units act on.

    Args:
        ties, rules: the bindings.
        state: shape (messages, COLUMNS), changed in place.
        requests: request ports as received.
        kept: request ports at the moment of their loss, changed in place.
        effective: out, request ports after limits and reactions; NaN for what was never received, and
            for what an external unit does not report.
        share: out, GOOD; falling from it to GONE while a lost request ramps down; HELD for a lost one
            that something stands in for; GONE for what an external unit does not report.
        limited: out, per request port the LIMIT_* code of what limits it, 0 for nothing.
        slewed: per row of ``rules.slew_tie``, the value that acted last, NaN for none; changed in place.
        statuses: status ports; those of the supervised messages are written.
        codes: trouble codes, shape (messages, failure types, trouble_codes.COLUMNS).
        operating: whether trouble codes are recorded: ignition on.
        t_ns: now.
        events, n_events: event records.

    Returns:
        The number of supervised messages that are not good, of event records, whether a trouble code
        has changed, and until when all this stays as it is if no frame comes.
    """
    for port in range(requests.shape[0]):
        effective[port] = requests[port]
        share[port] = GOOD
        limited[port] = 0.0
    _limit(ties, rules, effective, limited)
    failed = 0
    changed = False
    clutch = GOOD
    calm_ns: Any = np.int64(EVER_NS if rules.slew_tie.shape[0] == 0 else NEVER_NS)
    for message in rules.watched:
        if t_ns <= state[message, CALM_NS]:
            calm_ns = min(calm_ns, state[message, CALM_NS])
            if ties.status_port[message] >= 0:  # a fault may have written there
                statuses[ties.status_port[message]] = state[message, STATUS]
            continue
        supervised = ties.supervised[message] == 1
        limit = ties.timeout_ns[message]
        if supervised:
            before = state[message, PHASE]
            event = _event_of(rules, state, message, limit, t_ns)
            state[message, PHASE] = NEXT[before, event]
            lost = state[message, PHASE] >= LOST_PHASE
            reason = R_OK
            if state[message, PHASE] == NEVER:
                reason = _why(state, message, R_NEVER, limit, t_ns)
            elif event == E_SILENT or (lost and before < LOST_PHASE):
                reason = _why(state, message, R_TIMEOUT, limit, t_ns)
            elif lost:
                reason = _why(state, message, state[message, REASON], limit, t_ns)
        elif ties.rx_start[message] < ties.rx_start[message + 1] and (
            ties.node_ownership[ties.message_node[message]] == OWNER_EXTERNAL
            and ties.node_role[ties.message_node[message]] != ROLE_CONTROLLER
        ):
            reason = _watch_unit(ties, state, message, requests, effective, share, t_ns)
            lost = state[message, GOOD_NS] != NEVER_NS and reason != R_OK
        else:
            continue

        first, last = ties.cover_start[message], ties.cover_start[message + 1]
        told = reason + (REACTION_STEP * (ties.reaction[message] + 1) if supervised else 0)
        if lost and state[message, LOST_NS] == NEVER_NS:
            state[message, LOST_NS] = t_ns
            state[message, LOSSES] += 1
            state[message, GOOD_RUN] = 0
            for i in range(first, last):
                kept[ties.cover_port[i]] = requests[ties.cover_port[i]]
            n_events = note(events, n_events, t_ns, LOST, message, float(told))
        elif not lost and state[message, LOST_NS] != NEVER_NS:
            state[message, LOST_NS] = NEVER_NS
            n_events = note(events, n_events, t_ns, HEALED, message, 0.0)
        state[message, REASON] = reason
        if supervised and operating and _tell_codes(rules, state, codes, message, reason, t_ns):
            changed = True

        if lost:
            gone_ns = t_ns - state[message, LOST_NS]
            clutch = min(
                clutch, react(ties, rules, message, kept, effective, share, statuses, gone_ns)
            )
        elif reason != R_OK:
            for i in range(first, last):
                effective[ties.cover_port[i]] = np.nan
                share[ties.cover_port[i]] = GONE
        state[message, STATUS] = STATUS_OF[reason]
        if supervised and reason != R_OK:
            failed += 1
        if ties.status_port[message] >= 0:
            statuses[ties.status_port[message]] = STATUS_OF[reason]
        calm = NEVER_NS
        if reason == R_OK and not lost:
            calm = _calm_until(ties, rules, state, message, requests, operating)
        state[message, CALM_NS] = calm
        calm_ns = min(calm_ns, calm)
    if clutch < GOOD:
        open_clutch(effective, share, clutch)
    _slew(ties, rules, effective, share, limited, slewed)
    return failed, n_events, changed, calm_ns


@kernel
def _limit(ties: ResolvedBindings, rules: Rules, effective: Array, limited: Array) -> None:
    """Hold requests within the limits that limit."""
    for row in range(rules.limit_tie.shape[0]):
        if rules.limit_refuse[row] == 1:
            continue
        port = ties.rx_port[rules.limit_tie[row]]
        value = effective[port]
        if value < rules.limit_low[row]:
            effective[port] = rules.limit_low[row]
            limited[port] = ports.LIMIT_RANGE
        elif value > rules.limit_high[row]:
            effective[port] = rules.limit_high[row]
            limited[port] = ports.LIMIT_RANGE


@kernel
def _slew(
    ties: ResolvedBindings,
    rules: Rules,
    effective: Array,
    share: Array,
    limited: Array,
    slewed: Array,
) -> None:
    """Let requests change no faster than the rates that limit; ``slewed`` remembers."""
    for row in range(rules.slew_tie.shape[0]):
        if rules.slew_refuse[row] == 1:
            continue
        port = ties.rx_port[rules.slew_tie[row]]
        step = rules.slew_rate[row] * TICK_S
        value, last = effective[port], slewed[row]
        if share[port] == GOOD and abs(value - last) > step:
            effective[port] = last + (step if value > last else -step)
            limited[port] = ports.LIMIT_SLEW
        slewed[row] = effective[port]
