"""A bus in memory, for tests and scripts: what one endpoint sends, all others receive.

Delivery is immediate and in the order of sending; there is no bit time, arbitration or error.
"""

from __future__ import annotations

from collections.abc import Callable

from hev_can_emu.bus.port import RECORD, Bus
from hev_can_emu.messages.frame import SENT


class LoopbackHub:
    """The shared medium: endpoints join it while they are open."""

    def __init__(self, name: str = "loopback") -> None:
        self.name = name
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

    async def _close(self) -> None:
        self._hub.leave(self)

    def _send(self, raw: bytes, count: int) -> None:
        self._sent += count
        self._hub.carry(self, raw)
