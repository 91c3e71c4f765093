"""What a scenario's steps and expectations came to; the worst outcome is the scenario's."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import NamedTuple


class Outcome(Enum):
    """An outcome, from good to bad; :attr:`exit_code` is the command's."""

    PASS = "pass"
    INCONCLUSIVE = "inconclusive"
    FAIL = "fail"
    ERROR = "error"

    @property
    def exit_code(self) -> int:
        """0 pass, 1 fail, 2 error, 3 inconclusive."""
        return _EXIT_CODES[self]


_EXIT_CODES = {Outcome.PASS: 0, Outcome.FAIL: 1, Outcome.ERROR: 2, Outcome.INCONCLUSIVE: 3}
_SEVERITY = {outcome: rank for rank, outcome in enumerate(Outcome)}


class Verdict(NamedTuple):
    """One judgement.

    Attributes:
        kind: ``step`` or ``expectation``.
        name: the entry's own name, or what it says.
        outcome: pass, inconclusive, fail or error.
        instant_ns: scenario time at which the outcome was decided; None where it never was.
        expected: in words.
        observed: in words, with the signals' values at the instant.
        margin: distance from failing, in ``margin_unit``; negative where failed, None where the
            expectation has no measure.
        margin_unit: a unit's name; empty for a pure number.
        where: the entry's place in the scenario.
        window_ns: when the expectation began and ceased to look, run time; None where it never did.
        reads: what it looks at: ``Message.Signal`` and ``truth.name``, in the order of appearance.
    """

    kind: str
    name: str
    outcome: Outcome
    instant_ns: int | None
    expected: str
    observed: str
    margin: float | None
    margin_unit: str
    where: str
    window_ns: tuple[int | None, int | None] = (None, None)
    reads: tuple[str, ...] = ()


def worst(verdicts: Iterable[Verdict]) -> Outcome:
    """Return the worst outcome; nothing judged is a pass."""
    return max((each.outcome for each in verdicts), key=_SEVERITY.__getitem__, default=Outcome.PASS)
