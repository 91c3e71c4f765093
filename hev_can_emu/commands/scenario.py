"""``hev-can-emu scenario run``: play scenarios and judge them."""

from __future__ import annotations

import argparse
import re
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from hev_can_emu.commands._lockstep import add_lockstep_arguments, open_bus_for, run_lockstep
from hev_can_emu.commands._mqtt import MqttSide, add_mqtt_arguments, mqtt_address
from hev_can_emu.commands._options import add_setup_arguments, make_setup, seconds
from hev_can_emu.errors import BusError, InputError

if TYPE_CHECKING:
    from hev_can_emu.bus.wire_parts import Timing
    from hev_can_emu.commands._result import Result
    from hev_can_emu.report.run_report import RunReport
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.runtime.event_texts import Event
    from hev_can_emu.runtime.playing import Playing
    from hev_can_emu.runtime.reporting import RunLog
    from hev_can_emu.runtime.scenario_runs import Run
    from hev_can_emu.runtime.setup import Setup
    from hev_can_emu.runtime.statistics import Statistics
    from hev_can_emu.runtime.virtual import FrameSink

CLOCKS = ("virtual", "wall", "lockstep")
LOOK_NS = 50_000_000  #: with MQTT in virtual time, the car is looked at so often
PATIENCE_S = 2.0  #: for a broker at the end of a scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    run = actions.add_parser("run", help="play scenarios and judge what they show")
    run.add_argument(
        "files", metavar="FILE", nargs="+", help="scenario file, or name of a shipped one"
    )
    run.add_argument(
        "--clock",
        metavar="CLOCK",
        help="virtual (as fast as possible, repeatable), wall, or lockstep (virtual, waits for controllers "
        "in other processes); default: wall if a bus is named",
    )
    run.add_argument(
        "--bus", metavar="BUS", help="bus for wall clock and lockstep (default: socketcand)"
    )
    run.add_argument(
        "--seed", type=int, metavar="N", help="of everything random (default: the scenario's, or 0)"
    )
    run.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="a parameter's value; takes it out of the matrix; may be repeated",
    )
    run.add_argument("--out", metavar="DIR", help="leave recordings, verdicts and a picture there")
    run.add_argument("--no-report", action="store_true", help="with --out: recordings alone")
    run.add_argument("--no-plot", action="store_true", help="draw no picture")
    run.add_argument(
        "--record",
        metavar="ENDING",
        action="append",
        default=[],
        help="with --out: kinds of recording, .log .blf .asc .mf4 .csv .parquet (default: .blf and .log)",
    )
    run.add_argument(
        "--ledger", action="store_true", help="tell where the energy went (--model detailed)"
    )
    run.add_argument(
        "--slice",
        metavar="S",
        type=seconds,
        help="with --out: a recording of so many seconds before and after each failure",
    )
    add_setup_arguments(run)
    add_lockstep_arguments(run)
    add_mqtt_arguments(run)
    schema = actions.add_parser(
        "schema", help="print the JSON Schema of scenario files, for editors and checks"
    )
    schema.add_argument(
        "--dbc",
        metavar="FILE",
        help="network whose signals it names (default: the shipped hev.dbc)",
    )


