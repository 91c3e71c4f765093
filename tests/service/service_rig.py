"""A running emulator as a process of its own, and a controller that talks to it as any program would.

The controller's side uses python-can, cantools and autosar-e2e, nothing of this package.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import can
import cantools
from e2e import p11

LIMIT_S = 60.0
START_S = 400.0  # should the kernels have to be compiled first
PERIOD_S = 0.01
COMMAND = str(Path(sys.executable).parent / "hev-can-emu")
DATABASE = cantools.database.load_file(Path(__file__).parents[2] / "dbc" / "hev.dbc")


class Emulator:
    """``hev-can-emu run`` on a free port of the embedded bus."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.out, self.err = folder / "stdout", folder / "stderr"
        with self.out.open("w") as out, self.err.open("w") as err:
            self.process = subprocess.Popen(
                [COMMAND, "run", "--bus", "socketcand:127.0.0.1:0", *options],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd=folder,
            )
        self.port = int(self._await(r"python -m can\.logger .* port=(\d+)")[1])

    def _await(self, pattern: str) -> re.Match[str]:
        deadline = time.monotonic() + START_S
        while time.monotonic() < deadline and self.process.poll() is None:
            if found := re.search(pattern, self.out.read_text()):
                return found
            time.sleep(0.02)
        self.kill()
        raise AssertionError(f"no {pattern!r}:\n{self.out.read_text()}{self.err.read_text()}")

    def end(self, number: signal.Signals = signal.SIGINT) -> str:
        """Interrupt it, see that it ends well, and return what it printed."""
        assert self.process.poll() is None, f"ended by itself:\n{self.err.read_text()}"
        self.process.send_signal(number)
        code = self.process.wait(LIMIT_S)
        assert code == 0, self.err.read_text()
        assert "Traceback" not in self.err.read_text()
        return self.out.read_text()

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


@contextmanager
def emulator(folder: Path, *options: str) -> Iterator[Emulator]:
    """An emulator, killed in the end should the test not have ended it."""
    folder.mkdir(exist_ok=True)
    running = Emulator(folder, *options)
    try:
        yield running
    finally:
        running.kill()


class Sample(NamedTuple):
    """A decoded frame: the bus's time, s; when it came here, s of the monotonic clock; signals."""

    t: float
    came: float
    signals: dict[str, float | str]


class Node:
    """A program on the bus: hears everything, and sends requests every 10 ms while told to."""

    def __init__(self, port: int) -> None:
        self._bus = can.Bus(interface="socketcand", channel="vcan0", host="127.0.0.1", port=port)
        self._heard: dict[int, list[tuple[float, float, bytes]]] = {}
        self._changed = threading.Condition()
        self._ended = threading.Event()
        self._requests: dict[str, dict[str, float | str]] = {}
        self._counters: dict[str, int] = {}
        self.spoil = 0  # XORed onto the CRC
        self._threads = [
            threading.Thread(target=self._listen, daemon=True),
            threading.Thread(target=self._talk, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(LIMIT_S)
        self._bus.shutdown()

    # Hearing

    def _listen(self) -> None:
        while not self._ended.is_set():
            try:
                frame = self._bus.recv(0.05)
            except (can.CanError, OSError):  # the emulator has ended
                return
            if frame is None:
                continue
            with self._changed:
                heard = self._heard.setdefault(frame.arbitration_id, [])
                heard.append((frame.timestamp, time.monotonic(), bytes(frame.data)))
                self._changed.notify_all()

    def samples(self, message: str, since: float = 0.0) -> list[Sample]:
        """Return what was heard of a message after ``since``, bus time."""
        definition = DATABASE.get_message_by_name(message)
        with self._changed:
            heard = list(self._heard.get(definition.frame_id, ()))
        return [
            Sample(t, came, {k: _plain(v) for k, v in definition.decode(data).items()})
            for t, came, data in heard
            if t > since
        ]

    def raw(self) -> dict[int, list[tuple[float, float, bytes]]]:
        with self._changed:
            return {can_id: list(heard) for can_id, heard in self._heard.items()}

    def now(self) -> float:
        """Return the bus time of the latest frame."""
        with self._changed:
            return max((heard[-1][0] for heard in self._heard.values()), default=0.0)

    def until(
        self, message: str, wanted: Callable[[dict[str, float | str]], bool], limit_s: float = 20.0
    ) -> Sample:
        """Return the first frame of a message, from now on, that is as wanted."""
        definition = DATABASE.get_message_by_name(message)
        deadline = time.monotonic() + limit_s
        with self._changed:
            next_one = len(self._heard.get(definition.frame_id, ()))
        last: object = None
        while time.monotonic() < deadline:
            with self._changed:
                self._changed.wait(0.2)
                heard = self._heard.get(definition.frame_id, [])[next_one:]
            for t, came, data in heard:
                last = {k: _plain(v) for k, v in definition.decode(data).items()}
                if wanted(last):
                    return Sample(t, came, last)
            next_one += len(heard)
        raise AssertionError(f"{message} never came so within {limit_s} s; last: {last}")

    def wait(self, seconds: float) -> None:
        """Return once that much of the bus's time has passed."""
        start = self.now()
        deadline = time.monotonic() + LIMIT_S
        with self._changed:
            self._changed.wait_for(
                lambda: max(h[-1][0] for h in self._heard.values()) >= start + seconds, LIMIT_S
            )
        assert time.monotonic() < deadline

    # Talking

    def request(self, message: str, **signals: float | str) -> None:
        """Send a request every 10 ms from now on, other signals at their start values."""
        self._requests[message] = signals

    def fall_silent(self) -> None:
        self._requests.clear()

    def _talk(self) -> None:
        due = time.monotonic()
        while not self._ended.is_set():
            for message, signals in list(self._requests.items()):
                try:
                    self._bus.send(self._frame(message, signals))
                except (can.CanError, OSError):  # the emulator has ended
                    return
            due += PERIOD_S
            left = due - time.monotonic()
            if left > 0.0:
                self._ended.wait(left)
            else:
                due -= left

    def _frame(self, message: str, signals: dict[str, float | str]) -> can.Message:
        definition = DATABASE.get_message_by_name(message)
        values = {s.name: s.initial or 0 for s in definition.signals} | signals
        counter = self._counters.get(message, -1)
        self._counters[message] = values[f"{message}_Counter"] = (counter + 1) % 15
        data = bytearray(definition.encode(values))
        data_id = int(definition.dbc.attributes["E2EDataID"].value)
        p11.e2e_p11_protect(data, data_id, increment_counter=False)
        data[0] ^= self.spoil
        return can.Message(arbitration_id=definition.frame_id, data=data, is_extended_id=False)


@contextmanager
def node(port: int) -> Iterator[Node]:
    joined = Node(port)
    try:
        yield joined
    finally:
        joined.close()


def _plain(value: object) -> float | str:
    """Return a decoded value as a number, or as its label."""
    return float(value) if isinstance(value, int | float) else str(value)


def log_of(path: Path) -> list[can.Message]:
    """Read a recording with python-can."""
    with can.LogReader(path) as reader:
        return list(reader)


__all__ = [
    "COMMAND",
    "DATABASE",
    "LIMIT_S",
    "START_S",
    "Emulator",
    "Node",
    "emulator",
    "log_of",
    "node",
]
