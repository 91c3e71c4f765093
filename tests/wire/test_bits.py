"""Bits on the wire: hand counts, published bounds, and frames written out bit by bit."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire_reference import LENGTHS, crc, written_out

from hev_can_emu.bus.bits import INTERMISSION, bits_of, priority
from hev_can_emu.messages.frame import BRS, EXTENDED, FD, REMOTE, frame

pytestmark = pytest.mark.kernels


def bits(can_id: int, data: bytes, flags: int = 0) -> tuple[int, int]:
    ((nominal, fast),) = bits_of(frame(can_id, data, flags=flags)).tolist()
    return nominal, fast


def test_the_references_crcs_are_the_catalogues() -> None:
    text = "".join(f"{byte:08b}" for byte in b"123456789")
    assert crc(text, 0x4599, 15) == 0x059E
    assert crc(text, 0x1685B, 17) == 0x04F03
    assert crc(text, 0x102899, 21) == 0x0ED841


def test_a_frame_counted_by_hand() -> None:
    # 0x555, no data: 0 10101010101 0 0 0 0000, where the run of zeros after the identifier's last one
    # is RTR, IDE, r0 and DLC: seven zeros, so one stuff bit after five; the CRC has no run of five.
    # 1 + 11 + 3 + 4 + 15 + 1 stuff bit, and 10 to the end of the frame.
    assert crc("0" + "10101010101" + "0000000", 0x4599, 15) == 0b110011101001100
    assert bits(0x555, b"") == (1 + 11 + 3 + 4 + 15 + 1 + 10, 0)


@pytest.mark.parametrize(
    ("flags", "length", "plain", "most"),
    [
        # The Linux kernel's include/linux/can/length.h: whole frame and intermission, without and
        # with as many stuff bits as there can be.
        (0, 8, 111, 135),
        (EXTENDED, 8, 131, 160),
        (FD, 64, 579, 712),
        (FD | EXTENDED, 64, 598, 736),
    ],
)
@given(data=st.binary(min_size=64, max_size=64), can_id=st.integers(0, 0x7FF))
def test_every_frame_is_within_the_published_bounds(
    flags: int, length: int, plain: int, most: int, data: bytes, can_id: int
) -> None:
    identifier = can_id << 18 | can_id if flags & EXTENDED else can_id
    for fill in (data[:length], bytes(length), b"\xff" * length):
        nominal, fast = bits(identifier, fill, flags)
        assert plain <= nominal + INTERMISSION <= most
        assert fast == 0


@given(
    can_id=st.integers(0, (1 << 29) - 1),
    flags=st.sampled_from([0, EXTENDED, REMOTE, FD, FD | BRS, FD | BRS | EXTENDED, FD | EXTENDED]),
    length=st.sampled_from(LENGTHS),
    fill=st.sampled_from([None, b"\x00", b"\xff", b"\xf0", b"\x1f"]),
    data=st.binary(min_size=64, max_size=64),
)
def test_counts_are_those_of_the_frame_written_out(
    can_id: int, flags: int, length: int, fill: bytes | None, data: bytes
) -> None:
    if not flags & FD:
        length = min(length, 8)
    payload = (data if fill is None else fill * 64)[:length]
    identifier = can_id if flags & EXTENDED else can_id & 0x7FF
    slow, fast = written_out(identifier, flags, payload)
    assert bits(identifier, payload, flags) == (len(slow), len(fast))


def test_a_length_that_can_fd_does_not_have_is_padded() -> None:
    for length, padded in ((9, 12), (13, 16), (17, 20), (21, 24), (25, 32), (33, 48), (49, 64)):
        data = bytes(range(1, length + 1))
        assert bits(1, data, FD) == bits(1, data.ljust(padded, b"\0"), FD)


def test_arbitration_orders_as_the_wire_does() -> None:
    frames = [
        (0x000, 0), (0x001, 0), (0x001, REMOTE), (0x001 << 18, EXTENDED), ((0x001 << 18) | 5, EXTENDED),
        ((0x001 << 18) | 5, EXTENDED | REMOTE), (0x002, 0), (0x7FF, 0), (0x1FFFFFFF, EXTENDED),
    ]  # fmt: skip

    def field(can_id: int, flags: int) -> str:
        """The bits that decide, as sent: start of frame up to RTR, stuffing left out."""
        remote = "1" if flags & REMOTE else "0"
        if flags & EXTENDED:
            return f"{can_id >> 18:011b}11{can_id & 0x3FFFF:018b}{remote}"
        return f"{can_id:011b}{remote}0"

    assert sorted(frames, key=lambda f: priority(*f)) == frames
    assert sorted(frames, key=lambda f: field(*f)) == frames
