"""A table as plain text, to the letter as Rich prints it where there is no terminal.

Rich takes a sixth of a short run's time to be imported and to print, for colours that a log does not show.
Columns are as wide as their longest cell.  Where that is too wide, the widest are narrowed, and their cells
go on in the next line: at a blank, or within a word that no line can hold.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

_EDGES = (
    2  #: blanks around a table; a column has another between it and the next, and one to each side
)


class Column(NamedTuple):
    """A heading, whether its cells stand at the right, and whether they may go on in the next line."""

    heading: str
    right: bool = False
    folds: bool = True


def plain_table(
    title: str, columns: Sequence[Column], rows: Sequence[Sequence[str]], caption: str, width: int
) -> str | None:
    """Return the table's lines, at most ``width`` wide; None for what is better left to Rich.

    ``rows``: cells for each column.  That is text beyond printable ASCII, and a table that does not fit.
    """
    table = [[column.heading for column in columns], *rows]
    texts = [title, caption, *(cell for row in table for cell in row)]
    if not all(text.isascii() and text.isprintable() for text in texts):
        return None
    last = len(columns) - 1
    sides = [(i > 0) + (i < last) for i in range(len(columns))]
    limit = width - last - _EDGES
    longest = [max(map(len, cells)) for cells in zip(*table, strict=True)]
    widths = [min(size + side, limit) for size, side in zip(longest, sides, strict=True)]
    widths = _narrowed(widths, [column.folds for column in columns], limit)
    sizes = [size - side for size, side in zip(widths, sides, strict=True)]
    whole = sum(widths) + last + _EDGES
    if whole > width or min(sizes) < 1:
        return None
    lines = [line.ljust(whole) for line in _folded(title, whole)] if title else []
    lines.append(" " * whole)
    for number, row in enumerate(table):
        cells = [_folded(text, size) for text, size in zip(row, sizes, strict=True)]
        height = max(map(len, cells))
        for n in range(height):
            line = []
            for column, size, cell in zip(columns, sizes, cells, strict=True):
                # A heading stands at the bottom of its row, all else at the top.
                at = n - (height - len(cell) if number == 0 else 0)
                text = cell[at] if 0 <= at < len(cell) else ""
                line.append(text.rstrip().rjust(size) if column.right else text.ljust(size))
            lines.append(f" {'   '.join(line)} ")
        if number == 0:
            lines.append(f" {'─' * (whole - 2)} ")
    lines.append(" " * whole)
    lines += [line.ljust(whole) for line in _folded(caption, whole)]
    return "\n".join(lines) + "\n"


def _narrowed(widths: list[int], folds: Sequence[bool], limit: int) -> list[int]:
    """Return the widths with as much taken from the widest columns that fold as is too much, if that can be.

    The widest are first made as narrow as the next, evenly, then these together with that one.
    """
    excess = sum(widths) - limit
    while excess > 0:
        most = max((width for width, fold in zip(widths, folds, strict=True) if fold), default=0)
        rest = [w for w, fold in zip(widths, folds, strict=True) if fold and w != most]
        step = min(excess, most - max(rest, default=0))
        if step == 0:
            break
        widest = [fold and width == most for width, fold in zip(widths, folds, strict=True)]
        left, taken = excess, list(widths)
        for i, each in enumerate(widest):
            if each:
                part = min(step, round(left / sum(widest[i:])))
                taken[i] -= part
                left -= part
        widths = taken
        excess = sum(widths) - limit
    return widths


def _folded(text: str, width: int) -> list[str]:
    """Return the lines of a text, each at most so wide."""
    starts = [0]
    filled = 0  # of the present line
    for found in re.finditer(r"\s*\S+\s*", text):
        start, word = found.start(), found.group()
        needed = len(word.rstrip())
        if needed <= width - filled:
            filled += len(word)
        elif needed > width:
            starts += range(start, found.end(), width)
            filled = len(word) % width or width
        elif filled:
            starts.append(start)
            filled = len(word)
    starts = sorted(set(starts))
    return [
        text[start:end][:width] for start, end in zip(starts, [*starts[1:], len(text)], strict=True)
    ]
