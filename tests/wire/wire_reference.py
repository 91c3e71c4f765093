"""A frame's bits written out one by one, CRC included: code of its own to compare with."""

from __future__ import annotations

from hev_can_emu.messages.frame import BRS, EXTENDED, FD, REMOTE

LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # by data length code
GRAY = ("000", "001", "011", "010", "110", "111", "101", "100")


def crc(bits: str, polynomial: int, width: int, start: int = 0) -> int:
    register = start
    for bit in bits:
        carry = (register >> (width - 1)) & 1
        register = (register << 1) & ((1 << width) - 1)
        if carry != int(bit):
            register ^= polynomial
    return register


def stuffed(bits: str, *, at_end: bool) -> str:
    """Insert the opposite of any five equal bits after them."""
    out = ""
    for bit in bits:
        if len(out) >= 5 and len(set(out[-5:])) == 1:
            out += str(1 - int(out[-1]))
        out += bit
    if at_end and len(set(out[-5:])) == 1:
        out += str(1 - int(out[-1]))
    return out


def written_out(can_id: int, flags: int, data: bytes) -> tuple[str, str]:
    """Return the bits sent at the nominal rate, and those sent at the data rate."""
    remote = "1" if flags & REMOTE else "0"
    extended = bool(flags & EXTENDED)
    identifier = f"{can_id:029b}" if extended else f"{can_id:011b}"
    head = "0" + identifier[:11] + ("11" + identifier[11:] if extended else "")
    code = f"{LENGTHS.index(len(data)):04b}"
    payload = "".join(f"{byte:08b}" for byte in data)
    if not flags & FD:
        head += remote + "00" + code
        body = head + ("" if flags & REMOTE else payload)
        body += f"{crc(body, 0x4599, 15):015b}"
        return stuffed(body, at_end=True) + "1" + "01" + "1" * 7, ""
    head += "0" + ("" if extended else "0") + "10" + ("1" if flags & BRS else "0")
    whole = stuffed(head + "0" + code + payload, at_end=False)
    before = stuffed(head, at_end=False)
    count = len(whole) - len(head + "0" + code + payload)
    gray = GRAY[count % 8]
    sequence = gray + str(gray.count("1") % 2)
    width, polynomial = (17, 0x1685B) if len(data) <= 16 else (21, 0x102899)
    check = crc(whole + sequence, polynomial, width, 1 << (width - 1))
    field = sequence + f"{check:0{width}b}"
    fixed = ""
    for place in range(0, len(field), 4):
        fixed += str(1 - int((whole + fixed)[-1])) + field[place : place + 4]
    fast, slow = whole[len(before) :] + fixed + "1", "01" + "1" * 7
    return (before + slow, fast) if flags & BRS else (before + fast + slow, "")
