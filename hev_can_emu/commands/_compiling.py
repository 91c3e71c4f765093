"""Tells how far the compilation of the kernels is, where any is needed."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from hev_can_emu.commands._live import LiveLine, bar

if TYPE_CHECKING:
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.runtime.setup import Setup

_EVERY_S = 10.0  # between lines, where there is no terminal


def ready_emulator(setup: Setup) -> Emulator:
    """Return an emulator whose kernels are compiled, telling of it if that takes long."""
    from hev_can_emu.runtime.emulator import Emulator

    with compiling():
        emulator = Emulator(setup)
        emulator.advance(0)
    return emulator


@contextlib.contextmanager
def compiling(quiet: bool = False) -> Iterator[Compilation]:
    """Show, on stderr, how many kernels have been compiled; nothing while none has to be."""
    from hev_can_emu.jit import before_compiling

    told = Compilation(quiet)

    def listen() -> None:
        from numba.core import event as untyped_event

        event: Any = untyped_event

        class Listener(untyped_event.Listener):
            def on_start(self, event: Any) -> None:
                told.begin()

            def on_end(self, event: Any) -> None:
                told.add(event.data["dispatcher"])

        if not told.ended:
            listener = Listener()
            event.register("numba:compile", listener)
            told.deaf = lambda: event.unregister("numba:compile", listener)

    before_compiling(listen)
    try:
        yield told
    finally:
        told.end()


class Compilation:
    """Counts compiled kernels and shows the count.

    Attributes:
        count: kernels compiled so far.
        ended: whether it counts no more.
        deaf: ends the listening, if there is any.
    """

    def __init__(self, quiet: bool) -> None:
        self.count = 0
        self.ended = False
        self.deaf: Callable[[], object] = lambda: None
        self._quiet = quiet
        self._line = LiveLine()
        self._started_s = time.monotonic()
        self._told_s = 0.0
        self._expected = 0

    def begin(self) -> None:
        """Take note that a kernel is not in the cache."""
        if self._expected:
            return
        self._started_s = self._told_s = time.monotonic()
        self._expected = max(_kernels_imported(), 1)
        if not self._quiet:
            self._line.say("compiling the kernels, once: takes a minute or two")

    def add(self, dispatcher: Any) -> None:
        """Count one compiled function, if it is a kernel and not a part of numba."""
        if not _is_kernel(dispatcher):
            return
        self.count += 1
        if self._quiet:
            return
        now_s = time.monotonic()
        # Some kernels are compiled for several types of arguments, so the end is not known exactly.
        share = min(self.count / self._expected, 0.99)
        text = f"{self.count} of about {self._expected} kernels, {now_s - self._started_s:.0f} s"
        self._line.show(f"{bar(share)} {text}")
        if not self._line.live and now_s - self._told_s >= _EVERY_S:
            self._told_s = now_s
            self._line.say(f"compiled {text}")

    def end(self) -> None:
        """Say how long it took."""
        self.ended = True
        self.deaf()
        if self._expected and not self._quiet:
            self._line.say(
                f"compiled {self.count} kernels in {time.monotonic() - self._started_s:.0f} s"
            )


def _is_kernel(dispatcher: Any) -> bool:
    function = getattr(dispatcher, "py_func", None)
    return str(getattr(function, "__module__", "")).startswith("hev_can_emu")


def _kernels_imported() -> int:
    modules = [module for name, module in sys.modules.items() if name.startswith("hev_can_emu")]
    found = {
        id(value) for module in modules for value in vars(module).values() if _is_kernel(value)
    }
    return len(found)
