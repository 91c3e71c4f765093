"""The frame record: what crosses every seam between bus and core.

Frames travel as NumPy structured arrays of :data:`FRAME`, never as objects, so that the compiled
tick and the Python adapters read the same memory.
"""

from __future__ import annotations

import numpy as np

EXTENDED = 1  #: 29-bit identifier
FD = 2  #: CAN FD format
BRS = 4  #: bit-rate switch (CAN FD)
REMOTE = 8  #: remote frame (classic CAN, no data)
ERROR = 16  #: error frame
SENT = 32  #: sent by this program (recorders write it as Tx)

FRAME = np.dtype(
    [
        ("t_ns", np.int64),
        ("id", np.uint32),
        ("flags", np.uint8),
        ("length", np.uint8),
        ("channel", np.uint16),
        ("data", np.uint8, (64,)),
    ]
)
"""One frame, 80 bytes: time in ns, identifier, flags, data length in bytes, channel, data."""


def make_frames(capacity: int) -> np.ndarray:
    """Return a zeroed frame buffer of shape ``(capacity,)``."""
    return np.zeros(capacity, dtype=FRAME)


def frame(can_id: int, data: bytes, t_ns: int = 0, flags: int = 0) -> np.ndarray:
    """Return a buffer of shape ``(1,)`` holding one frame; raises ValueError beyond 64 bytes."""
    if len(data) > 64:
        raise ValueError(f"a frame holds at most 64 data bytes, got {len(data)}")
    buffer = make_frames(1)
    buffer["t_ns"] = t_ns
    buffer["id"] = can_id
    buffer["flags"] = flags
    buffer["length"] = len(data)
    buffer["data"][0, : len(data)] = np.frombuffer(data, dtype=np.uint8)
    return buffer
