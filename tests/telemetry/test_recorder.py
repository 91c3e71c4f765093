"""Recordings are whole, and say the same to other tools' readers as was recorded."""

from __future__ import annotations

import errno
import threading
import time
from datetime import UTC, datetime
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hev_can_emu.errors import InputError, StateError
from hev_can_emu.messages.frame import BRS, ERROR, EXTENDED, FD, REMOTE, SENT, frame, make_frames
from hev_can_emu.telemetry import recorder as recorder_module
from hev_can_emu.telemetry.candump import format_candump
from hev_can_emu.telemetry.recorder import FORMATS, Recorder, open_recorder

EPOCH_NS = 1_436_509_052_005_000_000  # with the millisecond part below 100, and not zero
READERS = {
    ".log": can.CanutilsLogReader,
    ".blf": can.BLFReader,
    ".asc": lambda path: can.ASCReader(path, relative_timestamp=False),
    ".mf4": can.MF4Reader,
}


def read(ending: str, path: Path) -> list[can.Message]:
    with READERS[ending](path) as reader:
        return list(reader)


def mixed_frames() -> np.ndarray:
    frames = np.concatenate(
        [
            frame(0x123, bytes.fromhex("1122334455667788"), 0, SENT),
            frame(0x7FF, b"", 1_000_000),
            frame(0x12345678, b"\xab", 2_000_000, EXTENDED),
            frame(0x1, b"\x01", 2_500_000, EXTENDED | SENT),
            frame(0x55, bytes(range(64)), 3_000_000, FD | BRS),
            frame(0x56, bytes(range(12)), 3_000_000, FD),
            frame(0x57, b"\x09", 1_500_000_000, 0),
        ]
    )
    frames["channel"] = [0, 0, 0, 0, 0, 0, 3]
    return frames


def as_tuples(frames: np.ndarray, *, direction: bool) -> list[tuple[object, ...]]:
    keep = EXTENDED | FD | BRS | (SENT if direction else 0)
    return [
        (int(f["id"]), int(f["flags"]) & keep, f["data"][: f["length"]].tobytes()) for f in frames
    ]


def message_tuple(message: can.Message, *, direction: bool) -> tuple[object, ...]:
    flags = EXTENDED * message.is_extended_id + FD * message.is_fd + BRS * message.bitrate_switch
    if direction and not message.is_rx:
        flags += SENT
    return message.arbitration_id, flags, bytes(message.data)


