"""Writes what ``--out`` leaves of runs: JSON and a page each, slices, JUnit and an index of all."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.report.run_report import RunReport
    from hev_can_emu.runtime.playing import RunResult
    from hev_can_emu.runtime.signal_log import SignalLog
    from hev_can_emu.telemetry.table import Network

JUNIT = "junit.xml"
INDEX = "index.html"
_OPTIONS = (
    "clock", "bus", "seed", "vehicle", "model", "reduction", "dbc", "bindings", "protection", "start",
)  # fmt: skip


def command_of(arguments: argparse.Namespace, run: RunResult, varied: Sequence[str]) -> str:
    """Return the command that repeats one run, but for where its results go.

    Args:
        arguments: of the command that made it.
        run: what was run.
        varied: names over which the scenario's matrix runs.
    """
    words = ["hev-can-emu", "scenario", "run", run.file]
    head = {"vehicle": run.vehicle, "model": run.model, "start": run.start, "seed": run.seed}
    for name in _OPTIONS:
        value = getattr(arguments, name, None)
        if value is None and name in varied:
            value = head[name]
        if value is not None:
            words += [f"--{name}", str(value)]
    for value in arguments.node:
        words += ["--node", value]
    given = {text.partition("=")[0].strip() for text in arguments.set}
    for value in arguments.set:
        words += ["--set", value]
    for name in varied:
        if name in run.parameters and name not in given:
            words += ["--set", f"{name}={run.parameters[name]}"]
    return shlex.join(words)


def write_run(folder: Path, stem: str, report: RunReport) -> None:
    """Write a run's JSON and its page; the page needs jinja2, without it a line says so."""
    from hev_can_emu.report.json_report import write_json
    from hev_can_emu.report.page import write_page

    _guarded(folder / f"{stem}.json", lambda path: write_json(path, report))
    try:
        write_page(folder / f"{stem}.html", report)
    except InputError as error:
        if error.expected != "the package jinja2":
            raise
        print(f"no page: {error.hint}")


def write_whole(folder: Path, title: str, reports: Sequence[tuple[RunReport, str]]) -> None:
    """Write what is told of all runs together: JUnit, and an index page where there are several.

    Args:
        folder: where the runs' own files are.
        title: of the index.
        reports: each run and the stem of its files.
    """
    from hev_can_emu.report.junit import write_junit
    from hev_can_emu.report.page import write_index

    _guarded(folder / JUNIT, lambda path: write_junit(path, [report for report, _ in reports]))
    if len(reports) > 1 and (folder / f"{reports[0][1]}.html").exists():
        pages = [(report, f"{stem}.html") for report, stem in reports]
        write_index(folder / INDEX, title, pages)


def write_slices(
    folder: Path,
    stem: str,
    ending: str,
    around_s: float,
    result: RunResult,
    log: SignalLog,
    network: Network,
    epoch_ns: int,
) -> list[str]:
    """Write what was on the bus around each verdict that is no pass; return the files' names."""
    from hev_can_emu.scenario.verdict import Outcome
    from hev_can_emu.telemetry.recorder import open_recorder

    names: list[str] = []
    around_ns = round(around_s * 1e9)
    for verdict in result.verdicts:
        if verdict.outcome is Outcome.PASS or verdict.instant_ns is None:
            continue
        names.append(f"{stem}.slice{len(names) + 1}{ending}")
        frames = log.between(verdict.instant_ns - around_ns, verdict.instant_ns + around_ns + 1)
        with open_recorder(folder / names[-1], epoch_ns=epoch_ns, network=network) as recorder:
            recorder.write(frames, len(frames))
    return names


def _guarded(path: Path, write: Callable[[Path], None]) -> None:
    try:
        write(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(str(path), "a file that can be written", reason) from error
