"""A scripted scenario of 600 s beside its peers, in one run: python benchmarks/scenario.py

Ours is the whole process of ``hev-can-emu scenario run`` on the 16-DOF model with a candump recording,
from its start to its end.  The peers do the bus's part alone: they encode the very signals of that
recording with cantools, message by message, and send them at the same instants on python-can's virtual bus,
which one receiver reads, beside an exact NumPy step of the 16-DOF driveline each millisecond.  They are
measured on a stretch of the recording and scaled to its length; their start, the imports and the reading
of the DBC, is measured as a process of its own.  What they need besides (the matrix, the values of the
signals) is not counted.  The ratio is given without their start, and of whole processes.  All is in
wall-clock seconds, best of five for ours, and in CPU seconds, which another load on the machine changes
less: hash, text, file and expectations are made on further threads.

Below stands where ours go, part by part, each measured alone; what lies outside this program's code (imports,
the hash, the file) is a floor that no change of it can pass.
"""

from __future__ import annotations

import os

# Its idle workers would turn beside the peers' and add to their CPU seconds; ours says so itself.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import hashlib
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import can
import cantools
import numpy as np

from hev_can_emu.messages.frame import make_frames
from hev_can_emu.plant.linear import state_space
from hev_can_emu.plant.structure import CONFIGURATIONS, full_order
from hev_can_emu.resources import folder
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup, load_car
from hev_can_emu.telemetry.candump import format_candump

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


class Seconds(NamedTuple):
    """How long something took, and how long processors worked on it."""

    wall: float
    cpu: float


def ours(out: Path, name: str = "long", text: str = SCENARIO) -> Seconds:
    """Run the command; return its seconds."""
    scenario = out / f"{name}.yaml"
    scenario.write_text(text)
    # Emptying a large file that is there takes longer than making one.
    (out / f"{name}.log").unlink(missing_ok=True)
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
    return timed(command)


def timed(command: list[str | Path]) -> Seconds:
    """Run a command; return its seconds."""
    # As where it is installed: there modules are compiled to bytecode.
    usual = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    started = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=usual)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1):
        raise SystemExit(f"{command[0]} gave {process.returncode}")
    return Seconds(time.perf_counter() - started, used.ru_utime + used.ru_stime)


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


def peers(log: Path) -> Seconds:
    """Return the seconds of the peers for the whole length."""
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
    started, used = time.perf_counter(), time.process_time()
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
    stretch = Seconds(time.perf_counter() - started, time.process_time() - used)
    sender.shutdown()
    receiver.shutdown()
    return Seconds(*(each / STRETCH_S * LENGTH_S for each in stretch))


def peers_start() -> Seconds:
    """Return the seconds of a process of the peers' that has nothing to send, the best of five."""
    code = (
        "import can, cantools, numpy\n"
        f"cantools.database.load_file({str(folder('dbc') / 'hev.dbc')!r})\n"
        "buses = [can.Bus(interface='virtual', channel='bench') for _ in range(2)]\n"
        "for each in buses: each.shutdown()\n"
    )
    runs = [timed([sys.executable, "-c", code]) for _ in range(5)]
    return Seconds(min(run.wall for run in runs), min(run.cpu for run in runs))


def alone(work: Callable[[], object]) -> float:
    """Return the CPU seconds of some work in this process, the best of three."""
    best = math.inf
    for _ in range(3):
        started = time.process_time()
        work()
        best = min(best, time.process_time() - started)
    return best


def parts(out: Path, lines: int) -> Iterator[tuple[str, float]]:
    """Yield where the seconds go: what, and how many of CPU."""
    python: list[str | Path] = [sys.executable, "-c"]
    for modules in ("numpy", "numpy, numba"):
        best = min(timed([*python, f"import {modules}"]).cpu for _ in range(3))
        yield f"bare: import {modules}", best
    short = SCENARIO.replace(f"duration: {LENGTH_S} s", "duration: 1 s").replace(
        "times: 40", "times: 1"
    )
    short = short.replace("\n  from: 1 s", "")
    yield "ours: start and end, 1 s", min(ours(out, "short", short).cpu for _ in range(3))

    ticks = 20_000
    bench = Bench(Setup(model="16dof"))
    bench.command(em2_mode=1.0, em2_torque=60.0)
    yield "ours: plant's ticks", alone(lambda: bench.run(ticks)) / ticks * LENGTH_S * 1000
    car = Emulator(Setup(nodes={"HCU": "emulated"}))
    for name, value in (("ContactorRequest", 1), ("EM2ControlMode", 1), ("EM2TorqueRequest", 60)):
        car.set_value(car.database.signal(name).index, value)
    none = make_frames(0)

    def drive() -> None:
        until_ns = car.now_ns + ticks * 1_000_000
        while car.now_ns < until_ns:
            car.run(until_ns, none, 0)

    yield "ours: all ticks, plant included", alone(drive) / ticks * LENGTH_S * 1000
    frames = car.advance(car.now_ns + 2_000_000_000).copy()
    scale = lines / len(frames)
    yield "ours: text of the recording", alone(lambda: format_candump(frames)) * scale
    yield "bare: SHA-256 of all frames", alone(lambda: hashlib.sha256(frames.tobytes())) * scale
    text = (out / "long.log").read_bytes()
    yield "bare: the file's bytes into a file", alone(lambda: (out / "copy").write_bytes(text))


def main() -> None:
    """Print seconds, the ratio, and where they go."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        ours(out)  # what is compiled once is compiled
        runs = [ours(out) for _ in range(5)]
        best = Seconds(min(run.wall for run in runs), min(run.cpu for run in runs))
        log = out / "long.log"
        lines = sum(1 for _ in log.open())
        theirs, start = peers(log), peers_start()
        whole = Seconds(theirs.wall + start.wall, theirs.cpu + start.cpu)
        print(f"{LENGTH_S} s of car time, {lines} frames")
        print(f"ours, whole process {best.wall:8.2f} s wall {best.cpu:8.2f} s CPU")
        print(f"peers (scaled)      {theirs.wall:8.2f} s wall {theirs.cpu:8.2f} s CPU")
        print(f"peers' start        {start.wall:8.2f} s wall {start.cpu:8.2f} s CPU")
        for what, their in (("ratio without that", theirs), ("whole processes", whole)):
            print(f"{what:<20}{their.wall / best.wall:8.1f}        {their.cpu / best.cpu:8.1f}")
        for what, seconds in parts(out, lines):
            print(f"  {what:<34}{seconds:6.2f} s CPU")


if __name__ == "__main__":
    main()
