"""The options of MQTT: what is understood, and what is refused in which words."""

from pathlib import Path

import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.telemetry.mqtt_address import (
    PASSWORD_VARIABLE,
    USER_VARIABLE,
    Address,
    parse_address,
)


def parse(text: str, vin: str | None = None, ca: str | None = None, **env: str) -> Address:
    return parse_address(text, vin, ca, env)


def test_addresses() -> None:
    plain = parse("mqtt://broker.local")
    assert (plain.host, plain.port, plain.tls) == ("broker.local", 1883, False)
    assert plain.root == "hev/HEVCANEMU00000001"
    assert parse("mqtts://broker.local").port == 8883
    assert parse("mqtt://[::1]:1884").describe() == "mqtt://[::1]:1884"
    own = parse("embedded:1999", vin="WVWZZZ1JZXW000001")
    assert (own.host, own.port, own.embedded) == ("127.0.0.1", 1999, True)
    assert own.root == "hev/WVWZZZ1JZXW000001"


def test_user_and_password_come_from_the_environment() -> None:
    address = parse("mqtt://a", **{USER_VARIABLE: "me", PASSWORD_VARIABLE: "secret"})
    assert (address.user, address.password) == ("me", "secret")
    assert "secret" not in address.describe()
    with pytest.raises(InputError, match=f"{PASSWORD_VARIABLE}: expected {USER_VARIABLE}"):
        parse("mqtt://a", **{PASSWORD_VARIABLE: "secret"})


BROKER = "expected mqtt://HOST[:PORT], mqtts://HOST[:PORT] or embedded[:PORT], got"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("localhost", f"--mqtt: {BROKER} 'localhost'; mqtt://localhost?"),
        ("", f"--mqtt: {BROKER} ''"),
        ("http://a", f"--mqtt: {BROKER} 'http://a'"),
        ("mqtt://a:b", f"--mqtt: {BROKER} 'mqtt://a:b'; "),
        ("mqtt://a:99999", f"--mqtt: {BROKER} 'mqtt://a:99999'; "),
        ("mqtt://a:0", "--mqtt: expected a port from 1 to 65535, got 0"),
        ("mqtt://a/topic", f"--mqtt: {BROKER} 'mqtt://a/topic'; nothing may follow the port"),
        ("mqtt://me:pw@a", f"--mqtt: {BROKER} a user in the address; put user and password into"),
        ("embedded:x", f"--mqtt: {BROKER} 'embedded:x'"),
    ],
)
def test_other_addresses_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(text)
    assert str(caught.value).startswith(message)
    assert "pw" not in str(caught.value).replace("password", "")


def test_bad_vins_and_certificates(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--vin: expected 17 capital letters"):
        parse("mqtt://a", vin="TOO/SHORT")
    with pytest.raises(InputError, match="--mqtt-ca: expected mqtts"):
        parse("mqtt://a", ca="ca.pem")
    with pytest.raises(InputError, match=r"got 'none\.pem'; no such file"):
        parse("mqtts://a", ca="none.pem")
    junk = tmp_path / "junk.pem"
    junk.write_text("no certificate")
    with pytest.raises(InputError, match="--mqtt-ca: expected a file of PEM certificates"):
        parse("mqtts://a", ca=str(junk)).tls_context()
