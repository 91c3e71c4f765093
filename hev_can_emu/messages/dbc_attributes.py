"""Attributes of DBC messages: timing, send type and protection, whatever the maker called their labels."""

from __future__ import annotations

import re
from typing import Any

from hev_can_emu.messages.definitions import SendType
from hev_can_emu.messages.protection_spec import CrcSpec, ProtectionSpec

#: Labels of GenMsgSendType, folded to lower-case letters, as makers write them.
_SEND_TYPES = {
    "cyclic": SendType.CYCLIC,
    "cyclicx": SendType.CYCLIC,
    "periodic": SendType.CYCLIC,
    "fixedperiodic": SendType.CYCLIC,
    "always": SendType.CYCLIC,
    "onchange": SendType.ON_CHANGE,
    "onchangewithrepetition": SendType.ON_CHANGE,
    "change": SendType.ON_CHANGE,
    "cyclicandspontaneous": SendType.CYCLIC_AND_CHANGE,
    "cyclicandspontaneouswithdelay": SendType.CYCLIC_AND_CHANGE,
    "cyclicandspontaneouswithrepetition": SendType.CYCLIC_AND_CHANGE,
    "cyclicandspontanwithdelay": SendType.CYCLIC_AND_CHANGE,
    "cyclicandspontan": SendType.CYCLIC_AND_CHANGE,
    "cyclicandonchange": SendType.CYCLIC_AND_CHANGE,
    "cycliconchange": SendType.CYCLIC_AND_CHANGE,
    "cyclicandevent": SendType.CYCLIC_AND_CHANGE,
    "cyclicevent": SendType.CYCLIC_AND_CHANGE,
    "cyclicandtriggered": SendType.CYCLIC_AND_CHANGE,
    "periodicandevent": SendType.CYCLIC_AND_CHANGE,
    "mixed": SendType.CYCLIC_AND_CHANGE,
    "cyclicifactive": SendType.CYCLIC_IF_ACTIVE,
    "cyclicifactivefast": SendType.CYCLIC_IF_ACTIVE,
    "cyclicifactiveandspontaneouswd": SendType.CYCLIC_IF_ACTIVE,
    "cyclicifactiveandspontanwd": SendType.CYCLIC_IF_ACTIVE,
    "cyclicwithfastperiod": SendType.CYCLIC_IF_ACTIVE,
    "cyclicfast": SendType.CYCLIC_IF_ACTIVE,
    "ifactive": SendType.CYCLIC_IF_ACTIVE,
    "ifactivewithrepetition": SendType.CYCLIC_IF_ACTIVE,
    "spontaneous": SendType.EVENT,
    "spontan": SendType.EVENT,
    "spontaneouswithdelay": SendType.EVENT,
    "spontanwithdelay": SendType.EVENT,
    "spontaneouswithrepetition": SendType.EVENT,
    "spontanwithrepetition": SendType.EVENT,
    "event": SendType.EVENT,
    "eventtriggered": SendType.EVENT,
    "eventwithrepetition": SendType.EVENT,
    "triggered": SendType.EVENT,
    "onwrite": SendType.EVENT,
    "onwritewithrepetition": SendType.EVENT,
    "sporadic": SendType.EVENT,
}

#: Labels of a raw value that carries no measurement, folded to lower-case letters.
_NOT_AVAILABLE = {
    "na",
    "notavailable",
    "nodata",
    "novalue",
    "signalnotavailable",
    "signalnotavailible",
    "signotavailable",
    "sna",
    "unavailable",
    "valuenotavailable",
    "nichtverfuegbar",
}
_INVALID = {"invalid", "invalidvalue", "signalinvalid"}


#: No whole-number attribute is larger; a time of so many ms still fits 64 bits of ns.
MOST = (1 << 31) - 1


def _fold(label: str) -> str:
    return re.sub(r"[^a-z]", "", label.lower())


def is_not_available(label: str) -> bool:
    """Whether a value's label says that there is no measurement."""
    folded = _fold(label)
    return folded in _NOT_AVAILABLE or folded.endswith("notavailable")


def is_invalid(label: str) -> bool:
    """Whether a label says "invalid", which means not available on the all-ones value only."""
    return _fold(label) in _INVALID


