"""The link beside real brokers: away, killed, silent, encrypted, embedded."""

import gc
import json
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import paho.mqtt.client as paho
import pytest
from broker_rig import LIMIT_S, Mosquitto, free_port, listener, mosquitto

from hev_can_emu.errors import StateError
from hev_can_emu.telemetry.mqtt_address import DEFAULT_VIN, Address, parse_address
from hev_can_emu.telemetry.mqtt_feed import Feed
from hev_can_emu.telemetry.mqtt_link import CALL_S, Link
from hev_can_emu.telemetry.vss import Leaf

LEAVES = [Leaf("Vehicle.Speed", "speed", "km/h"), Leaf("Vehicle.X", "x")]


@contextmanager
def link(address: Address, commands: bool = False) -> Iterator[Link]:
    feed = Feed(LEAVES, ["speed", "x"], 0.0, 1000.0)
    joined = Link(address, feed, {"version": "1"}, commands)
    joined.start()
    try:
        yield joined
    finally:
        joined.stop()


def eventually(true: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def offer(link: Link, speed: float) -> None:
    link.offer(np.array([speed, 1.0]), 0, 0)


def at(port: int) -> Address:
    return parse_address(f"mqtt://127.0.0.1:{port}", environment={})


def test_values_events_and_status_arrive_and_status_is_retained(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker:
        with listener(broker.port) as early, link(at(broker.port)) as it:
            assert early.until("/status").body == {"state": "online", "version": "1"}
            offer(it, 5.0)
            assert early.until("/Vehicle/Speed").body["value"] == 5.0
            it.happen("event/mode", {"text": "series"})
            assert early.until("/event/mode").body == {"text": "series"}
            with listener(broker.port) as late:
                status = late.until("/status")
                assert status.retain
                assert status.body["state"] == "online"
        with listener(broker.port) as after:
            assert after.until("/status").body == {"state": "offline"}


def test_a_broker_that_is_away_at_start_gets_the_newest_values_and_all_events(
    tmp_path: Path,
) -> None:
    port = free_port()
    with link(at(port)) as it:
        for speed in range(20):
            offer(it, float(speed))
            it.happen("event/mode", {"number": speed})
            eventually(lambda: it._slot is None)
        eventually(lambda: any("no connection" in each for each in it.take_notices()))
        assert it.counters.replaced >= 15  # of both signals only the newest waits
        broker = Mosquitto(tmp_path, port)
        broker.start()
        try:
            with listener(port) as ear:
                eventually(lambda: it.counters.connections == 1)
                it.happen("event/mode", {"number": 20})
                ear.until("/event/mode", lambda body: body["number"] == 20)
                numbers = [h.body["number"] for h in ear.heard if h.topic.endswith("/event/mode")]
                assert numbers == sorted(numbers)
                offer(it, 99.0)
                assert ear.until("/Vehicle/Speed", lambda b: b["value"] == 99.0)
        finally:
            broker.kill()


def test_a_broker_killed_again_and_again_is_found_again(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker, link(at(broker.port)) as it:
        for times in range(1, 4):
            eventually(lambda wanted=times: it.counters.connections == wanted)
            broker.kill()
            for speed in range(5):
                offer(it, 10.0 * times + speed)
            broker.start()
        eventually(lambda: it.counters.connections == 4)
        with listener(broker.port) as ear:
            offer(it, 77.0)
            ear.until("/Vehicle/Speed", lambda body: body["value"] == 77.0)
        notices = it.take_notices()
        assert sum(each.startswith("connected") for each in notices) == 4
        assert sum(each.startswith("no connection") for each in notices) == 3


@contextmanager
def silent(accepts: bool) -> Iterator[int]:
    """A port that never answers: it takes connections and says nothing, or does not even take them."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(8 if accepts else 0)
        port = server.getsockname()[1]
        filled = []
        if not accepts:
            for _ in range(4):
                plug = socket.socket()
                plug.setblocking(False)
                plug.connect_ex(("127.0.0.1", port))
                filled.append(plug)
        try:
            yield port
        finally:
            for plug in filled:
                plug.close()


# A process of its own: what it gives up it does not close.
STOP_AMID_CONNECTING = """
import sys, time
import numpy as np
from hev_can_emu.telemetry.mqtt_address import parse_address
from hev_can_emu.telemetry.mqtt_feed import Feed
from hev_can_emu.telemetry.mqtt_link import Link
link = Link(parse_address(sys.argv[1], environment={}), Feed([], [], 0.0, 1.0), {})
link.start()
time.sleep(0.5)
print(time.monotonic(), flush=True)
link.stop()
assert not link._thread.is_alive()
assert link.counters.connections == 0
"""


@pytest.mark.parametrize("accepts", [True, False])
@pytest.mark.parametrize("scheme", ["mqtt", "mqtts"])
def test_a_silent_broker_does_not_hold_up_the_end(accepts: bool, scheme: str) -> None:
    with silent(accepts) as port:
        done = subprocess.run(
            [sys.executable, "-c", STOP_AMID_CONNECTING, f"{scheme}://127.0.0.1:{port}"],
            capture_output=True, text=True, timeout=LIMIT_S, check=False,
        )  # fmt: skip
        took_s = time.monotonic() - float(done.stdout or 0.0)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert took_s < CALL_S  # what the library itself waits for


def test_more_events_than_fit_are_counted() -> None:
    with link(at(free_port())) as it:
        for number in range(600):
            it.happen("event/mode", {"number": number})
        eventually(lambda: it.counters.dropped == 600 - 512)


# paho leaves the sockets of a failed handshake to the collector, which may come at any time.
@pytest.mark.filterwarnings("ignore:unclosed <s:ResourceWarning")
def test_tls_and_password(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ca, key = tmp_path / "ca.pem", tmp_path / "key.pem"
    openssl = shutil.which("openssl")
    assert openssl, "tests need openssl"
    subprocess.run(
        [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2",
         "-keyout", str(key), "-out", str(ca), "-subj", "/CN=127.0.0.1",
         "-addext", "subjectAltName=IP:127.0.0.1"],
        check=True, capture_output=True,
    )  # fmt: skip
    users = tmp_path / "users"
    subprocess.run(["mosquitto_passwd", "-b", "-c", str(users), "me", "secret"], check=True)
    lines = (
        f"certfile {ca}",
        f"keyfile {key}",
        "allow_anonymous false",
        f"password_file {users}",
    )
    with mosquitto(tmp_path, *lines) as broker:
        text = f"mqtts://127.0.0.1:{broker.port}"
        right = {"HEV_CAN_EMU_MQTT_USER": "me", "HEV_CAN_EMU_MQTT_PASSWORD": "secret"}
        with link(parse_address(text, ca_file=str(ca), environment=right)) as it:
            eventually(lambda: it.counters.connections == 1)
        wrong = right | {"HEV_CAN_EMU_MQTT_PASSWORD": "guess"}
        with link(parse_address(text, ca_file=str(ca), environment=wrong)) as it:
            eventually(lambda: any("uthori" in each for each in it.take_notices()))
        # A certificate that nobody vouches for is refused.
        with link(parse_address(text, environment=right)) as it:
            eventually(lambda: any("certificate" in each for each in it.take_notices()))
            assert it.counters.connections == 0
    gc.collect()  # not in another test


def test_the_embedded_broker_serves_and_a_taken_port_is_told() -> None:
    port = free_port()
    address = parse_address(f"embedded:{port}", environment={})
    with link(address, commands=True) as it:
        eventually(lambda: it.counters.connections == 1)
        with listener(port, paho.MQTTv311) as ear:
            assert ear.until("/status").body["state"] == "online"
            offer(it, 3.0)
            ear.until("/Vehicle/Speed", lambda body: body["value"] == 3.0)
            ear.ask(DEFAULT_VIN, "input", {"id": 7})
            eventually(lambda: len(it._requests) == 1)
            (request,) = it.take_requests()
            it.answer(request, {"ok": True, "id": 7})
            assert ear.until("/response/input").body == {"ok": True, "id": 7}
        with pytest.raises(StateError, match=f"--mqtt embedded: 127.0.0.1:{port} cannot be served"):
            Link(address, Feed([], [], 0.0, 1.0), {}).start()


def test_requests_are_answered_where_they_say_with_their_correlation(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker, listener(broker.port) as ear:
        address = at(broker.port)
        with link(address, commands=True) as it:
            eventually(lambda: it.counters.connections == 1)
            ear.until("/status", lambda body: body["state"] == "online")
            ear.ask(DEFAULT_VIN, "fault/clear", {"name": "a"}, "mine/answers", b"\x01\x02")
            eventually(lambda: len(it._requests) == 1)
            (request,) = it.take_requests()
            assert request.verb == "fault/clear"
            assert json.loads(request.body) == {"name": "a"}
            it.answer(request, {"ok": True})
            answer = ear.until("mine/answers")
            assert (answer.body, answer.correlation) == ({"ok": True}, b"\x01\x02")
            for _ in range(40):
                ear.ask(DEFAULT_VIN, "input", {}, "mine/many")
            assert "commands wait" in ear.until("mine/many").body["error"]
            assert len(it.take_requests()) == 32


def test_a_retained_command_is_refused_or_each_connection_would_repeat_it(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker, listener(broker.port) as ear:
        ear.ask(DEFAULT_VIN, "input", {}, retain=True)
        ear.until("/command/input")
        with link(at(broker.port), commands=True) as it:
            refused = ear.until("/response/input").body
            assert refused["ok"] is False
            assert "must not be retained" in refused["error"]
            assert it.take_requests() == []


def test_without_leave_no_request_is_taken(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker, listener(broker.port) as ear, link(at(broker.port)) as it:
        eventually(lambda: it.counters.connections == 1)
        ear.ask(DEFAULT_VIN, "input", {"signal": "x", "value": 1})
        it.happen("event/mark", {})
        ear.until("/event/mark")
        assert it.take_requests() == []
