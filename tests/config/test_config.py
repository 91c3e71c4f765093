"""The YAML reader: what it reads, and the exact words with which it refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hev_can_emu import config
from hev_can_emu.errors import InputError


class Ramp(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    to: float | str
    over: Annotated[float, msgspec.Meta(gt=0)] = 1.0
    shape: Literal["linear", "smooth"] = "linear"

    def __post_init__(self) -> None:
        if self.to == 13:
            raise InputError("", "a lucky number", "13", "take 12")
        if self.to == 14:
            raise ValueError("fourteen will not do")


class File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    version: Literal[1]
    name: str = ""
    ramps: dict[str, Ramp] = {}
    steps: tuple[Ramp, ...] = ()
    limit: float | None = None
    gears: dict[str, dict[str, int]] = {}
    on: bool = False


def data(text: str) -> object:
    return config.parse(text).data


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("-1.5E+3", -1500.0),
        (".5", 0.5),
        ("12", 12),
        ("012", 12),
        ("+7", 7),
        ("0x1F", 31),
        ("0o17", 15),
        ("true", True),
        ("False", False),
        ("~", None),
        ("null", None),
        ("on", "on"),
        ("off", "off"),
        ("yes", "yes"),
        ("No", "No"),
        ("1_000", "1_000"),
        ("1:30", "1:30"),
        ("2024-01-02", "2024-01-02"),
        ("20 km/h", "20 km/h"),
        ("0b11", "0b11"),
        ("'12'", "12"),
        ('"true"', "true"),
        ("!!str 12", "12"),
        ("!!float 12", 12.0),
        ("1e", "1e"),
        (".", "."),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text: str, value: object) -> None:
    read = data(f"- {text}")
    assert read == [value]
    assert type(read[0]) is type(value)  # type: ignore[index]


def test_keys_are_their_text() -> None:
    assert data("on: 1\n1: 2\nnull: 3\n1e-3: 4") == {"on": 1, "1": 2, "null": 3, "1e-3": 4}


def test_anchors_and_flow_and_block() -> None:
    assert data("a: &x {b: [1, 2]}\nc: *x\nd: |\n  two\n  lines\n") == {
        "a": {"b": [1, 2]},
        "c": {"b": [1, 2]},
        "d": "two\nlines\n",
    }


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(2**62), 2**62)
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(st.characters(codec="ascii", categories=["L", "N", "P"])),
        lambda inner: st.lists(inner) | st.dictionaries(st.text("abc", min_size=1), inner),
        max_leaves=8,
    )
)
def test_json_is_read_as_json_reads_it(value: object) -> None:
    assert data(msgspec.json.encode(value).decode()) == value


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3", "f:3:1: expected each key once, got 'a' again; first in line 1"),
        ("a: [.nan]", "f:1:5: expected a finite number, got .nan"),
        ("a: -.inf", "f:1:4: expected a finite number, got -.inf"),
        ("a: 1e999", "f:1:4: expected a finite number, got 1e999"),
        (
            "a: 99999999999999999999",
            "f:1:4: expected a whole number of at most 63 bits, got 99999999999999999999",
        ),
        (
            "a: !!python/name:os 1",
            "f:1:4: expected plain data, got the tag 'tag:yaml.org,2002:python/name:os'",
        ),
        ("a: !thing 1", "f:1:4: expected plain data, got the tag '!thing'"),
        ("!!int x", "f:1:1: expected a value of !!int, got 'x'"),
        ("a: &x {b: *x}", "f:1:11: expected an anchor defined above, got '*x' inside itself"),
        (
            "a: &gear 1\nb: *gaer",
            "f:2:4: expected an anchor defined above, got '*gaer'; did you mean 'gear'?",
        ),
        (
            "a: &x {b: 1}\nc:\n  <<: *x",
            "f:3:3: expected a key, got '<<'; merge keys are not part of YAML 1.2",
        ),
        ("a: 1\n---\nb: 2", "f:2:1: expected one YAML document, got a second one"),
        ("[1, 2]: 3", "f:1:1: expected text as key, got a mapping or list"),
        ("", "f: expected a YAML document, got an empty file"),
        ("# nothing\n", "f: expected a YAML document, got an empty file"),
        (
            "a: 1\nb: \x00",
            "f:2:4: expected YAML text, got the control character U+0000; is this a binary file?",
        ),
        ("[" * 60, "f:1:51: expected at most 50 levels, got a deeper nesting"),
    ],
)
def test_refusals(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        config.parse(text, "f")
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("text", "where", "hint"),
    [
        ("a:\n\tb: 1", "f:2:1", "indent with spaces, not tabs"),
        ("a: b: c", "f:1:5", "quote a text that holds ': '"),
        ("a: [1, 2\nb: 3", "f:2:", ""),
        ("a: 'open", "f:1:9", ""),
        ("a: @x", "f:1:4", ""),
    ],
)
def test_syntax_errors_tell_line_and_column(text: str, where: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        config.parse(text, "f")
    assert caught.value.where.startswith(where)
    assert caught.value.expected == "YAML"
    assert "\n" not in str(caught.value)
    if hint:
        assert caught.value.hint == hint


def test_aliases_cannot_explode() -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    with pytest.raises(InputError, match="expected at most 500000 values, got more"):
        config.parse("\n".join(lines), "f")


BASE = "version: 1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x", "f:1: $: expected the key 'version', got only 'name'"),
        ("version: 2", "f:1: $.version: expected 1, got 2"),
        ("[1]", "f:1: $: expected a mapping, got a list"),
        (
            BASE + "nmae: x",
            "f:2: $.nmae: expected a known key, got 'nmae'; did you mean 'name'?",
        ),
        (
            BASE + "xyzzy: x",
            "f:2: $.xyzzy: expected a known key, got 'xyzzy'; "
            "known: version, name, ramps, steps, limit, gears, on",
        ),
        (BASE + "name: 3", "f:2: $.name: expected text, got 3"),
        (
            BASE + "name: true",
            "f:2: $.name: expected text, got true; quote it where the text is meant",
        ),
        (BASE + "on: on", "f:2: $.on: expected true or false, got 'on'"),
        (
            BASE + "ramps:\n  A: {to: 1}\n  B.C:\n    to: 2\n    over: 0\n",
            "f:6: $.ramps['B.C'].over: expected a number > 0.0, got 0",
        ),
        (
            BASE + "ramps:\n  A: {to: 1}\n  B: {to: 1, ovr: 2}\n",
            "f:4: $.ramps.B.ovr: expected a known key, got 'ovr'; did you mean 'over'?",
        ),
        (
            BASE + "steps:\n- to: 1\n- to: [1]\n",
            "f:4: $.steps[1].to: expected a number or text, got a list",
        ),
        (
            BASE + "steps:\n- to: 1\n  shape: liner\n",
            "f:4: $.steps[0].shape: expected one of linear, smooth, got 'liner'; "
            "did you mean 'linear'?",
        ),
        (
            BASE + "steps:\n- to: 13\n",
            "f:3: $.steps[0]: expected a lucky number, got 13; take 12",
        ),
        (
            BASE + "steps:\n- to: 14\n",
            "f:3: $.steps[0]: expected a usable entry, got fourteen will not do",
        ),
        (BASE + "limit: |\n  two\n  lines", "f:2: $.limit: expected a number, got 'two lines'"),
        (
            BASE + '"a\\nb": 1',
            "f:2: $['a b']: expected a known key, got 'a b'; "
            "known: version, name, ramps, steps, limit, gears, on",
        ),
        (BASE + "limit: x", "f:2: $.limit: expected a number, got 'x'"),
        (
            BASE + "gears:\n  a: {b: 1}\n  c: {d: 1, e: x}\n",
            "f:4: $.gears.c.e: expected a whole number, got 'x'",
        ),
    ],
)
def test_what_does_not_fit_is_told_with_line_and_path(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        config.parse(text, "f").convert(File)
    assert str(caught.value) == message


def test_load_gives_the_record(tmp_path: Path) -> None:
    path = tmp_path / "ok.yaml"
    path.write_text("\ufeffversion: 1\nlimit: 1e-3\nramps: {A: {to: 20 km/h}}\n", "utf-8")
    assert config.load(path, File) == File(1, limit=1e-3, ramps={"A": Ramp("20 km/h")})


def test_where_finds_the_nearest_line() -> None:
    document = config.parse("a:\n  b:\n  - 1\n  - 2\n", "f")
    assert document.where(("a", "b", 1)) == "f:4: $.a.b[1]"
    assert document.where(("a", "x", 1)) == "f:1: $.a.x[1]"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (None, "{}: expected a YAML file, got no such file; did you mean 'other.yaml'?"),
        ("dir", "{}: expected a YAML file, got a directory; name a file in it"),
        (
            b"a: 1\nb: \xff\xfe",
            "{}:2: expected UTF-8 text, got the byte 0xff; is this a binary file?",
        ),
        (b"a: " + b"x" * 5_000_000, "{}: expected at most 5 MB, got a larger file"),
        (b"", "{}: expected a YAML document, got an empty file"),
    ],
)
def test_files_that_cannot_be_read(tmp_path: Path, make: bytes | str | None, message: str) -> None:
    path = tmp_path / "othr.yaml"
    (tmp_path / "other.yaml").write_text("a: 1")
    if make == "dir":
        path.mkdir()
    elif isinstance(make, bytes):
        path.write_bytes(make)
    with pytest.raises(InputError) as caught:
        config.load(path, File)
    assert str(caught.value) == message.format(path)


def test_a_file_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path, mode: str) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)  # a mode of 0 does not stop root
    with pytest.raises(InputError, match="expected a readable file, got permission denied"):
        config.load(tmp_path / "x.yaml", File)


def test_a_name_with_a_nul_is_no_traceback() -> None:
    with pytest.raises(InputError, match="expected a readable file"):
        config.load("a\0b", File)
