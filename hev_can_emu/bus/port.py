"""The port that every bus adapter fills: frames in, frames out, never waiting.

The tick calls :meth:`Bus.drain` and :meth:`Bus.send` once a millisecond; neither may block.  What
takes time (sockets, drivers, other threads) happens in the adapter, which puts what it receives
into an inbox and takes what it sends from a queue of its own.
"""

from __future__ import annotations

import asyncio
import struct
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from hev_can_emu.errors import BusError, StateError
from hev_can_emu.messages.frame import FRAME, SENT

if TYPE_CHECKING:
    from hev_can_emu.bus.medium import Medium, Port
    from hev_can_emu.bus.wire_parts import Timing, WireEvent

RECORD = struct.Struct("=qIBBH64s")
"""One frame of :data:`~hev_can_emu.messages.frame.FRAME` as bytes: t_ns, id, flags, length, channel, data.

Unpacking a buffer's bytes with it costs a fraction of reading the array field by field.
"""

_STAMP = struct.Struct("=q")
_FLAGS_AT = struct.calcsize("=qI")

INBOX_FRAMES = (
    65_536  #: received frames kept for a reader that does not drain; later ones are dropped
)
NOTICES = 256  #: messages for people kept until taken; the oldest give way

if FRAME.itemsize != RECORD.size:  # pragma: no cover - guards edits of the frame record
    raise AssertionError("RECORD must describe FRAME")


class Counters(NamedTuple):
    """Frames since the bus was opened.

    ``sent``: handed to the medium.  ``received``: taken from it.  ``dropped``: lost here, because a
    queue was full.  ``errors``: refused by the medium, the driver or the protocol.
    """

    sent: int
    received: int
    dropped: int
    errors: int