def attribute(entry: Any, name: str, definitions: Any) -> Any:
    """Return an attribute of a message or signal, else its default, else None.

    An ENUM comes as its label, resolved through the file's own list.
    """
    own = entry.dbc.attributes if entry.dbc is not None else None
    definition = definitions.get(name)
    if own and name in own:
        value = own[name].value
        definition = own[name].definition
    elif definition is not None:
        value = definition.default_value
    else:
        return None
    if definition is not None and definition.type_name == "ENUM" and value is not None:
        choices = definition.choices or []
        if value not in choices and str(value).isdecimal() and int(value) < len(choices):
            return choices[int(value)]
    return value


def integer_attribute(entry: Any, name: str, definitions: Any, lowest: int) -> int | None:
    """Return a whole-number attribute or None; raises ValueError naming what it is instead."""
    value = attribute(entry, name, definitions)
    if value is None or value == "":
        return None
    try:
        number = int(value) if isinstance(value, int) else int(float(value))
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"'{value}'") from None
    if not lowest <= number <= MOST:
        raise ValueError(f"{number}")
    return number


def read_send_type(entry: Any, definitions: Any) -> SendType:
    """Return the normalised GenMsgSendType; where it says nothing, what the signals' own types say."""
    label = attribute(entry, "GenMsgSendType", definitions)
    if label is not None and (found := _SEND_TYPES.get(_fold(str(label)))):
        return found
    folded = {
        _fold(str(attribute(signal, "GenSigSendType", definitions))) for signal in entry.signals
    }
    kinds = {_SEND_TYPES[name] for name in folded if name in _SEND_TYPES}
    cyclic = integer_attribute(entry, "GenMsgCycleTime", definitions, 0) or 0
    if SendType.CYCLIC_IF_ACTIVE in kinds:
        return SendType.CYCLIC_IF_ACTIVE
    if kinds & {SendType.ON_CHANGE, SendType.EVENT}:
        return SendType.CYCLIC_AND_CHANGE if cyclic > 0 else SendType.ON_CHANGE
    return SendType.NONE


def read_protection(entry: Any, definitions: Any) -> ProtectionSpec | None:
    """Return the declared protection of a message (docs/protection.md) or None; raises ValueError."""
    profile = attribute(entry, "E2EProfile", definitions)
    if profile is None or profile in ("", "none"):
        return None

    def number(name: str, default: int) -> int:
        try:
            value = integer_attribute(entry, name, definitions, -1)
        except ValueError as error:
            raise ValueError(f"expected {name}: a whole number, got {error}") from error
        return default if value is None else value

    def label(name: str, default: str) -> Any:
        value = attribute(entry, name, definitions)
        return default if value in (None, "") else str(value)

    listed = str(attribute(entry, "E2EDataIDList", definitions) or "")
    try:
        data_ids = tuple(int(word, 0) for word in re.split(r"[\s,;]+", listed.strip()) if word)
    except ValueError:
        raise ValueError(f"expected 16 bytes in E2EDataIDList, got '{listed}'") from None
    width = number("E2ECRCWidth", 8)
    crc = CrcSpec(
        width=width,
        polynomial=number("E2ECRCPolynomial", 0x1D),
        init=number("E2ECRCInit", 0),
        xor=number("E2ECRCXor", 0),
        reflected=number("E2ECRCReflected", 0) == 1,
        big_endian=number("E2ECRCBigEndian", 0) == 1,
        first_byte=number("E2ECRCFirstByte", 0),
        last_byte=number("E2ECRCLastByte", -1),
        own_as_zero=number("E2ECRCOwnAsZero", 0) == 1,
    )
    return ProtectionSpec(
        profile=str(profile),  # type: ignore[arg-type]  # checked by the record itself
        data_id=number("E2EDataID", 0),
        data_id_mode=label("E2EDataIDMode", "both"),
        data_id_list=data_ids,
        crc_offset=number("E2ECRCOffset", -1),
        counter_offset=number("E2ECounterOffset", -1),
        nibble_offset=number("E2EDataIDNibbleOffset", -1),
        max_delta_counter=number("E2EMaxDeltaCounter", 1),
        crc=crc if profile == "custom" else CrcSpec(),
        counter_length=number("E2ECounterLength", 4) if profile == "custom" else 4,
        counter_max=number("E2ECounterMax", -1) if profile == "custom" else -1,
        counter_big_endian=profile == "custom" and number("E2ECounterBigEndian", 0) == 1,
        data_id_position=label("E2EDataIDPosition", "none") if profile == "custom" else "none",
    )
