"""The car on a real kernel's vcan0, with nothing but can-utils around it.

canplayer plays a controller's requests round and round, candump writes down what comes of them, and that
decides what is requested next.  So a slow machine takes longer, and comes to the same end.  cangen
disturbs meanwhile, cansend sends single frames.
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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TextIO

import cantools
import pytest
from e2e import p11

pytestmark = pytest.mark.socketcan

DEVICE = "vcan0"
LIMIT_S = 120.0
COMMAND = str(Path(sys.executable).parent / "hev-can-emu")
DATABASE = cantools.database.load_file(Path(__file__).parents[2] / "dbc" / "hev.dbc")
REQUESTS = [m for m in DATABASE.messages if "HCU" in m.senders]
CAR = {m.frame_id: m for m in DATABASE.messages if "HCU" not in m.senders}
COUNTERS = 15  # values of an alive counter, 0 to 14
PERIOD_MS = 10

# Wheel, base circle and gear radii of the shipped car, as ratios of speeds.
EM1_RATIO = 1.298737  # EM1 shaft over input shaft
EM2_RATIO = 1.850703  # EM2 shaft over intermediate shaft
G1 = 1.843526  # input shaft over intermediate shaft in G1
EM2_RPM = 1700  # some 25 km/h
EM1_RPM = round(EM2_RPM / EM2_RATIO * G1 * EM1_RATIO)  # turns as fast as G1 wants

# Not needed here: system calls are dear inside user-mode Linux.
SILENT = [word for node in ("ESC", "BMS", "VEH") for word in ("--node", f"{node}=silent")]

Signals = dict[str, float | str]


class Phase(NamedTuple):
    """What is requested, beside what was before, until the car is as wanted."""

    requests: Signals
    wanted: Callable[[Signals], bool]


DRIVE = {
    "crank and launch": Phase(
        {
            "ContactorRequest": "Closed",
            "EM2ControlMode": "Speed",
            "EM2SpeedRequest": EM2_RPM,
            "EM1ControlMode": "Speed",
            "EM1SpeedRequest": 1200,
            "ClutchTorqueCapacityRequest": 200,
        },
        lambda car: car["EngineSpeed"] > 700 and car["ClutchState"] == "Locked",
    ),
    "series": Phase(
        {"EngineRunRequest": "Run"},
        lambda car: (
            (car["DrivingMode"], car["EngineState"]) == ("Series", "Running")
            and abs(car["EM2Speed"] - EM2_RPM) < 50
        ),
    ),
    "open C1, match G1": Phase(
        {"ClutchTorqueCapacityRequest": 0, "EM1SpeedRequest": EM1_RPM},
        lambda car: car["ClutchState"] == "Open" and abs(car["EM1Speed"] - EM1_RPM) < 100,
    ),
    "engage G1": Phase(
        {"EM1ControlMode": "Torque", "GearRequest": "G1", "ShiftForceRequest": 900},
        lambda car: car["Gear"] == "G1",
    ),
    "close C1": Phase(
        {"ClutchTorqueCapacityRequest": 200}, lambda car: car["DrivingMode"] == "ParallelG1"
    ),
}


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


def write_requests(path: Path, signals: Signals) -> None:
    """Write a log that holds every request with each of its counter's values, at its period."""
    lines = []
    for turn, message in itertools.product(range(2 * COUNTERS), REQUESTS):
        every = message.cycle_time // PERIOD_MS
        if turn % every:
            continue
        names = {s.name for s in message.signals}
        values = {s.name: s.initial or 0 for s in message.signals}
        values |= {name: value for name, value in signals.items() if name in names}
        values[f"{message.name}_Counter"] = turn // every % COUNTERS
        data = bytearray(message.encode(values))
        data_id = int(message.dbc.attributes["E2EDataID"].value)
        p11.e2e_p11_protect(data, data_id, increment_counter=False)
        lines.append(f"({turn * 0.01:.6f}) {DEVICE} {message.frame_id:03X}#{data.hex().upper()}\n")
    path.write_text("".join(lines))