@pytest.mark.parametrize("ending", FORMATS)
def test_read_back_by_python_can(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{ending}"
    frames = mixed_frames()
    with open_recorder(path, epoch_ns=EPOCH_NS) as recorder:
        recorder.write(frames, 4)
        recorder.write(frames[4:], len(frames) - 4)
    messages = read(ending, path)
    direction = ending != ".log"
    assert [message_tuple(m, direction=direction) for m in messages] == as_tuples(
        frames, direction=direction
    )
    expected = (EPOCH_NS + frames["t_ns"]) / 1e9
    assert [m.timestamp for m in messages] == pytest.approx(expected, abs=1.5e-6, rel=0)
    channels = {".log": ["vcan0"] * 6 + ["can3"]}.get(ending, [0] * 6 + [3])
    assert [m.channel for m in messages] == channels


def test_candump_lines_are_those_of_can_utils() -> None:
    frames = np.concatenate(
        [
            frame(0x123, b"\x11\x22", 0),
            frame(0x123, b"", 999_999),
            frame(0x12345678, b"\xfe", 1_000, EXTENDED | SENT),
            frame(0x1, b"", 0, EXTENDED),
            frame(0x123, b"", 0, REMOTE),
            frame(0x123, bytes(4), 0, REMOTE),
            frame(0x123, b"\xaa", 0, FD),
            frame(0x123, b"\xaa\xbb", 0, FD | BRS),
            frame(0x4, b"", 0, ERROR),
            frame(0x0, b"\x99", 0, ERROR),
        ]
    )
    time_zero = 1_436_509_052_249_713_000
    assert format_candump(frames, time_zero, "vcan0").decode().splitlines() == [
        "(1436509052.249713) vcan0 123#1122",
        "(1436509052.250712) vcan0 123#",
        "(1436509052.249714) vcan0 12345678#FE",
        "(1436509052.249713) vcan0 00000001#",
        "(1436509052.249713) vcan0 123#R",
        "(1436509052.249713) vcan0 123#R4",
        "(1436509052.249713) vcan0 123##0AA",
        "(1436509052.249713) vcan0 123##1AABB",
        "(1436509052.249713) vcan0 20000004#0000000000000000",
        "(1436509052.249713) vcan0 20000080#0000000000000000",
    ]
    assert format_candump(frames[:1], 5_000_000) == b"(0000000000.005000) vcan0 123#1122\n"
    assert format_candump(frames[:0]) == b""


@given(
    st.lists(
        st.tuples(
            st.integers(0, 0x1FFF_FFFF),
            st.booleans(),
            st.one_of(st.binary(max_size=8), st.binary(max_size=64)),
            st.one_of(st.integers(0, 10**12), st.integers(0, 10**16 - 1)),
            st.integers(0, 2),
        ),
        min_size=1,
        max_size=20,
    ),
    st.sampled_from(["vcan0", "c", "can_of_16_letters", "fünf"]),
)
def test_candump_agrees_with_a_line_by_line_writer(
    rows: list[tuple[int, bool, bytes, int, int]], first: str
) -> None:
    frames = make_frames(len(rows))
    lines = []
    for at, (can_id, extended, data, t_us, channel) in enumerate(rows):
        can_id &= 0x1FFF_FFFF if extended else 0x7FF
        t_us %= 9 * 10**15  # what 64 bits of nanoseconds hold
        fd = len(data) > 8
        flags = (EXTENDED if extended else 0) | (FD if fd else 0)
        frames[at : at + 1] = frame(can_id, data, t_us * 1000 + 999, flags)
        frames[at]["channel"] = channel
        name = f"can{channel}" if channel else first
        digits = 8 if extended else 3
        seconds, rest = divmod(t_us, 10**6)
        text = f"{'#0' if fd else ''}{data.hex().upper()}"
        lines.append(f"({seconds:010d}.{rest:06d}) {name} {can_id:0{digits}X}#{text}\n")
    assert format_candump(frames, channel=first).decode() == "".join(lines)


@pytest.mark.parametrize("ending", FORMATS)
def test_nothing_is_lost_when_the_writer_is_slower(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "BACKLOG_FRAMES", 500)
    path = tmp_path / f"burst{ending}"
    frames = make_frames(100)
    frames["length"] = 4
    with open_recorder(path) as recorder:
        for start in range(0, 5000, 100):
            numbers = np.arange(start, start + 100, dtype=">u4")
            frames["data"][:, :4] = numbers.view(np.uint8).reshape(-1, 4)
            frames["t_ns"] = np.arange(start, start + 100) * 1_000_000
            recorder.write(frames, 100)
        assert recorder.counters.waited > 0
        assert recorder.counters.written == 5000
    numbers_read = [int.from_bytes(m.data, "big") for m in read(ending, path)]
    assert numbers_read == list(range(5000))


@pytest.mark.parametrize("ending", FORMATS)
def test_a_killed_process_leaves_what_was_flushed(ending: str, tmp_path: Path) -> None:
    """Read the file as it is on the disk while the recorder still runs."""
    path, copy = tmp_path / f"open{ending}", tmp_path / f"copy{ending}"
    flushed = threading.Event()
    file = FORMATS[ending](path, EPOCH_NS, "vcan0")
    inner = file.flush

    def flush() -> None:
        inner()
        flushed.set()

    file.flush = flush  # type: ignore[method-assign]
    with Recorder(path, file) as recorder:
        recorder.write(mixed_frames(), 3)
        started = time.monotonic()
        assert flushed.wait(10)
        assert time.monotonic() - started < 5
        copy.write_bytes(path.read_bytes())
        messages = read(ending, copy)
        assert [m.arbitration_id for m in messages] == [0x123, 0x7FF, 0x12345678]
        assert messages[0].timestamp == pytest.approx(EPOCH_NS / 1e9, abs=1.5e-6)


@pytest.mark.parametrize("ending", FORMATS)
def test_an_older_recording_leaves_nothing_in_its_place(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"again{ending}"
    whole = mixed_frames()[[0, 1, 2, 3, 6]]
    for frames in (np.tile(whole, 2000), whole, whole[:0]):
        with open_recorder(path) as recorder:
            recorder.write(frames, len(frames))
        assert len(read(ending, path)) == len(frames)


def test_a_recording_into_a_device_is_let_go(tmp_path: Path) -> None:
    path = tmp_path / "nowhere.log"
    path.symlink_to("/dev/null")
    with open_recorder(path) as recorder:
        recorder.write(mixed_frames(), 7)
    assert recorder.counters.written == 7
    assert path.is_char_device()


def test_writing_costs_the_caller_microseconds(tmp_path: Path) -> None:
    frames = mixed_frames()
    with open_recorder(tmp_path / "fast.log") as recorder:
        costs = []
        for _ in range(500):
            started = time.perf_counter()
            recorder.write(frames, len(frames))
            costs.append(time.perf_counter() - started)
    assert np.median(costs) < 100e-6


def test_candump_text_is_made_fast() -> None:
    frames = make_frames(20_000)
    frames["id"] = np.arange(20_000) % 0x800
    frames["length"] = 8
    format_candump(frames)
    started = time.perf_counter()
    format_candump(frames)
    rate = 20_000 / (time.perf_counter() - started)
    assert rate > 100_000  # about 2,000,000 on an idle core; line by line makes some 400,000


def test_a_full_disk_is_told_by_write_and_close(tmp_path: Path) -> None:
    class FullFile:
        def write(self, frames: np.ndarray) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

        def flush(self) -> None:
            raise AssertionError("nothing was written")

        def close(self) -> None:
            pass

    recorder = Recorder(tmp_path / "full.log", FullFile())
    recorder.write(mixed_frames(), 1)
    with pytest.raises(InputError, match="No space left on device"):
        recorder.close()
    with pytest.raises(InputError, match="No space left on device"):
        recorder.write(mixed_frames(), 1)


def test_a_closed_recorder_refuses_frames_and_closes_again(tmp_path: Path) -> None:
    recorder = open_recorder(tmp_path / "a.log")
    recorder.close()
    recorder.close()
    with pytest.raises(StateError, match="is closed"):
        recorder.write(mixed_frames(), 1)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("run.mf5", r"expected a file ending of \.log, \.blf, \.asc, \.mf4, .*got '\.mf5'"),
        ("run", "got none"),
        ("run.bfl", r"did you mean '\.blf'"),
        ("nowhere/run.log", "expected an existing folder"),
        ("folder.log", "expected a writable file, got Is a directory"),
        ("folder.blf", "expected a writable file, got Is a directory"),
    ],
)
def test_unusable_paths_are_one_clear_line(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "folder.log").mkdir()
    (tmp_path / "folder.blf").mkdir()
    with pytest.raises(InputError, match=text) as caught:
        open_recorder(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / name).is_file()


def test_blf_times_are_utc(tmp_path: Path) -> None:
    """The header's start, read by hand: year, month, weekday, day, hour, minute, second, ms."""
    path = tmp_path / "utc.blf"
    with open_recorder(path, epoch_ns=EPOCH_NS) as recorder:
        recorder.write(mixed_frames(), 1)
    start = np.frombuffer(path.read_bytes()[56:72], dtype="<u2")
    expected = datetime.fromtimestamp(EPOCH_NS / 1e9, tz=UTC)
    assert start[[0, 1, 3, 4, 5, 6]].tolist() == [
        expected.year,
        expected.month,
        expected.day,
        expected.hour,
        expected.minute,
        expected.second,
    ]
