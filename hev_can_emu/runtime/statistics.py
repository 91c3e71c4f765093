"""How well a run in real time kept its clock, in constant memory however long it runs."""

from __future__ import annotations

from dataclasses import dataclass, field

_SHARE_BITS = 4
_SHARES = 1 << _SHARE_BITS  # bins per doubling: a bin is at most 1/16, 6 %, wide
_OCTAVES = 32  # up to 2**36 us, some 19 hours


class Histogram:
    """Counts of durations in bins whose width grows with the duration.

    Below 16 us a bin is 1 us wide, above it 1/16 of the power of two it lies over: a quantile is exact
    to 1 us or 3 %, whichever is more.
    """

    def __init__(self) -> None:
        self._counts = [0] * (_SHARES * _OCTAVES)
        self._total = 0
        self._largest_ns = 0

    def add(self, duration_ns: int) -> None:
        """Count one duration; a negative one counts as zero."""
        self._total += 1
        if duration_ns > self._largest_ns:
            self._largest_ns = duration_ns
        self._counts[_bin_of(max(duration_ns, 0) // 1000)] += 1

    @property
    def total(self) -> int:
        """How many durations were counted."""
        return self._total

    @property
    def largest_us(self) -> float:
        """The largest duration, exactly; 0 of none."""
        return self._largest_ns * 1e-3

    def quantile_us(self, share: float) -> float:
        """Return the duration that the given share (0 to 1) does not exceed, us; 0 of none."""
        wanted = share * self._total
        seen = 0
        for index, count in enumerate(self._counts):
            seen += count
            if count and seen >= wanted:
                low, high = _edges_us(index)
                return min(0.5 * (low + high), self.largest_us)
        return 0.0


def _bin_of(whole_us: int) -> int:
    octave = max(whole_us.bit_length() - _SHARE_BITS - 1, 0)
    return min((octave << _SHARE_BITS) + (whole_us >> octave), _SHARES * _OCTAVES - 1)


def _edges_us(index: int) -> tuple[int, int]:
    """Return the durations between which a bin lies."""
    octave = max((index >> _SHARE_BITS) - 1, 0)
    low = index - (octave << _SHARE_BITS)
    return low << octave, (low + 1) << octave


@dataclass
class Statistics:
    """How a run in real time went.

    ``ticks``: done.  ``overruns``: ticks begun a whole period or more after their deadline.
    ``stalls``: times the car's time stood still because the machine had slept, ``stalled_ns`` in all.
    ``sent``, ``received``: frames.  ``lateness``: from each tick's deadline to its end.
    """

    ticks: int = 0
    overruns: int = 0
    stalls: int = 0
    stalled_ns: int = 0
    sent: int = 0
    received: int = 0
    lateness: Histogram = field(default_factory=Histogram)

    def describe(self) -> str:
        """Return one line for people."""
        late = self.lateness
        text = f"{self.ticks} ticks, {self.overruns} overruns"
        if self.stalls:
            text += f", {self.stalls} stalls ({self.stalled_ns * 1e-9:.1f} s)"
        return text + (
            f"; tick done {late.quantile_us(0.5):.0f} us after its deadline (median), "
            f"{late.quantile_us(0.99):.0f} us (99 %), {late.largest_us:.0f} us (most)"
        )
