"""Whether a request message's content can be meant: available, in range, not too fast, plausible."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu.reasons import (
    R_HIGH,
    R_IMPLAUSIBLE,
    R_LOW,
    R_NOT_AVAILABLE,
    R_OK,
    R_SLEW,
)
from hev_can_emu.ecu.rules import Rules
from hev_can_emu.ecu.ties import ResolvedBindings, received_value
from hev_can_emu.jit import kernel

Array = npt.NDArray[np.float64]


@kernel
def _signals(ties: ResolvedBindings, rules: Rules, message: int, values: Array) -> int:
    """Return what is wrong with the signals for themselves."""
    for tie in range(ties.rx_start[message], ties.rx_start[message + 1]):
        value = values[ties.rx_signal[tie]]
        if math.isnan(value):
            if ties.rx_optional[tie] == 0:
                return R_NOT_AVAILABLE
        elif value < ties.rx_low[tie] and rules.ignored[message, R_LOW] == 0:
            return R_LOW
        elif value > ties.rx_high[tie] and rules.ignored[message, R_HIGH] == 0:
            return R_HIGH
        elif ties.rx_optional[tie] == 0 and math.isnan(received_value(ties, values, tie)):
            return R_NOT_AVAILABLE
    return R_OK


@kernel
def defect(
    ties: ResolvedBindings,
    rules: Rules,
    message: int,
    values: Array,
    requests: Array,
    statuses: Array,
    since_ns: int,
) -> int:
    """Return the reason for which a request message is not good, or R_OK.

    Args:
        ties, rules: the bindings.
        message: its index.
        values: decoded signals.
        requests: request ports as the last good frame left them.
        statuses: status ports.
        since_ns: time since that frame, below 0 for none.
    """
    reason = _signals(ties, rules, message, values)
    if reason != R_OK:
        return reason
    for row in range(rules.limit_start[message], rules.limit_start[message + 1]):
        value = received_value(ties, values, rules.limit_tie[row])
        if rules.limit_refuse[row] == 1:
            if value < rules.limit_low[row]:
                return R_LOW
            if value > rules.limit_high[row]:
                return R_HIGH
    for row in range(rules.slew_start[message], rules.slew_start[message + 1]):
        if rules.slew_refuse[row] == 1 and since_ns >= 0:
            tie = rules.slew_tie[row]
            change = abs(received_value(ties, values, tie) - requests[ties.rx_port[tie]])
            if change > rules.slew_rate[row] * since_ns * 1e-9 + rules.slew_slack[row]:
                return R_SLEW
    for row in range(rules.claim_start[message], rules.claim_start[message + 1]):
        value = received_value(ties, values, rules.claim_tie[row])
        actual = statuses[rules.claim_status[row]]
        if math.isnan(rules.claim_when[row]):
            difference = value - actual
        elif value == rules.claim_when[row]:
            difference = actual
        else:
            continue
        if difference < rules.claim_low[row] or difference > rules.claim_high[row]:
            return R_IMPLAUSIBLE
    return R_OK
