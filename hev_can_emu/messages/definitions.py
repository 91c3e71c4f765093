"""What a network consists of: frozen records of messages and signals, independent of any file format.

Annotations are evaluated where they stand: msgspec takes three times as long to evaluate each as a text.
"""

import enum

import msgspec

from hev_can_emu.messages.protection_spec import ProtectionSpec


class SendType(enum.Enum):
    """When a message is sent (see :mod:`hev_can_emu.messages.restbus` for the exact rules)."""

    NONE = "none"
    CYCLIC = "cyclic"
    ON_CHANGE = "on change"
    CYCLIC_AND_CHANGE = "cyclic and on change"
    CYCLIC_IF_ACTIVE = "cyclic if active"
    EVENT = "event"


class SignalDef(msgspec.Struct, frozen=True, kw_only=True):
    """One signal of one message.

    ``start`` is the DBC start bit (big-endian: of the most significant bit).  ``scale`` and ``offset``
    map raw to physical values (``physical = raw * scale + offset``) and stay ``int`` where the file
    writes integers.  ``not_available`` and ``initial`` are raw values.  ``multiplexer`` names the signal
    whose raw value selects this one, ``multiplexer_ranges`` the inclusive ranges that do.  A ``constant``
    signal is sent with its initial value where none is given, even a floating-point one.
    """

    index: int
    message_index: int
    name: str
    message: str
    start: int
    length: int
    little_endian: bool = True
    signed: bool = False
    is_float: bool = False
    scale: float = 1
    offset: float = 0
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    labels: dict[int, str] = {}
    not_available: int | None = None
    initial: float | None = None
    constant: bool = False
    is_multiplexer: bool = False
    multiplexer: str | None = None
    multiplexer_ranges: tuple[tuple[int, int], ...] = ()
    receivers: tuple[str, ...] = ()
    comment: str = ""

    @property
    def qualified_name(self) -> str:
        """``Message.Signal``."""
        return f"{self.message}.{self.name}"

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw value that an integer signal's bits can hold."""
        if self.signed:
            return -(1 << (self.length - 1)), (1 << (self.length - 1)) - 1
        return 0, (1 << self.length) - 1

    def bits(self) -> frozenset[int]:
        """Return the bits that the signal covers, numbered ``8 * byte + bit`` (0 least significant)."""
        if self.little_endian:
            return frozenset(range(self.start, self.start + self.length))
        first = 8 * (self.start // 8) + 7 - self.start % 8
        return frozenset(8 * (n // 8) + 7 - n % 8 for n in range(first, first + self.length))


class MessageDef(msgspec.Struct, frozen=True, kw_only=True):
    """One message: identifier, layout, sender, timing and protection.  Times are in ns."""

    index: int
    name: str
    can_id: int
    extended: bool = False
    fd: bool = False
    brs: bool = False
    length: int = 8
    sender: str = ""
    receivers: tuple[str, ...] = ()
    signals: tuple[SignalDef, ...] = ()
    send_type: SendType = SendType.NONE
    cycle_time_ns: int = 0
    fast_cycle_time_ns: int = 0
    repetitions: int = 0
    delay_ns: int = 0
    start_delay_ns: int | None = None
    protection: ProtectionSpec | None = None
    comment: str = ""

    @property
    def wire_length(self) -> int:
        """Data bytes on the bus: CAN FD rounds up to the next length that its DLC can express."""
        if self.length <= 8:
            return self.length
        return next(size for size in (12, 16, 20, 24, 32, 48, 64) if size >= self.length)
