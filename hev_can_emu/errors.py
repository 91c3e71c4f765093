"""Every exception of the package.

::

    HevError                what this package raises on purpose; the command prints it on one line
    |-- InputError          a file, option or value that cannot be used (exit code 2); also a ValueError
    |-- BusError            a bus that cannot be opened, or was lost
    |-- StateError          an operation that the object's present state does not allow
    `-- NotMet              what a test bench waited for has not come; also an AssertionError

Misuse of a Python interface raises ``ValueError``; the outside world raises these.  Adapters
translate third-party exceptions once, ``from exc``.
"""

from __future__ import annotations

from collections.abc import Iterable


class HevError(Exception):
    """Base of all errors raised on purpose."""


class InputError(HevError, ValueError):
    """Unusable input, told as ``WHERE: expected X, got Y; hint``.

    Args:
        where: the file (with line where known), then the path in it, or the option's name.
        expected: what would have been accepted.
        got: what was found instead.
        hint: how to mend it; may be empty.
    """

    def __init__(self, where: str, expected: str, got: str, hint: str = "") -> None:
        self.where = where
        self.expected = expected
        self.got = got
        self.hint = hint
        tail = f"; {hint}" if hint else ""
        super().__init__(f"{where}: expected {expected}, got {got}{tail}")


class BusError(HevError):
    """A bus could not be opened, refused a frame, or went away."""


class StateError(HevError):
    """The object is not in a state that allows the operation."""


class NotMet(HevError, AssertionError):
    """A condition has not come within its time, told with what was seen instead."""


def did_you_mean(name: str, known: Iterable[str], count: int = 3) -> str:
    """Return ``did you mean 'a' or 'b'?`` for the names nearest to ``name``, or an empty string."""
    import difflib  # takes a millisecond, and hardly anybody errs

    by_folded = {candidate.lower(): candidate for candidate in known}
    near = difflib.get_close_matches(name.lower(), by_folded, n=count, cutoff=0.5)
    if not near:
        return ""
    return "did you mean " + " or ".join(f"'{by_folded[folded]}'" for folded in near) + "?"
