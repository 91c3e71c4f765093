"""Copies of frames, as bytes: NumPy copies records field by field, which takes five times as long."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def copy_frames(frames: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """Return a copy of frames (FRAME records), shape (n,)."""
    return np.ascontiguousarray(frames).view(np.uint8).copy().view(frames.dtype)
