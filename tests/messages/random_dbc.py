"""Random but valid DBC texts, and values that fit their signals."""

from __future__ import annotations

import random
import re

HEADER = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A B\n\n'
FD_SIZES = (12, 16, 20, 24, 32, 48, 64)


def bits_of(start: int, length: int, little: bool) -> list[int] | None:
    """Return the bits a signal covers, or None where it leaves bit 0 downward."""
    if little:
        return list(range(start, start + length))
    first = 8 * (start // 8) + 7 - start % 8
    return [8 * (n // 8) + 7 - n % 8 for n in range(first, first + length)]


class Layout:
    """Finds free places for signals in a message."""

    def __init__(self, rng: random.Random, size: int) -> None:
        self.rng, self.size = rng, size
        self.used: set[int] = set()

    def place(self, length: int, little: bool) -> int | None:
        for _ in range(30):
            start = self.rng.randrange(8 * self.size)
            bits = bits_of(start, length, little)
            if max(bits) < 8 * self.size and self.used.isdisjoint(bits):
                self.used.update(bits)
                return start
        return None


def random_signal(rng: random.Random, layout: Layout, name: str, mux: str = "", small: int = 0):
    """Return (SG_ line, extra lines with {id}) or None."""
    little = rng.random() < 0.5
    floating = not small and rng.random() < 0.2
    if small:
        length, signed = small, False
    elif floating:
        length, signed = rng.choice((16, 32, 64)), True
    else:
        length = rng.choice((1, 2, 3, 7, 8, 9, 12, 15, 16, 17, 24, 31, 32, 33, 40, 53, 57, 63, 64))
        signed = rng.random() < 0.5
    start = layout.place(length, little)
    if start is None:
        return None
    scale = 1 if small else rng.choice((1, 1, 2, 0.1, 0.5, 0.125, 0.01, -1, -0.25, 3, 1e-3, 7.7))
    offset = 0 if small else rng.choice((0, 0, -40, 1, 0.5, -1000, 273.15, 12345))
    extra = []
    limits = "[0|0]"
    if floating:
        extra.append(f"SIG_VALTYPE_ {{id}} {name} : {2 if length == 64 else 1};")
    elif not small:
        low, high = (
            (-(1 << length - 1), (1 << length - 1) - 1) if signed else (0, (1 << length) - 1)
        )
        if rng.random() < 0.5 and length > 2:
            a, b = sorted((rng.randint(low, high), rng.randint(low, high)))
            ends = sorted((a * scale + offset, b * scale + offset))
            limits = f"[{ends[0]:.12g}|{ends[1]:.12g}]"
        if rng.random() < 0.4 and 1 < length < 33:
            labels = {rng.randint(low, high): f"L{n}" for n in range(3)}
            labels[-1 if signed else high] = "SNA"
            text = " ".join(f'{raw} "{label}"' for raw, label in labels.items())
            extra.append(f"VAL_ {{id}} {name} {text} ;")
    line = (
        f" SG_ {name} {mux}{' ' if mux else ''}: {start}|{length}@{int(little)}{'-' if signed else '+'} "
        f'({scale},{offset}) {limits} "u" B'
    )
    return line, extra


def random_message(rng: random.Random, number: int) -> tuple[list[str], list[str]]:
    """Return the lines of one message and its extra lines."""
    extended = rng.random() < 0.3
    can_id = 0x100 + number if not extended else 0x80000000 | (0x18FF0000 + number)
    fd = rng.random() < 0.3
    size = rng.choice(FD_SIZES) if fd else rng.randint(1, 8)
    name = f"M{number}"
    lines, extra = [f"BO_ {can_id} {name}: {size} A"], []
    layout = Layout(rng, size)

    def add(signal_name: str, mux: str = "", small: int = 0, place: Layout = layout) -> bool:
        made = random_signal(rng, place, signal_name, mux, small)
        if made is None:
            return False
        lines.append(made[0])
        extra.extend(line.format(id=can_id) for line in made[1])
        return True

    kind = rng.random()
    if kind < 0.3 and size >= 3:  # simple multiplexing: M, m0, m1, ...
        if add("Mux", "M", small=rng.choice((2, 3, 4))):
            for selector in range(3):
                branch = Layout(rng, size)
                branch.used = set(layout.used)
                for n in range(rng.randint(1, 2)):
                    add(f"X{selector}_{n}", f"m{selector}", place=branch)
        lines[2:] = sorted(lines[2:], key=lambda _: rng.random())
        used = set(range(8 * size))  # branches may use every bit
        layout.used = used
    elif kind < 0.5 and size >= 6:  # extended multiplexing, two levels, ranges of selectors
        if add("Outer", "M", small=3) and add("Inner", "m1M", small=3) and add("Leaf", "m2"):
            extra.append(f"SG_MUL_VAL_ {can_id} Inner Outer 1-1, 3-4;")
            extra.append(f"SG_MUL_VAL_ {can_id} Leaf Inner 0-2, 5-7;")
        else:
            lines[1:] = []
            extra.clear()
            layout.used = set()
            add("Plain")
    for n in range(rng.randint(1, 8)):
        add(f"S{n}")
    if fd:
        extra.append(f'BA_ "VFrameFormat" BO_ {can_id} {15 if extended else 14};')
    elif extended:
        extra.append(f'BA_ "VFrameFormat" BO_ {can_id} 1;')
    return lines, extra


def random_dbc(rng: random.Random, messages: int = 3) -> str:
    """Return the text of a DBC file with several messages of all kinds."""
    blocks, extras = [], []
    for number in range(messages):
        lines, extra = random_message(rng, number)
        blocks.append("\n".join(lines))
        extras += extra
    kinds = ["StandardCAN", "ExtendedCAN", *["reserved"] * 12, "StandardCAN_FD", "ExtendedCAN_FD"]
    formats = ",".join(f'"{kind}"' for kind in kinds)
    attributes = (
        f'BA_DEF_ BO_ "VFrameFormat" ENUM {formats};\nBA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
    )
    order = ("BA_ ", "VAL_ ", "SIG_VALTYPE_ ", "SG_MUL_VAL_ ")
    tail = [line for prefix in order for line in extras if line.startswith(prefix)]
    return HEADER + "\n\n".join(blocks) + "\n\n" + attributes + "\n".join(tail) + "\n"


_TOKENS = (
    "BO_", "SG_", "BA_", "VAL_", "SG_MUL_VAL_", "SIG_VALTYPE_", "m1M", "nan", "inf", "1e400", "-1", "65",
    "99999999999999999999", '"', "(", ")", "|", "@", ";", ":", "\n", "é", "\0",
)  # fmt: skip
_NUMBERS = ("0", "-1", "64", "65", "255", "99999", "2147483648", "18446744073709551616", "1e999")


def mutated(rng: random.Random, text: str) -> str:
    """Return a DBC text cut off, or with pieces changed, lost, doubled, swapped."""
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(text) + 1)
        end = at + rng.randint(0, 12)
        match rng.randrange(7):
            case 0:
                text = text[:at]
            case 1:
                text = text[:at] + rng.choice(_TOKENS) + text[at:]
            case 2:
                text = text[:at] + rng.choice(_TOKENS) + text[end:]
            case 3:
                text = text[:at] + text[end:]
            case 4:
                lines = text.split("\n")
                lines.insert(rng.randrange(len(lines)), rng.choice(lines))
                text = "\n".join(lines)
            case 5:
                lines = text.split("\n")
                rng.shuffle(lines)
                text = "\n".join(lines)
            case _:
                numbers = list(re.finditer(r"-?\d+", text))
                if numbers:
                    one = rng.choice(numbers)
                    text = text[: one.start()] + rng.choice(_NUMBERS) + text[one.end() :]
    return text
