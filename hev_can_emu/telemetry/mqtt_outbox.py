"""What waits for the broker: bounded, newest kept per topic, what is given up counted."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple


class Letter(NamedTuple):
    """One message to send; ``topic`` is whole; ``correlation`` answers an MQTT 5 request."""

    topic: str
    payload: bytes
    retain: bool = False
    correlation: bytes | None = None


class Outbox:
    """Two queues, used from one thread.

    Values keep their newest per topic, so their number is that of the topics.  Happenings (events, verdicts,
    answers) keep their order; past ``most`` the oldest is given up.

    Attributes:
        replaced: values that a newer one took the place of before they were sent.
        dropped: happenings given up.
    """

    def __init__(self, most: int = 512) -> None:
        self._most = most
        self._values: dict[str, Letter] = {}
        self._happenings: deque[Letter] = deque()
        self.replaced = 0
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._values) + len(self._happenings)

    def put_value(self, letter: Letter) -> None:
        """Let a value wait, in place of an older one of its topic."""
        if self._values.pop(letter.topic, None) is not None:
            self.replaced += 1
        self._values[letter.topic] = letter

    def put_happening(self, letter: Letter) -> None:
        """Let a happening wait, behind those before."""
        if len(self._happenings) >= self._most:
            self._happenings.popleft()
            self.dropped += 1
        self._happenings.append(letter)

    def take(self) -> Letter | None:
        """Return the next to send, happenings first; None of none."""
        if self._happenings:
            return self._happenings.popleft()
        if self._values:
            return self._values.pop(next(iter(self._values)))
        return None

    def give_back(self, letter: Letter, happening: bool) -> None:
        """Put back what could not be sent, unless there is newer."""
        if happening:
            self._happenings.appendleft(letter)
        elif letter.topic not in self._values:
            self._values[letter.topic] = letter
