"""Protection: known answers, agreement with an independent implementation, receiver's conclusions."""

import e2e
import numpy as np
import pytest
from e2e import p01, p02, p05, p11
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hev_can_emu.messages.crc import crc_table, crc_update
from hev_can_emu.messages.protection import (
    COUNTER_JUMP,
    COUNTER_REPEATED,
    CRC_WRONG,
    ENFORCE,
    FIRST,
    LENGTH_WRONG,
    NEVER,
    OBSERVE,
    OFF,
    OK,
    build_protection,
    check,
    check_word,
    is_accepted,
    protect,
)
from hev_can_emu.messages.protection_spec import CrcSpec, ProtectionSpec
from hev_can_emu.messages.word_protection import G_MODULUS, G_ON, protect_word

IDS = tuple(range(1, 17))
SPECS = {
    "P01 both": ProtectionSpec(profile="P01", data_id=0x123),
    "P01 alternating": ProtectionSpec(profile="P01", data_id=0x123, data_id_mode="alternating"),
    "P01 low": ProtectionSpec(profile="P01", data_id=0x123, data_id_mode="low"),
    "P01 nibble": ProtectionSpec(profile="P01", data_id=0x123, data_id_mode="nibble"),
    "P02": ProtectionSpec(profile="P02", data_id_list=IDS),
    "P05": ProtectionSpec(profile="P05", data_id=0x1234),
    "P11 both": ProtectionSpec(profile="P11", data_id=0x123),
    "P11 nibble": ProtectionSpec(profile="P11", data_id=0x123, data_id_mode="nibble"),
    "P22": ProtectionSpec(profile="P22", data_id_list=IDS),
    "custom 8": ProtectionSpec(
        profile="custom",
        crc=CrcSpec(polynomial=0x07, init=0xFF, xor=0x55, reflected=True),
        data_id=0xABCD,
        data_id_position="suffix",
        crc_offset=56,
        counter_offset=3,
        counter_length=7,
        counter_max=99,
    ),
    "custom 16": ProtectionSpec(
        profile="custom",
        crc=CrcSpec(width=16, polynomial=0x8005, reflected=True, big_endian=True),
        crc_offset=8,
        counter_offset=0,
        counter_length=8,
    ),
}
MORE = {
    "custom own as zero": ProtectionSpec(
        profile="custom",
        crc=CrcSpec(polynomial=0x1D, init=0xFF, own_as_zero=True, first_byte=1, last_byte=6),
        data_id=0x17,
        data_id_mode="low",
        data_id_position="prefix",
        crc_offset=24,
        counter_offset=60,
        counter_length=4,
    ),
    "custom no counter": ProtectionSpec(
        profile="custom", crc=CrcSpec(polynomial=0x2F), crc_offset=0, counter_length=0
    ),
    "custom no CRC": ProtectionSpec(
        profile="custom", crc=CrcSpec(width=0), counter_offset=30, counter_length=12
    ),
    "custom counter across bytes": ProtectionSpec(
        profile="custom",
        crc=CrcSpec(polynomial=0x2F),
        crc_offset=0,
        counter_offset=20,
        counter_length=10,
        counter_big_endian=True,
    ),
}
NAMES = list(SPECS)
TABLE = build_protection([*SPECS.values(), None])


def protected(name: str, data: bytes, counter: int) -> np.ndarray:
    buffer = np.frombuffer(data, dtype=np.uint8).copy()
    protect(TABLE, NAMES.index(name), buffer, len(data), counter)
    return buffer


@pytest.mark.parametrize(
    ("name", "counter", "expected"),
    [
        ("P01 both", 0, "cc00000000000000"),
        ("P11 both", 0, "cc00000000000000"),
        ("P01 nibble", 0, "2a10000000000000"),
        ("P11 nibble", 0, "2a10000000000000"),
        ("P02", 1, "1b01000000000000"),
        ("P22", 1, "1b01000000000000"),
        ("P05", 0, "1cca000000000000"),
    ],
)
def test_known_answers(name: str, counter: int, expected: str) -> None:
    assert bytes(protected(name, bytes(8), counter)).hex() == expected


