"""Faults of frames between their sender and everybody else: what is in them, whether and when they arrive.

One kernel takes a frame and gives none, one or several; what is to arrive later waits in a store.  On one
frame faults act in this order: signals, counter, CRC, length, then copies, delay and loss.  The counter
and CRC of a frame whose signals were changed are right again, as if its sender had meant it.

A frame of this program is changed as it is sent.  A received one is changed before its unit sees it: the
fault lies between the bus and the unit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import fault_table as table
from hev_can_emu.ecu.fault_rows import CODES
from hev_can_emu.ecu.fault_table import FaultTable, end_row, normal, uniform
from hev_can_emu.jit import inner_kernel
from hev_can_emu.messages.codec import Codec, find_message, is_active, to_pattern, to_physical
from hev_can_emu.messages.columns import (
    M_LENGTH,
    M_WIRE_LENGTH,
    S_BIT,
    S_BYTE,
    S_LENGTH,
    S_PARENT,
    S_STEP,
)
from hev_can_emu.messages.frame import EXTENDED, SENT
from hev_can_emu.messages.protection import (
    P_COUNTER_BIG_ENDIAN,
    P_COUNTER_BIT,
    P_COUNTER_BITS,
    P_CRC_BYTE,
    P_MODULUS,
    P_ON,
    P_WIDTH,
    Protection,
    protect,
    read_bits,
)
from hev_can_emu.messages.raw import get_bits
from hev_can_emu.messages.restbus import T_COLUMNS, T_COUNTER

Frames = npt.NDArray[np.void]
Integers = npt.NDArray[np.int64]

HELD_FRAMES = 256  #: frames that can wait at a time; what finds no room is lost
MOST_COPIES = 8
BABBLED_FRAMES = 2048  #: what babbling nodes may send in a tick, together
_UNTIL_NEXT = 1 << 62  # due with the message's next frame
_MILLISECOND = 1_000_000

_COUNTER_WRONG, _COUNTER_FROZEN = CODES["counter_wrong"], CODES["counter_frozen"]
_COUNTER_RANDOM, _COUNTER_OFFSET = CODES["counter_random"], CODES["counter_offset"]
_CRC_WRONG, _CRC_FROZEN = CODES["crc_wrong"], CODES["crc_frozen"]
_CRC_RANDOM, _CRC_OFFSET = CODES["crc_random"], CODES["crc_offset"]
_WRONG_LENGTH, _DROP, _DELAY, _JITTER = (
    CODES["wrong_length"], CODES["drop"], CODES["delay"], CODES["jitter"],
)  # fmt: skip
_DUPLICATE, _REORDER = CODES["duplicate"], CODES["reorder"]
_SILENT, _BABBLING = CODES["silent_node"], CODES["babbling_node"]
_STUCK, _OFFSET, _NOISE = CODES["signal_stuck"], CODES["signal_offset"], CODES["signal_noise"]
_DRIFT, _NOT_AVAILABLE = CODES["signal_drift"], CODES["signal_not_available"]

# When each kind acts on a frame; -1: not on frames.
_LAST_STAGE = 5
STAGES = np.full(len(CODES), -1, dtype=np.int64)
for _stage, _kinds in enumerate(
    (
        (_STUCK, _OFFSET, _NOISE, _DRIFT, _NOT_AVAILABLE),
        (_COUNTER_WRONG, _COUNTER_FROZEN, _COUNTER_RANDOM, _COUNTER_OFFSET),
        (_CRC_WRONG, _CRC_FROZEN, _CRC_RANDOM, _CRC_OFFSET),
        (_WRONG_LENGTH,),
        (_DUPLICATE, _DELAY, _JITTER, _REORDER),
        (_DROP, _SILENT),
    )
):
    STAGES[list(_kinds)] = _stage


@inner_kernel
def _replace_bits(
    data: np.ndarray, byte: int, bit: int, step: int, length: int, pattern: Any
) -> None:
    """Overwrite the bits of a signal; see :func:`hev_can_emu.messages.raw.get_bits`."""
    for n in range(length):
        mask = 1 << bit
        value: Any = np.int64(data[byte]) & (255 - mask)
        if np.int64((pattern >> np.uint64(n)) & np.uint64(1)) != 0:
            value |= mask
        data[byte] = value
        bit += 1
        if bit == 8:
            bit = 0
            byte += step


@inner_kernel
def _counter(protection: Protection, message: int, data: np.ndarray) -> Any:
    layout = protection.layout[message]
    return read_bits(
        data, layout[P_COUNTER_BIT], layout[P_COUNTER_BITS], layout[P_COUNTER_BIG_ENDIAN]
    )


@inner_kernel
def _change_signal(
    codec: Codec, protection: Protection, faults: FaultTable, slot: int, data: np.ndarray, t_ns: int
) -> None:
    whole, real = faults.whole, faults.real
    s, message = whole[slot, table.TARGET], whole[slot, table.MESSAGE]
    signal = codec.signals[s]
    if signal[S_PARENT] >= 0 and not is_active(codec.signals, codec.lists, s, data):
        return
    byte, bit, step, length = signal[S_BYTE], signal[S_BIT], signal[S_STEP], signal[S_LENGTH]
    bits = get_bits(data, byte, bit, step, length)
    value = to_physical(codec.signals, codec.scaling, s, bits)
    kind, given = whole[slot, table.KIND], real[slot, table.VALUE]
    if kind == _STUCK:
        if whole[slot, table.LATCHED] == 0:
            whole[slot, table.LATCHED] = 1
            real[slot, table.LATCH] = value if math.isnan(given) else given
        value = real[slot, table.LATCH]
    elif kind == _OFFSET:
        value += given
    elif kind == _NOISE:
        value += given * normal(whole, slot)
    elif kind == _DRIFT:
        value += given * (t_ns - whole[slot, table.START_NS]) * 1e-9
    else:
        value = math.nan
    pattern, _ = to_pattern(codec.signals, codec.scaling, codec.lists, s, value)
    _replace_bits(data, byte, bit, step, length, pattern)
    if protection.layout[message, P_ON] != 0:
        counter = _counter(protection, message, data)
        protect(protection, message, data, codec.messages[message, M_LENGTH], counter)


@inner_kernel
def _change_counter(
    codec: Codec, protection: Protection, faults: FaultTable, slot: int, data: np.ndarray
) -> None:
    whole = faults.whole
    message, kind = whole[slot, table.MESSAGE], whole[slot, table.KIND]
    modulus = protection.layout[message, P_MODULUS]
    counter = _counter(protection, message, data)
    if kind == _COUNTER_WRONG:
        counter = modulus - 1 - counter
    elif kind == _COUNTER_FROZEN:
        if whole[slot, table.LATCHED] == 1:
            counter = whole[slot, table.MARK]
    elif kind == _COUNTER_RANDOM:
        counter = int(uniform(whole, slot) * modulus)
    else:
        counter = (counter + whole[slot, table.NUMBER]) % modulus
    whole[slot, table.MARK], whole[slot, table.LATCHED] = counter, 1
    protect(protection, message, data, codec.messages[message, M_LENGTH], counter)


@inner_kernel
def _change_crc(protection: Protection, faults: FaultTable, slot: int, data: np.ndarray) -> None:
    whole = faults.whole
    message, kind = whole[slot, table.MESSAGE], whole[slot, table.KIND]
    layout = protection.layout[message]
    first, width = 8 * layout[P_CRC_BYTE], layout[P_WIDTH]
    top = (1 << width) - 1
    crc = read_bits(data, first, width, 0)
    if kind == _CRC_WRONG:
        crc = crc ^ top
    elif kind == _CRC_FROZEN:
        if whole[slot, table.LATCHED] == 0:
            whole[slot, table.LATCHED] = 1
            whole[slot, table.MARK] = crc
        crc = whole[slot, table.MARK]
    elif kind == _CRC_RANDOM:
        crc = int(uniform(whole, slot) * (top + 1))
    else:
        crc = (crc + whole[slot, table.NUMBER]) & top
    for n in range(width >> 3):
        data[layout[P_CRC_BYTE] + n] = (crc >> (8 * n)) & 0xFF


@inner_kernel
def _hits(faults: FaultTable, slot: int, message: int, node: int) -> bool:
    """Whether a row concerns this frame, by its target and by chance."""
    whole = faults.whole
    if whole[slot, table.MESSAGE] >= 0:
        if whole[slot, table.MESSAGE] != message:
            return False
    elif whole[slot, table.NODE] != node or node < 0:
        return False
    chance = faults.real[slot, table.CHANCE]
    return bool(chance >= 1.0 or uniform(whole, slot) < chance)


@inner_kernel
def _hold(
    faults: FaultTable, held: Frames, held_row: Integers, frame: Frames, message: int, due_ns: int
) -> None:
    """Keep a frame until its time; without room it is lost."""
    place = faults.counts[table.HELD]
    if place < held.shape[0]:
        held[place] = frame[0]
        held_row[place, 0] = due_ns
        held_row[place, 1] = message
        faults.counts[table.HELD] = place + 1


@inner_kernel
def release_frames(
    faults: FaultTable,
    held: Frames,
    held_row: Integers,
    t_ns: int,
    message: int,
    sent: int,
    frames: Frames,
    n_frames: int,
) -> Any:
    """Append the frames held back whose time has come; return the number of frames.

    With ``message`` not below 0 those that waited for its next frame.  ``sent``: SENT for frames of this
    program, 0 for received ones.
    """
    kept = 0
    for place in range(faults.counts[table.HELD]):
        mine = (np.int64(held[place]["flags"]) & SENT) == sent
        if message >= 0:
            mine = mine and held_row[place, 0] == _UNTIL_NEXT and held_row[place, 1] == message
        else:
            mine = mine and held_row[place, 0] <= t_ns
        if mine and n_frames < frames.shape[0]:
            frames[n_frames] = held[place]
            frames[n_frames]["t_ns"] = t_ns
            n_frames += 1
        elif not mine:
            held[kept] = held[place]
            held_row[kept, 0] = held_row[place, 0]
            held_row[kept, 1] = held_row[place, 1]
            kept += 1
    faults.counts[table.HELD] = kept
    return n_frames


@inner_kernel
def _is_waiting(faults: FaultTable, held_row: Integers, message: int) -> bool:
    """Whether a frame of this message waits for the next one."""
    for place in range(faults.counts[table.HELD]):
        if held_row[place, 0] == _UNTIL_NEXT and held_row[place, 1] == message:
            return True
    return False


@inner_kernel
def pass_frame(
    codec: Codec,
    protection: Protection,
    faults: FaultTable,
    held: Frames,
    held_row: Integers,
    frame: Frames,
    message: int,
    node: int,
    t_ns: int,
    events: npt.NDArray[np.void],
    n_events: int,
) -> Any:
    """Let the active faults act on one frame.

    Args:
        codec, protection: the network.
        faults: the table.
        held, held_row: frames that wait, shape (HELD_FRAMES,); when they are due and of which message,
            shape (HELD_FRAMES, 2).
        frame: shape (1,), changed in place.
        message, node: its message and that message's sender, -1 for none.
        t_ns: now.
        events, n_events: event records.

    Returns:
        How many copies of the frame arrive now, and the number of event records.
    """
    whole = faults.whole
    data = frame[0]["data"]
    copies = 1
    due_ns = t_ns
    for stage in range(_LAST_STAGE + 1):
        for slot in range(whole.shape[0]):
            kind = whole[slot, table.KIND]
            if whole[slot, table.STATE] != table.ACTIVE or STAGES[kind] != stage:
                continue
            if not _hits(faults, slot, message, node):
                continue
            intact = np.int64(frame[0]["length"]) == codec.messages[message, M_WIRE_LENGTH]
            if stage <= 2 and not intact:
                continue
            if kind == _REORDER and _is_waiting(faults, held_row, message):
                continue
            whole[slot, table.HITS] += 1
            if stage == 0:
                _change_signal(codec, protection, faults, slot, data, t_ns)
            elif stage == 1:
                _change_counter(codec, protection, faults, slot, data)
            elif stage == 2:
                _change_crc(protection, faults, slot, data)
            elif kind == _WRONG_LENGTH:
                frame[0]["length"] = whole[slot, table.NUMBER]
                for n in range(whole[slot, table.NUMBER], 64):
                    data[n] = 0
            elif kind == _DUPLICATE:
                copies = min(copies + whole[slot, table.NUMBER], MOST_COPIES + 1)
            elif kind == _REORDER:
                due_ns = _UNTIL_NEXT
            elif stage == _LAST_STAGE:
                if (
                    copies > 0
                    and intact
                    and whole[slot, table.LATCHED] == 0
                    and whole[slot, table.MESSAGE] >= 0
                    and protection.layout[message, P_COUNTER_BITS] != 0
                ):
                    whole[slot, table.LATCHED] = 1
                    whole[slot, table.MARK] = _counter(protection, message, data) - 1
                copies = 0
            else:
                late = whole[slot, table.TIME_NS]
                if kind == _JITTER:
                    late = int(uniform(whole, slot) * (late + _MILLISECOND))
                late = late // _MILLISECOND * _MILLISECOND
                due_ns = max(due_ns + late, whole[slot, table.DUE_NS])
                whole[slot, table.DUE_NS] = due_ns
            limit = whole[slot, table.FRAMES]
            if limit > 0 and whole[slot, table.HITS] >= limit:
                n_events = end_row(faults, slot, t_ns, events, n_events)
    if due_ns > t_ns:
        for _ in range(copies):
            _hold(faults, held, held_row, frame, message, due_ns)
        copies = 0
    return copies, n_events


@inner_kernel
def pass_sent(
    codec: Codec,
    protection: Protection,
    message_node: Integers,
    faults: FaultTable,
    held: Frames,
    held_row: Integers,
    scratch: Frames,
    frames: Frames,
    first: int,
    n_frames: int,
    t_ns: int,
    events: npt.NDArray[np.void],
    n_events: int,
) -> Any:
    """Let the active faults act on what this program sends now: ``frames[first:n_frames]``.

    ``scratch`` holds at least as many frames.  Late frames go first, then the others in their order, then
    what babbling nodes send.

    Returns:
        The number of frames in ``frames`` and of event records.
    """
    count = n_frames - first
    for i in range(count):
        scratch[i] = frames[first + i]
    n = release_frames(faults, held, held_row, t_ns, -1, SENT, frames, first)
    for i in range(count):
        extended = np.int64(scratch[i]["flags"]) & EXTENDED
        message = find_message(codec, scratch[i]["id"], extended)
        copies, n_events = pass_frame(
            codec, protection, faults, held, held_row, scratch[i : i + 1], message,
            message_node[message], t_ns, events, n_events,
        )  # fmt: skip
        for _ in range(copies):
            if n < frames.shape[0]:
                frames[n] = scratch[i]
                n += 1
        if copies > 0 and faults.counts[table.HELD] > 0:
            n = release_frames(faults, held, held_row, t_ns, message, SENT, frames, n)
    return _babble(faults, frames, n, t_ns), n_events


@inner_kernel
def resume_counters(faults: FaultTable, transmit_state: Integers) -> None:
    """Let the senders' counters go on where those of faults that have ended stopped, if they say so.

    ``transmit_state``: of :func:`hev_can_emu.messages.restbus.restbus_state_size`.
    """
    whole = faults.whole
    for slot in range(whole.shape[0]):
        if (
            whole[slot, table.STATE] == table.ENDED
            and whole[slot, table.RESUME] == table.RESUME_STOPPED
            and whole[slot, table.LATCHED] == 1
            and whole[slot, table.MESSAGE] >= 0
        ):
            counter = whole[slot, table.MESSAGE] * T_COLUMNS + T_COUNTER
            transmit_state[counter] = whole[slot, table.MARK] + 1
            whole[slot, table.LATCHED] = 0


@inner_kernel
def silence_nodes(
    faults: FaultTable, message_node: Integers, enabled: npt.NDArray[np.uint8]
) -> None:
    """Take out of ``enabled`` what silent nodes do not even try to send, so that their counters stop."""
    whole = faults.whole
    for slot in range(whole.shape[0]):
        if (
            whole[slot, table.STATE] == table.ACTIVE
            and whole[slot, table.KIND] == _SILENT
            and whole[slot, table.RESUME] == table.RESUME_STOPPED
        ):
            for message in range(enabled.shape[0]):
                if message_node[message] == whole[slot, table.NODE]:
                    enabled[message] = 0


@inner_kernel
def _babble(faults: FaultTable, frames: Frames, n_frames: int, t_ns: int) -> Any:
    """Append what babbling nodes send in this millisecond; return the number of frames."""
    whole = faults.whole
    last = min(frames.shape[0], n_frames + BABBLED_FRAMES)
    for slot in range(whole.shape[0]):
        if whole[slot, table.STATE] != table.ACTIVE or whole[slot, table.KIND] != _BABBLING:
            continue
        for _ in range(whole[slot, table.TIME_NS]):
            if n_frames >= last:
                break
            frame = frames[n_frames : n_frames + 1]
            frame[0]["t_ns"] = t_ns
            frame[0]["id"] = whole[slot, table.NUMBER]
            frame[0]["flags"] = SENT | (EXTENDED if whole[slot, table.MARK] != 0 else 0)
            frame[0]["length"] = whole[slot, table.TARGET]
            frame[0]["channel"] = 0
            data = frame[0]["data"]
            for n in range(64):
                data[n] = 0
            for n in range(whole[slot, table.TARGET]):
                data[n] = int(uniform(whole, slot) * 256.0)
            n_frames += 1
            whole[slot, table.HITS] += 1
    return n_frames
