"""The protocol without sockets: elements cut from any segmentation, malformed ones told apart."""

from __future__ import annotations

import pytest
from can.interfaces.socketcand.socketcand import (
    convert_ascii_message_to_can_message,
    convert_can_message_to_ascii_message,
)
from hypothesis import given
from hypothesis import strategies as st

from hev_can_emu.bus import socketcand_protocol as protocol
from hev_can_emu.messages.frame import ERROR, EXTENDED, FD, REMOTE, frame

STREAM = b"< open vcan0 >< rawmode >< send 123 2 1A 22 >\n< send 12345678 0  >< echo >"
ELEMENTS = [
    protocol.Open("vcan0"),
    protocol.RawMode(),
    protocol.Send(0x123, 0, b"\x1a\x22"),
    protocol.Send(0x12345678, EXTENDED, b""),
    protocol.Echo(),
]


@given(st.lists(st.integers(0, len(STREAM)), max_size=8).map(sorted))
def test_any_segmentation_gives_the_same_elements(cuts: list[int]) -> None:
    parser = protocol.Parser()
    elements = []
    for start, end in zip([0, *cuts], [*cuts, len(STREAM)], strict=True):
        found, error = parser.feed(STREAM[start:end])
        assert error is None
        elements += found
    assert elements == ELEMENTS


@pytest.mark.parametrize(
    "text",
    [
        b"hello",
        b"< >",
        b"< nonsense >",
        b"< send >",
        b"< send 123 >",
        b"< send 8000 zz >",
        b"< send 800 0 >",
        b"< send 20000000 0 >",
        b"< send 123456789 0 >",
        b"< send 0x1 0 >",
        b"< send +12 0 >",
        b"< send 123 2 1A >",
        b"< send 123 1 1A 22 >",
        b"< send 123 1 1_0 >",
        b"< send 123 1 -1 >",
        b"< send 123 1 100 >",
        b"< send 123 1 \xff >",
        b"< open >",
        b"< open a b >",
        b"\x00\xff\xfe",
        b"< " + b"x" * 600,
    ],
)
def test_malformed_input_is_an_error_after_what_was_good(text: bytes) -> None:
    elements, error = protocol.Parser().feed(b"< echo >" + text)
    assert elements == [protocol.Echo()]
    assert error is not None
    assert str(error).isascii()
    assert str(error).startswith("expected ")


@given(st.binary(max_size=300))
def test_random_bytes_never_raise(data: bytes) -> None:
    elements, _ = protocol.Parser().feed(data)
    assert isinstance(elements, list)


@pytest.mark.parametrize("words", [b"40 " + b"0 " * 64, b"64 " + b"00 " * 64, b"C " + b"1 " * 12])
def test_can_fd_is_refused_not_malformed(words: bytes) -> None:
    [element], error = protocol.Parser().feed(b"< send 123 " + words + b">")
    assert error is None
    assert isinstance(element, protocol.Refusal)
    assert "classic-CAN" in element.reason


@given(
    st.booleans().flatmap(
        lambda extended: st.tuples(
            st.integers(0, 0x1FFF_FFFF if extended else 0x7FF), st.just(extended)
        )
    ),
    st.binary(max_size=8),
    st.integers(0, 4 * 10**18),
)
def test_python_can_reads_what_is_written_and_the_reverse(
    identifier: tuple[int, bool], data: bytes, time_ns: int
) -> None:
    can_id, extended = identifier
    flags = EXTENDED if extended else 0
    raw = frame(can_id, data, flags=flags).tobytes()
    text, refused = protocol.format_frames(raw, protocol.format_stamp(time_ns))
    assert len(text) == protocol.FRAME_BYTES
    message = convert_ascii_message_to_can_message(text.decode())
    assert refused == 0
    assert (message.arbitration_id, message.is_extended_id) == (can_id, extended)
    assert bytes(message.data) == data
    assert message.timestamp == pytest.approx(time_ns / 1e9, abs=1e-6, rel=1e-15)
    [sent], error = protocol.Parser().feed(convert_can_message_to_ascii_message(message).encode())
    assert error is None
    assert sent == protocol.Send(can_id, flags, data)


def test_error_frames_have_a_form_and_fd_and_remote_have_none() -> None:
    assert protocol.format_frames(frame(0x4, b"", flags=ERROR).tobytes(), "1.000000") == (
        b"< error 20000004 " + b"1.000000".zfill(45) + b" >",
        0,
    )
    for flags, data in ((FD, b"\x01"), (REMOTE, b""), (FD, bytes(64))):
        assert protocol.format_frames(frame(1, data, flags=flags).tobytes(), "1.0") == (b"", 1)
