"""What a person sees: a living line on a terminal, none elsewhere; memory that does not grow."""

from __future__ import annotations

import os
import pty
import subprocess
import threading
from pathlib import Path

import pytest
from service_rig import COMMAND, LIMIT_S, START_S, emulator, node

pytestmark = pytest.mark.realtime


def stderr_on_a_terminal(*arguments: str) -> str:
    """Run the command with a pseudo-terminal as stderr and return what was written there."""
    ours, theirs = pty.openpty()
    parts: list[bytes] = []

    def read() -> None:
        while True:
            try:
                parts.append(os.read(ours, 65536))
            except OSError:  # its last writer has gone
                return

    try:
        done = subprocess.Popen(
            [COMMAND, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=theirs,
            env=os.environ | {"COLUMNS": "100", "TERM": "xterm"},
        )
        os.close(theirs)
        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        assert done.wait(START_S) == 0
        reader.join(LIMIT_S)
    finally:
        os.close(ours)
    return b"".join(parts).decode()


def test_a_status_line_lives_on_a_terminal() -> None:
    shown = stderr_on_a_terminal("run", "--bus", "loopback", "--duration", "0.9")
    lines = [line for line in shown.split("\r\x1b[K") if "km/h" in line]
    assert len(lines) >= 3
    assert all("engine" in line and "overruns" in line for line in lines)
    assert max(len(line.strip()) for line in lines) < 100


def test_a_bar_shows_how_far_a_scenario_is(tmp_path: Path) -> None:
    path = tmp_path / "short.yaml"
    path.write_text("version: 1\nname: short\nduration: 1 s\nsteps:\n- {name: go, at: 500 ms}\n")
    shown = stderr_on_a_terminal("scenario", "run", str(path), "--bus", "loopback")
    bars = [line for line in shown.split("\r\x1b[K") if "━" in line]
    assert "waits for: go" in bars[0]
    assert "over" in bars[-1]
    filled = [bar.count("━") for bar in bars]
    assert filled == sorted(filled)
    assert filled[0] < 15
    assert filled[-1] == 30


def test_elsewhere_there_is_no_line_and_memory_stays(tmp_path: Path) -> None:
    def resident_kib(pid: int) -> int:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))

    with emulator(tmp_path, "--record", "run.log") as running, node(running.port) as listener:
        listener.until("ESC_Vehicle", lambda _: True)
        listener.request("HCU_EM2Request", EM2ControlMode="Torque", EM2TorqueRequest=10)
        listener.wait(3.0)
        before = resident_kib(running.process.pid)
        listener.wait(5.0)
        after = resident_kib(running.process.pid)
        running.end()
    assert "\r" not in running.err.read_text()
    # 11,000 frames; kept at 80 bytes each they would be 860 KiB
    assert after - before < 600
