"""The wall clock's grid: absolute deadlines from a kernel timer on the asyncio loop.

epoll rounds its own time-outs up to whole milliseconds, so a loop's ``call_at`` misses a 1 ms grid; a
timerfd, being a file, does not.  ``os.timerfd_create`` came with Python 3.13: before, the C library is
called.  Where there is no timerfd, ``call_at`` is the best there is.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import sys
import time
from collections.abc import Callable

_CLOCK_MONOTONIC = 1
_NONBLOCK, _CLOEXEC = 0o4000, 0o2000000
_ABSTIME = 1


class _Spec(ctypes.Structure):
    """struct itimerspec: interval, then first expiry; each seconds and nanoseconds."""

    _fields_ = (
        ("interval_s", ctypes.c_long),
        ("interval_ns", ctypes.c_long),
        ("value_s", ctypes.c_long),
        ("value_ns", ctypes.c_long),
    )


class Grid:
    """Calls ``due()`` as soon as possible after each deadline ``start_ns + k * period_ns``.

    Expiries that come together (a busy loop) are one call: the callback looks at the clock itself.

    Args:
        start_ns: of the monotonic clock.
        period_ns: distance of the deadlines.
        due: called on the loop.
    """

    def __init__(self, start_ns: int, period_ns: int, due: Callable[[], None]) -> None:
        self._start_ns = start_ns
        self._period_ns = period_ns
        self._due = due
        self._loop = asyncio.get_running_loop()
        self._fd = -1
        self._handle: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Arm the timer."""
        self._fd = _timer_fd(self._start_ns, self._period_ns)
        if self._fd >= 0:
            self._loop.add_reader(self._fd, self._expired)
        else:
            self._schedule()

    def stop(self) -> None:
        """Disarm it; idempotent."""
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _expired(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.read(self._fd, 8)
        self._due()

    def _schedule(self) -> None:
        passed = time.monotonic_ns() - self._start_ns
        following = self._start_ns + (passed // self._period_ns + 1) * self._period_ns
        self._handle = self._loop.call_at(following * 1e-9, self._fallback)

    def _fallback(self) -> None:
        self._schedule()
        self._due()


def _timer_fd(start_ns: int, period_ns: int) -> int:
    """Return an armed timerfd, or -1 where the system has none."""
    if not sys.platform.startswith("linux"):
        return -1
    library = ctypes.CDLL(None, use_errno=True)
    try:
        fd = int(library.timerfd_create(_CLOCK_MONOTONIC, _NONBLOCK | _CLOEXEC))
    except AttributeError:
        return -1
    if fd < 0:
        return -1
    spec = _Spec(*divmod(period_ns, 1_000_000_000), *divmod(start_ns, 1_000_000_000))
    if library.timerfd_settime(fd, _ABSTIME, ctypes.byref(spec), None) != 0:
        os.close(fd)
        return -1
    return fd
