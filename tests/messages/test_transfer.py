"""Whole frames: what is sent, protected, received, refused and counted."""

from pathlib import Path

import numpy as np
import pytest

from hev_can_emu.messages.codec import build_codec, encode
from hev_can_emu.messages.database import Database, load_database
from hev_can_emu.messages.frame import BRS, ERROR, EXTENDED, FD, REMOTE, SENT, make_frames
from hev_can_emu.messages.protection import (
    COUNTER_JUMP,
    COUNTER_REPEATED,
    CRC_WRONG,
    ENFORCE,
    FIRST,
    LENGTH_WRONG,
    OBSERVE,
    OFF,
    OK,
    build_protection,
)
from hev_can_emu.messages.restbus import (
    T_COLUMNS,
    T_COUNTER,
    T_SATURATED,
    T_SENT,
    build_restbus,
    reset_restbus,
    restbus_state_size,
)
from hev_can_emu.messages.transfer import (
    X_ACCEPTED,
    X_COLUMNS,
    X_CRC,
    X_JUMP,
    X_LENGTH,
    X_RANGE,
    X_REPEATED,
    receive,
    receive_state_size,
    reset_receive,
    transmit,
)

MS = 1_000_000
TEXT = """VERSION ""

NS_ :

BS_:

BU_: A B

BO_ 256 Speed: 8 A
 SG_ CRC : 0|8@1+ (1,0) [0|255] "" B
 SG_ Counter : 8|4@1+ (1,0) [0|14] "" B
 SG_ Value : 16|16@1+ (0.5,-1000) [-1000|10000] "rpm" B
 SG_ Mode : 12|3@1+ (1,0) [0|5] "" B

BO_ 2564089600 Wide: 9 A
 SG_ Number : 7|32@0- (1,0) [0|0] "" B

BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","r","r","r","r","r","r","r","r","r","r","r","r","StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";
BA_DEF_ BO_ "E2EProfile" ENUM "none","P01","P02","P05","P11","P22","custom";
BA_DEF_ BO_ "E2EDataID" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_DEF_DEF_ "CANFD_BRS" "0";
BA_DEF_DEF_ "E2EProfile" "none";
BA_DEF_DEF_ "E2EDataID" 0;
BA_ "E2EProfile" BO_ 256 4;
BA_ "E2EDataID" BO_ 256 291;
BA_ "VFrameFormat" BO_ 2564089600 15;
BA_ "CANFD_BRS" BO_ 2564089600 1;
VAL_ 256 Value 65535 "SNA" ;
"""  # noqa: E501


@pytest.fixture
def database(tmp_path: Path) -> Database:
    path = tmp_path / "net.dbc"
    path.write_text(TEXT)
    return load_database(path)


class Node:
    """Sender and receiver of the same database."""

    def __init__(self, database: Database, mode: int = ENFORCE) -> None:
        self.database, self.mode = database, mode
        self.codec = build_codec(database)
        self.protection = build_protection([m.protection for m in database.messages])
        self.restbus = build_restbus(database)
        self.state = np.zeros(restbus_state_size(self.restbus), dtype=np.int64)
        reset_restbus(self.restbus, self.state, 0)
        self.rx_state = np.zeros(receive_state_size(self.codec), dtype=np.int64)
        reset_receive(self.codec, self.rx_state)
        self.all = np.ones(len(database.messages), dtype=np.uint8)
        self.values = np.full(len(database.signals), np.nan)
        self.on_bus = self.values.copy()
        self.received = self.values.copy()
        self.frames = make_frames(8)
        self.count = 0

    def send(self, t_ms: int, capacity: int = 8) -> np.ndarray:
        self.count = transmit(
            self.codec,
            self.protection,
            self.restbus,
            self.state,
            self.all,
            self.values,
            self.on_bus,
            t_ms * MS,
            self.frames,
            0,
            capacity,
        )
        return self.frames[: self.count].copy()

    def take(self, frame: np.ndarray, sent: bool = False) -> tuple[int, int]:
        buffer = make_frames(1)
        buffer[0] = frame
        if not sent:
            buffer["flags"] &= 255 - SENT
        message, code = receive(
            self.codec,
            self.protection,
            self.rx_state,
            self.all,
            self.mode,
            buffer,
            0,
            self.received,
        )
        return int(message), int(code)

    def seen(self, column: int, message: int = 0) -> int:
        return int(self.rx_state[message * X_COLUMNS + column])

    def collect(self, can_id: int, count: int) -> list[np.ndarray]:
        found: list[np.ndarray] = []
        t = 0
        while len(found) < count and t < 10_000:
            found += [frame for frame in self.send(t) if frame["id"] == can_id]
            t += 1
        return found


def set_value(node: Node, name: str, value: float) -> int:
    index = node.database.signal(name).index
    node.values[index] = value
    return index


def test_a_frame_carries_everything(database: Database) -> None:
    node = Node(database)
    value = set_value(node, "Value", 123.4)
    set_value(node, "Mode", 3)
    frame = node.collect(0x100, 1)[0]
    assert frame["flags"] == SENT
    assert frame["length"] == 8
    # raw 2247 = round((123.4 + 1000) / 0.5), mode 3 in bits 12..14, counter 0
    assert bytes(frame["data"][1:8]).hex() == "30c70800000000"
    assert node.on_bus[value] == 123.5
    assert node.on_bus[database.signal("CRC").index] == frame["data"][0]
    assert node.on_bus[database.signal("Counter").index] == 0
    assert node.take(frame) == (0, FIRST)
    assert node.received[value] == 123.5


