"""Copies of frames, as bytes: NumPy copies records field by field, which takes many times as long."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Frames = npt.NDArray[np.void]


def copy_frames(frames: Frames) -> Frames:
    """Return a copy of frames (FRAME records), shape (n,)."""
    return _bytes(frames).copy().view(frames.dtype)


def lasting_frames(frames: Frames) -> Frames:
    """Return frames that nobody can change: a copy inside of bytes, or the given ones if they are such."""
    base: object = frames
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, bytes):
        return frames
    return np.frombuffer(_bytes(frames).tobytes(), dtype=frames.dtype)


def join_frames(parts: Sequence[Frames]) -> Frames:
    """Return the frames of all parts, one or more, that nobody can change."""
    return np.frombuffer(b"".join([_bytes(part).data for part in parts]), dtype=parts[0].dtype)


def _bytes(frames: Frames) -> npt.NDArray[np.uint8]:
    return np.ascontiguousarray(frames).view(np.uint8)
