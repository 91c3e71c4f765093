"""The connection to an MQTT broker, in a thread and on a loop of its own.

A broker may be away, slow or silent, a name may take seconds to resolve, a handshake may hang: nothing of
that reaches the tick's loop, which only leaves things here (:meth:`Link.offer`, :meth:`Link.happen`,
:meth:`Link.answer`) and picks requests up.  The thread and its helpers are daemons: a process never waits
for a broker to end.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError, StateError
from hev_can_emu.telemetry.mqtt_address import Address
from hev_can_emu.telemetry.mqtt_feed import Feed
from hev_can_emu.telemetry.mqtt_outbox import Letter, Outbox

if TYPE_CHECKING:
    import aiomqtt

FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 15.0  #: between attempts to connect, doubling
GRACE_S = 0.4  #: for the last messages and the word of leaving, s
CALL_S = 5.0  #: after this time without an answer the broker counts as lost, s
KEEPALIVE_S = 15
MOST_REQUESTS = 32  #: waiting for the car; more are refused
LARGEST_REQUEST = 1 << 18  #: bytes

_LOGGER = logging.getLogger("hev_can_emu.mqtt")
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.propagate = False


class Request(NamedTuple):
    """A command as it came: ``verb`` is the topic below ``command/``; where and how to answer."""

    verb: str
    body: bytes
    reply_to: str
    correlation: bytes | None


class Counters(NamedTuple):
    """Messages sent; values replaced by newer ones; happenings and requests given up; connections."""

    sent: int
    replaced: int
    dropped: int
    refused: int
    connections: int


class Link:
    """Publishes what it is given and collects requests, whatever the broker does.

    Args:
        address: of the broker.
        feed: decides what is told of a snapshot.
        status: fields of the retained status while online.
        commands: whether requests are taken.
    """

    def __init__(
        self, address: Address, feed: Feed, status: dict[str, Any], commands: bool = False
    ) -> None:
        self._address = address
        self._feed = feed
        self._status = status
        self._commands = commands
        self._context = address.tls_context()
        self._outbox = Outbox()
        self._slot: tuple[npt.NDArray[np.float64], int, int] | None = None
        self._given: deque[Letter] = deque()
        self._requests: deque[Request] = deque()
        self._notices: deque[str] = deque(maxlen=64)
        self._sent = self._refused = self._connections = 0
        self._told_lost = self._online = False
        self._stopping = False
        self._protocol = 4 if address.embedded else 5
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mqtt", daemon=True)
        self._session: asyncio.Task[None] | None = None
        self._failure: BaseException | None = None

    # From the tick's side

    def start(self) -> None:
        """Begin; raises StateError where an embedded broker cannot be started."""
        self._thread.start()
        self._ready.wait(10.0)
        if self._failure is not None:
            raise StateError(str(self._failure)) from self._failure

    def offer(self, statuses: npt.NDArray[np.float64], t_ns: int, unix_ns: int) -> None:
        """Leave a snapshot of the statuses (SI, not changed afterwards) with the car's time and the date."""
        pending = self._slot is not None
        self._slot = (statuses, t_ns, unix_ns)
        if not pending:
            self._call(self._take_snapshot)

    def happen(self, topic: str, payload: object, retain: bool = False) -> None:
        """Leave something that happened; ``topic`` is below the car's own, ``payload`` becomes JSON."""
        letter = Letter(f"{self._address.root}/{topic}", msgspec.json.encode(payload), retain)
        self._given.append(letter)
        self._call(self._take_given)

    def answer(self, request: Request, payload: object) -> None:
        """Leave the answer to a request."""
        body = msgspec.json.encode(payload)
        self._given.append(Letter(request.reply_to, body, False, request.correlation))
        self._call(self._take_given)

    def take_requests(self) -> list[Request]:
        """Return what has been asked for since the last call."""
        out: list[Request] = []
        with contextlib.suppress(IndexError):
            while True:
                out.append(self._requests.popleft())
        return out

    def take_notices(self) -> list[str]:
        """Return what is to be said to people since the last call."""
        out: list[str] = []
        with contextlib.suppress(IndexError):
            while True:
                out.append(self._notices.popleft())
        return out

    @property
    def counters(self) -> Counters:
        """What went out and what did not."""
        outbox = self._outbox
        return Counters(
            self._sent, outbox.replaced, outbox.dropped, self._refused, self._connections
        )

    def stop(self, patience_s: float = 0.0) -> None:
        """Send what waits and the word of leaving if the broker takes it at once, then end.

        ``patience_s``: how long to wait for a connection that is being made, and for what waits, s.
        """
        if patience_s > 0.0:
            deadline = time.monotonic() + patience_s
            while (not self._online or len(self._outbox)) and time.monotonic() < deadline:
                if not self._thread.is_alive() or self._told_lost:
                    break
                time.sleep(0.01)
        self._stopping = True
        self._call(self._begin_to_stop)
        self._thread.join(2.0 * GRACE_S)

    def _call(self, function: Callable[[], None]) -> None:
        loop = self._loop
        if loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(function)

    # On the link's own loop

    def _run(self) -> None:
        try:
            asyncio.run(self._main())
        except Exception as error:  # noqa: BLE001 - told by start(), or as a notice
            self._failure = error
            self._notices.append(f"ended: {error}")
        finally:
            self._ready.set()

    async def _main(self) -> None:
        loop = asyncio.get_running_loop()
        loop.set_default_executor(_Daemons())
        # The library leaves futures of lost connections behind; whatever matters is awaited here.
        loop.set_exception_handler(lambda _, context: _LOGGER.debug("%s", context.get("message")))
        self._wake = asyncio.Event()
        self._stop = asyncio.Event()
        async with contextlib.AsyncExitStack() as stack:
            if self._address.embedded:
                from hev_can_emu.telemetry.mqtt_embedded import embedded_broker

                await stack.enter_async_context(embedded_broker(self._address))
            self._loop = loop
            self._ready.set()
            self._take_given()
            wait_s = FIRST_WAIT_S
            while not self._stopping:
                connected = self._connections
                self._session = asyncio.create_task(self._hold_session(), name="mqtt session")
                await asyncio.wait([self._session])
                if self._stopping:
                    break
                if self._connections > connected:
                    wait_s = FIRST_WAIT_S
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._stop.wait(), wait_s)
                wait_s = min(2.0 * wait_s, LONGEST_WAIT_S)

    def _begin_to_stop(self) -> None:
        self._stop.set()
        self._wake.set()
        session = self._session
        if session is not None:
            grace_s = GRACE_S if self._online else 0.0
            asyncio.get_running_loop().call_later(grace_s, session.cancel)

    def _take_snapshot(self) -> None:
        slot, self._slot = self._slot, None
        if slot is None:
            return
        root = self._address.root
        for topic, payload in self._feed.due(*slot, time.monotonic()):
            self._outbox.put_value(Letter(f"{root}/{topic}", payload))
        self._wake.set()

    def _take_given(self) -> None:
        with contextlib.suppress(IndexError):
            while True:
                self._outbox.put_happening(self._given.popleft())
        self._wake.set()

    async def _hold_session(self) -> None:
        """Connect and stay connected as long as it goes; tell the first failure in a row."""
        import aiomqtt

        try:
            async with self._client() as client:
                self._connections += 1
                self._told_lost, self._online = False, True
                self._notices.append(f"connected to {self._address.describe()}")
                await self._tell_status(client, "online")
                if self._commands:
                    await client.subscribe(f"{self._address.root}/command/#", qos=1)
                self._feed.forget()
                receiving = asyncio.create_task(self._receive(client), name="mqtt receive")
                try:
                    await self._send(client, receiving)
                    await self._tell_status(client, "offline")
                finally:
                    receiving.cancel()
        except aiomqtt.MqttError as error:
            self._lost(error)
        except (OSError, ValueError) as error:
            self._lost(error)
        finally:
            self._online = False

    def _lost(self, error: Exception) -> None:
        text = str(error) or type(error).__name__
        code = getattr(getattr(error, "rc", None), "value", getattr(error, "rc", None))
        if self._protocol == 5 and code in (1, 132):
            self._protocol = 4  # the broker does not speak MQTT 5
            return
        if not self._told_lost and not self._stopping:
            self._told_lost = True
            self._notices.append(f"no connection to {self._address.describe()}: {text}")

    def _client(self) -> aiomqtt.Client:
        import aiomqtt

        address = self._address
        will = aiomqtt.Will(
            f"{address.root}/status", msgspec.json.encode({"state": "offline"}), 1, True
        )
        return aiomqtt.Client(
            address.host,
            address.port,
            username=address.user,
            password=address.password,
            logger=_LOGGER,
            protocol=aiomqtt.ProtocolVersion(self._protocol),
            will=will,
            timeout=CALL_S,
            keepalive=KEEPALIVE_S,
            max_queued_incoming_messages=2 * MOST_REQUESTS,
            tls_context=self._context,
        )

    async def _tell_status(self, client: aiomqtt.Client, state: str) -> None:
        body = {"state": state} | (self._status if state == "online" else {})
        topic = f"{self._address.root}/status"
        await client.publish(topic, msgspec.json.encode(body), qos=1, retain=True)

    async def _send(self, client: aiomqtt.Client, receiving: asyncio.Task[None]) -> None:
        """Send what waits until told to stop; raises MqttError when the broker is lost."""
        while True:
            self._wake.clear()
            while (letter := self._outbox.take()) is not None:
                await self._send_one(client, letter)
            if self._stopping:
                return
            waiting = asyncio.create_task(self._wake.wait())
            await asyncio.wait([waiting, receiving], return_when=asyncio.FIRST_COMPLETED)
            waiting.cancel()
            if receiving.done():
                receiving.result()

    async def _send_one(self, client: aiomqtt.Client, letter: Letter) -> None:
        import aiomqtt

        happening = not letter.topic.startswith(f"{self._address.root}/Vehicle/")
        properties = None
        if letter.correlation is not None and self._protocol == 5:
            properties = _properties()
            properties.CorrelationData = letter.correlation
        try:
            await client.publish(
                letter.topic,
                letter.payload,
                qos=1 if happening else 0,
                retain=letter.retain,
                properties=properties,
            )
        except aiomqtt.MqttError:
            self._outbox.give_back(letter, happening)
            raise
        self._sent += 1

    async def _receive(self, client: aiomqtt.Client) -> None:
        prefix = f"{self._address.root}/command/"
        async for message in client.messages:
            topic = str(message.topic)
            verb = topic.removeprefix(prefix)
            reply_to = getattr(message.properties, "ResponseTopic", None)
            correlation = getattr(message.properties, "CorrelationData", None)
            if not isinstance(reply_to, str) or any(each in reply_to for each in "+#"):
                reply_to = f"{self._address.root}/response/{verb}"
            body = message.payload if isinstance(message.payload, bytes) else b""
            request = Request(verb, body, reply_to, correlation)
            if message.retain:
                problem = "commands must not be retained: each new connection would repeat them"
            elif len(body) > LARGEST_REQUEST:
                problem = f"expected at most {LARGEST_REQUEST} bytes, got {len(body)}"
            elif len(self._requests) >= MOST_REQUESTS:
                problem = f"more than {MOST_REQUESTS} commands wait"
            else:
                self._requests.append(request)
                continue
            self._refused += 1
            refusal = msgspec.json.encode({"ok": False, "error": problem})
            self._outbox.put_happening(Letter(reply_to, refusal, False, correlation))
            self._wake.set()


def _properties() -> Any:
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties

    make: Any = Properties
    return make(PacketTypes.PUBLISH)


class _Daemons(ThreadPoolExecutor):
    """Runs blocking calls (name look-up, connect, handshake) in threads that nothing waits for."""

    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run ``function`` in a daemon thread of its own."""
        future: Future[Any] = Future()

        def work() -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                future.set_result(function(*args, **kwargs))
            except BaseException as error:  # noqa: BLE001 - carried to whoever waits
                future.set_exception(error)

        threading.Thread(target=work, name="mqtt connect", daemon=True).start()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for nothing."""


def check_installed(embedded: bool) -> None:
    """Raise InputError where the libraries are missing."""
    import importlib.util

    for name, extra in (("aiomqtt", "mqtt"), ("amqtt", "mqtt-embedded")):
        if (embedded or name == "aiomqtt") and importlib.util.find_spec(name) is None:
            raise InputError(
                "--mqtt", f"the library {name}", "none", f"pip install 'hev-can-emu[{extra}]'"
            )
