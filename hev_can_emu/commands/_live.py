"""A line that lives at the bottom of a terminal while other lines scroll above it.

Written by hand: a full-screen toolkit's refresh takes many milliseconds, and so misses ticks.
"""

from __future__ import annotations

import sys

_ERASE = "\r\x1b[K"


class LiveLine:
    """One line on stderr, rewritten in place; on anything but a terminal it is never shown."""

    def __init__(self) -> None:
        self.live = sys.stderr.isatty()
        self._shown = False

    def show(self, text: str) -> None:
        """Rewrite the line, cut to the terminal's width."""
        if not self.live:
            return
        import shutil  # takes a millisecond or two, which a run without a terminal need not spend

        width = shutil.get_terminal_size().columns
        sys.stderr.write(_ERASE + text[: width - 1])
        sys.stderr.flush()
        self._shown = True

    def say(self, text: str) -> None:
        """Write a line that stays, above the living one."""
        sys.stderr.write((_ERASE if self._shown else "") + text + "\n")
        sys.stderr.flush()
        self._shown = False

    def end(self) -> None:
        """Leave the line standing as it is."""
        if self._shown:
            sys.stderr.write("\n")
            sys.stderr.flush()
            self._shown = False


def bar(done: float, width: int = 30) -> str:
    """Return a bar of ``width`` characters, filled to the share ``done`` (0 to 1)."""
    filled = round(min(max(done, 0.0), 1.0) * width)
    return "━" * filled + "─" * (width - filled)
