"""Decoded signals as Parquet: a row per instant, null where nothing was sent, NaN for "not available".

A Parquet file cannot be read before its footer is written.  So while it grows, ``run.parquet`` is a
folder of complete files, each put there in one move, as Parquet readers take folders too; when the
recording ends, they become one file of that name.  A killed process leaves the folder, readable under
the same name.

pyarrow is an optional dependency (extra ``parquet``), imported when such a file is opened.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hev_can_emu.errors import InputError
from hev_can_emu.telemetry.csv_table import signal_places
from hev_can_emu.telemetry.table import TIME, Network, Rows, columns_of

_PART = "part-"
_GROUP_ROWS = 1 << 16  #: rows per row group of the finished file, at most
T_NS = "t_ns"  #: the second column: the same instant, exactly


class ParquetFile:
    """A ``.parquet`` file.

    Args:
        path: of the new file; a folder left there by a killed recording gives way.
        network: says what the columns are.

    Raises:
        InputError: pyarrow is not installed, or a folder of something else is in the way.
    """

    def __init__(self, path: Path, network: Network) -> None:
        self._arrow, self._parquet = _import(f"--record {path}")
        self._path = path
        self._schema = _schema(self._arrow, network)
        self._parts: list[Path] = []
        self._waiting: list[Rows] = []
        if path.is_dir():
            if any(not child.name.startswith(_PART) for child in path.iterdir()):
                raise InputError(f"--record {path}", "a file's name", "a folder")
            _remove(path)
        path.unlink(missing_ok=True)
        path.mkdir()
        self._put(self._schema.empty_table())

    def write(self, rows: Rows) -> None:
        """Append rows."""
        self._waiting.append(rows)

    def flush(self) -> None:
        """Write a part, readable as it stands; raises OSError."""
        if self._waiting:
            self._put(self._table(self._waiting))
            self._waiting = []

    def close(self) -> None:
        """Make one file of all parts; raises OSError."""
        self.flush()
        whole = self._path.with_name(f".{self._path.name}.whole")
        with self._parquet.ParquetWriter(whole, self._schema) as writer:
            tables, rows = [], 0
            for part in self._parts:
                tables.append(self._parquet.read_table(part))
                rows += tables[-1].num_rows
                if rows >= _GROUP_ROWS or part == self._parts[-1]:
                    writer.write_table(self._arrow.concat_tables(tables))
                    tables, rows = [], 0
        _remove(self._path)
        os.replace(whole, self._path)

    def _put(self, table: Any) -> None:
        """Write a part beside the folder, then move it there."""
        part = self._path / f"{_PART}{len(self._parts):06d}.parquet"
        made = self._path.with_name(f".{self._path.name}.part")
        self._parquet.write_table(table, made)
        os.replace(made, part)
        self._parts.append(part)

    def _table(self, parts: list[Rows]) -> Any:
        t_ns = np.concatenate([part.t_ns for part in parts])
        values = np.concatenate([part.values for part in parts])
        empty = ~np.concatenate([part.filled for part in parts])
        arrays = [self._arrow.array(t_ns * 1e-9), self._arrow.array(t_ns)]
        arrays += [
            self._arrow.array(values[:, column], mask=empty[:, column])
            for column in range(values.shape[1])
        ]
        return self._arrow.table(arrays, schema=self._schema)


def _remove(folder: Path) -> None:
    import shutil  # what other recordings need not import

    shutil.rmtree(folder)


def read_parquet(path: Path, network: Network) -> Iterator[Rows]:
    """Yield the rows of a Parquet file or folder, in parts; columns of truth are passed over.

    Raises:
        InputError: pyarrow is not installed, it is no such file, or a column is no signal.
    """
    arrow, _ = _import(str(path))
    from pyarrow import dataset

    width = len(network.database.signals)
    try:
        found = dataset.dataset(path, format="parquet")
        names = [name for name in found.schema.names if name != T_NS]
        places = signal_places(path, network, names)
        exact = T_NS in found.schema.names
        for batch in found.to_batches():
            stamps = batch.column(T_NS if exact else TIME).to_numpy(zero_copy_only=False)
            t_ns = stamps if exact else np.rint(stamps * 1e9)
            values = np.full((batch.num_rows, width), np.nan)
            filled = np.zeros((batch.num_rows, width), dtype=np.bool_)
            for name, place in zip(names[1:], places, strict=True):
                if place >= 0:
                    column = batch.column(name)
                    values[:, place] = column.cast("float64").to_numpy(zero_copy_only=False)
                    filled[:, place] = column.is_valid().to_numpy(zero_copy_only=False)
            yield Rows(t_ns.astype(np.int64), values, filled)
    except (arrow.ArrowException, OSError) as error:
        told = str(error).splitlines()[0]
        raise InputError(str(path), "a Parquet file of signals", told) from error


def _schema(arrow: Any, network: Network) -> Any:
    fields = [arrow.field(TIME, arrow.float64(), nullable=False)]
    fields.append(arrow.field(T_NS, arrow.int64(), nullable=False))
    fields += [
        arrow.field(column.name, arrow.float64(), metadata={"unit": column.unit})
        for column in columns_of(network)
    ]
    return arrow.schema(fields)


def _import(where: str) -> tuple[Any, Any]:
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError as error:
        hint = "pip install 'hev-can-emu[parquet]'"
        raise InputError(where, "the package pyarrow", "none installed", hint) from error
    return arrow, parquet
