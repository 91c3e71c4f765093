"""The tables of a network are the same whether they are made or were kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hev_can_emu.messages.codec_tables import build_codec
from hev_can_emu.messages.database import load_database
from hev_can_emu.messages.protection import build_protection
from hev_can_emu.messages.restbus import build_restbus
from hev_can_emu.resources import folder
from hev_can_emu.runtime import kept
from hev_can_emu.runtime.network_tables import network_tables


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
        for one, other in zip(made, network_tables(database), strict=True):
            assert type(one) is type(other)
            for name in one._fields:
                right, found = getattr(one, name), getattr(other, name)
                assert found.dtype == right.dtype, name
                np.testing.assert_array_equal(found, right, err_msg=name)


def test_another_network_has_tables_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "cache_folder", lambda module: tmp_path)
    whole = load_database(folder("dbc") / "hev.dbc")
    rest = load_database(folder("dbc") / "hev.dbc", {whole.messages[0].name})
    assert len(network_tables(whole)[2].order) == len(whole.messages)
    assert len(network_tables(rest)[2].order) == len(rest.messages) == len(whole.messages) - 1
