"""Bindings as tables, and the kernels that carry values across them.

A *tie* joins one signal to one port by ``port = signal * gain + offset`` (or back), or by a map of
single values where the network's codes differ from the ports'.  NaN, not available, passes through.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from hev_can_emu.jit import kernel

ROLE_CONTROLLER, ROLE_EMULATED = 0, 1
OWNER_EMULATED, OWNER_EXTERNAL, OWNER_SILENT = 0, 1, 2
REACT_HOLD, REACT_RAMP_TO_ZERO, REACT_OPEN_CLUTCH, REACT_SUBSTITUTE, REACT_LIMP_HOME = 0, 1, 2, 3, 4

OWNERSHIPS = {"emulated": OWNER_EMULATED, "external": OWNER_EXTERNAL, "silent": OWNER_SILENT}
REACTIONS = {
    "hold": REACT_HOLD,
    "ramp_to_zero": REACT_RAMP_TO_ZERO,
    "open_clutch": REACT_OPEN_CLUTCH,
    "substitute": REACT_SUBSTITUTE,
    "limp_home": REACT_LIMP_HOME,
}


class ResolvedBindings(NamedTuple):
    """Bindings with names replaced by indices: M messages, N nodes, R received and T sent ties.

    The ties of message ``m`` are ``rx_start[m]`` to ``rx_start[m + 1] - 1`` (``tx_start`` alike, and
    ``cover_start`` for the request ports that the reaction of its supervision acts on).  A tie's map is
    ``map_value[i]`` (signal) against ``map_code[i]`` (port), i from ``map_start`` to ``map_stop - 1``;
    an empty one means gain and offset.  Indices and times (ns) are int64, flags uint8.
    """

    rx_start: np.ndarray  #: (M+1,)
    rx_signal: np.ndarray  #: (R,) index into the signal vector
    rx_port: np.ndarray  #: (R,) index into the request vector
    rx_gain: np.ndarray
    rx_offset: np.ndarray
    rx_map_start: np.ndarray
    rx_map_stop: np.ndarray
    rx_optional: np.ndarray  #: (R,) 1 where "not available" is no defect of the message
    rx_low: np.ndarray  #: (R,) least physical value of the signal, -inf for none
    rx_high: np.ndarray  #: (R,) greatest physical value of the signal, inf for none
    tx_start: np.ndarray  #: (M+1,)
    tx_signal: np.ndarray  #: (T,) index into the signal vector
    tx_port: np.ndarray  #: (T,) index into the status vector
    tx_gain: np.ndarray
    tx_offset: np.ndarray
    tx_map_start: np.ndarray
    tx_map_stop: np.ndarray
    map_value: np.ndarray
    map_code: np.ndarray
    message_node: np.ndarray  #: (M,) the sender's place in the bindings' nodes, -1 unbound
    node_role: np.ndarray  #: (N,) ROLE_*
    node_ownership: np.ndarray  #: (N,) OWNER_*
    supervised: np.ndarray  #: (M,) 1 where the request is watched
    timeout_ns: np.ndarray  #: (M,) without a good frame for so long, the request is lost
    ramp_ns: np.ndarray  #: (M,) from the lost request's value to zero
    reaction: np.ndarray  #: (M,) REACT_*
    status_port: np.ndarray  #: (M,) status port that takes the REQUEST_* code, -1 none
    silence_ns: np.ndarray  #: (M,) an external unit silent for longer is gone; 0: never
    cover_start: np.ndarray  #: (M+1,)
    cover_port: np.ndarray  #: index into the request vector


def with_ownership(resolved: ResolvedBindings, ownership: Mapping[int, int]) -> ResolvedBindings:
    """Return the same ties with the ownership (OWNER_*) of some nodes, by index, replaced."""
    node_ownership = resolved.node_ownership.copy()
    for node, owner in ownership.items():
        node_ownership[node] = owner
    return resolved._replace(node_ownership=node_ownership)


@kernel
def received_value(resolved: ResolvedBindings, values: np.ndarray, tie: int) -> Any:
    """Return what one received tie (index) carries from ``values`` to its port, NaN not available."""
    value = values[resolved.rx_signal[tie]]
    start, stop = resolved.rx_map_start[tie], resolved.rx_map_stop[tie]
    if start == stop:
        return value * resolved.rx_gain[tie] + resolved.rx_offset[tie]
    for i in range(start, stop):
        if resolved.map_value[i] == value:
            return resolved.map_code[i]
    return np.nan


@kernel
def requests_from_signals(
    resolved: ResolvedBindings, message: int, values: np.ndarray, requests: np.ndarray
) -> None:
    """Carry the signals of one received ``message`` (index) from ``values`` to the ``requests`` ports.

    A message of an emulated unit counts only while that unit is external.
    """
    node = resolved.message_node[message]
    if node < 0:
        return
    if (
        resolved.node_role[node] != ROLE_CONTROLLER
        and resolved.node_ownership[node] != OWNER_EXTERNAL
    ):
        return
    for tie in range(resolved.rx_start[message], resolved.rx_start[message + 1]):
        requests[resolved.rx_port[tie]] = received_value(resolved, values, tie)


@kernel
def sent_value(resolved: ResolvedBindings, tie: int, code: float) -> Any:
    """Return the signal's value for what the port of one sent tie (index) holds, NaN not available."""
    start, stop = resolved.tx_map_start[tie], resolved.tx_map_stop[tie]
    if start == stop:
        return code * resolved.tx_gain[tie] + resolved.tx_offset[tie]
    for i in range(start, stop):
        if resolved.map_code[i] == code:
            return resolved.map_value[i]
    return np.nan


@kernel
def message_from_statuses(
    resolved: ResolvedBindings, message: int, statuses: np.ndarray, values: np.ndarray
) -> None:
    """Carry ``statuses`` ports to the signals of one ``message`` (index) in ``values``."""
    for tie in range(resolved.tx_start[message], resolved.tx_start[message + 1]):
        values[resolved.tx_signal[tie]] = sent_value(resolved, tie, statuses[resolved.tx_port[tie]])


@kernel
def signals_from_statuses(
    resolved: ResolvedBindings, statuses: np.ndarray, values: np.ndarray
) -> None:
    """Carry ``statuses`` ports to the signals of every emulated unit's messages in ``values``.

    Signals of external units are left alone: there ``values`` holds what was received.
    """
    for message in range(resolved.message_node.size):
        node = resolved.message_node[message]
        if node >= 0 and resolved.node_ownership[node] == OWNER_EMULATED:
            message_from_statuses(resolved, message, statuses, values)
