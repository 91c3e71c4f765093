"""Any python-can interface as a bus of ours.

python-can blocks: it is opened in a worker thread, read by the loop's selector where its socket
allows (socketcan, udp_multicast) and by a thread of its own elsewhere, and written by a thread
from a bounded queue.  Its exceptions, and those of the drivers below it, become ours here and
nowhere else.
"""

from __future__ import annotations

import asyncio
import errno
import threading
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hev_can_emu.bus.echo import EchoFilter
from hev_can_emu.bus.port import RECORD, Bus
from hev_can_emu.bus.pythoncan_frames import error_number, flags_of, to_message, unfit
from hev_can_emu.bus.pythoncan_opening import Target, open_target
from hev_can_emu.errors import BusError
from hev_can_emu.messages.frame import REMOTE

if TYPE_CHECKING:
    import can

QUEUE_FRAMES = 8192  #: frames waiting to be sent (some 2 s of a full 500 kbit/s bus)
READS_PER_TURN = 256  #: frames read before the loop gets its turn
POLL_S = 0.2  #: how often a reading thread looks whether it should end
CLOSE_S = 2.0  #: on closing, queued frames get this long to leave
FULL_WAIT_S = 0.001  #: pause before a frame is tried again that the driver's full queue refused
FULL_TRIES = 500
FAILURES_MEAN_LOST = 16  #: that many sends failing in a row mean that the bus is gone

_SELECTABLE = ("socketcan", "udp_multicast")
_GONE = {errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.EBADF, errno.ENETUNREACH, errno.EPIPE}


