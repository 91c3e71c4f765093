"""Networks read before: the parser of DBC files takes half a second that most runs need not spend.

What was read is kept in the user's cache folder, under a hash of the file's bytes beside one of the code that
reads it; a folder that cannot be written, or an entry that cannot be read, costs that time and nothing else.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Collection
from pathlib import Path

import msgspec

from hev_can_emu.jit import cache_folder
from hev_can_emu.kept_file import keep, read_kept
from hev_can_emu.messages.database import Database, load_database
from hev_can_emu.messages.definitions import MessageDef

_KEPT = 50  #: networks kept per version of the code


class _Entry(msgspec.Struct, frozen=True):
    nodes: tuple[str, ...]
    messages: tuple[MessageDef, ...]


def cached_database(path: Path, leave_out: Collection[str] = ()) -> Database:
    """Return what :func:`load_database` returns, from the cache where it is there; raises as it does."""
    try:
        raw = path.read_bytes()
    except OSError:
        return load_database(path, leave_out)
    key = hashlib.sha256(repr(sorted(leave_out)).encode() + raw).hexdigest()[:32]
    entry = cache_folder("messages.dbc_reader") / f"{key}.network"
    content = read_kept(entry)
    if content is not None:
        with contextlib.suppress(msgspec.MsgspecError):
            found = msgspec.msgpack.decode(content, type=_Entry)
            return Database(path=path, nodes=found.nodes, messages=found.messages)
    database = load_database(path, leave_out)
    keep(
        entry, msgspec.msgpack.encode(_Entry(database.nodes, database.messages)), "*.network", _KEPT
    )
    return database
