"""The car in a test: set signals, let time pass, wait for conditions, look at bus and truth.

Time is virtual and belongs to the test.  A controller in the same process is stepped with the car;
controllers in other processes can be, too, over the embedded server (:class:`Testbench` only).
"""

from __future__ import annotations

import asyncio
from types import TracebackType
from typing import Any, Self

from hev_can_emu.bus.open import open_lockstep_bus
from hev_can_emu.errors import InputError, NotMet, StateError
from hev_can_emu.runtime.lockstep import Lockstep
from hev_can_emu.runtime.setup import Setup
from hev_can_emu.runtime.testbench_core import (
    BenchCore,
    FrameController,
    SignalController,
    Snapshot,
    Value,
)
from hev_can_emu.runtime.tick import TICK_NS

__all__ = [
    "FrameController",
    "InputError",
    "NotMet",
    "SignalController",
    "Snapshot",
    "StateError",
    "SyncTestbench",
    "Testbench",
]


class SyncTestbench(BenchCore):
    """A car in a test, for ``with`` blocks.

    Args:
        setup: the car; or give its fields by name (``model="4dof"``).  The controller's and the driver's
            nodes (HCU, VEH) are played by the bench unless said otherwise.
        controller: stepped with the car, see :class:`SignalController` and :class:`FrameController`.
        period: how often it is.
        seed: of faults' random numbers.
        record: files of what is on the bus, see docs/recordings.md.

    Raises:
        InputError: a file or choice cannot be used.
    """

    def __enter__(self) -> Self:
        self._start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    def advance(self, duration: Value) -> None:
        """Let time pass: seconds, or text with a unit (``"20 ms"``), in whole ticks."""
        self._run(self._instant(duration))

    def until(self, condition: str, within: Value = "10 s") -> float:
        """Let time pass until a condition of the scenario language holds.

        Returns:
            how long that took, s.

        Raises:
            NotMet: it has not come in time (an AssertionError); tells what was seen.
            InputError: no such condition.
        """
        question = self._asker.condition(condition)
        start, limit = self.emulator.now_ns, self._instant(within)
        while not question.holds(start):
            if self.emulator.now_ns >= limit:
                raise self._missed(condition, within, start)
            self._run(self.emulator.now_ns + TICK_NS)
        return (self.emulator.now_ns - start) * 1e-9

    def _run(self, until_ns: int) -> None:
        while self.emulator.now_ns < until_ns:
            stop = self._control(until_ns)
            received = self._take_given()
            sent = self.emulator.advance(stop, received, len(received))
            self._note(received, sent)


class Testbench(BenchCore):
    """A car in a test, for ``async with`` blocks; see :class:`SyncTestbench` for what else it takes.

    Args:
        partners: controllers in other processes that time waits for, over the embedded server.
        bus: where it listens, ``socketcand[:HOST[:PORT]]``; by default on any free port.
        patience_s: how long a partner may take for a step, in wall time.

    Attributes:
        port: of the server, where there are partners.
    """

    __test__ = False  # no test class, whatever it is called

    def __init__(
        self,
        setup: Setup | None = None,
        *,
        partners: int = 0,
        bus: str = "socketcand:127.0.0.1:0",
        patience_s: float = 10.0,
        **more: Any,
    ) -> None:
        if partners:
            more["nodes"] = {"HCU": "external"} | dict(more.get("nodes", {}))
        super().__init__(setup, **more)
        self.port = 0
        self._bus = None
        if partners:
            self._bus = open_lockstep_bus(bus, lambda: self.emulator.now_ns, partners, patience_s)
            self._lockstep = Lockstep(self.emulator, lambda: self.emulator.now_ns, self._bus)

    async def __aenter__(self) -> Self:
        self._start()
        if self._bus is not None:
            await self._bus.__aenter__()
            self.port = self._bus.port
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bus is not None:
            await self._bus.__aexit__(kind, error, trace)
        self._end()

    async def advance(self, duration: Value) -> None:
        """Let time pass: seconds, or text with a unit (``"20 ms"``), in whole ticks.

        Raises:
            BusError: a partner has left, or has not answered in time.
        """
        await self._run(self._instant(duration))

    async def until(self, condition: str, within: Value = "10 s") -> float:
        """Let time pass until a condition holds; see :meth:`SyncTestbench.until`."""
        question = self._asker.condition(condition)
        start, limit = self.emulator.now_ns, self._instant(within)
        while not question.holds(start):
            if self.emulator.now_ns >= limit:
                raise self._missed(condition, within, start)
            await self._run(self.emulator.now_ns + TICK_NS)
        return (self.emulator.now_ns - start) * 1e-9

    async def _run(self, until_ns: int) -> None:
        while self.emulator.now_ns < until_ns:
            stop = self._control(until_ns)
            given = self._take_given()
            if self._bus is None:
                sent = self.emulator.advance(stop, given, len(given))
                received = given
            else:
                received, sent = await self._lockstep.step(stop, given)
            self._note(received, sent)
        await asyncio.sleep(0)