@pytest.mark.parametrize(
    ("width", "polynomial", "init", "xor", "reflected", "expected"),
    [
        (8, 0x07, 0x00, 0x00, False, 0xF4),  # CRC-8/SMBUS
        (8, 0x1D, 0xFF, 0xFF, False, 0x4B),  # CRC-8/SAE-J1850
        (8, 0x2F, 0xFF, 0xFF, False, 0xDF),  # CRC-8/AUTOSAR
        (8, 0x31, 0x00, 0x00, True, 0xA1),  # CRC-8/MAXIM
        (16, 0x1021, 0xFFFF, 0x0000, False, 0x29B1),  # CRC-16/IBM-3740
        (16, 0x8005, 0x0000, 0x0000, True, 0xBB3D),  # CRC-16/ARC
        (16, 0x1021, 0xFFFF, 0xFFFF, True, 0x906E),  # CRC-16/IBM-SDLC (init is symmetric)
    ],
)
def test_crc_check_values(width, polynomial, init, xor, reflected, expected) -> None:
    """The catalogue's check value: the CRC of the text 123456789."""
    table = crc_table(width, polynomial, reflected)
    crc = init
    for byte in b"123456789":
        crc = crc_update(table, width, int(reflected), crc, byte)
    assert crc ^ xor == expected


P01_MODES = {
    "both": p01.E2E_P01_DATAID_BOTH,
    "alternating": p01.E2E_P01_DATAID_ALT,
    "low": p01.E2E_P01_DATAID_LOW,
    "nibble": p01.E2E_P01_DATAID_NIBBLE,
}
P11_MODES = {"both": p11.E2E_P11_DATAID_BOTH, "nibble": p11.E2E_P11_DATAID_NIBBLE}


def independent(spec: ProtectionSpec, data: bytearray) -> None:
    """Protect with the package autosar-e2e, counter as it stands in the data."""
    if spec.profile == "P01":
        mode = P01_MODES[spec.data_id_mode]
        p01.e2e_p01_protect(data, spec.data_id, data_id_mode=mode, increment_counter=False)
    elif spec.profile == "P11":
        mode = P11_MODES[spec.data_id_mode]
        p11.e2e_p11_protect(data, spec.data_id, data_id_mode=mode, increment_counter=False)
    elif spec.profile == "P02":
        p02.e2e_p02_protect(data, bytes(spec.data_id_list), increment_counter=False)
    else:
        p05.e2e_p05_protect(data, spec.data_id, increment_counter=False)


PROFILES = st.one_of(
    st.builds(
        ProtectionSpec,
        profile=st.just("P01"),
        data_id=st.integers(0, 0xFFFF),
        data_id_mode=st.sampled_from(list(P01_MODES)),
    ),
    st.builds(
        ProtectionSpec,
        profile=st.just("P11"),
        data_id=st.integers(0, 0xFFFF),
        data_id_mode=st.sampled_from(list(P11_MODES)),
    ),
    st.builds(ProtectionSpec, profile=st.just("P05"), data_id=st.integers(0, 0xFFFF)),
    st.builds(
        ProtectionSpec,
        profile=st.just("P02"),
        data_id_list=st.tuples(*[st.integers(0, 255)] * 16),
    ),
)


@settings(max_examples=200, deadline=None)
@given(spec=PROFILES, data=st.binary(min_size=3, max_size=64), counter=st.integers(0, 255))
def test_agrees_with_autosar_e2e(spec: ProtectionSpec, data: bytes, counter: int) -> None:
    assert e2e.__name__ == "e2e"
    counter %= spec.counter_modulus
    ours = np.frombuffer(data, dtype=np.uint8).copy()
    protect(build_protection([spec]), 0, ours, len(data), counter)
    theirs = bytearray(data)
    if spec.profile == "P05":
        theirs[2] = counter
    elif spec.sends_nibble:
        theirs[1] = spec.data_id >> 4 & 0xF0 | counter
    else:
        theirs[1] = theirs[1] & 0xF0 | counter
    independent(spec, theirs)
    assert bytes(ours).hex() == theirs.hex()


