"""The hash on a thread of its own is the one made at once, and what fails there is told."""

import hashlib

import numpy as np
import pytest

from hev_can_emu.messages.frame import make_frames
from hev_can_emu.runtime.virtual import HashBehind, TraceHash


def batches() -> list[np.ndarray]:
    random = np.random.default_rng(3)
    found = []
    for count in random.integers(0, 500, 60).tolist():
        frames = make_frames(count)
        frames["t_ns"] = random.integers(0, 1 << 40, count)
        frames["data"] = random.integers(0, 256, (count, 64))
        found.append(frames)
    return found


def test_it_is_the_hash_of_all_frames_in_order() -> None:
    whole = batches()
    at_once = TraceHash()
    with HashBehind() as behind:
        for frames in whole:
            at_once.add(frames, len(frames))
            given = frames.copy()
            behind.add(given, len(given))
            given["t_ns"] = 0  # the caller uses its buffer again
        assert behind.end() == at_once.hexdigest()
    assert at_once.hexdigest() == hashlib.sha256(np.concatenate(whole).tobytes()).hexdigest()


def test_a_failure_in_the_thread_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(self: TraceHash, frames: np.ndarray, count: int) -> None:
        raise MemoryError("no room")

    monkeypatch.setattr(TraceHash, "add", fails)
    with HashBehind() as behind:
        for _ in range(40):
            behind.add(make_frames(3), 3)
        with pytest.raises(MemoryError, match="no room"):
            behind.end()


def interrupted(behind: HashBehind) -> None:
    with behind:
        behind.add(make_frames(3), 3)
        raise KeyboardInterrupt


def test_an_interrupted_run_leaves_no_thread_waiting() -> None:
    behind = HashBehind()
    with pytest.raises(KeyboardInterrupt):
        interrupted(behind)
    assert not behind._thread.is_alive()
