"""Copies of frames are the same frames, and nobody else's."""

import numpy as np

from hev_can_emu.messages.frame import FRAME, frame, make_frames
from hev_can_emu.messages.frame_copy import copy_frames


def test_a_copy_is_equal_and_apart() -> None:
    frames = np.concatenate([frame(n, bytes(range(n)), 10 * n) for n in range(64)])
    for part in (frames, frames[3:9], frames[::2], frames[:0], make_frames(1)):
        copied = copy_frames(part)
        assert copied.dtype == FRAME
        assert copied.tobytes() == np.ascontiguousarray(part).tobytes()
        assert not np.shares_memory(copied, part)
    copied = copy_frames(frames)
    copied["data"][5, 0] = 99
    assert frames["data"][5, 0] == 0
