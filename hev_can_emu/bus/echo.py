"""Telling one's own frames, handed back by the medium, from equal frames of others.

python-can's udp_multicast delivers to a sender what it sent, unmarked.  Each frame sent is expected
back once; what comes back beyond that was sent by somebody else.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

EXPECTED_WITHIN_NS = 1_000_000_000  #: an echo later than this was lost
REMEMBERED = 16_384  #: kinds of frames expected back at most


class EchoFilter:
    """Frames sent and not yet heard back.  Thread-safe.

    Args:
        now_ns: the clock, in ns.
    """

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._expected: dict[
            tuple[int, int, bytes], tuple[int, int]
        ] = {}  # count, time of the last
        self._lock = threading.Lock()

    def expect(self, can_id: int, flags: int, data: bytes) -> None:
        """Note a frame just before it is sent."""
        key = (can_id, flags, data)
        now = self._now_ns()
        with self._lock:
            count, since = self._expected.pop(key, (0, now))
            if now - since > EXPECTED_WITHIN_NS:
                count = 0
            self._expected[key] = (count + 1, now)
            if len(self._expected) > REMEMBERED:
                del self._expected[next(iter(self._expected))]

    def is_own(self, can_id: int, flags: int, data: bytes) -> bool:
        """Return whether a received frame is an expected echo, and expect it no longer."""
        key = (can_id, flags, data)
        with self._lock:
            count, since = self._expected.pop(key, (0, 0))
            if not count or self._now_ns() - since > EXPECTED_WITHIN_NS:
                return False
            if count > 1:
                self._expected[key] = (count - 1, since)
            return True
