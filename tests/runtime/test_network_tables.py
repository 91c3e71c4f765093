"""The tables of a network are the same whether they are made or were kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hev_can_emu.ecu.bindings import resolve
from hev_can_emu.ecu.network import complete
from hev_can_emu.errors import InputError
from hev_can_emu.messages.codec_tables import build_codec
from hev_can_emu.messages.database import load_database
from hev_can_emu.messages.protection import build_protection
from hev_can_emu.messages.restbus import build_restbus
from hev_can_emu.resources import folder
from hev_can_emu.runtime import kept
from hev_can_emu.runtime.network_tables import network_tables, network_ties
from hev_can_emu.runtime.setup import Setup, network_files


def assert_same(found: Any, right: Any) -> None:
    assert type(found) is type(right)
    for name in right._fields:
        one, other = getattr(found, name), getattr(right, name)
        assert one.dtype == other.dtype, name
        np.testing.assert_array_equal(one, other, err_msg=name)


def test_kept_tables_are_those_that_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "cache_folder", lambda module: tmp_path)
    database = load_database(folder("dbc") / "hev.dbc")
    specs = [message.protection for message in database.messages]
    made = (
        build_codec(database),
        build_protection(specs, [message.length for message in database.messages]),
        build_restbus(database),
    )
    for _ in range(2):
        for found, right in zip(network_tables(database), made, strict=True):
            assert_same(found, right)


def test_kept_ties_are_those_that_are_resolved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "cache_folder", lambda module: tmp_path)
    dbc, document, bindings = network_files(Setup())
    database = complete(bindings, load_database(dbc, bindings.leave_out), document.where)
    made = resolve(bindings, database, document.where)
    for _ in range(2):
        assert_same(network_ties(bindings, database, document.where), made)
    fewer = msgspec.structs.replace(bindings, messages={})
    assert len(network_ties(fewer, database, document.where).rx_signal) == 0
    message = next(iter(bindings.messages.values()))
    wrong = msgspec.structs.replace(bindings, messages={"Nobody": message})
    for _ in range(2):
        with pytest.raises(InputError, match="Nobody"):
            network_ties(wrong, database, document.where)


def test_another_network_has_tables_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "cache_folder", lambda module: tmp_path)
    whole = load_database(folder("dbc") / "hev.dbc")
    rest = load_database(folder("dbc") / "hev.dbc", {whole.messages[0].name})
    assert len(network_tables(whole)[2].order) == len(whole.messages)
    assert len(network_tables(rest)[2].order) == len(rest.messages) == len(whole.messages) - 1
