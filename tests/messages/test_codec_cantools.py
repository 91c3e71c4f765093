"""Byte identity with cantools over generated databases of every kind."""

import logging
import math
import random
from collections import Counter
from pathlib import Path

import bitstruct
import cantools.database.can
import pytest
from cantools.database import DecodeError, EncodeError
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from networks import TEXTS
from random_dbc import random_dbc

from hev_can_emu.messages.database import load_database
from hev_can_emu.messages.named import NamedCodec
from hev_can_emu.messages.transmit_set import TransmitSet

logging.getLogger("cantools").setLevel(logging.CRITICAL)
# One worker for the whole file: its last test counts what the others did.
pytestmark = pytest.mark.xdist_group("codec")
COUNTED: Counter[str] = Counter()
QUICK = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dbc") / "random.dbc"


def both(scratch: Path, text: str):
    scratch.write_text(text, encoding="utf-8")
    database = load_database(scratch)
    reference = cantools.database.can.Database(strict=True)
    reference.add_dbc_string(text)
    return database, NamedCodec(database), reference


def kinds(message, selected) -> set[str]:
    """Name what a message's encoding has exercised."""
    found = {
        "fd" if message.fd else "classic",
        "extended id" if message.extended else "standard id",
    }
    for signal in message.signals:
        if signal.name in selected:
            found.add("little" if signal.little_endian else "big")
            found.add(f"float{signal.length}" if signal.is_float else f"signed {signal.signed}")
            found |= {"64 bits"} if signal.length == 64 and not signal.is_float else set()
            found |= {"labels"} if signal.labels else set()
            found |= {"multiplexed"} if signal.multiplexer else set()
            found |= {"two levels"} if signal.multiplexer == "Inner" else set()
    return found


def draw_value(rng: random.Random, signal):
    """Return a number near the signal's range, half-way cases included."""
    if signal.is_float:
        raw = rng.choice((0.0, 1.5, -2.75, 1e-7, 6.1e-5, 3e4, 65504.0, rng.uniform(-1e4, 1e4)))
        return raw * signal.scale + signal.offset
    low, high = signal.raw_range
    if signal.minimum is not None:
        ends = sorted(
            (limit - signal.offset) / signal.scale for limit in (signal.minimum, signal.maximum)
        )
        low, high = max(low, math.ceil(ends[0])), min(high, math.floor(ends[1]))
        if low > high:
            low, high = signal.raw_range
    raw = rng.choice((low, high, rng.randint(low, high), rng.randint(low, high)))
    labelled = [raw for raw in signal.labels if raw != signal.not_available]
    if labelled and rng.random() < 0.2:
        raw = rng.choice(labelled)
    if raw == signal.not_available:
        raw = low if raw != low else high
    part = rng.choice((0, 0, 0.5, -0.5, 0.25, rng.uniform(-0.5, 0.5)))
    if signal.length > 50:
        part = 0
    return (raw + part) * signal.scale + signal.offset


def lands_on_not_available(signal, value) -> bool:
    if signal.not_available is None:
        return False
    return round((value - signal.offset) / signal.scale) == signal.not_available


def compare_bytes(database, ours, reference, rng: random.Random, rounds: int) -> None:
    """Encode random values of every message both ways, singly and as one set."""
    together = TransmitSet(database)
    encoded = 0
    for message in database.messages:
        theirs = reference.get_message_by_name(message.name)
        for _ in range(rounds):
            values = {signal.name: draw_value(rng, signal) for signal in message.signals}
            if "Mux" in values:
                values["Mux"] = rng.randrange(3)
            for name in ("Outer", "Inner"):
                if name in values:
                    values[name] = rng.choice((1, 2, 3, 4, 5))
            if any(
                lands_on_not_available(signal, values[signal.name]) for signal in message.signals
            ):
                continue
            try:
                selected = theirs.gather_signals(values)
                expected = theirs.encode(selected, strict=True)
            except (EncodeError, bitstruct.Error, OverflowError):
                continue
            assert ours.encode_message(message.name, values).hex() == expected.hex(), values
            if all(signal.length <= 53 or signal.is_float for signal in message.signals):
                for signal in message.signals:
                    together.values[signal.index] = values[signal.name]
                together.encode()
                frame = together.frames[message.index]
                assert frame["data"].tobytes() == expected.ljust(64, b"\0"), values
            encoded += 1
            COUNTED.update(kinds(message, selected))
    assert ours.saturations == 0
    COUNTED["encoded"] += encoded


@QUICK
@given(seed=st.integers(0, 10**9))
def test_bytes_equal_those_of_cantools(scratch: Path, seed: int) -> None:
    rng = random.Random(seed)
    compare_bytes(*both(scratch, random_dbc(rng)), rng, 15)


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("networks")
    return {name: both(folder / f"{n}.dbc", text) for n, (name, text) in enumerate(TEXTS.items())}


@pytest.mark.parametrize("name", TEXTS)
@settings(max_examples=25)
@given(seed=st.integers(0, 10**9))
def test_on_every_kind_of_network(networks, name: str, seed: int) -> None:
    database, ours, reference = networks[name]
    rng = random.Random(seed)
    rounds = 1 if len(database.messages) > 5 else 5
    compare_bytes(database, ours, reference, rng, rounds)
    compare_values(database, ours, reference, rng, rounds)


def test_every_kind_was_encoded() -> None:
    """Guard the generator: runs after the test above, whose encodings it counts."""
    if not COUNTED:
        pytest.skip("counts what the test above encodes; run the whole file")
    everything = (
        "classic", "fd", "standard id", "extended id", "little", "big", "float16", "float32", "float64",
        "signed True", "signed False", "64 bits", "labels", "multiplexed", "two levels",
    )  # fmt: skip
    assert {kind: COUNTED[kind] for kind in everything if COUNTED[kind] < 3} == {}


@QUICK
@given(seed=st.integers(0, 10**9))
def test_values_equal_those_of_cantools(scratch: Path, seed: int) -> None:
    rng = random.Random(seed)
    compare_values(*both(scratch, random_dbc(rng)), rng, 15)


def compare_values(database, ours, reference, rng: random.Random, rounds: int) -> None:
    """Decode random frames of every message both ways."""
    for message in database.messages:
        theirs = reference.get_message_by_name(message.name)
        for _ in range(rounds):
            data = rng.choice(
                (
                    rng.randbytes(message.length),
                    bytes(message.length),
                    b"\xff" * message.length,
                    b"\x11" * message.length,
                )
            )
            try:
                expected = theirs.decode(data, decode_choices=False)
            except DecodeError:
                continue  # a selector that selects nothing: ours decodes the rest
            got = ours.decode_message(message.can_id, data, message.extended)
            assert set(got) == set(expected)
            for signal in message.signals:
                if signal.name not in expected:
                    continue
                value = expected[signal.name]
                missing = signal.not_available
                if missing is not None:
                    raw = theirs.decode(data, decode_choices=False, scaling=False)[signal.name]
                    if raw == missing:
                        value = math.nan
                same = got[signal.name] == value or (
                    math.isnan(value) and math.isnan(got[signal.name])
                )
                assert same, (signal, value, got[signal.name])
