"""A YAML file that was read before reads the same without a parser; a damaged record of it does no harm."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hev_can_emu import config
from hev_can_emu.errors import InputError

TEXT = """\
numbers: [1, 1.0, -0.0, 1e-3, 0x10, 9223372036854775807, 0.1, 1e300]
words: {on: on, null: ~, true: true, text: "a: b", "12": '12', empty: }
shared: &shared [1, {deep: [x]}]
again: *shared
nothing: []
none: {}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setattr("hev_can_emu.jit.cache_folder", lambda module: folder)
    return folder


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "file.yaml"
    file.write_text(TEXT)
    return file


def same(one: config.Node, other: config.Node) -> bool:
    return repr(one) == repr(other) and one == other


def test_the_second_reading_is_as_the_first(folder: Path, file: Path) -> None:
    parsed = config.parse(TEXT, str(file))
    first, second = config.read(file), config.read(file)
    assert len(list(folder.iterdir())) == 1
    assert same(first.root, parsed.root)
    assert same(second.root, parsed.root)
    assert second.where(("shared", 1, "deep")) == f"{file}:3: $.shared[1].deep"
    assert second.where(("again", 1, "deep", 0)) == first.where(("again", 1, "deep", 0))
    other = file.with_name("other.yaml")
    other.write_text(TEXT)
    assert config.read(other).where(("none",)) == f"{other}:6: $.none"
    assert len(list(folder.iterdir())) == 1


def test_a_change_is_seen(folder: Path, file: Path) -> None:
    assert config.read(file).data["numbers"][0] == 1
    file.write_text(TEXT.replace("[1, 1.0", "[2, 1.0"))
    assert config.read(file).data["numbers"][0] == 2


@pytest.mark.parametrize("place", [0, 20, 31, 32, 60, -1])
def test_a_damaged_record_is_made_anew(folder: Path, file: Path, place: int) -> None:
    whole = config.read(file)
    (record,) = folder.iterdir()
    content = bytearray(record.read_bytes())
    content[place] ^= 1
    for damaged in (bytes(content), bytes(content[:place]), b""):
        record.write_bytes(damaged)
        assert same(config.read(file).root, whole.root)
        assert same(config.read(file).root, whole.root)


def test_no_folder_costs_time_alone(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hev_can_emu.jit.cache_folder", lambda module: file / "none")
    assert same(config.read(file).root, config.parse(TEXT, str(file)).root)


def test_what_is_refused_is_refused_again(folder: Path, file: Path) -> None:
    file.write_text("a: 1\na: 2\n")
    for _ in range(2):
        with pytest.raises(InputError, match="each key once"):
            config.read(file)
    assert list(folder.iterdir()) == []


def test_half_a_pair_of_surrogates_is_read(folder: Path, file: Path) -> None:
    file.write_text('a: "\\ud800"\n')
    for _ in range(2):
        try:
            assert config.read(file).data == {"a": "\ud800"}
        except InputError:  # by the parser, where it is strict
            assert list(folder.iterdir()) == []


def test_no_parser_is_imported(file: Path, tmp_path: Path) -> None:
    code = (
        "import sys; from hev_can_emu import config; "
        f"print(config.read({str(file)!r}).data['words']['on'], 'yaml' in sys.modules)"
    )
    said = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={"HEV_CAN_EMU_CACHE": str(tmp_path)}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        said.append(done.stdout)
    assert said == ["on True\n", "on False\n"]
