"""``hev-can-emu replay``: a recording to a bus, or its requests to the car."""

from __future__ import annotations

import argparse
import sys
import time
from typing import TYPE_CHECKING

from hev_can_emu.commands._options import add_setup_arguments, make_setup, seconds
from hev_can_emu.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from hev_can_emu.runtime.replay import Comparison, Frames
    from hev_can_emu.runtime.setup import Setup
    from hev_can_emu.telemetry.table import Network

_ONLY_REQUESTS = ("record", "compare")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "log", metavar="LOG", help="recording: .log, .blf, .asc, .mf4, .csv or .parquet"
    )
    parser.add_argument(
        "--as-requests",
        action="store_true",
        help="give the car what the recording's controller and driver sent; offline unless --bus is given",
    )
    parser.add_argument("--bus", metavar="BUS", help="bus to play to (default: socketcand)")
    parser.add_argument(
        "--factor",
        metavar="F",
        type=_factor,
        default=1.0,
        help="2 plays twice as fast (default: 1)",
    )
    parser.add_argument(
        "--from", dest="first", metavar="S", type=_instant, default=0.0, help="begin there, s"
    )
    parser.add_argument("--to", dest="last", metavar="S", type=seconds, help="end there, s")
    parser.add_argument(
        "--sender",
        metavar="NODE",
        action="append",
        default=[],
        help="play only what this node sends; may be repeated",
    )
    parser.add_argument(
        "--record",
        metavar="FILE",
        action="append",
        default=[],
        help="with --as-requests: record requests and answers",
    )
    parser.add_argument(
        "--compare",
        action="store_true",
        help="with --as-requests, offline: exit code 1 where the car answers otherwise than recorded",
    )
    add_setup_arguments(parser)


def execute(arguments: argparse.Namespace) -> int:
    """Replay; returns the exit code."""
    if not arguments.as_requests:
        for name in _ONLY_REQUESTS:
            if getattr(arguments, name):
                raise InputError(f"--{name}", "--as-requests beside it", "none")
    if arguments.as_requests and arguments.bus is None and arguments.factor != 1.0:
        raise InputError("--factor", "--bus beside it", "none", "offline there is no pace")
    if arguments.compare and arguments.bus is not None:
        raise InputError("--compare", "no --bus beside it", f"'{arguments.bus}'")
    setup = make_setup(arguments)
    setup.check()
    from hev_can_emu.bus.open import open_bus
    from hev_can_emu.telemetry.reading import read_recording
    from hev_can_emu.telemetry.recorder import check_path

    if arguments.bus is not None:
        open_bus(arguments.bus, time.monotonic_ns)
    for path in arguments.record:
        check_path(path)
    network = _network(setup)
    frames = _chosen(arguments, network, read_recording(arguments.log, network))
    if not arguments.as_requests:
        return _to_bus(arguments, frames)
    if arguments.bus is None:
        return _offline(arguments, setup, frames)
    return _beside_bus(arguments, setup, frames)


