"""The socketcand protocol's raw mode, without input or output.

Text elements between ``<`` and ``>`` over TCP, as the daemon of the linux-can project speaks them
(https://github.com/linux-can/socketcand, doc/protocol.md)::

    server                      client
    < hi >
                                < open vcan0 >
    < ok >
                                < rawmode >
    < ok >
    < frame 123 23.424242 1A22 >
                                < send 123 2 1A 22 >

Identifiers of three digits are standard, of eight extended.  A frame without data has two blanks
before ``>``: clients split at single blanks.

A server that keeps lockstep knows two more, of its own (docs/lockstep.md)::

                                < lockstep NAME >
    < now 0 >
                                < done 10000000 >
    < now 10000000 >
"""

from __future__ import annotations

from typing import NamedTuple

from hev_can_emu.bus.port import RECORD
from hev_can_emu.messages.frame import ERROR, EXTENDED, FD, REMOTE

HI = b"< hi >"
OK = b"< ok >"
ECHO = b"< echo >"
ELEMENT_BYTES = 512  #: an element longer than this is malformed (a 64-byte send has about 210)
FRAME_BYTES = 64  #: length of every frame element written
_STAMP_STANDARD = FRAME_BYTES - len("< frame 123   >")
_STAMP_EXTENDED = FRAME_BYTES - len("< frame 12345678   >")

_HEX_DIGITS = b"0123456789abcdefABCDEF"
_BYTE = {
    text.encode(): value
    for value in range(256)
    for text in {f"{value:x}", f"{value:02x}", f"{value:X}", f"{value:02X}"}
} | {
    f"{high}{low}".encode(): int(f"{high}{low}", 16)
    for high in "0123456789abcdefABCDEF"
    for low in "0123456789abcdefABCDEF"
}
_CANNOT_CARRY = FD | REMOTE
UNFIT = (
    "CAN FD and remote frames are not sent: socketcand carries classic data frames only; use "
    "--bus socketcan:vcan0 or --bus udp_multicast:239.74.163.2"
)


class ProtocolError(Exception):
    """The peer sent something that is not this protocol; its connection is beyond saving."""


class Open(NamedTuple):
    """``< open CHANNEL >``."""

    channel: str


class RawMode(NamedTuple):
    """``< rawmode >``."""


class Echo(NamedTuple):
    """``< echo >``: are you alive?"""


class Send(NamedTuple):
    """``< send ID LENGTH BYTES >``; ``flags`` is 0 or EXTENDED."""

    can_id: int
    flags: int
    data: bytes


class Lockstep(NamedTuple):
    """``< lockstep NAME >``: time is to wait for this client."""

    name: str


class Done(NamedTuple):
    """``< done T >``: all that this client sends before ``T`` ns is sent."""

    until_ns: int


class Refusal(NamedTuple):
    """A well-formed element that this server cannot serve; ``reason`` has no blanks.

    python-can quotes the first word after ``< error`` in the exception that it raises, so the
    reason is written as one word to reach a person's eyes whole.
    """

    reason: str


Element = Open | RawMode | Echo | Send | Lockstep | Done | Refusal

_FD_REFUSED = Refusal("64-byte-frames-refused:socketcand-carries-classic-CAN-of-8-bytes-only")
_REMOTE_REFUSED = Refusal("remote-frames-refused:socketcand-cannot-carry-them")
_NAME_BYTES = 32
_OTHER_MODES = frozenset(
    b"bcmmode isotpmode controlmode statistics add update delete filter subscribe unsubscribe "
    b"sendpdu isotpconf".split()
)