class Dump:
    """Reads what candump writes, as far as it is."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._part = ""
        self.car: Signals = {}

    def read(self) -> None:
        """Take what is new into ``car``: the latest value of each of the car's signals."""
        *lines, self._part = (self._part + self._file.read()).split("\n")
        latest: dict[int, bytes] = {}
        for line in lines:
            found = re.fullmatch(r"\([\d.]+\) \w+ ([0-9A-F]{3})#((?:[0-9A-F]{2})+)", line)
            if found and int(found[1], 16) in CAR:
                latest[int(found[1], 16)] = bytes.fromhex(found[2])
        for can_id, data in latest.items():
            decoded = CAR[can_id].decode(data)
            self.car |= {
                k: float(v) if isinstance(v, int | float) else str(v) for k, v in decoded.items()
            }

    def until(self, what: str, wanted: Callable[[Signals], bool]) -> None:
        """Return once the car is as wanted."""
        deadline = time.monotonic() + LIMIT_S
        while not self.car or not wanted(self.car):
            assert time.monotonic() < deadline, f"{what} never came about; last: {self.car}"
            time.sleep(0.05)
            self.read()


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """What candump saw of a drive in which can-utils were the controller and the noise."""
    # In memory while it lasts: each line is a write, which is slow on user-mode Linux's own files.
    folder = tmp_path_factory.mktemp("drive")
    candump, emulator, log = folder / "candump.log", folder / "emulator.txt", folder / "requests"
    with contextlib.ExitStack() as running:
        running.enter_context(program("candump", "-d", "-r", "4000000", "-L", DEVICE, out=candump))
        car = running.enter_context(
            program(
                *(COMMAND, "run", "--bus", f"socketcan:{DEVICE}", "--model", "4dof", *SILENT),
                out=emulator,
            )
        )
        # Results are kept, above all those of a drive that failed.
        for file in (candump, emulator):
            running.callback(shutil.copy, file, os.environ["SCRATCH"])
        wait_for(emulator, r"join from another terminal: +candump vcan0")
        # Requests from a node that knows no protection: refused, and counted by the car.
        wrong = f"{DATABASE.get_message_by_name('HCU_EM2Request').frame_id:03X}#FF{'00' * 7}"
        for _ in range(3):
            subprocess.run(["cansend", DEVICE, wrong], check=True, timeout=LIMIT_S)
        dump = Dump(running.enter_context(candump.open()))
        dump.until("refusal", lambda now: now["RejectedFrames"] == 3)
        noise = ("-g", "10", "-I", "0", "-L", "r", "-D", "r", "-m")  # -m: of every kind
        running.enter_context(program("cangen", DEVICE, *noise))
        requested: Signals = {}
        for name, phase in DRIVE.items():
            requested |= phase.requests
            write_requests(log, requested)
            with program("canplayer", "-l", "i", "-I", str(log)):
                dump.until(name, phase.wanted)
        assert car.poll() is None, emulator.read_text()
        car.send_signal(signal.SIGINT)
        assert car.wait(LIMIT_S) == 0, emulator.read_text()
    assert "Traceback" not in emulator.read_text()
    return Drive(candump.read_text(), emulator.read_text())


class Drive:
    """What a drive left: candump's lines and the emulator's."""

    def __init__(self, dumped: str, said: str) -> None:
        found = (re.fullmatch(r"\(([\d.]+)\) \w+ ([0-9A-F]+)#(\S*)", x) for x in dumped.split("\n"))
        self.frames = [(float(f[1]), f[2], f[3]) for f in found if f]
        told = re.search(r"frames: (\d+) sent, \d+ received, (\d+) dropped", said)
        assert told, said
        self.sent = int(told[1])
        # On a machine that is starved: by the emulator's full queue, by candump's.
        self.dropped = int(told[2]), sum(map(int, re.findall(r"dropped (\d+) CAN frame", dumped)))

    def of(self, message: cantools.database.can.Message) -> list[tuple[float, str]]:
        """Return time and data of each frame of one message."""
        own = f"{message.frame_id:03X}"
        return [(t, data) for t, can_id, data in self.frames if can_id == own]


def test_requests_by_canplayer_switch_the_mode(drive: Drive) -> None:
    message = DATABASE.get_message_by_name("EMU_PlantState")
    modes: list[str] = []
    lines = []
    for t, data in drive.of(message):
        mode = str(message.decode(bytes.fromhex(data))["DrivingMode"])
        if modes[-1:] != [mode]:
            modes.append(mode)
            lines.append(f"({t:.6f}) {DEVICE} {message.frame_id:03X}#{data}  {mode}\n")
    Path(os.environ["SCRATCH"], "switch.txt").write_text("".join(lines))
    assert modes[0] == "ElectricNeutral"
    assert modes.index("Series") < modes.index("ParallelG1")


def test_none_of_the_cars_frames_is_lost_though_cangen_disturbs(drive: Drive) -> None:
    noise = [(can_id, data) for _, can_id, data in drive.frames if can_id in ("000", "00000000")]
    assert len(noise) > 100
    assert {can_id for can_id, _ in noise} == {"000", "00000000"}
    assert {data[:1] == "#" for _, data in noise} == {True, False}  # CAN FD
    assert any(data.startswith("R") for _, data in noise)

    frames = {message: drive.of(message) for message in CAR.values()}
    lost = drive.sent - sum(map(len, frames.values()))
    by_emulator, by_candump = drive.dropped
    assert by_emulator <= lost <= by_emulator + by_candump
    gaps = 0
    for message, seen in frames.items():
        counter = f"{message.name}_Counter"
        if counter in {s.name for s in message.signals}:
            counters = [message.decode(bytes.fromhex(data))[counter] for _, data in seen]
            gaps += sum((b - a) % COUNTERS != 1 for a, b in itertools.pairwise(counters))
    assert gaps <= lost
    assert len([message for message, seen in frames.items() if seen]) > 15
