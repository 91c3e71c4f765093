"""Sending and receiving whole frames: the two kernels that the tick calls.

They join schedule, codec and protection; frames are records of :data:`hev_can_emu.messages.frame.FRAME`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hev_can_emu.jit import inlined_kernel, kernel
from hev_can_emu.messages.codec import Codec, decode, encode, find_message, is_active, to_physical
from hev_can_emu.messages.columns import (
    F_HIGH,
    F_LOW,
    M_COUNT,
    M_FIRST,
    M_FLAGS,
    M_GUARD_COUNT,
    M_GUARDS,
    M_ID,
    M_LENGTH,
    M_QUICK,
    M_WIRE_LENGTH,
    S_BIT,
    S_BYTE,
    S_EXTRA,
    S_EXTRA_COUNT,
    S_HAS_NA,
    S_KIND,
    S_LENGTH,
    S_NA,
    S_PARENT,
    S_STEP,
)
from hev_can_emu.messages.frame import ERROR, EXTENDED, REMOTE, SENT
from hev_can_emu.messages.protection import (
    COUNTER_JUMP,
    COUNTER_REPEATED,
    CRC_WRONG,
    LENGTH_WRONG,
    NEVER,
    OFF,
    OK,
    P_ON,
    Protection,
    check,
    check_word,
    is_accepted,
    protect,
)
from hev_can_emu.messages.quick import quick_values, quick_word
from hev_can_emu.messages.raw import SIGNED, UNSIGNED, float_value, get_bits, signed_value
from hev_can_emu.messages.restbus import (
    R_TYPE,
    T_COLUMNS,
    T_COUNTER,
    T_SATURATED,
    T_SENT,
    Restbus,
    is_due,
    is_idle,
    wake_at,
)
from hev_can_emu.messages.word_protection import G_ON, protect_word
from hev_can_emu.moves import fill_integers

# Columns of the receive state, X_COLUMNS per message.
X_COUNTER = 0  # last protection counter taken, NEVER before
X_LAST_NS = 1  # time of the last accepted frame
X_ACCEPTED = 2  # frames used
X_LENGTH = 3  # frames of a wrong length
X_CRC = 4  # frames of a wrong CRC
X_REPEATED = 5  # frames of a repeated counter
X_JUMP = 6  # frames after a jump of the counter
X_RANGE = 7  # values outside their declared range, in used frames
X_LAST_RANGE = 8  # the same in the last used frame
X_COLUMNS = 9


def receive_state_size(codec: Codec) -> int:
    """Return how many int64 the receiver's state takes."""
    return int(codec.messages.shape[0]) * X_COLUMNS


@kernel
def reset_receive(codec: Codec, state: np.ndarray) -> None:
    """Forget every frame received."""
    for m in range(codec.messages.shape[0]):
        for n in range(X_COLUMNS):
            state[m * X_COLUMNS + n] = 0
        state[m * X_COLUMNS + X_COUNTER] = NEVER
        state[m * X_COLUMNS + X_LAST_NS] = -(1 << 62)


@kernel
def _read_guard(codec: Codec, s: int, data: np.ndarray, on_bus_values: np.ndarray) -> None:
    """Write the value of a signal that the protection set."""
    signals = codec.signals
    bits = get_bits(
        data, signals[s, S_BYTE], signals[s, S_BIT], signals[s, S_STEP], signals[s, S_LENGTH]
    )
    on_bus_values[s] = to_physical(signals, codec.scaling, s, bits)


