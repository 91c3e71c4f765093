"""The table of verdicts in the terminal: what was expected, what was seen, and by how much."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TextIO

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

# Words, not signs or colour alone: the table also goes into logs.
_STYLES = {
    "pass": "bold green",
    "fail": "bold red",
    "inconclusive": "bold yellow",
    "error": "bold red",
}
_LOG_WIDTH = 140


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
    """Return the table; its caption counts the verdicts."""
    table = Table(
        title=Text(title, style="bold"),
        caption=Text(summary(rows)),
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("expectation", overflow="fold")
    table.add_column("verdict", no_wrap=True)
    table.add_column("at", justify="right", no_wrap=True)
    table.add_column("expected", overflow="fold")
    table.add_column("observed", overflow="fold")
    table.add_column("margin", justify="right", overflow="fold")
    for row in rows:
        table.add_row(
            Text(row.name),
            Text(row.verdict, style=_STYLES.get(row.verdict, "bold")),
            "" if row.time_s is None else f"{row.time_s:.3f} s",
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


def print_verdicts(rows: Sequence[VerdictRow], title: str, file: TextIO | None = None) -> None:
    """Print the table: as wide as the terminal, or broad enough for a log file (default stdout)."""
    console = Console(file=file, highlight=False)
    if not console.is_terminal:
        console = Console(file=file, highlight=False, width=_LOG_WIDTH)
    console.print(verdict_table(rows, title))
