"""The declaration of a message's protection, as a record that a DBC or a file beside it fills.

Annotations are evaluated where they stand, as in :mod:`.definitions`.
"""

from typing import Literal

import msgspec

Profile = Literal["P01", "P02", "P05", "P11", "P22", "custom"]
DataIdMode = Literal["both", "alternating", "low", "nibble"]
DataIdPosition = Literal["none", "prefix", "suffix"]

PROFILES = ("P01", "P02", "P05", "P11", "P22", "custom")
DATA_ID_MODES = ("both", "alternating", "low", "nibble")
DATA_ID_POSITIONS = ("none", "prefix", "suffix")

_MODES_OF = {"P01": DATA_ID_MODES, "P11": ("both", "nibble"), "custom": DATA_ID_MODES}


class CrcSpec(msgspec.Struct, frozen=True, kw_only=True):
    """A cyclic redundancy check of 8 or 16 bits; ``polynomial`` without its leading one.

    ``width`` 0 stands for no check code.  The code covers the bytes ``first_byte`` to ``last_byte`` (-1:
    the message's last) without its own, which count as zero where ``own_as_zero``.
    """

    width: int = 8
    polynomial: int = 0x1D
    init: int = 0
    xor: int = 0
    reflected: bool = False
    big_endian: bool = False
    first_byte: int = 0
    last_byte: int = -1
    own_as_zero: bool = False

    def __post_init__(self) -> None:
        if self.width not in (0, 8, 16):
            raise ValueError(f"expected a CRC width of 8, 16 or 0 (none), got {self.width}")
        if self.first_byte < 0 or -1 < self.last_byte < self.first_byte or self.last_byte < -1:
            got = f"{self.first_byte} to {self.last_byte}"
            raise ValueError(f"expected a CRC over bytes in rising order, got {got}")
        if self.width == 0:
            return
        for name in ("polynomial", "init", "xor"):
            value = getattr(self, name)
            if not 0 <= value < 1 << self.width:
                raise ValueError(f"expected a CRC {name} of {self.width} bits, got {value}")


_CRC_OF = {
    "P01": CrcSpec(),
    "P11": CrcSpec(),
    "P02": CrcSpec(polynomial=0x2F, init=0xFF, xor=0xFF),
    "P22": CrcSpec(polynomial=0x2F, init=0xFF, xor=0xFF),
    "P05": CrcSpec(width=16, polynomial=0x1021, init=0xFFFF),
}


