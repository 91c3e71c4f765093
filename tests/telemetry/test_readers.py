"""Other programs' readers, and a process killed while it records."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from asammdf import MDF
from recorded import DBC, network, recorded

from hev_can_emu.errors import InputError
from hev_can_emu.telemetry.reading import read_recording
from hev_can_emu.telemetry.recorder import ENDINGS, FORMATS, open_recorder

EPOCH_NS = 1_700_000_000_250_000_000
CHILD = """
import sys, threading
sys.path.insert(0, sys.argv[1])
from recorded import DBC, network, recorded
from hev_can_emu.telemetry.recorder import open_recorder
run = recorded()
recorders = [open_recorder(path, network=run.network) for path in sys.argv[2:]]
for recorder in recorders:
    recorder.write(run.frames, 1500)
pause = threading.Event()
while any(recorder.counters.flushed < 1500 for recorder in recorders):
    pause.wait(0.02)
for recorder in recorders:
    recorder.write(run.frames[1500:], 7)
print("flushed", flush=True)
pause.wait()
"""


def test_tshark_reads_candump_and_blf(tmp_path: Path) -> None:
    tshark = shutil.which("tshark")
    assert tshark, "tests need the Debian package tshark"
    run = recorded()
    for ending in (".log", ".blf"):
        path = tmp_path / f"run{ending}"
        with open_recorder(path, epoch_ns=EPOCH_NS) as recorder:
            recorder.write(run.frames, len(run.frames))
        fields = ["-T", "fields", "-e", "frame.time_epoch", "-e", "can.id", "-e", "data.data"]
        shown = subprocess.run(
            [tshark, "-r", path, *fields],
            capture_output=True, text=True, check=True, timeout=120, env=os.environ | {"TZ": "UTC"},
        )  # fmt: skip
        rows = [line.split("\t") for line in shown.stdout.splitlines()]
        assert len(rows) == len(run.frames)
        times = np.array([float(row[0]) for row in rows])
        assert times == pytest.approx((EPOCH_NS + run.frames["t_ns"]) * 1e-9, rel=0, abs=2e-6)
        assert [int(row[1], 0) for row in rows] == run.frames["id"].tolist()
        assert [row[2] for row in rows] == [bytes(f["data"][:8]).hex() for f in run.frames]


def test_asammdf_decodes_the_bus_logging(tmp_path: Path) -> None:
    run = recorded()
    path = tmp_path / "run.mf4"
    with open_recorder(path, network=run.network) as recorder:
        recorder.write(run.frames, 2000)
        recorder.write(run.frames[2000:], len(run.frames) - 2000)
    with MDF(path) as bus, bus.extract_bus_logging({"CAN": [(str(DBC), 0)]}) as signals:
        speed = signals.get("VehicleSpeed")
        torque = signals.get("EM2TorqueRequest")
    assert speed.unit == "km/h"
    frames = run.frames[run.frames["id"] == 400]
    assert speed.timestamps == pytest.approx(frames["t_ns"] * 1e-9, abs=1e-9)
    assert speed.samples[-1] > 1.0
    assert torque.samples[-1] == 80.0


@pytest.mark.parametrize("ending", ENDINGS)
def test_every_format_is_read_back(ending: str, tmp_path: Path) -> None:
    run = recorded()
    path = tmp_path / f"run{ending}"
    dates = ending in FORMATS
    with open_recorder(path, network=run.network, epoch_ns=EPOCH_NS) as recorder:
        recorder.write(run.frames, len(run.frames))
    back = read_recording(path, run.network)
    expected = run.frames.copy()
    for frames in (back, expected):
        frames.sort(order=["t_ns", "id"])
    for field in ("id", "length", "data"):
        assert np.array_equal(back[field], expected[field]), field
    # A date in float64 seconds is exact to a quarter of a microsecond.
    assert back["t_ns"] == pytest.approx(expected["t_ns"], abs=1500 if dates else 0)


def test_a_killed_process_leaves_what_was_flushed(tmp_path: Path) -> None:
    paths = [tmp_path / f"run{ending}" for ending in ENDINGS]
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, Path(__file__).parent, *paths],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert child.stdout is not None
    assert child.stdout.readline() == "flushed\n"
    os.kill(child.pid, signal.SIGKILL)
    assert child.wait(30) == -signal.SIGKILL
    child.stdout.close()
    run = recorded()
    last = run.frames["t_ns"][1499]
    sure = int(np.searchsorted(run.frames["t_ns"], last))  # tables hold the last instant back
    for path in paths:
        back = read_recording(path, run.network)
        assert len(back) >= (1500 if path.suffix in FORMATS else sure), path
        expected = run.frames[: len(back)].copy()
        for frames in (back, expected):
            frames.sort(order=["t_ns", "id"])
        assert np.array_equal(back["data"], expected["data"]), path


@pytest.mark.parametrize("ending", ENDINGS)
def test_garbage_is_told_in_one_line(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"garbage{ending}"
    path.write_bytes(bytes(range(256)) * 8)
    with pytest.raises(InputError) as told:
        read_recording(path, network())
    assert str(path) in str(told.value)
    assert "\n" not in str(told.value)


def test_what_is_not_there_or_no_recording_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a recording, got no such file"):
        read_recording(tmp_path / "none.log", network())
    with pytest.raises(InputError, match=r"expected a file ending of .*did you mean '\.mf4'"):
        read_recording(tmp_path / "run.mdf4", network())


def test_a_second_recording_takes_the_place_of_a_killed_one(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    path.mkdir()
    (path / "part-000000.parquet").write_bytes(b"left over")
    run = recorded()
    with open_recorder(path, network=run.network) as recorder:
        recorder.write(run.frames, 100)
    assert path.is_file()
    assert len(read_recording(path, run.network)) == 100
    path.unlink()
    path.mkdir()
    (path / "thesis.txt").write_text("irreplaceable")
    with pytest.raises(InputError, match="expected a file's name, got a folder"):
        open_recorder(path, network=run.network)
    assert (path / "thesis.txt").exists()
