"""Where the broker is: ``mqtt://host[:port]``, ``mqtts://host[:port]`` or ``embedded[:port]``."""

from __future__ import annotations

import os
import re
import ssl
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit

import msgspec

from hev_can_emu.errors import InputError

EMBEDDED = "embedded"
DEFAULT_VIN = "HEVCANEMU00000001"
USER_VARIABLE, PASSWORD_VARIABLE = "HEV_CAN_EMU_MQTT_USER", "HEV_CAN_EMU_MQTT_PASSWORD"

_VIN = re.compile(r"[A-HJ-NPR-Z0-9]{17}")


class Address(msgspec.Struct, frozen=True, kw_only=True):
    """A broker and the car's name there.

    Attributes:
        host, port: of the broker.
        tls: whether the connection is encrypted; ``ca_file`` has the certificates to trust then, the
            system's if None.
        embedded: a broker of our own is started on loopback.
        user, password: None for none.
        vin: vehicle identification number, the second level of every topic.
    """

    host: str
    port: int
    tls: bool = False
    embedded: bool = False
    ca_file: str | None = None
    user: str | None = None
    password: str | None = None
    vin: str = DEFAULT_VIN

    @property
    def root(self) -> str:
        """First levels of every topic."""
        return f"hev/{self.vin}"

    def describe(self) -> str:
        """Return the address for people, without the password."""
        scheme = "mqtts" if self.tls else "mqtt"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{scheme}://{host}:{self.port}"

    def tls_context(self) -> ssl.SSLContext | None:
        """Return what checks the broker's certificate and name, None without TLS; raises InputError."""
        if not self.tls:
            return None
        try:
            return ssl.create_default_context(cafile=self.ca_file)
        except (OSError, ssl.SSLError) as error:
            raise _bad_ca(self.ca_file or "", str(error)) from error


def parse_address(
    text: str,
    vin: str | None = None,
    ca_file: str | None = None,
    environment: Mapping[str, str] | None = None,
) -> Address:
    """Read the options of the command line; user and password come from the environment.

    Raises:
        InputError: no address, no VIN, or no certificates.
    """
    variables = os.environ if environment is None else environment
    vin = DEFAULT_VIN if vin is None else vin
    if not _VIN.fullmatch(vin):
        raise InputError(
            "--vin", "17 capital letters and digits without I, O and Q", f"'{vin}'", "ISO 3779"
        )
    user = variables.get(USER_VARIABLE) or None
    password = variables.get(PASSWORD_VARIABLE) or None
    if password is not None and user is None:
        raise InputError(PASSWORD_VARIABLE, f"{USER_VARIABLE} beside it", "none")
    wanted = "mqtt://HOST[:PORT], mqtts://HOST[:PORT] or embedded[:PORT]"
    if text.partition(":")[0] == EMBEDDED and "/" not in text:
        if ca_file is not None:
            raise InputError("--mqtt-ca", "mqtts://...", text, "the embedded broker is on loopback")
        port_text = text.partition(":")[2] or "1883"
        if not (port_text.isascii() and port_text.isdigit() and 0 < int(port_text) < 65536):
            raise InputError("--mqtt", wanted, f"'{text}'")
        return Address(host="127.0.0.1", port=int(port_text), embedded=True, vin=vin)
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise InputError("--mqtt", wanted, f"'{text}'", str(error)) from error
    if parts.scheme not in ("mqtt", "mqtts") or not host:
        hint = f"mqtt://{text}?" if "//" not in text and text else ""
        raise InputError("--mqtt", wanted, f"'{text}'", hint)
    if parts.username is not None or parts.password is not None:
        hint = f"put user and password into {USER_VARIABLE} and {PASSWORD_VARIABLE}"
        raise InputError("--mqtt", wanted, "a user in the address", hint)
    if parts.path not in ("", "/") or parts.query or parts.fragment:
        raise InputError("--mqtt", wanted, f"'{text}'", "nothing may follow the port")
    tls = parts.scheme == "mqtts"
    if ca_file is not None:
        if not tls:
            raise InputError("--mqtt-ca", "mqtts://...", f"'{text}'")
        if not Path(ca_file).is_file():
            raise _bad_ca(ca_file, "no such file")
    if port == 0:
        raise InputError("--mqtt", "a port from 1 to 65535", "0")
    return Address(
        host=host,
        port=port or (8883 if tls else 1883),
        tls=tls,
        ca_file=ca_file,
        user=user,
        password=password,
        vin=vin,
    )


def _bad_ca(path: str, why: str) -> InputError:
    return InputError("--mqtt-ca", "a file of PEM certificates", f"'{path}'", why)
