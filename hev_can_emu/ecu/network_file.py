"""What a bindings file adds to the DBC: how messages are protected and sent, and constant signals.

Annotations are evaluated where they stand: msgspec takes three times as long to evaluate each as a text.
"""

from typing import Literal

import msgspec

Profile = Literal["none", "P01", "P02", "P05", "P11", "P22", "custom"]
SendWord = Literal["cyclic", "on_change", "cyclic_and_change", "cyclic_if_active", "event", "never"]


class ProtectionBinding(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A message's counter and CRC (docs/protection.md), in place of what the DBC says.

    ``crc``, ``counter`` and ``data_id_nibble`` name signals.  Where the DBC has no signal for them,
    ``crc_bit`` with ``crc_width`` and ``counter_bit`` with ``counter_length`` say where they lie (bits
    numbered ``8 * byte + bit``, the lowest one); without either they lie where the profile puts them.
    From ``crc_width`` on all fields count for ``custom`` only.
    """

    profile: Profile
    data_id: int = 0
    data_id_mode: Literal["both", "alternating", "low", "nibble"] = "both"
    data_id_list: tuple[int, ...] = ()
    crc: str = ""
    counter: str = ""
    data_id_nibble: str = ""
    crc_bit: int | None = None
    counter_bit: int | None = None
    data_id_nibble_bit: int | None = None
    max_delta_counter: int = 1
    crc_width: Literal[0, 8, 16] | None = None
    polynomial: int | None = None
    init: int = 0
    xor: int = 0
    reflected: bool = False
    big_endian: bool | None = None
    first_byte: int = 0
    last_byte: int | None = None
    own_as_zero: bool = False
    counter_length: int | None = None
    counter_max: int | None = None
    data_id_position: Literal["none", "prefix", "suffix"] = "none"


class Sending(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When a message is sent, in place of what the DBC says; times are quantities (``20 ms``)."""

    type: SendWord | None = None
    period: str = ""
    fast_period: str = ""
    repetitions: int | None = None
    delay: str = ""
    phase: str = ""
