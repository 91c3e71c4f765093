"""A bus full of random frames: a minute in real time, an hour in virtual time.

    python benchmarks/bus_full.py [HOURS]

4,500 random frames a second (a full 500 kbit/s bus): classic, CAN FD, remote and error frames, of known and
unknown identifiers.  Prints how late the car's own ticks are, whether its own frames keep their
period, and how much memory the process has.
"""

from __future__ import annotations

import asyncio
import sys
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hev_can_emu.bus.loopback import LoopbackHub
from hev_can_emu.messages.frame import ERROR, FRAME
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.service import Service
from hev_can_emu.runtime.setup import Setup

RATE = 4500  # frames/s
MINUTE_S = 60.0
SECOND_NS = 1_000_000_000


def resident_kib() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))


def random_frames(
    generator: np.random.Generator, count: int, ids: list[int]
) -> npt.NDArray[np.void]:
    """Return random frames: four in five of a known identifier, every sixth an error frame."""
    frames = np.zeros(count, dtype=FRAME)
    wild = generator.integers(0, 1 << 29, count, dtype=np.uint64).astype(np.uint32)
    frames["id"] = np.where(generator.random(count) < 0.8, generator.choice(ids, count), wild)
    flags = generator.integers(0, 16, count).astype(np.uint8)
    frames["flags"] = np.where(generator.random(count) < 1 / 6, flags | ERROR, flags)
    frames["length"] = generator.integers(0, 65, count)
    frames["data"] = generator.integers(0, 256, (count, 64), dtype=np.uint8)
    return frames


class Periods:
    """Looks at the times of the car's own frames."""

    def __init__(self, emulator: Emulator) -> None:
        self._periods = {m.can_id: m.cycle_time_ns for m in emulator.database.messages}
        self._last: dict[int, int] = {}
        self.frames = 0
        self.wrong = 0

    def add(self, frames: npt.NDArray[np.void], count: int) -> None:
        for can_id, t_ns in zip(
            frames["id"][:count].tolist(), frames["t_ns"][:count].tolist(), strict=True
        ):
            self.frames += 1
            if can_id in self._last and t_ns - self._last[can_id] != self._periods[can_id]:
                self.wrong += 1
            self._last[can_id] = t_ns

    def describe(self) -> str:
        return f"{self.frames} own frames, {self.wrong} off their period"


async def minute(emulator: Emulator, ids: list[int]) -> None:
    """A minute in real time on the loopback."""
    hub = LoopbackHub()
    generator = np.random.default_rng(1)
    service = Service(
        emulator, lambda now_ns: hub.endpoint(now_ns), duration_ns=round(MINUTE_S * SECOND_NS)
    )
    running = asyncio.create_task(service.run())
    begin = time.monotonic()
    sent = 0
    memory: list[int] = []
    async with hub.endpoint(time.monotonic_ns) as noise:
        while not running.done():
            due = int((time.monotonic() - begin) * RATE) - sent
            noise.send(random_frames(generator, due, ids), due)
            sent += due
            noise._inbox.clear()  # what it hears itself is of no interest
            if time.monotonic() - begin > MINUTE_S / 6 * (len(memory) + 1):
                memory.append(resident_kib())
            await asyncio.sleep(0.002)
    await running
    statistics = service.statistics
    print(f"in real time: {statistics.describe()}")
    print(f"  {statistics.received} random frames in, {statistics.sent} own frames out")
    print(f"  memory after each 10 s, KiB: {' '.join(map(str, memory))}")


def hours(emulator: Emulator, ids: list[int], count: float) -> None:
    """So many hours in virtual time."""
    generator = np.random.default_rng(2)
    periods = Periods(emulator)
    begin = time.monotonic()
    start_ns = emulator.now_ns
    seconds = round(count * 3600)
    print(f"in virtual time, {count:g} h: memory, KiB")
    for second in range(seconds):
        now = emulator.now_ns
        frames = random_frames(generator, RATE, ids)
        frames["t_ns"] = now + np.arange(RATE) * (SECOND_NS - 1_000_000) // RATE
        sent = emulator.advance(now + SECOND_NS, frames, RATE)
        emulator.take_events()
        periods.add(sent, len(sent))
        if second % max(seconds // 6, 1) == seconds // 60:
            print(f"  {second / 60:6.1f} min: {resident_kib()}")
    print(f"  {(emulator.now_ns - start_ns) / SECOND_NS / 60:6.1f} min: {resident_kib()}")
    print(f"  {periods.describe()}; {seconds / (time.monotonic() - begin):.0f} times real time")


def main() -> None:
    emulator = Emulator(Setup(model="4dof"))
    emulator.advance(0)
    # Not the controller's: what it sends at random would only be refused for its CRC.
    ids = [message.can_id for message in emulator.database.messages]
    asyncio.run(minute(emulator, ids))
    hours(emulator, ids, float(sys.argv[1]) if len(sys.argv) > 1 else 1.0)


if __name__ == "__main__":
    main()