class Parser:
    """Cuts a byte stream into elements; keeps what is incomplete."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> tuple[list[Element], ProtocolError | None]:
        """Return the elements completed by ``data``, and what stopped the parsing, if anything.

        After an error the parser must not be fed again.
        """
        *complete, rest = (self._rest + data).split(b">")
        elements: list[Element] = []
        try:
            for text in complete:
                elements.append(parse_element(text))  # noqa: PERF401 - keeps those before an error
            rest = rest.lstrip()
            if rest and not rest.startswith(b"<"):
                raise ProtocolError(f"expected '<', got {_shown(rest)}")
            if len(rest) > ELEMENT_BYTES:
                raise ProtocolError(f"expected '>' within {ELEMENT_BYTES} bytes")
        except ProtocolError as error:
            return elements, error
        self._rest = rest
        return elements, None


def parse_element(text: bytes) -> Element:
    """Return the element whose text, without the closing ``>``, is ``text``; raises ProtocolError."""
    text = text.lstrip()
    if not text.startswith(b"<") or len(text) > ELEMENT_BYTES:
        raise ProtocolError(f"expected '< ... >', got {_shown(text)}")
    words = text[1:].split()
    if not words:
        raise ProtocolError("expected a command, got '< >'")
    command = words[0]
    if command == b"send":
        return _parse_send(words, text)
    if command == b"open" and len(words) == 2:
        return Open(words[1].decode("ascii", "replace"))
    if command == b"rawmode" and len(words) == 1:
        return RawMode()
    if command == b"echo" and len(words) == 1:
        return Echo()
    if command == b"done" and len(words) == 2:
        if not (words[1].isdigit() and len(words[1]) < 19):
            raise ProtocolError(f"expected a time in ns after done, got {_shown(text)}")
        return Done(int(words[1]))
    if command == b"lockstep" and len(words) == 2 and len(words[1]) <= _NAME_BYTES:
        return Lockstep(words[1].decode("ascii", "replace"))
    if command in _OTHER_MODES:
        return Refusal(f"{command.decode()}-refused:this-server-speaks-rawmode-only")
    raise ProtocolError(f"expected open, rawmode, send or echo, got {_shown(text)}")


def _parse_send(words: list[bytes], text: bytes) -> Send | Refusal:
    if len(words) < 3:
        raise ProtocolError(f"expected '< send ID LENGTH BYTES >', got {_shown(text)}")
    can_id, flags = _parse_id(words[1], text)
    stated = _parse_hex(words[2], text)
    try:
        data = bytes([_BYTE[word] for word in words[3:]])
    except KeyError:
        raise ProtocolError(f"expected bytes in hex, got {_shown(text)}") from None
    if stated > 8 and len(data) in (stated, int(words[2]) if words[2].isdigit() else -1):
        return _FD_REFUSED
    if stated and not data:  # what python-can makes of a remote frame
        return _REMOTE_REFUSED
    if stated != len(data):
        raise ProtocolError(f"expected {stated} data bytes, got {_shown(text)}")
    return Send(can_id, flags, data)


def _parse_id(word: bytes, text: bytes) -> tuple[int, int]:
    can_id = _parse_hex(word, text)
    extended = len(word) > 3
    if can_id > (0x1FFF_FFFF if extended else 0x7FF):
        raise ProtocolError(f"expected an identifier of 11 or 29 bits, got {_shown(text)}")
    return can_id, EXTENDED if extended else 0


def _parse_hex(word: bytes, text: bytes) -> int:
    if len(word) > 8 or word.strip(_HEX_DIGITS):
        raise ProtocolError(f"expected a hex number of 1 to 8 digits, got {_shown(text)}")
    return int(word, 16)


def _shown(text: bytes) -> str:
    """Return the start of ``text``, fit to be printed."""
    return ascii(text[:40].decode("latin-1")) + ("..." if len(text) > 40 else "")


def format_stamp(time_ns: int) -> str:
    """Return ``time_ns`` as seconds with six decimals, as frames carry it."""
    seconds, rest = divmod(time_ns, 1_000_000_000)
    return f"{seconds}.{rest // 1000:06d}"


def format_frame(can_id: int, flags: int, data: bytes, stamp: str) -> str:
    """Return the ``< frame ... >`` (or ``< error ... >``) element of one classic frame.

    Every element is ``FRAME_BYTES`` long, by leading zeros in its time.  python-can reads 1024 bytes
    at a time and prints a warning whenever that cuts an element in two; a divisor of 1024 is never cut.
    """
    if flags & ERROR:
        return f"< error {can_id | 0x2000_0000:08X} {stamp.zfill(_STAMP_EXTENDED + 1)} >"
    text = data.hex().upper()
    if flags & EXTENDED:
        return f"< frame {can_id:08X} {stamp.zfill(_STAMP_EXTENDED - len(text))} {text} >"
    return f"< frame {can_id:03X} {stamp.zfill(_STAMP_STANDARD - len(text))} {text} >"


def sort_out(raw: bytes) -> tuple[bytes, int]:
    """Return those of consecutive ``RECORD`` frames that the protocol can carry; how many it cannot."""
    fit = []
    refused = 0
    for start in range(0, len(raw), RECORD.size):
        record = raw[start : start + RECORD.size]
        _, _, flags, length, _, _ = RECORD.unpack(record)
        if flags & _CANNOT_CARRY or length > 8:
            refused += 1
        else:
            fit.append(record)
    return b"".join(fit), refused


def format_frames(raw: bytes, stamp: str = "", epoch_ns: int = 0) -> tuple[bytes, int]:
    """Return the text of consecutive ``RECORD`` frames, and how many of them it could not carry.

    CAN FD and remote frames have no form in this protocol.

    Args:
        raw: the frames.
        stamp: the time that all of them carry; empty for each frame's own.
        epoch_ns: added to their own times.
    """
    parts = []
    refused = 0
    for t_ns, can_id, flags, length, _, data in RECORD.iter_unpack(raw):
        if flags & _CANNOT_CARRY or length > 8:
            refused += 1
        else:
            told = stamp or format_stamp(epoch_ns + t_ns)
            parts.append(format_frame(can_id, flags, data[:length], told))
    return "".join(parts).encode(), refused


def format_now(t_ns: int) -> bytes:
    """Return ``< now T >``, as long as a frame's element."""
    digits = FRAME_BYTES - len("< now  >")
    return f"< now {t_ns:0{digits}d} >".encode()
