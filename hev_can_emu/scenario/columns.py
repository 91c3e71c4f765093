"""What a scenario looks at, as the columns of a row that is filled at every tick."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

T, SINCE_STEP, SIGNAL, SEEN, TRUTH, EVENT, FRAME = range(7)  #: kinds of columns


class Column(NamedTuple):
    """One entry of the row.

    Attributes:
        kind: ``T`` and ``SINCE_STEP``: s; ``SIGNAL``: as last received; ``SEEN``: when, s; ``TRUTH``: of the
            plant, SI; ``EVENT``: 1.0 at the tick at which such an event is seen; ``FRAME``: 1.0 at the
            tick after a frame of the signal's message.
        what: index of the signal or truth; for events what it concerns, -1 for anything.
        event: the event's kind.
        value: the event's number, NaN for any.
    """

    kind: int
    what: int = 0
    event: int = -1
    value: float = math.nan


class Columns:
    """Numbers columns in the order in which expressions ask for them; 0 is t, 1 since_step."""

    def __init__(self) -> None:
        self._numbers: dict[Column, int] = {}
        self.number(Column(T))
        self.number(Column(SINCE_STEP))

    def __len__(self) -> int:
        return len(self._numbers)

    def number(self, column: Column) -> int:
        """Return the column's place in the row."""
        # NaN differs from itself, but this one is always the same object, which a dict goes by.
        return self._numbers.setdefault(column, len(self._numbers))

    def tables(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Return kind, index and event, shape (n, 3), and the events' numbers, shape (n,)."""
        columns = list(self._numbers)
        whole = [(each.kind, each.what, each.event) for each in columns]
        return np.array(whole, dtype=np.int64), np.array([each.value for each in columns])
