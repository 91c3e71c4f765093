"""What can be wrong with a bus: frames that are destroyed, a node that floods it."""

from __future__ import annotations

import random
from typing import NamedTuple


class Disturbance(NamedTuple):
    """Frames that are destroyed on the wire.

    ``sender``: name of the node whose frames are hit, '' any; ``receiver``: name of the node that finds
    fault with them, '' the sender itself; ``identifier`` and ``extended``: which frames, None any;
    ``frames``: how many tries to send are destroyed before it ends, 0 no limit; ``chance``: share of those
    that are; ``place``: where in the frame, 0 its start and 1 its end, None at random; ``start_ns`` and
    ``end_ns``: when, None without end; ``seed``: of what is random.
    """

    sender: str = ""
    receiver: str = ""
    identifier: int | None = None
    extended: bool = False
    frames: int = 0
    chance: float = 1.0
    place: float | None = None
    start_ns: int = 0
    end_ns: int | None = None
    seed: int = 0


class ActiveDisturbance:
    """A disturbance and how often it has struck.

    Attributes:
        hits: tries to send that it destroyed.
    """

    def __init__(self, what: Disturbance) -> None:
        self.what = what
        self.hits = 0
        self._random = random.Random(what.seed)

    def strikes(self, t_ns: int, sender: str, identifier: int, extended: bool) -> bool:
        """Return whether the frame whose sending begins at ``t_ns`` is hit, and count it if so."""
        what = self.what
        if t_ns < what.start_ns or (what.end_ns is not None and t_ns >= what.end_ns):
            return False
        if what.frames and self.hits >= what.frames:
            return False
        if what.sender not in ("", sender):
            return False
        if what.identifier is not None and (
            (what.identifier, what.extended) != (identifier, extended)
        ):
            return False
        if what.chance < 1.0 and self._random.random() >= what.chance:
            return False
        self.hits += 1
        return True

    def place(self) -> float:
        """Return where in the frame it strikes, 0 to 1."""
        return self._random.random() if self.what.place is None else self.what.place


class Flood(NamedTuple):
    """A node that sends one frame over and over.

    ``record``: the frame, as RECORD bytes; ``period_ns``: from one to the next, 0 as fast as the bus
    takes them; ``start_ns`` and ``end_ns``: when, None without end.
    """

    record: bytes
    period_ns: int
    start_ns: int = 0
    end_ns: int | None = None
