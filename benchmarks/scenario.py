"""A scripted scenario of 600 s beside its peers, in one run: python benchmarks/scenario.py

Ours is the whole process of ``hev-can-emu scenario run`` on the 16-DOF model with a candump recording,
from its start to its end.  The peers do the bus's part alone: they encode the very signals of that
recording with cantools, message by message, and send them at the same instants on python-can's virtual bus,
which one receiver reads, beside an exact NumPy step of the 16-DOF driveline each millisecond.  They are
measured on a stretch of the recording, and scaled to its length.  Times are CPU seconds, which another
load on the machine changes little; wall-clock seconds stand beside them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import can
import cantools
import numpy as np

from hev_can_emu.plant.linear import state_space
from hev_can_emu.plant.structure import CONFIGURATIONS, full_order
from hev_can_emu.resources import folder
from hev_can_emu.runtime.setup import load_car

LENGTH_S = 600
STRETCH_S = 20  #: of the peers
COMMAND = Path(sys.executable).parent / "hev-can-emu"
SCENARIO = f"""\
version: 1
name: stop and go for ten minutes
duration: {LENGTH_S} s
steps:
- at: 0 s
  set: {{ContactorRequest: Closed, EM2ControlMode: Torque}}
- repeat:
    times: 40
    steps:
    - name: pull
      after: 1 s
      ramp: {{EM2TorqueRequest: {{to: 180 Nm, over: 800 ms}}}}
    - name: fast
      when: VehicleSpeed > 30 km/h
      timeout: 10 s
      held: 50 ms
      ramp: {{EM2TorqueRequest: {{to: -120 Nm, over: 500 ms}}}}
    - name: slow
      when: VehicleSpeed < 5 km/h
      timeout: 10 s
      ramp: {{EM2TorqueRequest: {{to: 0 Nm, over: 200 ms}}}}
expectations:
- always: abs(EM2Speed) < 9000 rpm
- always: abs(WheelSpeedFL - WheelSpeedFR) < 2 km/h
  from: 1 s
- never: VehicleSpeed > 60 km/h
- jerk: {{value: truth.acceleration, limit: 60 m/s^3}}
"""


def ours(out: Path) -> tuple[float, float]:
    """Run the command; return its CPU and wall-clock seconds."""
    scenario = out / "long.yaml"
    scenario.write_text(SCENARIO)
    command = [
        COMMAND,
        "scenario",
        "run",
        scenario,
        "--out",
        out,
        "--record",
        ".log",
        "--no-report",
    ]
    # As where it is installed: there modules are compiled to bytecode.
    usual = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    started = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=usual)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1):
        raise SystemExit(f"the scenario gave {process.returncode}")
    return used.ru_utime + used.ru_stime, time.perf_counter() - started


def frames_of(log: Path) -> list[tuple[int, int, bytes]]:
    """Return millisecond, identifier and data of a stretch of the recording."""
    found = []
    for line in log.open():
        stamp, _, frame = line.split()
        ms = round(float(stamp[1:-1]) * 1e3)
        if ms >= STRETCH_S * 1000:
            break
        identifier, _, data = frame.partition("#")
        found.append((ms, int(identifier, 16), bytes.fromhex(data)))
    return found


def peers(log: Path) -> float:
    """Return the CPU seconds of the peers for the whole length."""
    database = cantools.database.load_file(str(folder("dbc") / "hev.dbc"))
    work = []
    for ms, identifier, data in frames_of(log):
        message = database.get_message_by_frame_id(identifier)
        work.append((ms, message, message.decode(data)))
    parameters = load_car("dai2024")[0]
    a, b = state_space(full_order(parameters), CONFIGURATIONS["electric_neutral"])
    nx, nu = b.shape
    block = np.zeros((nx + nu, nx + nu))
    block[:nx, :nx], block[:nx, nx:] = a * 1e-3, b * 1e-3
    from scipy.linalg import expm

    step = expm(block)
    ad, bd = step[:nx, :nx].copy(), step[:nx, nx:].copy()
    x, u = np.zeros(nx), np.zeros(nu)
    sender = can.Bus(interface="virtual", channel="bench")
    receiver = can.Bus(interface="virtual", channel="bench")
    at = 0
    started = time.process_time()
    for ms in range(STRETCH_S * 1000):
        x = ad @ x + bd @ u
        while at < len(work) and work[at][0] == ms:
            _, message, values = work[at]
            sender.send(
                can.Message(
                    arbitration_id=message.frame_id,
                    data=message.encode(values),
                    is_extended_id=message.is_extended_frame,
                )
            )
            at += 1
        while receiver.recv(0) is not None:
            pass
    used = time.process_time() - started
    sender.shutdown()
    receiver.shutdown()
    return used / STRETCH_S * LENGTH_S


def main() -> None:
    """Print seconds and the ratio."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        ours(out)  # what is compiled once is compiled
        best = min(ours(out) for _ in range(2))
        log = out / "long.log"
        lines = sum(1 for _ in log.open())
        theirs = peers(log)
    print(f"{LENGTH_S} s of car time, {lines} frames")
    print(f"ours, whole process {best[0]:8.2f} s CPU {best[1]:8.2f} s wall")
    print(f"peers (scaled)      {theirs:8.2f} s CPU")
    print(f"ratio               {theirs / best[0]:8.1f}")


if __name__ == "__main__":
    main()
