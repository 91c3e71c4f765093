"""Encoding and decoding beside cantools, in one run: python benchmarks/codec.py [DBC].

Prints microseconds per message (per call for the whole set) and the ratio.  Each figure is the
median of interleaved rounds, so that a busy machine slows both sides alike.
"""

from __future__ import annotations

import logging
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cantools.database.can
import numpy as np

from hev_can_emu.messages.codec import M_LENGTH, build_codec, encode
from hev_can_emu.messages.database import load_database
from hev_can_emu.messages.frame import make_frames
from hev_can_emu.messages.named import NamedCodec
from hev_can_emu.messages.protection import build_protection
from hev_can_emu.messages.restbus import build_restbus, reset_restbus, restbus_state_size, trigger
from hev_can_emu.messages.transfer import transmit

ROUNDS = 15


def synthetic() -> str:
    """Return 20 messages of 8 byte-sized signals each."""
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: A B", ""]
    for m in range(20):
        lines.append(f"BO_ {256 + m} M{m}: 8 A")
        lines += [f' SG_ S{m}_{n} : {8 * n}|8@1+ (0.5,-40) [-40|86] "u" B' for n in range(8)]
        lines.append("")
    return "\n".join(lines) + "\n"


def seconds(call: Callable[[], object], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count


def compare(title: str, theirs: Callable[[], object], ours: Callable[[], object], n: int) -> None:
    theirs(), ours()
    pairs = [(seconds(theirs, n), seconds(ours, 4 * n)) for _ in range(ROUNDS)]
    a, b = (statistics.median(column) for column in zip(*pairs, strict=True))
    print(f"{title:<44} {a * 1e6:9.2f} us {b * 1e6:8.2f} us {a / b:7.1f} x")


def main() -> None:
    """Compare on a DBC file, or on a synthetic network of 20 messages with 8 signals."""
    logging.getLogger("cantools").setLevel(logging.CRITICAL)
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    if path is None:
        import tempfile

        path = Path(tempfile.mkdtemp()) / "synthetic.dbc"
        path.write_text(synthetic())
    database = load_database(path)
    reference = cantools.database.can.Database()
    reference.add_dbc_string(path.read_text())
    named, codec = NamedCodec(database), build_codec(database)
    count = len(database.messages)
    everything = {
        message.name: {
            signal.name: signal.raw_range[0] * signal.scale + signal.offset
            if signal.minimum is None
            else signal.minimum
            for signal in message.signals
        }
        for message in database.messages
    }
    message = max(database.messages, key=lambda entry: len(entry.signals))
    theirs, values = reference.get_message_by_name(message.name), everything[message.name]
    data = theirs.encode(values)
    assert data == named.encode_message(message.name, values)
    print(f"{path.name}: {count} messages; {message.name} has {len(message.signals)} signals")
    print(f"{'':<44} {'cantools':>12} {'here':>11}")
    name, can_id = message.name, message.can_id
    compare(
        "encode, names and values",
        lambda: theirs.encode(values),
        lambda: named.encode_message(name, values),
        500,
    )
    compare(
        "encode, cantools unchecked (strict=False)",
        lambda: theirs.encode(values, strict=False),
        lambda: named.encode_message(name, values),
        500,
    )
    compare(
        "decode, names and values",
        lambda: theirs.decode(data, decode_choices=False),
        lambda: named.decode_message(can_id, data),
        500,
    )

    vector = np.full(len(database.signals), np.nan)
    for entry in database.messages:
        for signal in entry.signals:
            vector[signal.index] = everything[entry.name][signal.name]
    on_bus, buffer = vector.copy(), np.zeros(64, dtype=np.uint8)
    for entry in database.messages:
        encode(codec, entry.index, vector, buffer, on_bus)
        raw = reference.get_message_by_name(entry.name).encode(everything[entry.name])
        assert bytes(buffer[: codec.messages[entry.index, M_LENGTH]]) == raw
    protection = build_protection([entry.protection for entry in database.messages])
    restbus = build_restbus(database)
    state = np.zeros(restbus_state_size(restbus), dtype=np.int64)
    enabled, frames = np.ones(count, dtype=np.uint8), make_frames(count)
    reset_restbus(restbus, state, 0)
    sent = 0

    def send_all() -> None:
        nonlocal sent
        state.reshape(count, -1)[:, trigger_column] = 1
        sent = transmit(
            codec, protection, restbus, state, enabled, vector, on_bus, 0, frames, 0, count
        )

    trigger(state, 0)
    trigger_column = int(np.flatnonzero(state)[0]) if state.any() else 0
    trigger_column = int(np.argmax(state.reshape(count, -1)[0] == 1))
    pairs = [(reference.get_message_by_name(key), item) for key, item in everything.items()]
    compare(
        f"all {count} messages (here with schedule, CRC)",
        lambda: [entry.encode(item) for entry, item in pairs],
        send_all,
        20,
    )
    assert sent == count


if __name__ == "__main__":
    main()