def execute(arguments: argparse.Namespace) -> int:
    """Run every scenario; the worst outcome gives the exit code.  Or print the schema."""
    if arguments.action == "schema":
        return _print_schema(arguments.dbc)
    clock = arguments.clock
    if clock is not None and clock not in CLOCKS:
        raise InputError("--clock", f"one of {', '.join(CLOCKS)}", f"'{clock}'")
    if clock == "virtual" and arguments.bus is not None and _timing(arguments.bus) is None:
        hint = "use --clock wall, or the in-memory bus with bit times: loopback?bitrate=500000"
        raise InputError("--bus", "no bus with --clock virtual", f"'{arguments.bus}'", hint)

    mqtt_address(arguments)  # told at once if it cannot be one
    from hev_can_emu.commands._result import make_folder, print_ledger, print_result
    from hev_can_emu.resources import folder, shipped_or_path
    from hev_can_emu.telemetry.recorder import check_ending

    for name in ("record", "slice"):
        if getattr(arguments, name) and arguments.out is None:
            raise InputError(f"--{name}", "--out DIR beside it", "none")
    for ending in arguments.record:
        check_ending(ending)
    paths = [shipped_or_path(name, folder("scenarios"), "scenario run") for name in arguments.files]
    if arguments.bus is not None and clock != "lockstep":
        from hev_can_emu.bus.open import open_bus

        open_bus(arguments.bus, time.monotonic_ns)  # a name that cannot be a bus is told at once
    out = make_folder(arguments.out)
    # Every file is read and checked before the first one runs.
    prepared = _prepare(arguments, paths)
    if arguments.ledger:
        for _, _, playing in prepared:
            playing.emulator.ledger()
    if clock == "lockstep":
        for _, _, playing in prepared:
            open_bus_for(arguments, arguments.bus or playing.scenario.bus, playing.emulator)
    codes: list[int] = []
    used: set[str] = set()
    reports: list[tuple[RunReport, str]] = []
    for path, label, playing in prepared:
        bus = arguments.bus or playing.scenario.bus
        wall = clock in ("wall", "lockstep") or (clock is None and bus is not None)
        if arguments.mqtt_commands and (not wall or clock == "lockstep"):
            raise InputError("--mqtt-commands", "--clock wall", "virtual time")
        stem = _stem(f"{path.stem} {label}".strip(), used)
        timing = None if bus is None or wall else _timing(bus)
        bus = (bus or "socketcand") if wall else None
        result, report = _run(playing, bus, timing, out, stem, arguments)
        print_result(result)
        if arguments.ledger and result.ledger is not None:
            print_ledger(result.ledger)
        codes.append(result.outcome.exit_code)
        if report is not None:
            reports.append((report, stem))
    if out is not None and reports:
        from hev_can_emu.commands._reports import write_whole

        write_whole(out, ", ".join(dict.fromkeys(path.stem for path in paths)), reports)
    # As severe as the worst: unusable, fail, inconclusive, pass.
    return next((code for code in (2, 1, 3) if code in codes), 0)


def _print_schema(dbc: str | None) -> int:
    from hev_can_emu.messages.database import load_database
    from hev_can_emu.resources import folder
    from hev_can_emu.runtime.scenario_schema import schema_text

    if dbc is None:
        text = (folder("scenarios") / "scenario.schema.json").read_text()
    else:
        text = schema_text(load_database(Path(dbc)).messages)
    print(text, end="")
    return 0


def _timing(bus: str) -> Timing | None:
    """Return the bit times of a bus that can be had in virtual time, in memory; None for others."""
    from hev_can_emu.bus.open import timing_of

    return timing_of(bus) if bus.startswith("loopback") else None


def _stem(name: str, used: set[str]) -> str:
    """Return a name for a run's files that no earlier run of this command has."""
    base = re.sub(r"[^A-Za-z0-9_.=-]+", "_", name)
    stem, number = base, 1
    while stem in used:
        number += 1
        stem = f"{base}_{number}"
    used.add(stem)
    return stem


_HEAD = {
    "--vehicle": "vehicle",
    "--model": "model",
    "--start": "start",
    "--node": "nodes",
    "--bus": "bus",
}


def _prepare(arguments: argparse.Namespace, paths: list[Path]) -> list[tuple[Path, str, Playing]]:
    """Read all scenarios and build their cars, alike ones once; raises InputError."""
    from hev_can_emu.commands._compiling import compiling
    from hev_can_emu.runtime.playing import Playing
    from hev_can_emu.runtime.scenario_runs import HEAD, read_runs

    if arguments.seed is not None and arguments.seed < 0:
        raise InputError("--seed", "0 or more", f"{arguments.seed}")
    cars: list[_Car] = []
    prepared = []
    told = [key for key in HEAD if getattr(arguments, key) is not None]
    with compiling():
        for path in paths:
            for run in read_runs(path, _parameters(arguments), told):
                emulator, start = _car(arguments, run, cars)
                scenario = run.scenario
                if arguments.seed is not None:
                    scenario = msgspec.structs.replace(scenario, seed=arguments.seed)
                playing = Playing(emulator, run.document, scenario, run.locate, start)
                if start is None:
                    emulator.attach(playing.player.script)
                prepared.append((path, run.label, playing))
    return prepared


