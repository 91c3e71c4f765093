"""The tick's lateness without MQTT, and with a broker that is killed ten times, in one run.

    python benchmarks/mqtt.py

Needs mosquitto.  Stretches of the same length alternate, each a car of its own on a loopback bus in real
time; with MQTT every signal is told 20 times a second and the broker is killed and started again all
along.  Last comes SIGTERM amid a connect to a broker that takes connections and never answers.
"""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hev_can_emu.bus.open import open_bus
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.publishing import open_link
from hev_can_emu.runtime.remote import Remote
from hev_can_emu.runtime.service import Service, Watcher
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.statistics import Statistics
from hev_can_emu.telemetry.mqtt_address import parse_address
from hev_can_emu.telemetry.mqtt_link import Counters

STRETCH_S = 10.0
PAIRS = 2
KILLS = 10  # in all
PERIOD_S = 0.05


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


class Broker:
    """mosquitto on a port of loopback."""

    def __init__(self, folder: Path, port: int) -> None:
        found = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin")
        if found is None:
            sys.exit("needs mosquitto")
        config = folder / "mosquitto.conf"
        config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nuser root\n")
        self._command = [found, "-c", str(config)]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen(self._command, stdout=quiet, stderr=quiet)

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


async def stretch(port: int | None, broker: Broker | None) -> tuple[Statistics, Counters | None]:
    """Run a car for a stretch; with a port it is told of, and the broker is killed all along."""
    emulator = Emulator(Setup(nodes={"HCU": "emulated"}))
    emulator.advance(0)
    for name, value in (("ContactorRequest", 1), ("EM2ControlMode", 1), ("EM2TorqueRequest", 60)):
        emulator.set_value(emulator.database.signal(name).index, value)
    link, watchers = None, []
    if port is not None:
        address = parse_address(f"mqtt://127.0.0.1:{port}", environment={})
        link = open_link(address, emulator, PERIOD_S, commands=False)
        link.start()
        remote = Remote(emulator, link, time.time_ns())
        watchers.append(Watcher("mqtt", PERIOD_S, remote.look))
    service = Service(
        emulator,
        lambda now_ns: open_bus("loopback", now_ns),
        duration_ns=round(STRETCH_S * 1e9),
        watchers=watchers,
    )

    async def kill() -> None:
        pause_s = STRETCH_S / (KILLS / PAIRS + 0.5)
        for _ in range(KILLS // PAIRS):
            await asyncio.sleep(pause_s - 0.3)
            assert broker is not None
            await asyncio.to_thread(broker.kill)
            await asyncio.sleep(0.3)
            await asyncio.to_thread(broker.start)

    killer = asyncio.create_task(kill()) if broker is not None else None
    await service.run()
    if killer is not None:
        killer.cancel()
    if link is not None:
        link.stop()
    return service.statistics, None if link is None else link.counters


def tell(name: str, statistics: Statistics, counters: Counters | None) -> None:
    late = statistics.lateness
    text = (
        f"{name:24s}{statistics.overruns:8d} of {statistics.ticks} overruns, tick done "
        f"{late.quantile_us(0.5):5.0f} us late (median), {late.quantile_us(0.99):6.0f} us (99 %)"
    )
    if counters is not None:
        text += f"; {counters.sent} sent, {counters.connections} connections, {counters.replaced} replaced"
    print(text)


def end_amid_connecting() -> float:
    """Return how long ``run`` takes to end after SIGTERM while it connects to a silent broker, s."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        command = [Path(sys.executable).parent / "hev-can-emu", "run"]
        options = ["--bus", "loopback", "--mqtt", f"mqtt://127.0.0.1:{port}"]
        process = subprocess.Popen([*command, *options], stdout=subprocess.DEVNULL)
        silent.accept()
        time.sleep(2.0)
        begin = time.monotonic()
        process.send_signal(signal.SIGTERM)
        code = process.wait()
        taken_s = time.monotonic() - begin
    assert code == 0, code
    return taken_s


def main() -> None:
    port = free_port()
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        broker = Broker(Path(folder), port)
        broker.start()
        stack.callback(broker.kill)
        for _ in range(PAIRS):
            tell("without MQTT", *asyncio.run(stretch(None, None)))
            tell(f"with, {KILLS // PAIRS} broker kills", *asyncio.run(stretch(port, broker)))
    print(f"SIGTERM amid a connect to a silent broker: ended after {end_amid_connecting():.2f} s")


if __name__ == "__main__":
    main()
