"""Encoding and decoding beside cantools, in one run: python benchmarks/codec.py [DBC ...].

Prints microseconds of processor time per call and the ratio.  Each figure is the median of interleaved
rounds, so that a busy machine slows both sides alike; every round has values of its own.  Bytes are compared
before anything is timed.
"""

from __future__ import annotations

import logging
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cantools.database.can
from e2e import p11

from hev_can_emu.messages.database import Database, load_database
from hev_can_emu.messages.definitions import SignalDef
from hev_can_emu.messages.named import NamedCodec
from hev_can_emu.messages.transmit_set import TransmitSet
from hev_can_emu.resources import folder

ROUNDS = 25
Values = dict[str, dict[str, float]]


def synthetic() -> Path:
    """Write a network of 20 messages with 8 byte-sized signals each; return its path."""
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: A B", ""]
    for m in range(20):
        lines.append(f"BO_ {256 + m} M{m}: 8 A")
        lines += [f' SG_ S{m}_{n} : {8 * n}|8@1+ (0.5,-40) [-40|86] "u" B' for n in range(8)]
        lines.append("")
    path = Path(tempfile.mkdtemp()) / "synthetic.dbc"
    path.write_text("\n".join(lines) + "\n")
    return path


def draw(rng: random.Random, signal: SignalDef) -> float:
    """Return an encodable value inside the declared range."""
    low, high = signal.raw_range
    if signal.minimum is not None and signal.maximum is not None:
        low = max(low, round((signal.minimum - signal.offset) / signal.scale))
        high = min(high, round((signal.maximum - signal.offset) / signal.scale))
    raw = rng.randint(low, high)
    return (low if raw == signal.not_available else raw) * signal.scale + signal.offset


def seconds(call: Callable[[], object], count: int) -> float:
    start = time.thread_time()
    for _ in range(count):
        call()
    return (time.thread_time() - start) / count


class Bench:
    """One network on both sides, with values that change from round to round."""

    def __init__(self, path: Path) -> None:
        self.database: Database = load_database(path)
        self.reference: Any = cantools.database.can.Database()
        self.reference.add_dbc_string(path.read_text(encoding="utf-8"))
        self.named = NamedCodec(self.database)
        self.set = TransmitSet(self.database)
        self.protected = TransmitSet(self.database, protected=True)
        self.rng = random.Random(1)
        self.pairs: list[tuple[Any, dict[str, float]]] = []
        self.largest = max(self.database.messages, key=lambda message: len(message.signals))

    def renew(self) -> None:
        """Draw new values and check that both sides make the same bytes of them."""
        self.pairs = []
        for message in self.database.messages:
            values = {signal.name: draw(self.rng, signal) for signal in message.signals}
            self.pairs.append((self.reference.get_message_by_name(message.name), values))
            for signal in message.signals:
                for one in (self.set, self.protected):
                    one.values[signal.index] = values[signal.name]
        self.set.encode()
        for (theirs, values), frame in zip(self.pairs, self.set.frames, strict=True):
            data = theirs.encode(values)
            assert data == frame["data"][: len(data)].tobytes(), theirs.name
            assert data == self.named.encode_message(theirs.name, values), theirs.name

    def compare(self, title: str, make: Callable[[], tuple[Any, Any]], count: int) -> None:
        """Time what ``make`` returns for both sides, anew each round, and print a row."""
        rows = []
        for _ in range(ROUNDS):
            self.renew()
            theirs, ours = make()
            theirs(), ours()
            rows.append((seconds(theirs, count), seconds(ours, 10 * count)))
        a, b = (statistics.median(column) * 1e6 for column in zip(*rows, strict=True))
        ratio = statistics.median(theirs / ours for theirs, ours in rows)
        print(f"{title:<58} {a:9.2f} us {b:8.3f} us {ratio:7.1f} x")

    def run(self) -> None:
        """Print the table of one network."""
        place = self.largest.index
        count = len(self.database.messages)
        print(
            f"{self.database.path.name}: {count} messages, {len(self.database.signals)} signals; "
            f"{self.largest.name} has {len(self.largest.signals)}"
        )
        print(f"{'':<58} {'cantools':>12} {'here':>11}")

        def encode() -> tuple[Any, Any]:
            theirs, values = self.pairs[place]
            name, make = self.largest.name, self.named.encode_message
            return lambda: theirs.encode(values), lambda: make(name, values)

        def encode_unchecked() -> tuple[Any, Any]:
            theirs, values = self.pairs[place]
            name, make = self.largest.name, self.named.encode_message
            return lambda: theirs.encode(values, strict=False), lambda: make(name, values)

        def decode() -> tuple[Any, Any]:
            theirs, values = self.pairs[place]
            data = theirs.encode(values)
            key, extended, read = (
                self.largest.can_id,
                self.largest.extended,
                self.named.decode_message,
            )
            return lambda: theirs.decode(data, decode_choices=False), lambda: read(
                key, data, extended
            )

        def whole() -> tuple[Any, Any]:
            pairs = self.pairs
            return lambda: [theirs.encode(values) for theirs, values in pairs], self.set.encode

        def guarded() -> tuple[Any, Any]:
            triples = [
                (*pair, message.protection.data_id if message.protection else 0)
                for pair, message in zip(self.pairs, self.database.messages, strict=True)
            ]

            def theirs() -> None:
                for message, values, data_id in triples:
                    data = bytearray(message.encode(values))
                    p11.e2e_p11_protect(data, data_id)

            return theirs, self.protected.encode

        self.compare("encode, names and values in, bytes out", encode, 300)
        self.compare("encode, cantools unchecked (strict=False)", encode_unchecked, 300)
        self.compare("decode, bytes in, names and values out", decode, 300)
        self.compare(f"encode all {count} messages in one call", whole, 20)
        if all(m.protection and m.protection.profile == "P11" for m in self.database.messages):
            self.compare("... with counters and CRCs (theirs: autosar-e2e)", guarded, 20)
        print()


def main() -> None:
    """Compare on the DBC files named, else on the shipped network and a synthetic one."""
    logging.getLogger("cantools").setLevel(logging.CRITICAL)
    for path in map(Path, sys.argv[1:] or (folder("dbc") / "hev.dbc", synthetic())):
        Bench(path).run()


if __name__ == "__main__":
    main()