@inlined_kernel
def write_frame(
    codec: Codec,
    protection: Protection,
    message: int,
    counter: int,
    values: np.ndarray,
    on_bus_values: np.ndarray,
    t_ns: int,
    frames: np.ndarray,
    i: int,
) -> Any:
    """Encode and protect a message into ``frames[i]``; return the number of saturated values.

    The protection's own signals (counter, CRC), where the database has them, get their values in
    ``on_bus_values`` too.
    """
    row = codec.messages[message]
    data = frames[i]["data"]
    words = data.view(np.uint64)
    fill_integers(words, 0, 8, 0)
    saturated: Any = np.int64(0)
    unusual: Any = np.int64(1)
    quick = row[M_QUICK] != 0
    if quick:
        word, unusual = quick_word(
            codec.ranges, codec.places, codec.signals.shape[0], row[M_FIRST], row[M_COUNT], values
        )  # fmt: skip
        words[0] = word
    if unusual != 0:
        saturated = encode(codec, message, values, data, on_bus_values)
    if protection.words[message, G_ON] != 0:
        words[0] = protect_word(protection.words, protection.remainders, message, words[0], counter)
    elif protection.layout[message, P_ON] != 0:
        protect(protection, message, data, row[M_LENGTH], counter)
    if quick:
        quick_values(
            codec.ranges, 0, codec.places, 0, codec.signals.shape[0], row[M_FIRST], row[M_COUNT],
            words[0], on_bus_values, 0,
        )  # fmt: skip
    else:
        for n in range(row[M_GUARDS], row[M_GUARDS] + row[M_GUARD_COUNT]):
            _read_guard(codec, codec.lists[n], data, on_bus_values)
    frames[i]["t_ns"] = t_ns
    frames[i]["id"] = row[M_ID]
    frames[i]["flags"] = row[M_FLAGS] | SENT
    frames[i]["length"] = row[M_WIRE_LENGTH]
    frames[i]["channel"] = 0
    return saturated


@kernel
def transmit(
    codec: Codec,
    protection: Protection,
    restbus: Restbus,
    state: np.ndarray,
    enabled: np.ndarray,
    values: np.ndarray,
    on_bus_values: np.ndarray,
    t_ns: int,
    frames_out: np.ndarray,
    n_out: int,
    capacity: int,
) -> Any:
    """Append every frame due at ``t_ns`` to ``frames_out`` and return the new number of frames in it.

    ``state``: int64 of :func:`~hev_can_emu.messages.restbus.restbus_state_size`; ``enabled``: uint8
    (messages), 0 for messages that this program does not send; ``values``: float64 (signals), what is to
    be sent; ``on_bus_values``: float64 (signals), what receivers see, kept between calls.  The protection
    counter advances with each frame written.  Messages that find no room below ``capacity`` stay due.
    """
    for place in range(restbus.order.shape[0]):
        if n_out >= capacity:
            break
        m = restbus.order[place]
        if not is_idle(restbus.schedule[m, R_TYPE], state, m, t_ns):
            n_out = _transmit_one(
                codec, protection, restbus, state, enabled, values, on_bus_values, t_ns,
                frames_out, n_out, m,
            )  # fmt: skip
    return n_out


@inlined_kernel
def transmit_these(
    codec: Codec,
    protection: Protection,
    restbus: Restbus,
    state: np.ndarray,
    enabled: np.ndarray,
    values: np.ndarray,
    on_bus_values: np.ndarray,
    t_ns: int,
    frames_out: np.ndarray,
    n_out: int,
    messages: np.ndarray,
    count: int,
    wake: np.ndarray,
) -> Any:
    """As :func:`transmit`, of what :func:`~.restbus.awake` found, and with room for all of it.

    ``messages`` then begins with the messages of the new frames, in their order; ``wake`` goes on.
    """
    first = n_out
    for i in range(count):
        m = messages[i]
        before = n_out
        n_out = _transmit_one(
            codec, protection, restbus, state, enabled, values, on_bus_values, t_ns, frames_out,
            n_out, m,
        )  # fmt: skip
        wake[m] = wake_at(restbus, state, m)
        if n_out > before:
            messages[before - first] = m
    return n_out


@inlined_kernel
def _transmit_one(
    codec: Codec,
    protection: Protection,
    restbus: Restbus,
    state: np.ndarray,
    enabled: np.ndarray,
    values: np.ndarray,
    on_bus_values: np.ndarray,
    t_ns: int,
    frames_out: np.ndarray,
    n_out: int,
    m: int,
) -> Any:
    if is_due(restbus, codec, state, enabled, values, on_bus_values, m, t_ns):
        base = m * T_COLUMNS
        counter = state[base + T_COUNTER]
        saturated = write_frame(
            codec, protection, m, counter, values, on_bus_values, t_ns, frames_out, n_out
        )
        state[base + T_COUNTER] += 1
        state[base + T_SENT] += 1
        state[base + T_SATURATED] += saturated
        n_out += 1
    return n_out


