"""What all expectations share: a window, blocks of rows to look at, one decision."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.scenario.expression import Array, Expression, Read
from hev_can_emu.scenario.verdict import Outcome, Verdict

NEVER = 1 << 62  #: later than any scenario lasts


class Head(NamedTuple):
    """Of an expectation: its name, what it says, its window in words, its place, what it looks at."""

    name: str
    says: str
    window: str
    where: str
    reads: tuple[Read, ...]


class Block(NamedTuple):
    """Rows of what was seen, in the order of time; ``last``: with the final one the window closes."""

    t_ns: npt.NDArray[np.int64]
    rows: Array
    last: bool


class Frames(NamedTuple):
    """Frames that were on the bus: when, identifier, whether it is extended."""

    t_ns: npt.NDArray[np.int64]
    identifiers: npt.NDArray[np.uint32]
    extended: npt.NDArray[np.bool_]


class Monitor:
    """Watches one window and decides once.

    The player tells when the window opens and closes, then hands over every tick of it, both ends
    included, in blocks of any size; where they end changes nothing.
    """

    def __init__(self, head: Head, margin_unit: str) -> None:
        self.head = head
        self.opened = False
        self.open_ns = 0
        self.close_ns = NEVER
        self.outcome: Outcome | None = None
        self.margin = math.inf
        self._margin_unit = margin_unit
        self._instant_ns: int | None = None
        self._observed = ""

    def watch(self, block: Block) -> None:
        """Look at the next ticks of the window; decide as soon as it can be said."""
        raise NotImplementedError

    def hear(self, frames: Frames) -> None:
        """Take frames of the window; they come before the ticks of the same time."""

    def abandon(self, reason: str) -> None:
        """Decide that nothing can be said, unless something was."""
        if self.outcome is None:
            self.outcome, self._observed = Outcome.INCONCLUSIVE, reason
            self.margin = math.inf

    def distrust(self, reason: str) -> None:
        """Take back a failure that may be the host's."""
        if self.outcome is Outcome.FAIL:
            self.outcome = Outcome.INCONCLUSIVE
            self._observed = f"{self._observed}; not told against: {reason}"

    def verdict(self) -> Verdict:
        """Return the record; what is undecided so far reads as inconclusive, and stays undecided."""
        undecided = self.outcome is None
        closes = self.close_ns if self.close_ns < NEVER else None
        return Verdict(
            kind="expectation",
            name=self.head.name,
            outcome=self.outcome or Outcome.INCONCLUSIVE,
            instant_ns=self._instant_ns,
            expected=f"{self.head.says} {self.head.window}".strip(),
            observed="the scenario has not come to an end" if undecided else self._observed,
            margin=self.margin if math.isfinite(self.margin) else None,
            margin_unit=self._margin_unit if math.isfinite(self.margin) else "",
            where=self.head.where,
            window_ns=(self.open_ns, closes) if self.opened else (None, None),
            reads=tuple(each.source for each in self.head.reads),
        )

    def _decide(self, outcome: Outcome, t_ns: int, observed: str) -> None:
        self.outcome, self._instant_ns, self._observed = outcome, int(t_ns), observed

    def _leave(self, t_ns: int) -> None:
        """Let the margin be the time that is left."""
        if self.close_ns < NEVER:
            self.margin, self._margin_unit = (self.close_ns - int(t_ns)) * 1e-9, "s"

    def _see(self, row: Array) -> str:
        """Return in words what is looked at."""
        return ", ".join(
            f"{each.name} = {each.say(float(row[each.column]))}" for each in self.head.reads
        )


def first_true(condition: npt.NDArray[np.bool_]) -> int | None:
    """Return the place of the first True, None where there is none."""
    if not condition.size:
        return None
    place = int(condition.argmax())
    return place if condition[place] else None


def truth_of(expression: Expression, rows: Array) -> npt.NDArray[np.bool_]:
    """Return for each row whether the condition holds."""
    return np.asarray(expression.values(rows) == 1.0, dtype=np.bool_)
