"""The report for programs: JSON, whose names and meanings docs/reports.md lists."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from hev_can_emu.report.run_report import RunReport
from hev_can_emu.scenario.verdict import Verdict

VERSION = 1


def write_json(path: Path, report: RunReport) -> None:
    """Write a run; in virtual time the same run gives the same bytes.  Raises OSError."""
    content: dict[str, Any] = {
        "version": VERSION,
        "scenario": report.name,
        "file": report.file,
        "description": report.description,
        "outcome": report.outcome.value,
        "car_time_s": report.car_s,
        "clock": report.clock,
        "seed": report.seed,
        "trace": report.trace,
        "command": report.command,
        "parameters": dict(report.parameters),
        "car": dict(report.car),
        "versions": dict(report.versions),
        "verdicts": [_verdict(verdict) for verdict in report.verdicts],
        "events": [event._asdict() for event in report.happenings],
        "spans": [span._asdict() for span in report.spans],
        "faults": list(report.faults),
        "periods": [period._asdict() for period in report.periods],
        "recordings": list(report.files),
    }
    if report.started:
        content |= {
            "started": report.started,
            "wall_time_s": report.wall_s,
            "timing": dict(report.timing),
        }
    if report.ledger is not None:
        content["ledger"] = report.ledger
    path.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n")


def _verdict(verdict: Verdict) -> dict[str, Any]:
    return {
        "kind": verdict.kind,
        "name": verdict.name,
        "outcome": verdict.outcome.value,
        "instant_s": _seconds(verdict.instant_ns),
        "expected": verdict.expected,
        "observed": verdict.observed,
        "margin": verdict.margin,
        "margin_unit": verdict.margin_unit,
        "where": verdict.where,
        "window_s": [_seconds(instant) for instant in verdict.window_ns],
        "reads": list(verdict.reads),
    }


def _seconds(t_ns: int | None) -> float | None:
    return None if t_ns is None else t_ns * 1e-9
