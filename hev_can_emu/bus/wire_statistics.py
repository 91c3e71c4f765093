"""What a wire has carried, and how busy it was."""

from __future__ import annotations

SECOND_NS = 1_000_000_000


class WireStatistics:
    """Counts since the start.

    Attributes:
        frames: sent whole.
        errors: tries to send that failed.
        overwritten: frames whose successor came before they won the bus.
        dropped: frames that found a node's queue full.
        lost: frames of nodes that were off the bus.
        busy_ns: time in which the wire was not idle, intermissions included.
        peak: greatest bus load of a whole second, 0 to 1.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.errors = 0
        self.overwritten = 0
        self.dropped = 0
        self.lost = 0
        self.busy_ns = 0
        self.peak = 0.0
        self._second = 0
        self._busy_in_second_ns = 0

    def occupy(self, start_ns: int, end_ns: int) -> None:
        """Count the wire as busy from ``start_ns`` to ``end_ns``."""
        self.busy_ns += end_ns - start_ns
        while start_ns < end_ns:
            second = start_ns // SECOND_NS
            if second != self._second:
                self._second = second
                self._busy_in_second_ns = 0
            part_ns = min(end_ns, (second + 1) * SECOND_NS) - start_ns
            self._busy_in_second_ns += part_ns
            self.peak = max(self.peak, self._busy_in_second_ns / SECOND_NS)
            start_ns += part_ns

    def load(self, elapsed_ns: int) -> float:
        """Return the mean bus load, 0 to 1, over the time since the start."""
        return self.busy_ns / elapsed_ns if elapsed_ns > 0 else 0.0

    def describe(self, elapsed_ns: int) -> str:
        """Return it in one line."""
        parts = [
            f"bus load {self.load(elapsed_ns):.1%} (mean), {self.peak:.1%} (busiest second)",
            f"{self.errors} error frames",
        ]
        parts += [
            f"{count} {what}"
            for count, what in (
                (self.overwritten, "overwritten"),
                (self.dropped, "dropped by full queues"),
                (self.lost, "lost by nodes off the bus"),
            )
            if count
        ]
        return ", ".join(parts)
