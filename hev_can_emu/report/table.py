"""The table of verdicts: what was expected, what was seen, and by how much.

A terminal gets a table that fits it, by Rich; a log one line per verdict, without the import of Rich, which
takes longer than a short run's ticks.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, TextIO

if TYPE_CHECKING:
    from rich.table import Table

# Words, not signs or colour alone: the table also goes into logs.
_STYLES = {
    "pass": "bold green",
    "fail": "bold red",
    "inconclusive": "bold yellow",
    "error": "bold red",
}
_HEADINGS = ("expectation", "verdict", "at", "expected", "observed", "margin")
_FIXED = ("verdict", "at")  #: columns that never go on in the next line


class VerdictRow(NamedTuple):
    """One expectation's outcome, ready to be read.

    Attributes:
        name: what was expected to happen.
        verdict: pass, fail, inconclusive or error.
        time_s: the instant that decided it, in s; None if there was none.
        expected: the condition, with unit.
        observed: the value that decided it, with unit.
        margin: distance to the limit, with unit; may be empty.
    """

    name: str
    verdict: str
    time_s: float | None
    expected: str
    observed: str
    margin: str = ""


def margin_text(margin: float | None, unit: str) -> str:
    """Return a margin for people; empty where there is none."""
    return "" if margin is None else f"{margin:.4g} {unit}".strip()


def verdict_table(rows: Sequence[VerdictRow], title: str) -> Table:
    """Return the table for a terminal; its caption counts the verdicts."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(title, style="bold"),
        caption=Text(summary(rows)),
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    for heading in _HEADINGS:
        table.add_column(
            heading,
            justify="right" if heading in ("at", "margin") else "left",
            no_wrap=heading in _FIXED,
            overflow="ellipsis" if heading in _FIXED else "fold",
        )
    for row in rows:
        table.add_row(
            Text(row.name),
            Text(row.verdict, style=_STYLES.get(row.verdict, "bold")),
            _instant(row),
            Text(row.expected),
            Text(row.observed),
            Text(row.margin),
        )
    return table


def summary(rows: Sequence[VerdictRow]) -> str:
    """Return ``3 pass, 1 fail``: how often each verdict was given, in the order of ``_STYLES``."""
    counts = dict.fromkeys(_STYLES, 0)
    for row in rows:
        counts[row.verdict] = counts.get(row.verdict, 0) + 1
    parts = [f"{count} {verdict}" for verdict, count in counts.items() if count]
    return ", ".join(parts) or "no expectations"


def log_lines(rows: Sequence[VerdictRow], title: str) -> list[str]:
    """Return the same for a log: a verdict is a line, however long, so that it can be searched for."""
    cells: list[tuple[str, ...]] = [
        (row.name, row.verdict, _instant(row), row.expected, row.observed, row.margin)
        for row in rows
    ]
    table = [tuple(" ".join(cell.split()) for cell in line) for line in [_HEADINGS, *cells]]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in table
    ]
    return [title, *lines, summary(rows)]


def print_verdicts(rows: Sequence[VerdictRow], title: str, file: TextIO | None = None) -> None:
    """Print the table, as wide as the terminal, or lines for a log file (default stdout)."""
    target = sys.stdout if file is None else file
    if target is None:  # closed from the start
        return
    if not target.isatty() and not {"FORCE_COLOR", "TTY_COMPATIBLE"} & os.environ.keys():
        print(*log_lines(rows, title), sep="\n", file=target, flush=True)
        return
    from rich.console import Console

    Console(file=file, highlight=False).print(verdict_table(rows, title))


def _instant(row: VerdictRow) -> str:
    return "" if row.time_s is None else f"{row.time_s:.3f} s"