@kernel
def count_out_of_range(codec: Codec, message: int, data: np.ndarray) -> Any:
    """Return how many signals of a frame lie outside their declared range.

    Not-available and labelled values are no such case.
    """
    count = 0
    row = codec.messages[message]
    for s in range(row[M_FIRST], row[M_FIRST] + row[M_COUNT]):
        signal = codec.signals[s]
        if signal[S_PARENT] >= 0 and not is_active(codec.signals, codec.lists, s, data):
            continue
        bits = get_bits(data, signal[S_BYTE], signal[S_BIT], signal[S_STEP], signal[S_LENGTH])
        if signal[S_HAS_NA] != 0 and np.int64(bits) == signal[S_NA]:
            continue
        if signal[S_KIND] == UNSIGNED:
            raw = np.float64(bits)
        elif signal[S_KIND] == SIGNED:
            raw = np.float64(signed_value(bits, signal[S_LENGTH]))
        else:
            raw = float_value(bits, signal[S_KIND])
        if codec.scaling[s, F_LOW] <= raw <= codec.scaling[s, F_HIGH] or np.isnan(raw):
            continue
        labelled = False
        for n in range(signal[S_EXTRA_COUNT]):
            if codec.lists[signal[S_EXTRA] + n] == raw:
                labelled = True
        if not labelled:
            count += 1
    return count


@inlined_kernel
def receive(
    codec: Codec,
    protection: Protection,
    state: np.ndarray,
    accept: np.ndarray,
    mode: int,
    frames: np.ndarray,
    i: int,
    values: np.ndarray,
) -> Any:
    """Take in ``frames[i]``: find its message, check it, and decode it where it may be used.

    ``state``: int64 of :func:`receive_state_size`; ``accept``: uint8 (messages), 0 for messages that are
    not to be taken from the bus; ``mode``: OFF, OBSERVE or ENFORCE; ``values``: float64 (signals), written
    only by frames that are used (:func:`~hev_can_emu.messages.protection.is_accepted` of the code).

    Returns:
        the message's index and its code.  The index is -1, and nothing happens, for unknown identifiers,
        messages that are not accepted, remote and error frames, and frames this program sent.
    """
    flags = np.int64(frames[i]["flags"])
    if flags & (REMOTE | ERROR | SENT) != 0:
        return -1, OK
    m = find_message(codec, frames[i]["id"], flags & EXTENDED)
    if m < 0 or accept[m] == 0:
        return -1, OK
    base = m * X_COLUMNS
    row = codec.messages[m]
    length = np.int64(frames[i]["length"])
    if length != row[M_WIRE_LENGTH]:
        state[base + X_LENGTH] += 1
        return m, LENGTH_WRONG
    data = frames[i]["data"]
    word = data.view(np.uint64)[0]
    code = OK
    if mode != OFF:
        counter = state[base + X_COUNTER : base + X_COUNTER + 1]
        if protection.words[m, G_ON] != 0:
            code = check_word(protection, m, word, counter)
        else:
            code = check(protection, m, data, row[M_LENGTH], counter)
        if code == CRC_WRONG:
            state[base + X_CRC] += 1
        elif code == COUNTER_REPEATED:
            state[base + X_REPEATED] += 1
        elif code == COUNTER_JUMP:
            state[base + X_JUMP] += 1
    if is_accepted(code, mode):
        state[base + X_ACCEPTED] += 1
        state[base + X_LAST_NS] = frames[i]["t_ns"]
        quick = row[M_QUICK] != 0
        stride, first, count = codec.signals.shape[0], row[M_FIRST], row[M_COUNT]
        out_of_range: Any = np.int64(0)
        beyond: Any = np.int64(1)
        if quick:
            beyond = quick_values(
                codec.ranges, 0, codec.places, 0, stride, first, count, word, values, 0
            )
        else:
            decode(codec, m, data, values)
        if beyond > 0:
            out_of_range = count_out_of_range(codec, m, data)
        state[base + X_RANGE] += out_of_range
        state[base + X_LAST_RANGE] = out_of_range
    return m, code