def _parameters(arguments: argparse.Namespace) -> dict[str, str]:
    given = {}
    for text in arguments.set:
        name, equals, value = text.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError("--set", "NAME=VALUE", f"'{text}'", "e.g. --set 'torque=150 Nm'")
        given[name.strip()] = value.strip()
    return given


class _Car:
    """A car that several runs may share, and its state at the start once the second asks for it."""

    def __init__(self, setup: Setup, emulator: Emulator) -> None:
        self.setup = setup
        self.emulator = emulator
        self.start: bytes | None = None


def _car(
    arguments: argparse.Namespace, run: Run, cars: list[_Car]
) -> tuple[Emulator, bytes | None]:
    """Return the car of a run, made where there is none like it, else with its state at the start."""
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.runtime.scenario_runs import setup_of

    scenario = run.scenario
    try:
        if arguments.bus is None and scenario.bus is not None:
            from hev_can_emu.bus.open import open_bus

            open_bus(scenario.bus, time.monotonic_ns)
        setup = make_setup(arguments, setup_of(scenario))
        for car in cars:
            if car.setup == setup:
                car.start = car.start or car.emulator.snapshot()  # nothing has run yet
                return car.emulator, car.start
        emulator = Emulator(setup)
    except InputError as error:
        option = error.where.split()[0]
        key = _HEAD.get(option)
        if key is None or getattr(arguments, key, None) or getattr(arguments, "node", None):
            raise
        # Said by the scenario's head, not on the command line.
        raise InputError(run.locate((key,)), error.expected, error.got, error.hint) from error
    cars.append(_Car(setup, emulator))
    return emulator, None


def _run(
    playing: Playing,
    bus: str | None,
    timing: Timing | None,
    out: Path | None,
    stem: str,
    arguments: argparse.Namespace,
) -> tuple[Result, RunReport | None]:
    from hev_can_emu.commands._result import Result
    from hev_can_emu.runtime.recording import Recording
    from hev_can_emu.runtime.virtual import play_on_wire, play_virtual

    emulator = playing.emulator
    # Virtual time has no date: its recordings start at zero, and repeat to the byte.
    lockstep = arguments.clock == "lockstep"
    epoch_ns = 0 if bus is None or lockstep else time.time_ns()
    endings: list[str] = arguments.record or [".blf", ".log"] if out is not None else []
    files = [f"{stem}{ending}" for ending in endings]
    log: RunLog | None = None
    if out is not None and not arguments.no_report:
        from hev_can_emu.runtime.reporting import RunLog

        log = RunLog(playing)
    recording = Recording(emulator, [out / name for name in files] if out else [], epoch_ns)
    sinks = recording.sinks if log is None else [*recording.sinks, log.add]
    mqtt = MqttSide(arguments, emulator, None if bus is None else epoch_ns, _say)
    mqtt.began(playing)
    if mqtt.on and bus is None:
        sinks = [*sinks, lambda _frames, _count: mqtt.look()]
    started = time.monotonic()
    trace = ""
    statistics: Statistics | None = None
    try:
        longest_ns = LOOK_NS if mqtt.on else None
        if timing is not None:
            trace, medium = play_on_wire(playing, sinks, timing)
            print(medium.describe())
        elif bus is None:
            trace = play_virtual(playing, sinks, longest_ns)
        elif lockstep:
            trace = _in_lockstep(playing, bus, sinks, longest_ns, arguments)
        else:
            statistics = _in_wall_time(playing, bus, epoch_ns, sinks, mqtt)
        run = playing.result(trace)
        wall_s = time.monotonic() - started
        if bus is None:
            for event in run.events:
                mqtt.event(event)
        mqtt.ended(run)
    finally:
        if log is not None:
            log.close()
        recording.close()
        mqtt.stop(PATIENCE_S)
    result = Result(
        run.name, list(run.verdicts), run.outcome, emulator.now_ns * 1e-9, wall_s, trace,
        emulator.ledger() if emulator.keeps_ledger else None,
    )  # fmt: skip
    if out is None or log is None:
        return result, None
    from hev_can_emu.commands._reports import command_of, write_run, write_slices
    from hev_can_emu.commands._result import draw, ledger_content
    from hev_can_emu.runtime.recording import network_of
    from hev_can_emu.runtime.reporting import make_report
    from hev_can_emu.telemetry.recorder import FORMATS

    if arguments.slice is not None:
        kind = next((each for each in endings if each.lower() in FORMATS), ".log")
        files += write_slices(
            out, stem, kind, arguments.slice, run, log.signals, network_of(emulator), epoch_ns
        )
    report = make_report(
        playing,
        run,
        log,
        wall_s=wall_s,
        clock="virtual" if bus is None else f"{'lockstep' if lockstep else 'wall'} ({bus})",
        command=command_of(arguments, run, tuple(playing.scenario.matrix)),
        started=_date(epoch_ns) if epoch_ns else "",
        statistics=statistics,
        files=files,
        ledger=None if result.ledger is None else ledger_content(result.ledger),
    )
    write_run(out, stem, report)
    if not arguments.no_plot:
        draw(out / f"{stem}.png", log.signals, playing, list(run.verdicts))
    print(f"report, recordings and picture: {out}/{stem}.*")
    return result, report


