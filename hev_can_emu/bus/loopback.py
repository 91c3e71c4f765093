"""A bus in memory, for tests and scripts: what one endpoint sends, all others receive.

Delivery is immediate and in the order of sending; with a bit rate it is as a CAN bus has it (see
:mod:`hev_can_emu.bus.wire`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from hev_can_emu.bus.port import RECORD, Bus, make_medium
from hev_can_emu.bus.wire_parts import Timing
from hev_can_emu.messages.frame import SENT

if TYPE_CHECKING:
    from hev_can_emu.bus.medium import Port


class LoopbackHub:
    """The shared medium: endpoints join it while they are open.

    Args:
        name: for people.
        timing: bit rates; None for delivery at once.
        now_ns: the clock of a bus with bit rates, ns.
    """

    def __init__(
        self,
        name: str = "loopback",
        timing: Timing | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.name = name
        self.timing = timing
        self.medium = make_medium(timing, now_ns)
        self._endpoints: list[LoopbackBus] = []

    def endpoint(self, now_ns: Callable[[], int]) -> LoopbackBus:
        """Return a new bus on this medium; it takes part while it is open."""
        return LoopbackBus(self, now_ns)

    def join(self, endpoint: LoopbackBus) -> None:
        """Let ``endpoint`` receive."""
        self._endpoints.append(endpoint)

    def leave(self, endpoint: LoopbackBus) -> None:
        """Stop ``endpoint`` from receiving."""
        self._endpoints.remove(endpoint)

    def carry(self, sender: LoopbackBus, raw: bytes) -> None:
        """Hand the frames in ``raw`` to every endpoint but ``sender``."""
        for _, can_id, flags, length, channel, data in RECORD.iter_unpack(raw):
            for endpoint in self._endpoints:
                if endpoint is not sender:
                    endpoint.receive(can_id, flags & ~SENT, data[:length], channel)


class LoopbackBus(Bus):
    """One endpoint of a :class:`LoopbackHub`."""

    def __init__(self, hub: LoopbackHub, now_ns: Callable[[], int]) -> None:
        super().__init__(now_ns)
        self._hub = hub
        self.medium = hub.medium
        self._port: Port | None = None

    def describe(self) -> str:
        """Return the medium's name."""
        return f"in-memory bus '{self._hub.name}'"

    def join_hint(self) -> str:
        """Return '': nothing outside this process can join."""
        return ""

    def receive(self, can_id: int, flags: int, data: bytes, channel: int) -> None:
        """Take one frame from the medium."""
        self._accept(can_id, flags, data, channel)

    async def _open(self) -> None:
        self._hub.join(self)
        if self.medium is not None:
            self._port = self._join(self.medium, self.describe())

    async def _close(self) -> None:
        self._hub.leave(self)
        if self._port is not None:
            self._leave(self._port)

    def _send(self, raw: bytes, count: int) -> None:
        self._sent += count
        if self._port is None or self.medium is None:
            self._hub.carry(self, raw)
        else:
            self._port.send(raw)
            self.medium.pump_in_time()