def test_fd_flags_and_padded_length(database: Database) -> None:
    node = Node(database)
    number = set_value(node, "Number", -2)
    frame = node.collect(0x18D4E700, 1)[0]
    assert frame["flags"] == EXTENDED | FD | BRS | SENT
    assert frame["length"] == 12, "9 bytes do not fit a DLC"
    assert bytes(frame["data"]).hex() == "fffffffe" + 60 * "00"
    assert node.take(frame) == (1, OK)
    assert node.received[number] == -2


def test_counter_advances_with_each_frame_only(database: Database) -> None:
    node = Node(database)
    frames = node.collect(0x100, 17)
    assert [int(frame["data"][1] & 15) for frame in frames] == [*range(15), 0, 1]
    node.all[0] = 0
    before = node.state[T_COUNTER]
    for t in range(1000, 1100):
        assert all(frame["id"] != 0x100 for frame in node.send(t))
    assert node.state[T_COUNTER] == before


def test_full_buffer_keeps_messages_due(database: Database) -> None:
    node = Node(database)
    assert len(node.send(1000, capacity=1)) == 1
    assert len(node.send(1000, capacity=8)) == 1
    assert node.state.reshape(-1, T_COLUMNS)[:, T_SENT].tolist() == [1, 1]


def test_saturation_is_counted_and_stays_below_not_available(database: Database) -> None:
    node = Node(database)
    value = set_value(node, "Value", 1e9)
    set_value(node, "Mode", 6.0)
    set_value(node, "CRC", 0)
    set_value(node, "Counter", 0)
    node.collect(0x100, 1)
    assert node.state[T_SATURATED] == 2
    assert node.on_bus[value] == 10000.0


def test_not_available_crosses_the_bus(database: Database) -> None:
    node = Node(database)
    value = database.signal("Value").index
    node.received[value] = 1.0
    frame = node.collect(0x100, 1)[0]
    assert bytes(frame["data"][2:4]) == b"\xff\xff"
    node.take(frame)
    assert np.isnan(node.received[value])


def test_the_physical_value_of_not_available_is_never_sent(tmp_path: Path) -> None:
    path = tmp_path / "net.dbc"
    path.write_text(TEXT.replace("[-1000|10000]", "[0|0]"))
    database = load_database(path)
    node = Node(database)
    data, value = np.zeros(8, dtype=np.uint8), set_value(node, "Value", 65535 * 0.5 - 1000)
    assert encode(node.codec, 0, node.values, data, node.on_bus) == 1
    assert node.on_bus[value] == 65534 * 0.5 - 1000


def test_bad_frames_are_told_and_not_used(database: Database) -> None:
    node = Node(database)
    value = set_value(node, "Value", 50)
    first, second, third, fourth, fifth = node.collect(0x100, 5)
    assert node.take(first) == (0, FIRST)
    node.received[value] = -1.0

    broken = second.copy()
    broken["data"][3] ^= 1
    assert node.take(broken) == (0, CRC_WRONG)
    short = second.copy()
    short["length"] = 7
    assert node.take(short) == (0, LENGTH_WRONG)
    assert node.take(first) == (0, COUNTER_REPEATED)
    assert node.take(fourth) == (0, COUNTER_JUMP)
    assert node.received[value] == -1.0, "none of these may be used"
    assert node.take(fifth) == (0, OK)
    assert node.received[value] == 50.0
    assert node.seen(X_ACCEPTED) == 2
    assert [node.seen(c) for c in (X_CRC, X_LENGTH, X_REPEATED, X_JUMP)] == [1, 1, 1, 1]
    assert third["id"] == 0x100


def test_observe_tells_but_uses(database: Database) -> None:
    node = Node(database, OBSERVE)
    value = set_value(node, "Value", 50)
    frame = node.collect(0x100, 1)[0]
    frame["data"][0] ^= 0xFF
    assert node.take(frame) == (0, CRC_WRONG)
    assert node.received[value] == 50.0


def test_off_checks_nothing_but_the_length(database: Database) -> None:
    node = Node(database, OFF)
    frame = node.collect(0x100, 1)[0]
    frame["data"][0] ^= 0xFF
    assert node.take(frame) == (0, OK)
    frame["length"] = 3
    assert node.take(frame) == (0, LENGTH_WRONG)


def test_values_out_of_range_are_counted(database: Database) -> None:
    node = Node(database, OFF)
    frame = node.collect(0x100, 1)[0]
    frame["data"][1] = 0x70  # mode 7 of 0 to 5
    frame["data"][2:4] = (0xFE, 0xFF)  # beyond 10000, not the not-available value
    assert node.take(frame) == (0, OK)
    assert node.seen(X_RANGE) == 2


def test_what_is_ignored(database: Database) -> None:
    node = Node(database)
    frame = node.collect(0x100, 1)[0]
    assert node.take(frame, sent=True) == (-1, OK)
    for flag in (REMOTE, ERROR, EXTENDED):
        other = frame.copy()
        other["flags"] = flag
        assert node.take(other) == (-1, OK)
    other = frame.copy()
    other["id"] = 0x101
    assert node.take(other) == (-1, OK)
    node.all[0] = 0
    assert node.take(frame) == (-1, OK)
    assert np.isnan(node.received).all()
