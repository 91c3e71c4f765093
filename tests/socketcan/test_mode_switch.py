"""The car on a real kernel's vcan0, with nothing but can-utils around it.

canplayer plays a controller's requests, cangen disturbs, cansend sends a single frame, candump writes
down what a foreign node sees; cantools reads it.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import can
import cantools
import pytest

pytestmark = pytest.mark.socketcan

DEVICE = "vcan0"
LIMIT_S = 200.0
COMMAND = str(Path(sys.executable).parent / "hev-can-emu")
DATABASE = cantools.database.load_file(Path(__file__).parents[2] / "dbc" / "hev.dbc")
OURS = {m.frame_id: m for m in DATABASE.messages}
REQUESTS = {m.frame_id for m in DATABASE.messages if "HCU" in m.senders}


@pytest.fixture(scope="module")
def scratch() -> Path:
    """stage.py's folder: holds what a run in virtual time had on the bus, takes the results."""
    return Path(os.environ["SCRATCH"])


@contextlib.contextmanager
def program(*command: str, out: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """A program that is running meanwhile."""
    with contextlib.ExitStack() as files:
        sink = subprocess.DEVNULL if out is None else files.enter_context(out.open("wb"))
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=sink, stderr=subprocess.STDOUT
        )
        try:
            yield process
        finally:
            process.terminate()
            process.wait(LIMIT_S)


def wait_for(path: Path, pattern: str) -> None:
    """Return once a program has written that."""
    deadline = time.monotonic() + LIMIT_S
    while not re.search(pattern, path.read_text()):
        assert time.monotonic() < deadline, f"no {pattern!r}:\n{path.read_text()}"
        time.sleep(0.05)


def requests_of(everything: Path, to: Path) -> int:
    """Write the controller's part of a log; returns its number of frames."""
    lines = [
        line
        for line in everything.read_text().splitlines(keepends=True)
        if int(line.split()[2].partition("#")[0], 16) in REQUESTS
    ]
    to.write_text("".join(lines))
    return len(lines)


def changes(
    log: list[can.Message], message: str, signal_name: str
) -> list[tuple[can.Message, str]]:
    """Return the frames in which a signal had a new value, and the values."""
    definition = DATABASE.get_message_by_name(message)
    seen: list[tuple[can.Message, str]] = []
    for frame in log:
        if frame.arbitration_id == definition.frame_id and not frame.is_extended_id:
            value = str(definition.decode(frame.data)[signal_name])
            if not seen or seen[-1][1] != value:
                seen.append((frame, value))
    return seen


@pytest.fixture(scope="module")
def drive(scratch: Path, tmp_path_factory: pytest.TempPathFactory) -> list[can.Message]:
    """What candump saw of a drive in which can-utils were the controller and the noise."""
    sent = requests_of(scratch / "everything.log", scratch / "requests.log")
    assert sent > 1000
    # In memory while it lasts: each line is a write, which is slow on user-mode Linux's own files.
    folder = tmp_path_factory.mktemp("drive")
    candump, emulator = folder / "candump.log", folder / "emulator.txt"
    with contextlib.ExitStack() as running:
        running.enter_context(program("candump", "-d", "-r", "4000000", "-L", DEVICE, out=candump))
        car = running.enter_context(
            program(COMMAND, "run", "--bus", f"socketcan:{DEVICE}", "--model", "4dof", out=emulator)
        )
        wait_for(emulator, r"join from another terminal: +candump vcan0")
        # A request from a node that knows no protection: refused, and counted by the car.
        wrong = f"{DATABASE.get_message_by_name('HCU_EM2Request').frame_id:03X}#FF{'00' * 7}"
        for _ in range(3):
            subprocess.run(["cansend", DEVICE, wrong], check=True, timeout=LIMIT_S)
        noise = ("-g", "4", "-I", "0", "-L", "r", "-D", "r", "-m")  # -m: of every kind
        running.enter_context(program("cangen", DEVICE, *noise))
        player = ["canplayer", "-I", str(scratch / "requests.log")]
        subprocess.run(player, check=True, timeout=LIMIT_S, stdout=subprocess.DEVNULL)
        assert car.poll() is None, emulator.read_text()
        car.send_signal(signal.SIGINT)
        assert car.wait(LIMIT_S) == 0, emulator.read_text()
    for file in (candump, emulator):
        shutil.copy(file, scratch)
    assert "Traceback" not in emulator.read_text()
    assert "DROPCOUNT" not in candump.read_text()
    with can.LogReader(candump) as reader:
        return list(reader)


def test_the_mode_is_switched_by_frames_from_canplayer(
    drive: list[can.Message], scratch: Path
) -> None:
    modes = changes(drive, "EMU_PlantState", "DrivingMode")
    names = [mode for _, mode in modes]
    (scratch / "switch.txt").write_text(
        "".join(
            f"({frame.timestamp:.6f}) vcan0 {frame.arbitration_id:03X}#{frame.data.hex().upper()}  {mode}\n"
            for frame, mode in modes
        )
    )
    driving = [mode for mode in names if mode in ("Series", "ParallelG1", "ParallelG2")]
    assert driving == ["Series", "ParallelG1"]
    assert names[-1] == "ParallelG1"
    assert [gear for _, gear in changes(drive, "TCU_Synchronizer", "Gear")][-1] == "G1"
    assert [state for _, state in changes(drive, "TCU_Clutch", "ClutchState")][-1] == "Locked"


def test_requests_without_protection_are_refused(drive: list[can.Message]) -> None:
    refused = changes(drive, "EMU_PlantState", "RejectedFrames")
    assert float(refused[-1][1]) >= 3.0


def test_none_of_the_cars_frames_is_lost_though_cangen_disturbs(drive: list[can.Message]) -> None:
    noise = [frame for frame in drive if frame.arbitration_id == 0]
    assert len(noise) > 200
    for kind in ("is_fd", "is_extended_id", "is_remote_frame", "bitrate_switch"):
        assert {getattr(frame, kind) for frame in noise} == {True, False}, kind
    checked = 0
    for can_id, message in OURS.items():
        counter = f"{message.name}_Counter"
        if can_id in REQUESTS or counter not in {s.name for s in message.signals}:
            continue
        frames = [f for f in drive if f.arbitration_id == can_id and not f.is_extended_id]
        counters = [message.decode(frame.data)[counter] for frame in frames]
        steps = {(b - a) % 15 for a, b in itertools.pairwise(counters)}
        assert steps == {1}, message.name
        checked += 1
    assert checked > 10
