"""The tick's lateness without and with a client that does not read, among 20 that come and go, in one run.

    python benchmarks/bus_clients.py

The car runs in real time on the embedded server; another process holds the clients.  Stretches
alternate: in every second one a client joins and never reads, until its buffer is full and it is dropped.
Two clients stay all along and look at each alive counter they hear: a step other than one is a frame
lost or out of order.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time

from hev_can_emu.bus.open import open_bus
from hev_can_emu.bus.port import Bus
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.event_texts import Event
from hev_can_emu.runtime.service import Service
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.statistics import Histogram

STRETCH_S = 20.0
PAIRS = 2
VISITORS = 20
STAYING = 2

CLIENTS = f"""
import asyncio, random, sys, cantools
from pathlib import Path
from hev_can_emu.resources import folder
database = cantools.database.load_file(folder("dbc") / "hev.dbc")
counters = {{m.frame_id: (m, f"{{m.name}}_Counter") for m in database.messages
            if f"{{m.name}}_Counter" in {{s.name for s in m.signals}}}}

async def join():
    reader, writer = await asyncio.open_connection("127.0.0.1", int(sys.argv[1]))
    writer.write(b"< open vcan0 >")
    await writer.drain()
    await reader.readuntil(b"< ok >")
    writer.write(b"< rawmode >")
    await reader.readuntil(b"< ok >")
    return reader, writer

async def stay(tally):
    reader, writer = await join()
    last = {{}}
    while True:
        try:
            words = (await reader.readuntil(b">")).split()
        except (asyncio.IncompleteReadError, ConnectionError):
            return
        if words[1] != b"frame":
            continue
        tally[0] += 1
        can_id = int(words[2], 16)
        if can_id in counters:
            message, name = counters[can_id]
            value = message.decode(bytes.fromhex(words[4].decode()))[name]
            if can_id in last and (value - last[can_id]) % 15 != 1:
                tally[1] += 1
            last[can_id] = value

async def visit(tally):
    while True:
        try:
            reader, writer = await join()
            await asyncio.sleep(random.uniform(0.05, 1.0))
            writer.close()
            tally[2] += 1
        except (OSError, asyncio.IncompleteReadError):
            return

async def main():
    tally = [0, 0, 0]
    tasks = [asyncio.create_task(stay(tally)) for _ in range({STAYING})]
    tasks += [asyncio.create_task(visit(tally)) for _ in range({VISITORS})]
    await asyncio.wait(tasks[:{STAYING}])
    print(*tally)

asyncio.run(main())
"""

STALLED = """
import socket, sys, time
with socket.socket() as stream:
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stream.connect(("127.0.0.1", int(sys.argv[1])))
    stream.sendall(b"< open vcan0 >< rawmode >")
    time.sleep(3600)
"""


def start(code: str, port: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, str(port)], stdout=subprocess.PIPE, text=True
    )


async def measure(service: Service, bus: Bus, dropped: list[str]) -> None:
    """Alternate the stretches, print each, and stop the service."""
    statistics = service.statistics
    port = bus.port  # type: ignore[attr-defined]
    clients = start(CLIENTS, port)
    await asyncio.sleep(3.0)
    sums = {False: Histogram(), True: Histogram()}
    print("stretch          ticks  overruns   late: median    99 %   most, us")
    for stretch in range(2 * PAIRS):
        stalled = bool(stretch % 2)
        process = start(STALLED, port) if stalled else None
        statistics.lateness = Histogram()
        overruns, ticks = statistics.overruns, statistics.ticks
        await asyncio.sleep(STRETCH_S)
        if process is not None:
            process.kill()
            process.wait()
        one = statistics.lateness
        print(
            f"{'one stalled' if stalled else 'all read':14}{statistics.ticks - ticks:8}"
            f"{statistics.overruns - overruns:10}{one.quantile_us(0.5):15.0f}{one.quantile_us(0.99):8.0f}"
            f"{one.largest_us:11.0f}"
        )
        sums[stalled] = one
    service.stop()
    output, _ = await asyncio.to_thread(clients.communicate, None, 30.0)
    heard, wrong, visits = output.split()
    ratio = sums[True].quantile_us(0.5) / max(sums[False].quantile_us(0.5), 1.0)
    print(f"last pair: median with the stalled client {ratio:.2f} times that without")
    print(f"{STAYING} clients that stayed heard {heard} frames, {wrong} lost or out of order")
    print(f"{visits} visits; told of the stalled one: {'; '.join(dropped) or 'nothing'}")


async def main() -> None:
    emulator = Emulator(Setup())
    emulator.advance(0)
    dropped: list[str] = []

    def note(event: Event) -> None:
        if "does not read" in event.text:
            dropped.append(event.text)

    tasks = []
    service = Service(
        emulator,
        lambda now_ns: open_bus("socketcand:127.0.0.1:0", now_ns, epoch_ns=time.time_ns()),
        on_ready=lambda bus: tasks.append(asyncio.ensure_future(measure(service, bus, dropped))),
        on_event=note,
    )
    await service.run()
    await tasks[0]


if __name__ == "__main__":
    asyncio.run(main())
