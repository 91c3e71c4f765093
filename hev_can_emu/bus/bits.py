"""How many bits a frame has on the wire, stuff bits included (ISO 11898-1:2015, 10.4 and 10.5).

Stuffing depends on the data and, in classic frames, on their CRC-15, so each frame is counted bit by bit.
In CAN FD frames the CRC (17 or 21 bits) is stuffed at fixed places: its length is what counts, not its value.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import inner_kernel, kernel
from hev_can_emu.messages.frame import BRS, EXTENDED, FD, REMOTE

INTERMISSION = 3  #: bits between a frame's end and the next one's start
CLASSIC_TAIL = 10  # CRC delimiter, ACK slot, ACK delimiter, 7 bits of end of frame
FD_CRC17 = 4 + 17 + 6  # stuff count, CRC, fixed stuff bits
FD_CRC21 = 4 + 21 + 7
SCRATCH_BITS = 39 + 4 + 8 * 64 + 15  #: most bits from start of frame to CRC, not stuffed
_CRC15 = 0x4599


@inner_kernel
def _append(bits: npt.NDArray[np.uint8], n: int, value: int, count: int) -> Any:
    """Append ``count`` bits of ``value``, highest first; return the new number of bits."""
    for k in range(count):
        bits[n + k] = (value >> (count - 1 - k)) & 1
    return n + count


@inner_kernel
def _dlc(length: int) -> Any:
    """Return the data length code of a length in bytes, padded up where CAN FD has no such length."""
    if length <= 8:
        return length
    if length <= 24:
        return 9 + (length - 9) // 4
    return 13 if length <= 32 else 14 if length <= 48 else 15


@inner_kernel
def _head(can_id: int, flags: int, bits: npt.NDArray[np.uint8]) -> Any:
    """Write start of frame up to the bit before ESI or DLC; return the number of bits."""
    fd = flags & FD != 0
    remote = 1 if flags & REMOTE != 0 and not fd else 0
    n = _append(bits, 0, 0, 1)
    if flags & EXTENDED:
        n = _append(bits, n, can_id >> 18, 11)
        n = _append(bits, n, 3, 2)  # SRR, IDE
        n = _append(bits, n, can_id & 0x3FFFF, 18)
        n = _append(bits, n, remote, 1)
    else:
        n = _append(bits, n, can_id, 11)
        n = _append(bits, n, remote, 1)
        n = _append(bits, n, 0, 1)  # IDE
    if fd:
        n = _append(bits, n, 2, 2)  # FDF, res
        n = _append(bits, n, 1 if flags & BRS else 0, 1)
    else:
        n = _append(bits, n, 0, 2 if flags & EXTENDED else 1)  # r1, r0
    return n


@kernel
def count_bits(frames: npt.NDArray[np.void], i: int, bits: npt.NDArray[np.uint8]) -> Any:
    """Return how many bits of ``frames[i]`` have the nominal and how many the data bit rate.

    From start to end of frame, without the intermission.  Where the rate is switched, the bit BRS is
    counted as nominal and the CRC delimiter as data: each is sent in part at both rates, and together
    they take one bit of each.  ``bits``: room for SCRATCH_BITS.
    """
    flags: Any = np.int64(frames[i]["flags"])
    length: Any = np.int64(frames[i]["length"])
    can_id: Any = np.int64(frames[i]["id"])
    n = _head(can_id, flags, bits)
    fd = flags & FD != 0
    length = min(length, 64 if fd else 8)
    switch = n  # stuff bits before the bit after BRS, and all later ones, have the data rate
    if fd:
        n = _append(bits, n, 0, 1)  # ESI
    code = _dlc(length)
    n = _append(bits, n, code, 4)
    if fd and length > 8:
        padded = 8 + 4 * (code - 8) if code <= 12 else (32, 48, 64)[code - 13]
    else:
        padded = length
    if flags & REMOTE == 0 or fd:
        for k in range(padded):
            byte: Any = np.int64(frames[i]["data"][k]) if k < length else np.int64(0)
            n = _append(bits, n, byte, 8)
    if not fd:
        crc = 0
        for k in range(n):
            top = (crc >> 14) ^ bits[k]
            crc = (crc << 1) & 0x7FFF
            if top != 0:
                crc ^= _CRC15
        n = _append(bits, n, crc, 15)

    before = after = 0  # stuff bits
    run = 0
    last = -1
    for k in range(n):
        if run == 5:
            if fd and k >= switch:
                after += 1
            else:
                before += 1
            last = 1 - last
            run = 1
        if bits[k] == last:
            run += 1
        else:
            last = int(bits[k])
            run = 1
    if not fd:
        # After the CRC's last bit there may be one; before a fixed stuff bit there is none.
        return n + before + (1 if run == 5 else 0) + CLASSIC_TAIL, 0
    crc_bits = FD_CRC21 if padded > 16 else FD_CRC17
    tail = CLASSIC_TAIL - 1
    fast = n - switch + after + crc_bits + 1
    if flags & BRS == 0:
        return switch + before + fast + tail, 0
    return switch + before + tail, fast


@kernel
def count_all_bits(
    frames: npt.NDArray[np.void],
    count: int,
    scratch: npt.NDArray[np.uint8],
    bits: npt.NDArray[np.int64],
) -> None:
    """Write :func:`count_bits` of the first ``count`` frames into ``bits``, shape (count, 2)."""
    for i in range(count):
        bits[i, 0], bits[i, 1] = count_bits(frames, i, scratch)


def bits_of(frames: npt.NDArray[np.void]) -> npt.NDArray[np.int64]:
    """Return nominal and fast bits of each frame, shape (n, 2)."""
    bits = np.empty((len(frames), 2), dtype=np.int64)
    frames = np.array(frames)  # writable, whatever was given: the kernel is compiled for one kind
    count_all_bits(frames, len(frames), np.empty(SCRATCH_BITS, dtype=np.uint8), bits)
    return bits


def priority(can_id: int, flags: int) -> int:
    """Return the arbitration field as a number: of several frames the least wins (10.4.2.2)."""
    remote = 1 if flags & REMOTE and not flags & FD else 0
    if flags & EXTENDED:
        return (can_id >> 18) << 21 | 3 << 19 | (can_id & 0x3FFFF) << 1 | remote
    return can_id << 21 | remote << 20
