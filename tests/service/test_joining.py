"""Other programs join a running emulator: nothing is lost, nothing is late on average."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest
from service_rig import COMMAND, DATABASE, LIMIT_S, emulator, log_of, node

pytestmark = pytest.mark.realtime

# Sent by the emulator: all but the controller's.
CYCLIC = [m for m in DATABASE.messages if m.cycle_time and "HCU" not in m.senders]


def slope(t: list[float]) -> float:
    """Return the mean distance of instants, by a straight line through all of them."""
    return float(np.polyfit(np.arange(len(t)), np.asarray(t) - t[0], 1)[0])


def contents(frames: list[can.Message]) -> list[tuple[int, bytes]]:
    return [(frame.arbitration_id, bytes(frame.data)) for frame in frames]


def test_joined_loggers_and_recordings_agree_and_periods_hold(tmp_path: Path) -> None:
    with emulator(tmp_path, "--record", "run.blf", "--record", "run.log") as running:
        logger = subprocess.Popen(
            [
                *(sys.executable, "-m", "can.logger", "-i", "socketcand", "-c", "vcan0"),
                *("-f", "client.log"),
                *("--bus-kwargs", "host=127.0.0.1", f"port={running.port}"),
            ],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            with node(running.port) as listener:
                listener.until("ESC_Vehicle", lambda _: True)
                listener.wait(10.5)
                heard = listener.raw()
            logger.send_signal(signal.SIGINT)
            _, complaints = logger.communicate(timeout=LIMIT_S)
        finally:
            logger.kill()
        assert complaints == ""
        printed = running.end()
    assert "frames: " in printed

    recorded = log_of(tmp_path / "run.blf")
    assert contents(recorded) == contents(log_of(tmp_path / "run.log"))
    logged = log_of(tmp_path / "client.log")
    assert len(logged) > 10_000
    everything, part = contents(recorded), contents(logged)
    # Counters repeat after 15 frames at the soonest; a whole second of frames does not.
    start = next(i for i in range(len(everything)) if everything[i : i + 1470] == part[:1470])
    assert everything[start : start + len(part)] == part

    assert len(CYCLIC) == 24
    for message in CYCLIC:
        period = message.cycle_time * 1e-3
        stamps = [f.timestamp for f in recorded if f.arbitration_id == message.frame_id]
        assert len(stamps) > 10.0 / period
        assert slope(stamps) == pytest.approx(period, rel=1e-3), message.name
        assert np.diff(stamps) == pytest.approx(period, abs=1e-5), message.name
        came = [came for _, came, _ in heard[message.frame_id]]
        assert slope(came) == pytest.approx(period, rel=1e-3), f"{message.name} as heard"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda s: s.name)
def test_a_signal_ends_it_well_with_recordings_complete(
    tmp_path: Path, number: signal.Signals
) -> None:
    names = ("run.blf", "run.log", "run.asc")
    options = [word for name in names for word in ("--record", name)]
    with emulator(tmp_path, *options) as running, node(running.port) as listener:
        listener.until("ESC_Vehicle", lambda _: True)
        listener.request("HCU_EM2Request", EM2ControlMode="Torque", EM2TorqueRequest=10)
        listener.wait(1.0)
        printed = running.end(number)
        heard = sum(len(each) for each in listener.raw().values())
    frames = {name: contents(log_of(tmp_path / name)) for name in names}
    assert frames["run.blf"] == frames["run.log"] == frames["run.asc"]
    request = DATABASE.get_message_by_name("HCU_EM2Request").frame_id
    requests = sum(can_id == request for can_id, _ in frames["run.log"])
    assert requests > 50
    assert f"{len(frames['run.log']) - requests} sent, {requests} received" in printed
    assert len(frames["run.log"]) - requests >= heard > 1000
    assert " 0 dropped, 0 refused, 0 unknown, 0 from a second sender" in printed


def test_duration_ends_it_by_itself_at_that_time(tmp_path: Path) -> None:
    with emulator(tmp_path, "--duration", "500 ms", "--record", "run.log") as running:
        assert running.process.wait(LIMIT_S) == 0
    assert running.out.read_text().splitlines()[-2].startswith("0.500 s, 500 ticks, ")
    stamps = [frame.timestamp for frame in log_of(tmp_path / "run.log")]
    assert stamps[-1] - stamps[0] == pytest.approx(0.499, abs=0.005)


def test_a_port_in_use_is_one_line(tmp_path: Path) -> None:
    with emulator(tmp_path) as running:
        second = subprocess.run(
            [COMMAND, "run", "--bus", f"socketcand:127.0.0.1:{running.port}", "--duration", "1"],
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        running.end()
    assert second.returncode == 2
    (line,) = second.stderr.splitlines()
    assert f"expected a free TCP port, got port {running.port} in use" in line
    assert second.stdout == ""