class PythonCanBus(Bus):
    """A bus opened as ``can.Bus(interface=..., channel=..., **options)``.

    Args:
        now_ns: the clock that stamps received frames.
        interface: python-can's name of it, e.g. ``socketcan``.
        channel: e.g. ``vcan0``; '' leaves it to python-can.
        options: further arguments of ``can.Bus``, e.g. ``bitrate``.
        spec: how the user named it, for messages; made from interface and channel otherwise.
        queue_frames: frames that may wait to be sent; more are dropped and counted.
    """

    def __init__(
        self,
        now_ns: Callable[[], int],
        interface: str,
        channel: str = "",
        options: dict[str, Any] | None = None,
        *,
        spec: str = "",
        queue_frames: int = QUEUE_FRAMES,
    ) -> None:
        super().__init__(now_ns)
        self.interface = interface
        self.channel = channel
        self._spec = spec or (f"{interface}:{channel}" if channel else interface)
        self._options = dict(options or {})
        if interface == "socketcan":
            self._options.setdefault("fd", True)  # else FD frames are not even received
        elif interface == "udp_multicast":
            self._options.setdefault("hop_limit", 0)  # python-can's own 1 reaches the LAN
        # udp_multicast hands a sender its own frames; the others do not, so there nothing is filtered.
        self._echo = EchoFilter(now_ns) if interface == "udp_multicast" else None
        self._queue_limit = queue_frames
        self._queue: deque[bytes] = deque()
        self._queued = 0
        self._work = threading.Condition()
        self._stopping = False
        self._failures = 0  # of sends in a row
        self._unfit_told = False
        self._bus: can.BusABC | None = None
        self._reader: threading.Thread | None = None
        self._sender: threading.Thread | None = None
        self._fileno = -1

    def describe(self) -> str:
        """Return interface and channel."""
        return f"python-can {self._spec}"

    def join_hint(self) -> str:
        """Return the command that joins from another terminal; '' for ``virtual``."""
        if self.interface == "virtual":
            return ""
        if self.interface == "socketcan":
            return f"candump {self.channel}"
        hint = f"python -m can.logger -i {self.interface}"
        if self.channel:
            hint += f" -c {self.channel}"
        if self._options:
            hint += " --bus-kwargs " + " ".join(f"{k}={v}" for k, v in self._options.items())
        return hint

    # -- opening and closing --------------------------------------------------------------------

    async def _open(self) -> None:
        # Shielded: a cancelled opening still ends with a closed bus, not with a leaked one.
        target = Target(self.interface, self.channel, self._options, self._spec)
        opening = asyncio.ensure_future(
            asyncio.to_thread(open_target, target, self._notices.append)
        )
        try:
            self._bus = await asyncio.shield(opening)
        except asyncio.CancelledError:
            opening.add_done_callback(_shut_down_late)
            raise
        name = self._spec
        if not self._watch():
            self._reader = threading.Thread(
                target=self._read_loop, name=f"bus-read {name}", daemon=True
            )
            self._reader.start()
        self._sender = threading.Thread(
            target=self._send_loop, name=f"bus-send {name}", daemon=True
        )
        self._sender.start()

    def _watch(self) -> bool:
        """Have the loop read the bus; returns False where that is impossible."""
        if self.interface not in _SELECTABLE or self._bus is None:
            return False
        fileno = self._bus.fileno()
        try:
            asyncio.get_running_loop().add_reader(fileno, self._read_ready)
        except NotImplementedError:  # Windows' default loop
            return False
        self._fileno = fileno
        return True

    async def _close(self) -> None:
        if self._fileno >= 0:
            asyncio.get_running_loop().remove_reader(self._fileno)
            self._fileno = -1
        with self._work:
            self._stopping = True
            self._work.notify_all()
        await asyncio.to_thread(self._close_blocking)

    def _close_blocking(self) -> None:
        if self._sender is not None:
            self._sender.join(CLOSE_S)
        if self._reader is not None:
            self._reader.join(CLOSE_S)
        if self._bus is not None:
            try:
                self._bus.shutdown()
            except Exception as error:
                raise BusError(f"{self.describe()}: closing failed: {error}") from error
            finally:
                self._bus = None

    # -- receiving ------------------------------------------------------------------------------

    def _read_ready(self) -> None:
        """Read what is there; called by the loop when the bus's socket is readable."""
        for _ in range(READS_PER_TURN):
            if not self._read_one(0.0):
                return
        # The bus may hold frames that its socket no longer shows.
        asyncio.get_running_loop().call_soon(self._read_again)

    def _read_again(self) -> None:
        if self._fileno >= 0:
            self._read_ready()

    def _read_loop(self) -> None:
        while not self._stopping and self._lost is None:
            self._read_one(POLL_S)

    def _read_one(self, timeout: float) -> bool:
        """Read one frame; returns whether there was one."""
        assert self._bus is not None
        try:
            message = self._bus.recv(timeout)
        except Exception as error:  # noqa: BLE001 - whatever a driver raises ends the bus, see `lost`
            if not self._stopping:
                self._fail("receiving failed", error)
            return False
        if message is None:
            return False
        flags = flags_of(message)
        data = bytes(message.data)
        if self._echo is None or not self._echo.is_own(message.arbitration_id, flags, data):
            if flags & REMOTE:
                data = bytes(message.dlc)
            self._accept(message.arbitration_id, flags, data)
        return True

    def _fail(self, what: str, error: Exception) -> None:
        """Make ``error`` the reason why this bus is lost."""
        self._errors += 1
        lost = BusError(f"{self.describe()}: {what}: {error or type(error).__name__}")
        lost.__cause__ = error
        self._lose(lost)
        loop = self._loop
        if self._fileno >= 0 and loop is not None:
            # A broken socket stays readable: unwatched, it does not spin the loop.
            loop.call_soon_threadsafe(loop.remove_reader, self._fileno)

    # -- sending --------------------------------------------------------------------------------

    def _send(self, raw: bytes, count: int) -> None:
        with self._work:
            room = self._queue_limit - self._queued
            if count > room:
                self._dropped += count - room
                count = room
                raw = raw[: count * RECORD.size]
            if count:
                self._queue.append(raw)
                self._queued += count
                self._work.notify()

    def _send_loop(self) -> None:
        import can

        while True:
            with self._work:
                while not self._queue and not self._stopping:
                    self._work.wait()
                if not self._queue:
                    return
                raw = self._queue.popleft()
            for _, can_id, flags, length, _, data in RECORD.iter_unpack(raw):
                if self._lost is None:
                    self._send_one(can.Message, can_id, flags, data[:length])
                with self._work:
                    self._queued -= 1

    def _send_one(self, make: type[can.Message], can_id: int, flags: int, data: bytes) -> None:
        assert self._bus is not None
        if reason := unfit(self.interface, flags):
            self._errors += 1
            if not self._unfit_told:
                self._unfit_told = True
                self._notices.append(reason)
            return
        try:
            message = to_message(make, can_id, flags, data)
            if self._echo is not None:
                self._echo.expect(can_id, flags_of(message), bytes(message.data))
            self._send_patiently(message)
        except Exception as error:  # noqa: BLE001 - counted; many in a row, or a dead device, end the bus
            self._errors += 1
            self._failures += 1
            if error_number(error) in _GONE or self._failures >= FAILURES_MEAN_LOST:
                self._fail("sending failed", error)
            elif self._failures == 1:
                self._notices.append(f"{self.describe()}: frame {can_id:X} not sent: {error}")
        else:
            self._failures = 0
            self._sent += 1

    def _send_patiently(self, message: can.Message) -> None:
        """Send, trying again while the driver's own queue is full (ENOBUFS on a real CAN device)."""
        assert self._bus is not None
        for left in range(FULL_TRIES, -1, -1):
            try:
                return self._bus.send(message)
            except Exception as error:
                if error_number(error) != errno.ENOBUFS or not left or self._stopping:
                    raise
            with self._work:
                self._work.wait_for(lambda: self._stopping, FULL_WAIT_S)
        return None


def _shut_down_late(opening: asyncio.Future[can.BusABC]) -> None:
    """Close a bus whose opening was given up while it was under way."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result().shutdown()
