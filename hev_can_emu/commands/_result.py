"""What a scenario run leaves behind: recordings, a picture, a verdict file, a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.plant.ledger import Ledger
    from hev_can_emu.runtime.playing import Playing
    from hev_can_emu.runtime.signal_log import SignalLog
    from hev_can_emu.scenario.verdict import Outcome, Verdict

# Series of the picture, the status ports they show, and in which unit.
_CURVES = {
    "engine_speed_rpm": ("engine_speed", "rpm"),
    "em1_speed_rpm": ("em1_speed", "rpm"),
    "em2_speed_rpm": ("em2_speed", "rpm"),
    "vehicle_speed_kmh": ("vehicle_speed", "km/h"),
    "engine_torque_nm": ("engine_torque", "Nm"),
    "em1_torque_nm": ("em1_torque", "Nm"),
    "em2_torque_nm": ("em2_torque", "Nm"),
    "clutch_torque_nm": ("clutch_torque", "Nm"),
}
_MODES = (
    "transition", "series", "parallel_g1", "parallel_g2",
    "electric_neutral", "electric_g1", "electric_g2",
)  # fmt: skip
_RIBBONS = (
    ("mode", "driving_mode", _MODES),
    ("gear", "gear", ("neutral", "g1", "g2", "between")),
    ("C1", "clutch_state", ("open", "slipping", "locked")),
)
_KINDS = (
    ("source", "came in"),
    ("sink", "went out"),
    ("stored", "stored more than at the start"),
    ("transfer", "between the machines (no part of the sum)"),
)


class Result(NamedTuple):
    """One run: its verdicts, the worst of them, how long it took, and where the energy went."""

    name: str
    verdicts: list[Verdict]
    outcome: Outcome
    car_s: float
    wall_s: float
    trace_hash: str
    ledger: Ledger | None = None


def make_folder(text: str | None) -> Path | None:
    """Return the folder for results, made where needed; raises InputError."""
    if text is None:
        return None
    path = Path(text)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"--out {path}", "a folder that can be made", f"{error.strerror}"
        ) from error
    return path


def print_result(result: Result) -> None:
    """Print the verdict table."""
    from hev_can_emu.report.table import VerdictRow, margin_text, print_verdicts

    rows = [
        VerdictRow(
            verdict.name if verdict.kind == "expectation" else f"{verdict.kind}: {verdict.name}",
            verdict.outcome.value,
            None if verdict.instant_ns is None else verdict.instant_ns * 1e-9,
            verdict.expected,
            verdict.observed,
            margin_text(verdict.margin, verdict.margin_unit),
        )
        for verdict in result.verdicts
        if verdict.kind == "expectation" or verdict.outcome.value != "pass"
    ]
    passed = sum(v.kind == "step" and v.outcome.value == "pass" for v in result.verdicts)
    print_verdicts(rows, result.name)
    print(
        f"{result.name}: {result.outcome.value.upper()}  "
        f"({passed} steps taken, {result.car_s:.2f} s of car time in {result.wall_s:.2f} s)"
    )
    if result.trace_hash:
        print(f"trace {result.trace_hash}")


def print_ledger(ledger: Ledger) -> None:
    """Print where the energy came from and went, one line per term that is not zero."""
    for kind, title in _KINDS:
        terms = [term for term in ledger.terms if term.kind == kind and term.energy != 0.0]
        total = "" if kind == "transfer" else f"{ledger.total(kind):14.1f} J"
        print(f"{title:<58}{total}")
        for term in terms:
            print(f"  {term.text:<56}{term.energy:14.1f} J")
    share = ledger.residue / ledger.moved if ledger.moved > 0.0 else 0.0
    print(
        f"energy moved {ledger.moved:.1f} J, does not close: {ledger.residue:.3g} J ({share:.1g})"
    )
    print(f"fuel burnt {ledger.fuel * 1e3:.2f} g")


def ledger_content(ledger: Ledger) -> dict[str, object]:
    """Return the ledger for reports: unit, sums and terms."""
    return {
        "unit": "J",
        "moved": ledger.moved,
        "residue": ledger.residue,
        "fuel_kg": ledger.fuel,
        "terms": [
            {"name": term.name, "kind": term.kind, "energy": term.energy, "text": term.text}
            for term in ledger.terms
        ],
    }


def draw(path: Path, log: SignalLog, playing: Playing, verdicts: list[Verdict]) -> None:
    """Draw speeds, torques and modes of a run; raises InputError without matplotlib."""
    from hev_can_emu.report.plot import plot_run
    from hev_can_emu.report.ribbons import Ribbon, StepMarker, segments_of
    from hev_can_emu.runtime.status_signals import status_on_grid

    emulator = playing.emulator
    t_s = np.arange(0.0, emulator.now_ns * 1e-9, 0.01)
    series = {
        key: status_on_grid(emulator, log, port, t_s, unit_name)
        for key, (port, unit_name) in _CURVES.items()
    }
    ribbons = []
    for title, port, words in _RIBBONS:
        codes = status_on_grid(emulator, log, port, t_s, "1")
        ribbons.append(Ribbon(title, segments_of(t_s, codes, dict(enumerate(words)))))
    steps = [
        StepMarker(verdict.instant_ns * 1e-9, verdict.name)
        for verdict in verdicts
        if verdict.kind == "step" and verdict.instant_ns is not None
    ]
    title = f"{playing.scenario.name} ({emulator.setup.model}, {emulator.vehicle_name})"
    plot_run(path, t_s, series, ribbons, title, steps)