def plainly(spec: ProtectionSpec, data: bytes, counter: int) -> bytes:
    """Protect as the page says it, bit by bit and without any table."""
    out = bytearray(data)
    for n, place in enumerate(spec.counter_places()):
        byte, bit = divmod(place, 8)
        out[byte] = out[byte] & ~(1 << bit) | (counter >> n & 1) << bit
    crc, width = spec.crc, spec.crc.width
    if width == 0:
        return bytes(out)
    own = range(spec.crc_bit // 8, spec.crc_bit // 8 + width // 8)
    last = len(data) - 1 if crc.last_byte < 0 else crc.last_byte
    covered = [
        0 if n in own else out[n]
        for n in range(crc.first_byte, last + 1)
        if n not in own or crc.own_as_zero
    ]
    low, high = spec.data_id & 0xFF, spec.data_id >> 8
    if spec.data_id_list:
        code = [spec.data_id_list[counter % 16]]
    else:
        code = {
            "both": [low, high],
            "low": [low],
            "nibble": [low, 0],
            "alternating": [high if counter % 2 else low],
        }[spec.data_id_mode]
    before = code if spec.data_id_position == "prefix" else []
    after = code if spec.data_id_position == "suffix" else []
    register = crc.init
    for byte in (*before, *covered, *after):
        for n in range(8):
            # Reflected: the mirrored register, bits entering least significant first.
            bit = byte >> n & 1 if crc.reflected else byte >> (7 - n) & 1
            if crc.reflected:
                mirrored = int(f"{crc.polynomial:0{width}b}"[::-1], 2)
                register = register >> 1 ^ (mirrored if (register ^ bit) & 1 else 0)
            else:
                top = register >> (width - 1) & 1
                register = (register << 1 & (1 << width) - 1) ^ (crc.polynomial if top ^ bit else 0)
    register ^= crc.xor
    order = "big" if crc.big_endian and width == 16 else "little"
    out[own.start : own.stop] = register.to_bytes(width // 8, order)
    return bytes(out)


@st.composite
def custom_specs(draw) -> tuple[ProtectionSpec, int]:
    """Return a custom protection of any layout, and the length of a message that holds it."""
    length = draw(st.integers(4, 64))
    width = draw(st.sampled_from([0, 8, 16]))
    bits = draw(st.integers(0 if width else 1, 16))
    high = draw(st.booleans())
    word = st.integers(0, (1 << width) - 1)
    first = draw(st.integers(0, length - 1))
    ids = draw(st.sampled_from([(), tuple(range(3, 19))])) if bits else ()
    fields = {
        "profile": "custom",
        "crc": CrcSpec(
            width=width,
            polynomial=draw(word) if width else 0,
            init=draw(word) if width else 0,
            xor=draw(word) if width else 0,
            reflected=draw(st.booleans()),
            big_endian=draw(st.booleans()),
            first_byte=first,
            last_byte=draw(st.sampled_from([-1, first, length - 1])),
            own_as_zero=draw(st.booleans()),
        ),
        "data_id": draw(st.integers(0, 0xFFFF)),
        "data_id_mode": draw(st.sampled_from(["both", "low", "nibble"] + ["alternating"] * (bits > 0))),
        "data_id_list": ids,
        "data_id_position": draw(st.sampled_from(["none", "prefix", "suffix"])),
        "crc_offset": 8 * draw(st.integers(0, length - 2)),
        "counter_offset": draw(st.integers(0, 8 * length - 1)),
        "counter_length": bits,
        "counter_big_endian": high,
        "counter_max": draw(st.sampled_from([-1, (1 << bits) - 2])) if bits > 2 else -1,
    }  # fmt: skip
    try:
        spec = ProtectionSpec(**fields)
        spec.check_length(length)
    except ValueError:
        assume(False)
    return spec, length


@settings(max_examples=300)
@given(made=custom_specs(), seed=st.randoms(use_true_random=False))
def test_any_layout_against_a_plain_reading_of_the_page(made, seed) -> None:
    spec, length = made
    data, counter = seed.randbytes(length), seed.randrange(spec.counter_modulus)
    table = build_protection([spec])
    ours = np.frombuffer(data, dtype=np.uint8).copy()
    protect(table, 0, ours, length, counter)
    assert bytes(ours).hex() == plainly(spec, data, counter).hex()
    state = np.array([NEVER], dtype=np.int64)
    assert check(table, 0, ours, length, state) == FIRST
    assert state[0] == counter
    protect(table, 0, ours, length, counter + 1)
    assert check(table, 0, ours, length, state) == OK


@pytest.mark.parametrize("name", NAMES)
def test_receiver_follows_the_counter(name: str) -> None:
    row, spec = NAMES.index(name), SPECS[name]
    state = np.array([NEVER], dtype=np.int64)
    data = bytes(range(0x10, 0x18))

    def receive(counter: int) -> int:
        return check(TABLE, row, protected(name, data, counter), 8, state)

    last = spec.counter_modulus - 1
    assert receive(last - 1) == FIRST
    assert receive(last) == OK
    assert receive(last + 1) == OK, "wraps to 0"
    assert state[0] == 0
    assert receive(0) == COUNTER_REPEATED
    assert receive(1) == OK
    assert receive(3) == COUNTER_JUMP
    assert receive(4) == OK, "in sequence with the frame after the jump"


@pytest.mark.parametrize("name", NAMES)
def test_every_single_bit_error_is_seen(name: str) -> None:
    row = NAMES.index(name)
    for bit in range(64):
        frame = protected(name, bytes(range(8)), 5)
        frame[bit // 8] ^= 1 << bit % 8
        state = np.array([4], dtype=np.int64)
        assert check(TABLE, row, frame, 8, state) == CRC_WRONG
        assert state[0] == 4, "a wrong frame leaves the counter alone"


@pytest.mark.parametrize("name", NAMES)
def test_protection_touches_only_its_own_bits(name: str) -> None:
    own = SPECS[name].bits()
    frame = protected(name, b"\xff" * 8, 2)
    for bit in set(range(64)) - own:
        assert frame[bit // 8] >> bit % 8 & 1


def test_largest_counter_step_is_adjustable() -> None:
    spec = ProtectionSpec(profile="P11", max_delta_counter=3)
    table = build_protection([spec])
    state = np.array([NEVER], dtype=np.int64)
    codes = []
    for counter in (0, 3, 7, 10):
        frame = np.zeros(8, dtype=np.uint8)
        protect(table, 0, frame, 8, counter)
        codes.append(check(table, 0, frame, 8, state))
    assert codes == [FIRST, OK, COUNTER_JUMP, OK]


def test_unprotected_messages_are_left_alone() -> None:
    data = np.arange(8, dtype=np.uint8)
    row = len(NAMES)
    protect(TABLE, row, data, 8, 3)
    assert bytes(data) == bytes(range(8))
    assert check(TABLE, row, data, 8, np.array([NEVER])) == OK


def test_what_is_accepted() -> None:
    codes = (OK, FIRST, CRC_WRONG, COUNTER_REPEATED, COUNTER_JUMP, LENGTH_WRONG)
    assert [is_accepted(code, ENFORCE) for code in codes] == [
        True,
        True,
        False,
        False,
        False,
        False,
    ]
    for mode in (OFF, OBSERVE):
        assert [is_accepted(code, mode) for code in codes] == [True] * 5 + [False]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"profile": "P07"}, "expected a profile of P01, P02, P05, P11, P22, custom, got 'P07'"),
        (
            {"profile": "P11", "data_id_mode": "low"},
            "expected a data ID mode of both, nibble for P11, got 'low'",
        ),
        ({"profile": "P02"}, "expected a data ID list of 16 bytes for P02, got none"),
        (
            {"profile": "P22", "data_id_list": (1, 2)},
            "expected 16 entries of the data ID list, got 2",
        ),
        ({"profile": "P01", "data_id": 70000}, "expected a data ID of 16 bits, got 70000"),
        (
            {"profile": "P01", "crc_offset": 3},
            "expected a CRC offset that is a multiple of 8, got 3",
        ),
        (
            {"profile": "P11", "counter_offset": 4},
            "expected CRC and counter apart, got common bits",
        ),
        (
            {"profile": "P05", "counter_offset": 4},
            "expected the counter of P05 at bit 16, got 4",
        ),
        (
            {"profile": "custom", "crc": CrcSpec(width=0), "counter_length": 0},
            "expected a counter or a CRC, got neither",
        ),
        (
            {"profile": "custom", "counter_length": 0, "data_id_mode": "alternating"},
            "expected a counter that chooses the data ID's byte, got none",
        ),
        (
            {"profile": "P11", "max_delta_counter": 15},
            "expected a largest counter step of 1 to 14, got 15",
        ),
    ],
)
def test_impossible_declarations(fields, message: str) -> None:
    with pytest.raises(ValueError, match="expected") as caught:
        ProtectionSpec(**fields)
    assert str(caught.value) == message