class ProtectionSpec(msgspec.Struct, frozen=True, kw_only=True):
    """How one message is protected; see docs/protection.md for each field's meaning.

    Offsets are bit numbers counted as in little-endian signals; -1 stands for the profile's own place.
    ``crc``, ``counter_length`` (0: no counter), ``counter_max``, ``counter_big_endian`` and
    ``data_id_position`` count for ``custom`` only.

    Raises:
        ValueError: for a combination that the profile does not know.
    """

    profile: Profile
    data_id: int = 0
    data_id_mode: DataIdMode = "both"
    data_id_list: tuple[int, ...] = ()
    crc_offset: int = -1
    counter_offset: int = -1
    nibble_offset: int = -1
    max_delta_counter: int = 1
    crc: CrcSpec = CrcSpec()
    counter_length: int = 4
    counter_max: int = -1
    counter_big_endian: bool = False
    data_id_position: DataIdPosition = "none"

    def __post_init__(self) -> None:
        if self.profile not in PROFILES:
            raise ValueError(f"expected a profile of {', '.join(PROFILES)}, got '{self.profile}'")
        if self.data_id_mode not in _MODES_OF.get(self.profile, DATA_ID_MODES):
            modes = ", ".join(_MODES_OF[self.profile])
            raise ValueError(
                f"expected a data ID mode of {modes} for {self.profile}, got '{self.data_id_mode}'"
            )
        if self.data_id_position not in DATA_ID_POSITIONS:
            raise ValueError(f"expected none, prefix or suffix, got '{self.data_id_position}'")
        if not 0 <= self.data_id <= 0xFFFF:
            raise ValueError(f"expected a data ID of 16 bits, got {self.data_id}")
        if self.data_id_list and len(self.data_id_list) != 16:
            raise ValueError(
                f"expected 16 entries of the data ID list, got {len(self.data_id_list)}"
            )
        if any(not 0 <= entry <= 0xFF for entry in self.data_id_list):
            raise ValueError("expected bytes in the data ID list, got a value outside 0 to 255")
        if self.profile in ("P02", "P22") and not self.data_id_list:
            raise ValueError(f"expected a data ID list of 16 bytes for {self.profile}, got none")
        if self.crc_offset % 8 and self.crc_offset != -1:
            raise ValueError(
                f"expected a CRC offset that is a multiple of 8, got {self.crc_offset}"
            )
        if self.profile == "P02" and self.crc_offset > 0:
            raise ValueError(f"expected the CRC of P02 in byte 0, got bit {self.crc_offset}")
        self._check_counter()
        if self.profile in ("P02", "P05", "P22") and self.counter_offset not in (
            -1,
            self.counter_bit,
        ):
            raise ValueError(
                f"expected the counter of {self.profile} at bit {self.counter_bit}, "
                f"got {self.counter_offset}"
            )
        spans = self._spans()
        for position, (name, bits) in enumerate(spans):
            for other, other_bits in spans[position + 1 :]:
                if bits & other_bits:
                    raise ValueError(f"expected {name} and {other} apart, got common bits")

    def _check_counter(self) -> None:
        if not 0 <= self.counter_length <= 16:
            raise ValueError(f"expected a counter of 0 to 16 bits, got {self.counter_length}")
        if self.counter_bits == 0:
            if self.effective_crc.width == 0:
                raise ValueError("expected a counter or a CRC, got neither")
            if self.data_id_list or self.data_id_mode == "alternating":
                raise ValueError("expected a counter that chooses the data ID's byte, got none")
            return
        if self.counter_max >= 1 << self.counter_length:
            raise ValueError(
                f"expected a largest counter of {self.counter_length} bits, got {self.counter_max}"
            )
        if not 1 <= self.max_delta_counter < self.counter_modulus:
            raise ValueError(
                f"expected a largest counter step of 1 to {self.counter_modulus - 1}, "
                f"got {self.max_delta_counter}"
            )

    def _spans(self) -> list[tuple[str, frozenset[int]]]:
        def span(first: int, length: int) -> frozenset[int]:
            return frozenset(range(first, first + length))

        spans = [
            ("CRC", span(self.crc_bit, self.effective_crc.width)),
            ("counter", frozenset(self.counter_places())),
        ]
        if self.sends_nibble:
            spans.append(("data ID nibble", span(self.nibble_bit, 4)))
        return spans

    def counter_places(self) -> list[int]:
        """Return the counter's bits, the least significant first, numbered ``8 * byte + bit``."""
        places, bit = [], self.counter_bit
        for _ in range(self.counter_bits):
            places.append(bit)
            bit += -15 if self.is_counter_big_endian and bit % 8 == 7 else 1
        return places

    @property
    def effective_crc(self) -> CrcSpec:
        """The profile's CRC, or the custom one."""
        return _CRC_OF.get(self.profile, self.crc)

    @property
    def crc_bit(self) -> int:
        """First bit of the CRC."""
        return max(self.crc_offset, 0)

    @property
    def counter_bit(self) -> int:
        """Lowest bit of the counter."""
        if self.profile == "P05":
            return self.crc_bit + 16
        if self.profile in ("P02", "P22"):
            return self.crc_bit + 8
        return 8 if self.counter_offset < 0 else self.counter_offset

    @property
    def nibble_bit(self) -> int:
        """Lowest bit of the data ID's nibble in mode ``nibble``."""
        return 12 if self.nibble_offset < 0 else self.nibble_offset

    @property
    def sends_nibble(self) -> bool:
        """Whether a nibble of the data ID travels in the frame."""
        return self.data_id_mode == "nibble" and self.profile in ("P01", "P11")

    @property
    def counter_bits(self) -> int:
        """Length of the counter in bits."""
        if self.profile == "custom":
            return self.counter_length
        return 8 if self.profile == "P05" else 4

    @property
    def is_counter_big_endian(self) -> bool:
        """Whether the counter's higher bits go on in the byte before."""
        return self.profile == "custom" and self.counter_big_endian

    @property
    def counter_modulus(self) -> int:
        """Number of values that the counter takes."""
        if self.profile in ("P01", "P11"):
            return 15
        if self.profile == "custom" and self.counter_max >= 0:
            return self.counter_max + 1
        return 1 << self.counter_bits

    def bits(self) -> frozenset[int]:
        """Return the bits that the protection writes, numbered ``8 * byte + bit``."""
        return frozenset[int]().union(*(bits for _, bits in self._spans()))

    def check_length(self, length: int) -> None:
        """Raise ValueError where a message of ``length`` bytes has no room for CRC and counter."""
        bits = self.bits()
        if min(bits) < 0:
            raise ValueError("expected a counter inside the message, got one that begins before it")
        if max(bits) >= 8 * length:
            raise ValueError(
                f"expected CRC and counter inside {length} bytes, got bit {max(bits)} beyond them"
            )
        crc = self.effective_crc
        if max(crc.first_byte, crc.last_byte) >= length:
            raise ValueError(
                f"expected a CRC over some of {length} bytes, got byte "
                f"{max(crc.first_byte, crc.last_byte)}"
            )
