"""What is left to a second thread is done, in order; what fails there ends the run."""

import hashlib
from functools import partial

import numpy as np
import pytest

from hev_can_emu.messages.frame import make_frames
from hev_can_emu.messages.frame_copy import lasting_frames
from hev_can_emu.runtime.behind import Behind
from hev_can_emu.runtime.virtual import TraceHash


def batches() -> list[np.ndarray]:
    random = np.random.default_rng(3)
    found = []
    for count in random.integers(0, 500, 60).tolist():
        frames = make_frames(count)
        frames["t_ns"] = random.integers(0, 1 << 40, count)
        frames["data"] = random.integers(0, 256, (count, 64))
        found.append(frames)
    return found


def test_a_hash_made_there_is_that_of_all_frames_in_order() -> None:
    whole = batches()
    trace = TraceHash()
    with Behind() as behind:
        for frames in whole:
            given = frames.copy()
            behind.do(partial(trace.add, lasting_frames(given), len(given)))
            given["t_ns"] = 0  # the caller uses its buffer again
        behind.wait()
        assert trace.hexdigest() == hashlib.sha256(np.concatenate(whole).tobytes()).hexdigest()


def test_who_gives_more_than_is_done_waits() -> None:
    done, ahead = [], []
    content = bytes(100_000)
    with Behind() as behind:
        for number in range(200):
            behind.do(lambda: done.append(hashlib.sha256(content).digest()))
            ahead.append(number + 1 - len(done))
    assert len(done) == 200
    assert max(ahead) <= 17


def test_a_failure_is_raised_by_what_follows_and_ends_the_work() -> None:
    done = []
    with Behind() as behind:
        behind.do(partial(int, "no number"))
        with pytest.raises(ValueError, match="no number"):
            behind.wait()
        with pytest.raises(ValueError, match="no number"):
            behind.do(lambda: done.append(1))
    assert not done


def interrupted(behind: Behind, done: list[int]) -> None:
    with behind:
        behind.do(lambda: done.append(1))
        raise KeyboardInterrupt


def test_an_interrupted_run_leaves_nothing_undone_and_no_thread() -> None:
    behind, done = Behind(), []
    with pytest.raises(KeyboardInterrupt):
        interrupted(behind, done)
    assert done == [1]
    assert not behind._thread.is_alive()