def test_a_message_must_have_room() -> None:
    with pytest.raises(ValueError, match="got bit 11 beyond them"):
        ProtectionSpec(profile="P11").check_length(1)
    ProtectionSpec(profile="P11").check_length(2)
    with pytest.raises(ValueError, match="got byte 9"):
        ProtectionSpec(profile="custom", crc=CrcSpec(last_byte=9)).check_length(8)
    with pytest.raises(ValueError, match="got one that begins before it"):
        ProtectionSpec(
            profile="custom", crc_offset=8, counter_offset=4, counter_length=8,
            counter_big_endian=True,
        ).check_length(8)  # fmt: skip


@pytest.mark.parametrize("name", [*SPECS, *MORE])
@settings(max_examples=60, deadline=None)
@given(
    data=st.binary(min_size=8, max_size=8), counter=st.integers(0, 1 << 40), flip=st.integers(0, 63)
)
def test_a_word_is_protected_and_checked_as_its_bytes_are(
    name: str, data: bytes, counter: int, flip: int
) -> None:
    table = build_protection([(SPECS | MORE)[name]], [8])
    big_endian_apart = name == "custom counter across bytes"
    assert table.words[0, G_ON] == (0 if big_endian_apart else 1)
    if big_endian_apart:
        return
    slow = np.frombuffer(data, dtype=np.uint8).copy()
    protect(table, 0, slow, 8, counter)
    word = protect_word(
        table.words, table.remainders, 0, np.frombuffer(data, np.uint64)[0], counter
    )
    assert np.uint64(word).tobytes() == slow.tobytes()
    broken = np.uint64(word) ^ np.uint64(1 << flip)
    for last in (NEVER, 0, counter % int(table.words[0, G_MODULUS]), 3):
        for received in (np.uint64(word), broken):
            states = np.array([[last], [last]], dtype=np.int64)
            code = check_word(table, 0, received, states[0])
            assert code == check(table, 0, received.reshape(1).view(np.uint8), 8, states[1])
            assert states[0, 0] == states[1, 0]


@pytest.mark.parametrize("length", range(3, 8))
@pytest.mark.parametrize("name", ["P01 both", "P02", "P05", "P22", "custom 16"])
def test_a_word_shorter_than_eight_bytes(name: str, length: int) -> None:
    table = build_protection([SPECS[name], None], [length, 8])
    assert table.words[:, G_ON].tolist() == [1, 0]
    data = np.array([0x5A, 0xC3, 0x7E, 0x99, 0x01, 0xFE, 0x42, 0x18], dtype=np.uint8)
    data[length:] = 0
    slow = data.copy()
    protect(table, 0, slow, length, 77)
    word = protect_word(table.words, table.remainders, 0, data.view(np.uint64)[0], 77)
    assert np.uint64(word).tobytes() == slow.tobytes()


def test_longer_messages_are_no_words() -> None:
    assert build_protection([SPECS["P05"]], [9]).words[0, G_ON] == 0