def _factor(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1e-3 <= value <= 1e3:
        raise argparse.ArgumentTypeError(f"expected a number from 0.001 to 1000, got '{text}'")
    return value


def _instant(text: str) -> float:
    return 0.0 if text in ("0", "0 s") else seconds(text)


def _network(setup: Setup) -> Network:
    from hev_can_emu.messages.codec import build_codec
    from hev_can_emu.messages.database import load_database
    from hev_can_emu.runtime.setup import network_files
    from hev_can_emu.telemetry.table import Network

    database = load_database(network_files(setup)[0])
    return Network(database, build_codec(database))


def _chosen(arguments: argparse.Namespace, network: Network, frames: Frames) -> Frames:
    """Return the part of the recording that is to be played, from 0 on."""
    from hev_can_emu.runtime.replay import frames_of_senders

    senders = {message.sender for message in network.database.messages if message.sender}
    for sender in arguments.sender:
        if sender not in senders:
            known = f"one of {', '.join(sorted(senders))}"
            raise InputError("--sender", known, f"'{sender}'", did_you_mean(sender, senders))
    if arguments.sender:
        frames = frames_of_senders(network.database, frames, arguments.sender)
    first, last = round(arguments.first * 1e9), frames["t_ns"][-1] + 1 if len(frames) else 0
    if arguments.last is not None:
        last = min(last, round(arguments.last * 1e9))
    chosen: Frames = frames[(frames["t_ns"] >= first) & (frames["t_ns"] < last)].copy()
    if not len(chosen):
        raise InputError(arguments.log, "frames in what is asked for", "none", "see --from, --to")
    chosen["t_ns"] -= first
    return chosen


def _to_bus(arguments: argparse.Namespace, frames: Frames) -> int:
    import asyncio
    import contextlib
    import signal

    from hev_can_emu.bus.open import DEFAULT_BUS, open_bus
    from hev_can_emu.runtime.replay import BusPlayer

    async def play() -> BusPlayer:
        start_ns = time.monotonic_ns()
        make_ns = time.time_ns()
        bus = open_bus(
            arguments.bus or DEFAULT_BUS, lambda: time.monotonic_ns() - start_ns, epoch_ns=make_ns
        )
        async with bus:
            print(f"{arguments.log}: {len(frames)} frames to {bus.describe()}")
            if hint := bus.join_hint():
                print(f"join from another terminal:  {hint}")
            sys.stdout.flush()
            player = BusPlayer(bus, frames, arguments.factor)
            loop = asyncio.get_running_loop()
            for number in (signal.SIGINT, signal.SIGTERM):
                with contextlib.suppress(ValueError, RuntimeError, NotImplementedError):
                    loop.add_signal_handler(number, player.stop)
            await player.play()
        for notice in bus.take_notices():
            print(notice)
        return player

    player = asyncio.run(play())
    late = player.lateness
    print(
        f"{player.sent} of {len(frames)} frames sent; {late.quantile_us(0.5):.0f} us after their "
        f"time (median), {late.largest_us:.0f} us (most)"
    )
    return 0


def _offline(arguments: argparse.Namespace, setup: Setup, frames: Frames) -> int:
    from hev_can_emu.commands._compiling import ready_emulator
    from hev_can_emu.runtime.recording import Recording
    from hev_can_emu.runtime.replay import (
        Comparison,
        play_requests,
        requesting_setup,
        requests_of,
    )
    from hev_can_emu.runtime.tick import TICK_NS

    emulator = ready_emulator(requesting_setup(setup, frames))
    requests = requests_of(emulator, frames)
    comparison = Comparison(emulator, frames)
    recording = Recording(emulator, arguments.record)
    until_ns = (int(frames["t_ns"][-1]) // TICK_NS + 1) * TICK_NS
    started = time.monotonic()
    try:
        trace = play_requests(emulator, requests, until_ns, [*recording.sinks, comparison.take])
    finally:
        recording.close()
    wall_s = time.monotonic() - started
    print(
        f"{arguments.log}: {len(requests)} requests, "
        f"{until_ns * 1e-9:.3f} s of car time in {wall_s:.2f} s"
    )
    print(f"trace {trace}")
    return _tell_differences(comparison, arguments.compare)


def _tell_differences(comparison: Comparison, compare: bool) -> int:
    compared, differences = comparison.result()
    if not compared:
        print("the recording has no frame of the car to compare with")
        return 1 if compare else 0
    if not differences:
        print(f"all {compared} frames of the car are as recorded")
        return 0
    print(f"{len(differences)} messages differ from the recording; the first differences:")
    for each in differences[:10]:
        print(f"  {each.message}: recorded {each.recorded}, answered {each.answered}")
    return 1 if compare else 0


def _beside_bus(arguments: argparse.Namespace, setup: Setup, frames: Frames) -> int:
    import asyncio

    from hev_can_emu.bus.open import open_bus
    from hev_can_emu.commands._compiling import ready_emulator
    from hev_can_emu.commands.run import StatusLine, print_statistics
    from hev_can_emu.runtime.recording import Recording
    from hev_can_emu.runtime.replay import FedBus, requesting_setup, requests_of
    from hev_can_emu.runtime.service import Service

    emulator = ready_emulator(requesting_setup(setup, frames))
    requests = requests_of(emulator, frames)
    epoch_ns = time.time_ns()
    recording = Recording(emulator, arguments.record, epoch_ns)
    line = StatusLine(emulator)

    async def serve() -> Service:
        service = Service(
            emulator,
            lambda now_ns: FedBus(
                open_bus(arguments.bus, now_ns, epoch_ns=epoch_ns),
                now_ns,
                requests,
                arguments.factor,
            ),
            recording.sinks,
            duration_ns=round(int(frames["t_ns"][-1]) / arguments.factor) + 1_000_000,
            on_ready=line.ready,
            on_status=line.status,
            on_event=line.event,
        )
        try:
            await service.run()
        finally:
            if service.opened:
                service.tell()
            await asyncio.to_thread(recording.close)
        return service

    try:
        service = asyncio.run(serve())
    finally:
        line.end()
    print_statistics(service)
    return 0
