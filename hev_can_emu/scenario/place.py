"""Where in a scenario something stands, so that every complaint can say it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hev_can_emu.errors import InputError

Steps = tuple[str | int, ...]


def spell(steps: Steps) -> str:
    """Return a path as text: ``$.steps[3].set.EM2TorqueRequest``."""
    parts = ["$"]
    for step in steps:
        if isinstance(step, int):
            parts.append(f"[{step}]")
        else:
            parts.append(f".{step}" if "." not in step else f"['{step}']")
    return "".join(parts)


class Place(NamedTuple):
    """A path into a scenario; ``locate`` turns it into text, with file and line where known."""

    locate: Callable[[Steps], str] = spell
    steps: Steps = ()

    def __truediv__(self, step: str | int) -> Place:
        return Place(self.locate, (*self.steps, step))

    def __str__(self) -> str:
        return self.locate(self.steps)

    @property
    def path(self) -> str:
        """The path alone, without file and line."""
        return spell(self.steps)

    def refuse(self, expected: str, got: str, hint: str = "") -> InputError:
        """Return the error to raise about what stands here."""
        line = " ".join(got.split())
        return InputError(
            str(self), expected, line if len(line) <= 300 else line[:297] + "...", hint
        )
