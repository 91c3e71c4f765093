"""The page of a run, and the index of several: HTML that needs nothing beside itself.

jinja2 is an optional dependency (extra ``report``), imported when a page is made.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hev_can_emu.errors import InputError
from hev_can_emu.report import figures
from hev_can_emu.report.run_report import RunReport
from hev_can_emu.report.table import margin_text
from hev_can_emu.scenario.verdict import Outcome

_TEMPLATES = Path(__file__).parent / "templates"
_ORDER = (Outcome.ERROR, Outcome.FAIL, Outcome.INCONCLUSIVE, Outcome.PASS)


def write_page(path: Path, report: RunReport) -> None:
    """Write the page of one run.

    Raises:
        InputError: jinja2 is not installed, or the file cannot be written.
    """
    expectations = [
        {
            "verdict": verdict,
            "id": f"expectation-{place}",
            "figure": figures.check_figure(report, verdict),
            "margin": margin_text(verdict.margin, verdict.margin_unit),
        }
        for place, verdict in enumerate(report.expectations, 1)
    ]
    troubles = [each for each in expectations if each["verdict"].outcome is not Outcome.PASS]  # type: ignore[attr-defined]
    _write(
        path,
        "run.html",
        report=report,
        expectations=expectations,
        troubles=troubles,
        bad_steps=[step for step in report.steps if step.outcome is not Outcome.PASS],
        held=_held(report),
        overview=figures.overview(report),
    )


def write_index(path: Path, title: str, reports: Sequence[tuple[RunReport, str]]) -> None:
    """Write the page that leads to several runs' pages.

    Args:
        path: the new file.
        title: of the whole.
        reports: each run, one at least, and the name of its page, beside this one.

    Raises:
        InputError: jinja2 is not installed, or the file cannot be written.
    """
    settings = [
        {**report.parameters, **report.car, "seed": str(report.seed)} for report, _ in reports
    ]
    common = [name for name in settings[0] if all(name in each for each in settings)]
    varied = [name for name in common if len({each[name] for each in settings}) > 1]
    counts = {
        outcome.value: sum(report.outcome is outcome for report, _ in reports) for outcome in _ORDER
    }
    worst = next((each for each in _ORDER if counts[each.value]), Outcome.PASS)
    expected = [tuple(each.name for each in report.expectations) for report, _ in reports]
    names = expected[0] if len(set(expected)) == 1 else ()
    rows = [
        {
            "report": report,
            "page": page,
            "parameters": [setting[name] for name in varied],
            "cells": _cells(report),
            "held": _held(report),
        }
        for (report, page), setting in zip(reports, settings, strict=True)
    ]
    _write(
        path,
        "index.html",
        title=title,
        rows=rows,
        varied=varied,
        names=names,
        counts=counts,
        worst=worst,
        total=len(reports),
        versions=reports[0][0].versions,
    )


def _cells(report: RunReport) -> list[dict[str, str]]:
    """Return outcome and words of each expectation."""
    cells = []
    for verdict in report.expectations:
        margin = margin_text(verdict.margin, verdict.margin_unit)
        told = f"{verdict.name}: {verdict.outcome.value}" + (f", margin {margin}" if margin else "")
        cells.append({"outcome": verdict.outcome.value, "told": told})
    return cells


def _held(report: RunReport) -> str:
    """Return how many expectations hold, in words."""
    held = sum(verdict.outcome is Outcome.PASS for verdict in report.expectations)
    return f"{held} of {len(report.expectations)}"


def _write(path: Path, template: str, **content: Any) -> None:
    try:
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ImportError as error:
        hint = "pip install 'hev-can-emu[report]'"
        raise InputError(str(path), "the package jinja2", "none installed", hint) from error
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style = (_TEMPLATES / "style.css").read_text(encoding="utf-8")
    script = (_TEMPLATES / "hover.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    page = environment.get_template(template).render(
        style=style, script=script, script_hash=f"sha256-{digest}", **content
    )
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(str(path), "a file that can be written", reason) from error
