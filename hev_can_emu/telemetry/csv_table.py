"""Decoded signals as CSV: a header with units, a row per instant, empty where nothing was sent.

``nan`` stands for a signal's "not available".  Numbers have 15 digits: enough for every value that a
signal of up to 50 bits can have.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.telemetry.table import TIME, TRUTH, Column, Network, Rows, columns_of

_READ_ROWS = 2048


class CsvFile:
    """A ``.csv`` file.

    Args:
        path: of the new file.
        network: says what the columns are.
    """

    def __init__(self, path: Path, network: Network) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        heads = [TIME, *(_head(column) for column in columns_of(network))]
        csv.writer(self._file, lineterminator="\n").writerow(heads)

    def write(self, rows: Rows) -> None:
        """Append rows; raises OSError."""
        lines = []
        empty = [""] * rows.values.shape[1]
        for t_ns, values, filled in zip(rows.t_ns.tolist(), rows.values, rows.filled, strict=True):
            cells = empty.copy()
            places = np.flatnonzero(filled)
            for place, value in zip(places.tolist(), values[places].tolist(), strict=True):
                cells[place] = f"{value:.15g}"
            seconds, rest = divmod(t_ns, 1_000_000_000)
            lines.append(f"{seconds}.{rest:09d},{','.join(cells)}\n")
        self._file.writelines(lines)

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _head(column: Column) -> str:
    return f"{column.name} [{column.unit}]" if column.unit else column.name


def read_csv(path: Path, network: Network) -> Iterator[Rows]:
    """Yield the rows of a CSV file, in parts; columns of truth are passed over.

    Raises:
        InputError: no such file, no time column, an unknown signal, a cell that is no number.
    """
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.reader(file)
        try:
            places = signal_places(path, network, [_name(head) for head in next(reader, [])])
            part: list[list[str]] = []
            for cells in reader:
                part.append(cells)
                if len(part) == _READ_ROWS:
                    yield _rows(path, network, places, part, reader.line_num)
                    part = []
            if part:
                yield _rows(path, network, places, part, reader.line_num)
        except (csv.Error, UnicodeDecodeError) as error:
            raise InputError(str(path), "a CSV file of signals", str(error)) from error


def signal_places(path: Path, network: Network, names: list[str]) -> list[int]:
    """Return each column's place among the signals, -1 for columns of truth; raises InputError."""
    if not names or names[0] != TIME:
        got = f"'{names[0]}'" if names else "nothing"
        raise InputError(str(path), f"a first column {TIME}", got)
    places = []
    for name in names[1:]:
        if name.startswith(TRUTH):
            places.append(-1)
            continue
        try:
            places.append(network.database.signal(name).index)
        except InputError as error:
            known = [signal.qualified_name for signal in network.database.signals]
            hint = did_you_mean(name, known)
            raise InputError(str(path), "columns that are signals", f"'{name}'", hint) from error
    return places


def _name(head: str) -> str:
    return head.partition(" [")[0]


def _rows(
    path: Path, network: Network, places: list[int], part: list[list[str]], last_line: int
) -> Rows:
    width = len(network.database.signals)
    values = np.full((len(part), width), np.nan)
    filled = np.zeros((len(part), width), dtype=np.bool_)
    t_ns: npt.NDArray[np.int64] = np.zeros(len(part), dtype=np.int64)
    for row, cells in enumerate(part):
        line = last_line - len(part) + row + 1
        if len(cells) != len(places) + 1:
            got = f"{len(cells)}"
            raise InputError(f"{path}: line {line}", f"{len(places) + 1} columns", got)
        try:
            t_ns[row] = _nanoseconds(cells[0])
            for place, cell in zip(places, cells[1:], strict=True):
                if cell and place >= 0:
                    values[row, place] = float(cell)
                    filled[row, place] = True
        except ValueError as error:
            raise InputError(f"{path}: line {line}", "numbers", str(error)) from error
    return Rows(t_ns, values, filled)


def _nanoseconds(text: str) -> int:
    """Return seconds as ns, exactly where they are written with up to nine decimals."""
    whole, point, rest = text.partition(".")
    if point and whole.isdigit() and rest.isdigit():
        return int(whole) * 1_000_000_000 + int(rest[:9].ljust(9, "0"))
    return round(float(text) * 1e9)
