"""Every broken DBC file gets one line: where, expected, got."""

import random
import re
from pathlib import Path

import pytest
from random_dbc import mutated, random_dbc

from hev_can_emu.errors import InputError
from hev_can_emu.messages.codec import build_codec
from hev_can_emu.messages.database import load_database
from hev_can_emu.messages.restbus import build_restbus

HEAD = 'VERSION ""\nBU_: A B\n'
ONE = 'BO_ 256 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" B\n'
E2E = (
    'BA_DEF_ BO_ "E2EProfile" ENUM "none","P01","P02","P05","P11","P22","custom";\n'
    'BA_DEF_DEF_ "E2EProfile" "none";\n'
)
FORMAT = "a DBC file (text that begins with VERSION, NS_, BU_ or BO_)"
CASES: dict[str, tuple[bytes, str]] = {
    "empty": (b"", f": expected {FORMAT}, got an empty file"),
    "binary": (
        b"VERSION\n\x00\x01",
        f":2: expected {FORMAT}, got binary data (a zero byte)",
    ),
    "prose": (
        b"hello: world\n",
        f":1: expected {FORMAT}, got 'hello: world'",
    ),
    "syntax": (
        (HEAD + "BO_ 256 M 8 A\n").encode(),
        ":3: expected DBC syntax (column 11), got 'BO_ 256 M 8 A'",
    ),
    "overlap": (
        (HEAD + ONE + ' SG_ T : 4|8@1+ (1,0) [0|0] "" B\n').encode(),
        ":5: expected signals of M that do not overlap, got 'T' and 'S' on the same bits",
    ),
    "beyond": (
        (HEAD + 'BO_ 256 M: 1 A\n SG_ S : 4|8@1+ (1,0) [0|0] "" B\n').encode(),
        ":4: expected a signal inside M, got 'S' beyond its last bit",
    ),
    "equal identifiers": (
        (HEAD + ONE + ONE.replace(" M:", " N:")).encode(),
        ":5: expected identifiers that occur once, got 0x100 for both 'M' and 'N'",
    ),
    "equal names": (
        (HEAD + ONE + ONE.replace("256", "257")).encode(),
        ":3: expected message names that occur once, got 'M' twice",
    ),
    "equal signals": (
        (HEAD + ONE + ' SG_ S : 8|8@1+ (1,0) [0|0] "" B\n').encode(),
        ":4: expected signal names that occur once in M, got 'S' twice",
    ),
    "factor zero": (
        (HEAD + ONE.replace("(1,0)", "(0,0)")).encode(),
        ":4: expected a finite factor other than 0 (M.S), got 0",
    ),
    "identifier": (
        (HEAD + ONE.replace("256", "4096")).encode(),
        ":3: expected an identifier of 11 bits, got 0x1000",
    ),
    "no bits": (
        (HEAD + ONE.replace("0|8@", "0|0@")).encode(),
        ":4: expected a signal of at least one bit, got 0",
    ),
    "float of 24 bits": (
        (HEAD + ONE.replace("0|8@1+", "0|24@1-") + "SIG_VALTYPE_ 256 S : 1;\n").encode(),
        ":4: expected a floating-point signal of 16, 32 or 64 bits (M.S), got 24",
    ),
    "a message to fill the memory": (
        (HEAD + ONE.replace(": 8 A", ": 4294967295 A")).encode(),
        ":3: expected a message of 0 to 64 bytes, got '4294967295'",
    ),
    "a signal to fill the memory": (
        (HEAD + ONE.replace("0|8@", "0|999999999@")).encode(),
        ":4: expected a signal of 1 to 64 bits, got '999999999'",
    ),
    "selectors to fill the memory": (
        (HEAD + ONE + "SG_MUL_VAL_ 256 S S 0-4294967295;\n").encode(),
        ":5: expected at most 65536 multiplexer values, got '0-4294967295'",
    ),
    "a name over two lines": (
        (HEAD + ONE + 'BA_ "No\npe" BO_ 256 1;\n').encode(),
        ":5: expected a name that the file defines, got 'No pe'",
    ),
    "a cycle time beyond all clocks": (
        (HEAD + ONE + 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 0;\nBA_DEF_DEF_ "GenMsgCycleTime" 0;\n'
         'BA_ "GenMsgCycleTime" BO_ 256 18446744073709551615;\n').encode(),
        ":3: expected GenMsgCycleTime of M: 0 to 2147483647, got 18446744073709551615",
    ),
    "labels of nothing": (
        (HEAD + ONE + 'VAL_ 256 T 1 "x" ;\n').encode(),
        ":5: expected a signal of message 256 that VAL_ belongs to, got 'T', which that message lacks",
    ),
    "unknown attribute": (
        (HEAD + ONE + 'BA_ "Nope" BO_ 256 1;\n').encode(),
        ":5: expected a name that the file defines, got 'Nope'",
    ),
    "protection without list": (
        (HEAD + ONE + E2E + 'BA_ "E2EProfile" BO_ 256 2;\n').encode(),
        ":3: expected a data ID list of 16 bytes for P02 (protection of M), got none",
    ),
    "protection without room": (
        (HEAD + ONE.replace(": 8 A", ": 1 A") + E2E + 'BA_ "E2EProfile" BO_ 256 4;\n').encode(),
        ":3: expected CRC and counter inside 1 bytes (protection of M), got bit 11 beyond them",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_one_line_tells_what_is_wrong(tmp_path: Path, case: str) -> None:
    content, expected = CASES[case]
    path = tmp_path / "net.dbc"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_database(path)
    assert str(caught.value) == f"{path}{expected}"


def test_messages_are_left_out_by_name(tmp_path: Path) -> None:
    path = tmp_path / "net.dbc"
    path.write_bytes(CASES["overlap"][0])
    assert load_database(path, ["M"]).messages == ()
    with pytest.raises(InputError) as caught:
        load_database(path, ["m"])
    assert (
        str(caught.value)
        == f"{path}: expected the message to leave out, got no 'm'; did you mean 'M'?"
    )


def test_missing_file_and_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "none.dbc", tmp_path):
        with pytest.raises(InputError, match="expected a readable DBC file, got"):
            load_database(path)


def test_names_are_looked_up_with_hints(tmp_path: Path) -> None:
    path = tmp_path / "net.dbc"
    path.write_text(HEAD + ONE + ONE.replace("256 M", "257 Speeds").replace("SG_ S", "SG_ Speed"))
    database = load_database(path)
    assert database.signal("Speed").qualified_name == "Speeds.Speed"
    assert database.signal_index("M", "S") == 0
    assert database.message_of_id(257).name == "Speeds"
    assert database.message_of_id(257, extended=True) is None
    with pytest.raises(InputError, match=r"got 'Sped'; did you mean 'Speed'"):
        database.signal("Sped")
    with pytest.raises(InputError, match="a message of the database, got 'Speds'; did you mean"):
        database.message("Speds")


def test_ambiguous_signal_must_be_qualified(tmp_path: Path) -> None:
    path = tmp_path / "net.dbc"
    path.write_text(HEAD + ONE + ONE.replace("256 M", "257 N"))
    with pytest.raises(InputError, match=r"write 'M\.S' or 'N\.S'"):
        load_database(path).signal("S")


def test_any_truncation_is_an_input_error_or_fine(tmp_path: Path) -> None:
    text = (HEAD + ONE + E2E + 'BA_ "E2EProfile" BO_ 256 4;\nVAL_ 256 S 1 "x" ;\n').encode()
    path = tmp_path / "net.dbc"
    failures = 0
    for length in range(len(text)):
        path.write_bytes(text[:length])
        try:
            load_database(path)
        except InputError:
            failures += 1
    assert failures > len(text) // 2


EXAMPLE = Path(__file__).parents[2] / "dbc" / "examples" / "alpin.dbc"


def test_no_mutation_gives_a_traceback(tmp_path: Path) -> None:
    """Texts cut, doubled, swapped, with monstrous numbers: one line of complaint, or a usable network."""
    path = tmp_path / "net.dbc"
    line = re.compile(rf"{re.escape(str(path))}(:\d+)?: expected [^\n]+, got [^\n]+")
    usable = 0
    for seed in range(400):
        rng = random.Random(seed)
        text = EXAMPLE.read_text() if seed % 8 == 0 else random_dbc(rng, 2)
        path.write_text(mutated(rng, text))
        complaint = ""
        try:
            database = load_database(path)
        except InputError as error:
            complaint = str(error)
        else:
            usable += 1
            assert build_codec(database).signals.shape[0] == len(database.signals)
            assert build_restbus(database).order.shape[0] == len(database.messages)
        assert not complaint or line.fullmatch(complaint), (seed, complaint)
    assert 40 < usable < 360
