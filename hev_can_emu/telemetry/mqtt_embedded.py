"""A broker for whoever has none: amqtt (extra ``mqtt-embedded``) on loopback, for one run."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import AsyncIterator

from hev_can_emu.errors import StateError
from hev_can_emu.telemetry.mqtt_address import Address


@contextlib.asynccontextmanager
async def embedded_broker(address: Address) -> AsyncIterator[None]:
    """Serve MQTT 3.1.1 at the address, without a password; raises StateError if the port is taken."""
    from amqtt.broker import Broker
    from amqtt.errors import BrokerError

    for name in ("amqtt", "transitions"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    broker = Broker(
        {
            "listeners": {"default": {"type": "tcp", "bind": f"{address.host}:{address.port}"}},
            "plugins": {
                "amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}
            },
        }
    )
    try:
        await broker.start()
    except (BrokerError, OSError) as error:
        raise StateError(
            f"--mqtt embedded: {address.host}:{address.port} cannot be served ({error.__cause__ or error})"
        ) from error
    try:
        yield
    finally:
        with contextlib.suppress(BrokerError):
            await broker.shutdown()
