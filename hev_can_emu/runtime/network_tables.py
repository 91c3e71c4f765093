"""The tables by which kernels read a network, kept from run to run: to make them takes long."""

from __future__ import annotations

import msgspec

from hev_can_emu.config import Locate
from hev_can_emu.ecu.bindings import resolve
from hev_can_emu.ecu.bindings_file import Bindings
from hev_can_emu.ecu.ties import ResolvedBindings
from hev_can_emu.messages.codec_tables import Codec, build_codec
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.protection import Protection, build_protection
from hev_can_emu.messages.restbus import Restbus, build_restbus
from hev_can_emu.runtime.kept import kept

_CODE = __name__.partition(".")[2]


def network_tables(database: Database) -> tuple[Codec, Protection, Restbus]:
    """Return how the messages of a network are encoded, protected and sent."""

    def make() -> tuple[Codec, Protection, Restbus]:
        specs = [message.protection for message in database.messages]
        lengths = [message.length for message in database.messages]
        return build_codec(database), build_protection(specs, lengths), build_restbus(database)

    return kept(_CODE, "tables", msgspec.msgpack.encode(database.messages), make)


def network_ties(bindings: Bindings, database: Database, locate: Locate) -> ResolvedBindings:
    """Return what :func:`hev_can_emu.ecu.bindings.resolve` returns; raises as it does."""
    key = msgspec.msgpack.encode((bindings, database.nodes, database.messages))
    return kept(_CODE, "ties", key, lambda: resolve(bindings, database, locate))
