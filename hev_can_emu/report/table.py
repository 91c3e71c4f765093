"""The table of verdicts in the terminal: what was expected, what was seen, and by how much."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, TextIO

from hev_can_emu.report.plain_table import Column, plain_table

if TYPE_CHECKING:
    from rich.table import Table

# Words, not signs or colour alone: the table also goes into logs.
_STYLES = {
    "pass": "bold green",
    "fail": "bold red",
    "inconclusive": "bold yellow",
    "error": "bold red",
}
_LOG_WIDTH = 140
_COLUMNS = (
    Column("expectation"),
    Column("verdict", folds=False),
    Column("at", right=True, folds=False),
    Column("expected"),
    Column("observed"),
    Column("margin", right=True),
)


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
    for column in _COLUMNS:
        table.add_column(
            column.heading,
            justify="right" if column.right else "left",
            no_wrap=not column.folds,
            overflow="fold" if column.folds else "ellipsis",
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


def log_table(rows: Sequence[VerdictRow], title: str) -> str | None:
    """Return the same as text for a log; None where that needs Rich, as for letters of double width."""
    cells = [
        (row.name, row.verdict, _instant(row), row.expected, row.observed, row.margin)
        for row in rows
    ]
    return plain_table(title, _COLUMNS, cells, summary(rows), _LOG_WIDTH)


def print_verdicts(rows: Sequence[VerdictRow], title: str, file: TextIO | None = None) -> None:
    """Print the table: as wide as the terminal, or broad enough for a log file (default stdout)."""
    target = sys.stdout if file is None else file
    text = log_table(rows, title) if _is_log(target) else None
    if text is not None:
        target.write(text)
        target.flush()
        return
    from rich.console import Console

    console = Console(file=file, highlight=False)
    if not console.is_terminal:
        console = Console(file=file, highlight=False, width=_LOG_WIDTH)
    console.print(verdict_table(rows, title))


def _instant(row: VerdictRow) -> str:
    return "" if row.time_s is None else f"{row.time_s:.3f} s"


def _is_log(file: TextIO) -> bool:
    """Return whether it is a plain file or a pipe beyond doubt; else Rich decides."""
    return (
        os.name == "posix"
        and isinstance(file, io.TextIOWrapper)
        and file.encoding.lower().startswith("utf")
        and not file.isatty()
        and not {"FORCE_COLOR", "TTY_COMPATIBLE"} & os.environ.keys()
    )