class Bus(ABC):
    """One CAN bus, opened once by ``async with`` and used from one asyncio loop.

    Args:
        now_ns: the clock that stamps received frames, in ns.

    One reader per bus: :meth:`drain` hands every frame out once.  A bus never hands out its own
    frames, and never mistakes another program's for its own.
    """

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._inbox: deque[bytes] = deque()
        self._sent = 0
        self._received = 0
        self._dropped = 0
        self._errors = 0
        self._lost: BusError | None = None
        self._notices: deque[str] = deque(maxlen=NOTICES)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._entered = False
        self._arrived = asyncio.Event()
        self._waiting = False
        self.medium: Medium | None = None  #: where the bus has bit times, what carries its frames
        self._played: Mapping[tuple[int, bool], str] = {}

    # -- what adapters fill in ------------------------------------------------------------------

    @abstractmethod
    def describe(self) -> str:
        """Return what this bus is, for one line of text."""

    @abstractmethod
    def join_hint(self) -> str:
        """Return the command by which another terminal can join, or '' where none can."""

    @abstractmethod
    async def _open(self) -> None:
        """Open the medium; raises InputError or BusError and leaves nothing open then."""

    @abstractmethod
    async def _close(self) -> None:
        """Close the medium, having sent what is queued where that is possible."""

    @abstractmethod
    def _send(self, raw: bytes, count: int) -> None:
        """Queue ``count`` frames, given as consecutive ``RECORD`` bytes."""

    # -- what the service uses ------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        """Open the bus; raises InputError (cannot be opened as asked) or BusError."""
        if self._entered:
            raise StateError(f"{self.describe()} was opened before; make another bus")
        self._entered = True
        self._loop = asyncio.get_running_loop()
        try:
            await self._open()
        except BaseException:
            self._loop = None
            raise
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self._close()
        self._loop = None

    def drain(self, frames: np.ndarray, capacity: int) -> int:
        """Move received frames, oldest first, into ``frames[:capacity]`` and return how many.

        Never waits.  ``t_ns`` is the time of receipt.  Raises BusError once the bus is lost and
        everything received before has been handed out.
        """
        if self.medium is not None:
            self.medium.pump()
        inbox = self._inbox
        if not inbox:
            if self._lost is not None:
                raise self._lost
            return 0
        count = min(len(inbox), capacity, len(frames))
        take = inbox.popleft
        frames[:count] = np.frombuffer(b"".join([take() for _ in range(count)]), dtype=FRAME)
        return count

    def send(self, frames: np.ndarray, count: int) -> None:
        """Queue ``frames[:count]`` for sending, in that order.  Never waits; copies.

        A full queue drops the newest frames and counts them.  Raises BusError if the bus is lost,
        StateError if it is not open.
        """
        if self._lost is not None:
            raise self._lost
        if self._loop is None:
            raise StateError(f"{self.describe()} is not open")
        if count > 0:
            self._send(frames[:count].tobytes(), count)

    async def wait(self) -> None:
        """Return as soon as at least one received frame can be drained, or the bus is lost."""
        self._waiting = True
        try:
            while not self._inbox and self._lost is None:
                self._arrived.clear()
                # Looked at again after clearing: a reader thread may have come in between.
                if not self._inbox and self._lost is None:
                    await self._arrived.wait()
        finally:
            self._waiting = False

    @property
    def counters(self) -> Counters:
        """The frames counted since the bus was opened."""
        return Counters(self._sent, self._received, self._dropped, self._errors)

    @property
    def lost(self) -> BusError | None:
        """Why the bus went away while open, or None."""
        return self._lost

    def take_notices(self) -> list[str]:
        """Return, and forget, the messages for people: who joined, left, or was refused."""
        taken = []
        while self._notices:
            taken.append(self._notices.popleft())
        return taken

    def play(self, senders: Mapping[tuple[int, bool], str]) -> None:
        """Say, before opening, which control unit sends which identifier (and whether it is extended).

        On a bus with bit times each unit is then a node of its own, and what they send comes back from
        :meth:`drain`, marked SENT, once it has been carried.  Other buses take no notice.
        """
        self._played = senders

    # -- for adapters ---------------------------------------------------------------------------

    def _join(self, medium: Medium, name: str) -> Port:
        """Return a port of ``medium`` that fills the inbox."""
        port = medium.join(name, self._take_carried)
        if self._played:
            port.play(self._played)
        medium.listeners.append(self._note_state)
        return port

    def _leave(self, port: Port) -> None:
        assert self.medium is not None
        port.leave()
        self.medium.listeners.remove(self._note_state)
        if not self.medium.ports:
            self.medium.stop()

    def _note_state(self, event: WireEvent) -> None:
        self._notices.append(event.describe())

    def _take_carried(self, record: bytes, t_ns: int) -> None:
        """Put a frame that the medium carried into the inbox, stamped when it had."""
        assert self.medium is not None
        if len(self._inbox) >= INBOX_FRAMES:
            self._dropped += 1
            return
        if not record[_FLAGS_AT] & SENT:
            self._received += 1
        # The bus's clock and the medium's tick alike but start apart.
        stamp = t_ns + self._now_ns() - self.medium.now_ns()
        self._inbox.append(_STAMP.pack(stamp) + record[_STAMP.size :])
        if self._waiting:
            self._wake()

    def _accept(self, can_id: int, flags: int, data: bytes, channel: int = 0) -> None:
        """Put one received frame into the inbox, stamped now.  Any thread may call this."""
        if len(self._inbox) >= INBOX_FRAMES:
            self._dropped += 1
            return
        self._received += 1
        self._inbox.append(RECORD.pack(self._now_ns(), can_id, flags, len(data), channel, data))
        if self._waiting:
            self._wake()

    def _lose(self, error: BusError) -> None:
        """Mark the bus as lost; the first reason stays.  Any thread may call this."""
        if self._lost is None:
            self._lost = error
            self._wake()

    def _wake(self) -> None:
        loop = self._loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self._arrived.set)


def make_medium(timing: Timing | None, now_ns: Callable[[], int]) -> Medium | None:
    """Return a medium with these bit rates and clock, or None for none."""
    if timing is None:
        return None
    from hev_can_emu.bus.medium import Medium  # imports the compiler: only where it is used

    return Medium(timing, now_ns)
