"""``hev-can-emu run``: the car on a bus in real time."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from hev_can_emu.commands._live import LiveLine
from hev_can_emu.commands._lockstep import add_lockstep_arguments, open_bus_for, run_lockstep
from hev_can_emu.commands._mqtt import MqttSide, add_mqtt_arguments, mqtt_address
from hev_can_emu.commands._options import add_setup_arguments, make_setup, seconds
from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.bus.port import Bus
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.runtime.event_texts import Event
    from hev_can_emu.runtime.service import Service
    from hev_can_emu.runtime.setup import Setup
    from hev_can_emu.runtime.statistics import Statistics

CLOCKS = ("wall", "lockstep")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--bus",
        metavar="BUS",
        default="socketcand",
        help="INTERFACE[:CHANNEL] of python-can (default: the embedded server, socketcand:127.0.0.1:29536)",
    )
    parser.add_argument(
        "--duration", metavar="S", type=seconds, help="stop after this time (default: run on)"
    )
    parser.add_argument(
        "--record",
        metavar="FILE",
        action="append",
        default=[],
        help="record frames (.log, .blf, .asc, .mf4) or decoded signals (.csv, .parquet)",
    )
    parser.add_argument(
        "--clock",
        metavar="CLOCK",
        default="wall",
        help="wall, or lockstep: virtual time that waits for controllers in other processes (default: wall)",
    )
    parser.add_argument(
        "--dtc-store",
        metavar="FILE",
        help="keep the trouble codes in this file, over restarts",
    )
    add_setup_arguments(parser)
    add_lockstep_arguments(parser)
    add_mqtt_arguments(parser, scenarios=True)


def execute(arguments: argparse.Namespace) -> int:
    """Run until told to stop; returns the exit code."""
    setup = make_setup(arguments)
    setup.check()
    if arguments.clock not in CLOCKS:
        raise InputError("--clock", f"one of {', '.join(CLOCKS)}", f"'{arguments.clock}'")
    address = mqtt_address(arguments)  # told at once if it cannot be one
    if arguments.clock == "lockstep":
        if address is not None:
            raise InputError("--mqtt", "the wall's clock", "--clock lockstep")
        return _in_lockstep(arguments, setup)
    # After the options: what follows takes a second to import.
    import asyncio

    from hev_can_emu.bus.open import open_bus
    from hev_can_emu.commands._compiling import ready_emulator
    from hev_can_emu.runtime.code_store import CodeStore, read_store
    from hev_can_emu.runtime.event_texts import Event
    from hev_can_emu.runtime.recording import Recording
    from hev_can_emu.runtime.service import Service, Watcher
    from hev_can_emu.telemetry.recorder import check_path

    # What can be told at once is told before anything is compiled or written.
    open_bus(arguments.bus, time.monotonic_ns)
    for path in arguments.record:
        check_path(path)
    if arguments.dtc_store:
        read_store(Path(arguments.dtc_store))
    emulator = ready_emulator(setup)  # compiled before the clock starts
    epoch_ns = time.time_ns()
    recording = Recording(emulator, arguments.record, epoch_ns)
    line = StatusLine(emulator)
    mqtt = MqttSide(arguments, emulator, epoch_ns, line.event)

    def tell(event: Event) -> None:
        line.event(event)
        mqtt.event(event)

    watchers = list(mqtt.watchers)
    store = CodeStore(emulator, Path(arguments.dtc_store)) if arguments.dtc_store else None
    failure = ""

    def keep_codes() -> None:
        nonlocal failure
        wrong = store.save() if store is not None else ""
        if wrong and wrong != failure:
            line.event(Event(emulator.now_ns, "trouble codes", wrong, 0, 0.0))
        failure = wrong

    if store is not None:
        watchers.append(Watcher("trouble codes", 0.5, keep_codes))
        for code in store.strangers:
            line.event(Event(0, "trouble codes", f"{code} is none of this network's", 0, 0.0))

    async def serve() -> Service:
        service = Service(
            emulator,
            lambda now_ns: open_bus(arguments.bus, now_ns, epoch_ns=epoch_ns),
            recording.sinks,
            duration_ns=None if arguments.duration is None else round(arguments.duration * 1e9),
            on_ready=line.ready,
            on_status=line.status,
            on_event=tell,
            watchers=watchers,
        )
        line.follow(service)
        mqtt.attach(service)
        try:
            await service.run()
        finally:
            if service.opened:
                service.tell()
            keep_codes()
            await asyncio.to_thread(recording.close)
        return service

    try:
        service = asyncio.run(serve())
    finally:
        line.end()
        mqtt.stop()
    print_statistics(service)
    mqtt.print_counters()
    return 0


def _in_lockstep(arguments: argparse.Namespace, setup: Setup) -> int:
    """Run in step with controllers in other processes, for a given time or until one leaves."""
    from hev_can_emu.commands._compiling import ready_emulator
    from hev_can_emu.runtime.recording import Recording
    from hev_can_emu.telemetry.recorder import check_path

    if arguments.dtc_store is not None:
        raise InputError("--dtc-store", "the wall's clock", "--clock lockstep")
    if arguments.duration is None:
        raise InputError(
            "--duration", "a time, with --clock lockstep", "none", "e.g. --duration 60"
        )
    for path in arguments.record:
        check_path(path)
    emulator = ready_emulator(setup)
    bus = open_bus_for(arguments, arguments.bus, emulator)
    end_ns = round(arguments.duration * 1e9)
    recording = Recording(emulator, arguments.record)
    started = time.monotonic()
    try:
        trace = run_lockstep(
            emulator,
            emulator,
            bus,
            recording.sinks,
            finished=lambda: emulator.now_ns >= end_ns,
            end_ns=end_ns,
            tell=lambda notice: print(f"{emulator.now_ns * 1e-9:8.3f} s  {notice}"),
        )
    finally:
        recording.close()
    print(f"{emulator.now_ns * 1e-9:.3f} s of car time in {time.monotonic() - started:.2f} s")
    print(f"trace {trace}")
    return 0


class StatusLine:
    """What the car does now, as one line at the bottom of a terminal; events scroll above it.

    On anything but a terminal only events are written.
    """

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator
        self._service: Service | None = None
        self._line = LiveLine()
        self._hinted = False

    def follow(self, service: Service) -> None:
        """Show the car that the service runs, should another take over."""
        self._service = service

    def ready(self, bus: Bus) -> None:
        """Say what runs where, and how to join."""
        emulator = self._emulator
        setup = emulator.setup
        print(
            f"{emulator.vehicle_name} ({setup.model}) on {bus.describe()}, protection {setup.protection}"
        )
        hint = bus.join_hint()
        if hint:
            print(f"join from another terminal:  {hint}")
        if "Identified" in emulator.provenance:
            print("parameters: identified, not published; see the vehicle file")
        if setup.start == "off" and setup.nodes.get("VEH") != "external":
            print("ignition off: nobody turns it on; use --node VEH=external and send VEH_Driver")
        sys.stdout.flush()

    def status(self, statistics: Statistics) -> None:
        """Rewrite the line."""
        if self._service is not None:
            self._emulator = self._service.emulator
        truth = self._emulator.truth
        rpm = 30.0 / 3.141592653589793
        mode = _MODES[round(self._emulator.state.statuses[_mode_port()])]
        self._line.show(
            f"{self._emulator.now_ns * 1e-9:7.1f} s {mode:16s}{truth('vehicle_speed') * 3.6:6.1f} km/h"
            f"  rpm: engine{truth('engine_speed') * rpm:5.0f} EM1{truth('em1_speed') * rpm:6.0f}"
            f" EM2{truth('em2_speed') * rpm:6.0f}"
            f"  overruns {statistics.overruns} tx {statistics.sent} rx {statistics.received}"
        )

    def event(self, event: Event) -> None:
        """Write an event above the line."""
        self._line.say(f"{event.t_ns * 1e-9:8.3f} s  {event.kind}: {event.text}")
        if event.kind == "lost" and "CRC" in event.text and not self._hinted:
            self._hinted = True
            self._line.say("hint: --protection off takes frames without counter and CRC")

    def end(self) -> None:
        """Leave the line standing."""
        self._line.end()


_MODES = (
    "transition", "series", "parallel G1", "parallel G2",
    "electric neutral", "electric G1", "electric G2",
)  # fmt: skip


def _mode_port() -> int:
    from hev_can_emu.ecu.ports import S_DRIVING_MODE

    return S_DRIVING_MODE


def print_statistics(service: Service) -> None:
    """Print how the run went."""
    from hev_can_emu.runtime import tick

    statistics, scalars = service.statistics, service.emulator.state.scalars
    counters = service.bus.counters
    print(f"{service.emulator.now_ns * 1e-9:.3f} s, {statistics.describe()}")
    print(
        f"frames: {statistics.sent} sent, {statistics.received} received, {counters.dropped} dropped, "
        f"{scalars[tick.REFUSED]} refused, {scalars[tick.UNKNOWN]} unknown, "
        f"{scalars[tick.CONFLICTS]} from a second sender"
    )
    clipped = service.emulator.saturations
    if clipped:
        print(f"values beyond their signal's range, sent as its end: {clipped}")
    if service.bus.medium is not None:
        print(service.bus.medium.describe())
