"""A real mosquitto on a free port of loopback, and clients that are none of this package's."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import paho.mqtt.client as paho
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

LIMIT_S = 30.0


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


class Mosquitto:
    """The broker; may be killed and started again on its port."""

    def __init__(self, folder: Path, port: int, *lines: str) -> None:
        found = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin")
        assert found, "tests need mosquitto (Debian: mosquitto, mosquitto-clients)"
        self.port = port
        self._config = folder / "mosquitto.conf"
        head = lines or ("allow_anonymous true",)
        self._config.write_text("\n".join((f"listener {port} 127.0.0.1", *head, "user root", "")))
        self._command = [found, "-c", str(self._config)]
        self._log = folder / "mosquitto.log"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(self._command, stdout=log, stderr=log)
        deadline = time.monotonic() + LIMIT_S
        while time.monotonic() < deadline:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1.0).close()
                return
            except OSError:
                assert self._process.poll() is None, self._log.read_text()
                time.sleep(0.01)
        raise AssertionError("mosquitto does not serve")

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


@contextmanager
def mosquitto(folder: Path, *lines: str) -> Iterator[Mosquitto]:
    broker = Mosquitto(folder, free_port(), *lines)
    broker.start()
    try:
        yield broker
    finally:
        broker.kill()


class Heard(NamedTuple):
    topic: str
    body: Any
    retain: bool
    correlation: bytes | None


class Listener:
    """Hears everything below ``hev/``, and may ask for things."""

    def __init__(self, port: int, version: int = paho.MQTTv5) -> None:
        self.heard: list[Heard] = []
        self._changed = threading.Condition()
        self._version = version
        ready = threading.Event()
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2, protocol=version)
        self._client.on_connect = lambda *_: self._client.subscribe([("hev/#", 1), ("mine/#", 1)])
        self._client.on_subscribe = lambda *_: ready.set()
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        assert ready.wait(LIMIT_S)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()

    def _on_message(self, _client: object, _userdata: object, message: paho.MQTTMessage) -> None:
        correlation = getattr(message.properties, "CorrelationData", None)
        body = json.loads(message.payload) if message.payload else None
        with self._changed:
            self.heard.append(Heard(message.topic, body, message.retain, correlation))
            self._changed.notify_all()

    def until(self, topic: str, wanted: Callable[[Any], bool] = lambda _: True) -> Heard:
        """Return the first message of a topic (below ``hev/VIN/``, or whole) that is as wanted."""
        deadline = time.monotonic() + LIMIT_S
        at = 0
        with self._changed:
            while True:
                for each in self.heard[at:]:
                    if each.topic.endswith(topic) and wanted(each.body):
                        return each
                at = len(self.heard)
                left = deadline - time.monotonic()
                last = [each for each in self.heard if each.topic.endswith(topic)][-3:]
                assert left > 0.0, f"{topic} never came so; last: {last}"
                self._changed.wait(left)

    def ask(
        self,
        vin: str,
        verb: str,
        body: object,
        reply_to: str | None = None,
        correlation: bytes | None = None,
        retain: bool = False,
    ) -> None:
        properties = None
        if self._version == paho.MQTTv5:
            properties = Properties(PacketTypes.PUBLISH)
            if reply_to is not None:
                properties.ResponseTopic = reply_to
            if correlation is not None:
                properties.CorrelationData = correlation
        payload = body if isinstance(body, bytes) else json.dumps(body).encode()
        self._client.publish(f"hev/{vin}/command/{verb}", payload, 1, retain, properties)


@contextmanager
def listener(port: int, version: int = paho.MQTTv5) -> Iterator[Listener]:
    joined = Listener(port, version)
    try:
        yield joined
    finally:
        joined.close()
