"""Copies of frames are the same frames, and nobody else's."""

import numpy as np
import pytest

from hev_can_emu.messages.frame import FRAME, frame, make_frames
from hev_can_emu.messages.frame_copy import copy_frames, join_frames, lasting_frames


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


def test_frames_that_last_are_copied_once_and_cannot_be_changed() -> None:
    frames = np.concatenate([frame(n, bytes(range(n)), 10 * n) for n in range(64)])
    before = frames.tobytes()
    for part in (frames, frames[3:9], frames[::2], frames[:0]):
        lasting = lasting_frames(part)
        assert lasting.dtype == FRAME
        assert lasting.tobytes() == np.ascontiguousarray(part).tobytes()
        assert not np.shares_memory(lasting, part)
    lasting = lasting_frames(frames)
    frames["t_ns"] = 0
    assert lasting.tobytes() == before
    assert lasting_frames(lasting) is lasting
    assert np.shares_memory(lasting_frames(lasting[5:9]), lasting)
    with pytest.raises(ValueError, match="read-only"):
        lasting["t_ns"] = 0
    # What only cannot be written to here may be written to elsewhere.
    view = frames[:]
    view.flags.writeable = False
    assert not np.shares_memory(lasting_frames(view), frames)
    assert join_frames([lasting[:7], frames[7:7], lasting[7:]]).tobytes() == before