def _date(epoch_ns: int) -> str:
    from datetime import datetime

    return datetime.fromtimestamp(epoch_ns // 1_000_000_000).astimezone().isoformat(sep=" ")


def _say(event: Event) -> None:
    print(f"{event.kind}: {event.text}", file=sys.stderr)


def _in_lockstep(
    playing: Playing,
    bus: str,
    sinks: list[FrameSink],
    longest_ns: int | None,
    arguments: argparse.Namespace,
) -> str:
    """Play the scenario with controllers in other processes; return the trace hash."""
    emulator = playing.emulator
    try:
        return run_lockstep(
            playing,
            emulator,
            open_bus_for(arguments, bus, emulator),
            sinks,
            finished=lambda: playing.finished,
            longest_ns=longest_ns,
            tell=lambda notice: print(f"{emulator.now_ns * 1e-9:8.3f} s  {notice}"),
        )
    except BusError as error:
        # Not the car's doing: what is undecided stays so.
        playing.player.finish(emulator.now_ns, f"bus lost ({error})")
        return ""


def _in_wall_time(
    playing: Playing, bus: str, epoch_ns: int, sinks: list[FrameSink], mqtt: MqttSide
) -> Statistics:
    import asyncio

    from hev_can_emu.bus.open import open_bus
    from hev_can_emu.commands.progress import PlayProgress
    from hev_can_emu.runtime.service import Service

    progress = PlayProgress(playing)

    def tell(event: Event) -> None:
        progress.event(event)
        mqtt.event(event)

    async def serve() -> Statistics:
        service = Service(
            playing.emulator,
            lambda now_ns: open_bus(bus, now_ns, epoch_ns=epoch_ns),
            sinks,
            playing,
            on_ready=progress.ready,
            on_status=progress.status,
            on_event=tell,
            watchers=mqtt.watchers,
        )
        try:
            await service.run()
        except BusError as error:
            # Not the car's doing: what is undecided stays so.
            playing.player.finish(playing.emulator.now_ns, f"bus lost ({error})")
        if service.interrupted:
            playing.player.finish(playing.emulator.now_ns, "interrupted")
        service.tell()
        progress.end(service.statistics)
        if service.bus.medium is not None:
            print(service.bus.medium.describe())
        return service.statistics

    return asyncio.run(serve())
