"""``hev-can-emu compare``: one scenario with each fidelity of the plant, over each other."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from hev_can_emu.commands._model import check_plot
from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

RPM = 30.0 / math.pi
# Quantity of the plant, what it is called, its factor from SI.
QUANTITIES: dict[str, tuple[str, float]] = {
    "engine_speed": ("engine (rpm)", RPM),
    "em1_speed": ("EM1 (rpm)", RPM),
    "em2_speed": ("EM2 (rpm)", RPM),
    "vehicle_speed": ("car (km/h)", 3.6),
    "clutch_slip": ("slip of C1 (rpm)", RPM),
    "clutch_torque": ("C1 carries (N·m)", 1.0),
    "clutch_capacity": ("capacity of C1 (N·m)", 1.0),
    "sleeve_position": ("sleeve (mm)", 1e3),
    "shift_force": ("shift force (N)", 1.0),
    "acceleration": ("acceleration (m/s²)", 1.0),
    "em1_torque": ("EM1 (N·m)", 1.0),
    "em2_torque": ("EM2 (N·m)", 1.0),
    "engine_torque": ("engine (N·m)", 1.0),
    "battery_current": ("battery (A)", 1.0),
}
DEFAULT = ("engine_speed", "em1_speed", "clutch_slip", "clutch_torque", "acceleration")


class Run(NamedTuple):
    """What one fidelity made of the scenario; times count from the window's step."""

    model: str
    outcome: str
    times: Array
    values: Array
    marks: list[tuple[float, str]]
    wall_s: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="scenario file, or name of a shipped one")
    parser.add_argument(
        "--models", metavar="LIST", help="fidelities, separated by commas (default: all)"
    )
    parser.add_argument("--vehicle", metavar="FILE", help="vehicle file or shipped name")
    parser.add_argument(
        "--quantity",
        metavar="NAME",
        action="append",
        help=f"of the plant; may be repeated (default: {', '.join(DEFAULT)})",
    )
    parser.add_argument(
        "--from", dest="begin", metavar="STEP", help="step from which to compare (default: start)"
    )
    parser.add_argument("--to", metavar="STEP", help="step up to which to compare (default: end)")
    parser.add_argument("--plot", metavar="FILE", help="draw them (.png, .svg, .pdf)")


def execute(args: argparse.Namespace) -> int:
    """Run the scenario once per fidelity and print how far they are apart; raises InputError."""
    from hev_can_emu.resources import folder, shipped_or_path
    from hev_can_emu.runtime.setup import MODELS

    plot = check_plot(args.plot) if args.plot else None
    models = args.models.split(",") if args.models else list(MODELS)
    for model in models:
        if model not in MODELS:
            raise InputError("--models", f"some of {', '.join(MODELS)}", f"'{model}'")
    names = args.quantity or list(DEFAULT)
    path = shipped_or_path(args.file, folder("scenarios"), "compare")
    runs = [_run(path, model, args, names) for model in models]
    _print(runs, names)
    if plot is not None:
        _draw(plot, runs, names, _title(path))
        print(f"picture: {plot}")
    return 0


def _run(path: Path, model: str, args: argparse.Namespace, names: list[str]) -> Run:
    """Play the scenario with one fidelity."""
    import time

    from hev_can_emu.commands._compiling import ready_emulator
    from hev_can_emu.runtime.playing import Playing
    from hev_can_emu.runtime.scenario_runs import read_scenario, setup_of
    from hev_can_emu.runtime.tick import TICK_NS
    from hev_can_emu.runtime.truth_log import TruthLog
    from hev_can_emu.runtime.virtual import play_virtual

    document, scenario = read_scenario(path)
    setup = setup_of(scenario)
    vehicle = args.vehicle or setup.vehicle
    emulator = ready_emulator(msgspec.structs.replace(setup, model=model, vehicle=vehicle))
    log = TruthLog(emulator, names)
    playing = Playing(emulator, document, scenario)
    started = time.perf_counter()
    play_virtual(playing, [log.add], TICK_NS)
    wall = time.perf_counter() - started
    instants = {
        verdict.name: verdict.instant_ns * 1e-9
        for verdict in playing.player.verdicts()
        if verdict.kind == "step" and verdict.instant_ns is not None
    }
    begin = _instant(instants, args.begin, "--from", 0.0, model)
    end = _instant(instants, args.to, "--to", math.inf, model)
    times, values = log.times, log.values
    inside = (times >= begin) & (times <= end)
    factors = np.array([QUANTITIES.get(name, (name, 1.0))[1] for name in names])
    marks = [(at - begin, name) for name, at in instants.items() if begin <= at <= end]
    return Run(
        model,
        playing.player.outcome.value,
        times[inside] - begin,
        values[inside] * factors,
        marks,
        wall,
    )


def _instant(
    instants: dict[str, float], step: str | None, option: str, default: float, model: str
) -> float:
    if step is None:
        return default
    if step not in instants:
        known = ", ".join(f"'{name}'" for name in instants)
        raise InputError(option, f"a step taken with {model}: {known}", f"'{step}'")
    return instants[step]


def _title(path: Path) -> str:
    from hev_can_emu.runtime.scenario_runs import read_scenario

    return read_scenario(path)[1].name


def _print(runs: list[Run], names: list[str]) -> None:
    """Print a table: per quantity its range with each fidelity, and the distance from the last."""
    from rich.console import Console
    from rich.table import Table

    finest = runs[-1]
    table = Table(box=None, pad_edge=False)
    table.add_column("quantity")
    for run in runs:
        table.add_column(run.model, justify="right")
    for run in runs[:-1]:
        table.add_column(f"{run.model} − {finest.model}, RMS", justify="right")
    for index, name in enumerate(names):
        label = QUANTITIES.get(name, (name, 1.0))[0]
        cells = [label]
        for run in runs:
            column = run.values[:, index]
            cells.append(f"{column.min():.5g} .. {column.max():.5g}" if len(column) else "-")
        cells += [f"{_distance(run, finest, index):.3g}" for run in runs[:-1]]
        table.add_row(*cells)
    table.add_row("verdict", *(run.outcome for run in runs))
    table.add_row("computed in (s)", *(f"{run.wall_s:.2f}" for run in runs))
    Console(highlight=False, soft_wrap=True).print(table)


def _distance(run: Run, other: Run, index: int) -> float:
    """Return the RMS difference on the instants that both have."""
    count = min(len(run.times), len(other.times))
    if count == 0:
        return math.nan
    apart = run.values[:count, index] - other.values[:count, index]
    return float(np.sqrt(np.mean(apart**2)))


def _draw(path: Path, runs: list[Run], names: list[str], title: str) -> None:
    from hev_can_emu.report.comparison_plot import Curve, Panel, plot_comparison
    from hev_can_emu.report.ribbons import StepMarker

    panels = [
        Panel(
            QUANTITIES.get(name, (name, 1.0))[0],
            [Curve(run.model, run.times, run.values[:, index]) for run in runs],
        )
        for index, name in enumerate(names)
    ]
    steps = [StepMarker(at, name) for at, name in runs[-1].marks]
    plot_comparison(path, panels, title, steps)
