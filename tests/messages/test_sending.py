"""When messages go out, from a DBC's own attributes to the times of the frames.

Every maker numbers its send types otherwise: the labels count, looked up in the file's own list.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hev_can_emu.messages.codec import build_codec
from hev_can_emu.messages.database import load_database
from hev_can_emu.messages.frame import BRS, EXTENDED, FD, make_frames
from hev_can_emu.messages.protection import build_protection
from hev_can_emu.messages.restbus import (
    awake,
    build_restbus,
    new_wake,
    reset_restbus,
    restbus_state_size,
)
from hev_can_emu.messages.transfer import transmit, transmit_these

MS = 1_000_000
FORMATS = ",".join(
    [
        '"StandardCAN"',
        '"ExtendedCAN"',
        *['"reserved"'] * 12,
        '"StandardCAN_FD"',
        '"ExtendedCAN_FD"',
    ]
)
NUMBERS = ("GenMsgCycleTime", "GenMsgCycleTimeFast", "GenMsgNrOfRepetition", "GenMsgStartDelayTime")
# The same five meanings as three makers label and number them.
LABELS = {
    "numbered from cyclic": ("Cyclic", "OnChange", "CyclicAndSpontaneous", "CyclicWithFastPeriod", "Event"),
    "cyclic in the middle": ("spontaneous", "IfActive", "cyclicX", "cyclicAndSpontanWithDelay", "OnChange"),
    "with spaces": ("Event Triggered", "On Change", "Periodic", "Cyclic If Active", "Cyclic And On Change"),
}  # fmt: skip
MEANING = {
    "Cyclic": "cyclic", "cyclicX": "cyclic", "Periodic": "cyclic",
    "OnChange": "change", "On Change": "change",
    "CyclicAndSpontaneous": "both", "cyclicAndSpontanWithDelay": "both", "Cyclic And On Change": "both",
    "CyclicWithFastPeriod": "active", "IfActive": "active", "Cyclic If Active": "active",
    "Event": "event", "spontaneous": "event", "Event Triggered": "event",
}  # fmt: skip


def dbc(labels: tuple[str, ...]) -> str:
    """Return a network with one message per label, named after its meaning."""
    listed = ",".join(f'"{label}"' for label in ("NoMsgSendType", *labels))
    lines = ['VERSION ""', "BU_: A B"]
    tail = []
    for n, label in enumerate(labels):
        can_id, name = 256 + n, MEANING[label]
        lines += [f"BO_ {can_id} {name}: 8 A", f' SG_ S_{name} : 0|8@1+ (1,0) [0|255] "" B']
        cycle = 0 if name in ("change", "event") else 20
        tail += [
            f'BA_ "GenMsgSendType" BO_ {can_id} {n + 1};',
            f'BA_ "GenMsgCycleTime" BO_ {can_id} {cycle};',
            f'BA_ "GenMsgStartDelayTime" BO_ {can_id} 3;',
        ]
        if name in ("active", "event"):
            tail.append(f'BA_ "GenMsgCycleTimeFast" BO_ {can_id} 5;')
        if name == "event":
            tail.append(f'BA_ "GenMsgNrOfRepetition" BO_ {can_id} 2;')
    return (
        "\n".join(
            [
                *lines,
                f'BA_DEF_ BO_ "GenMsgSendType" ENUM {listed};',
                *(
                    f'BA_DEF_ BO_ "{name}" INT 0 60000;\nBA_DEF_DEF_ "{name}" 0;'
                    for name in NUMBERS
                ),
                'BA_DEF_DEF_ "GenMsgSendType" "NoMsgSendType";',
                *tail,
            ]
        )
        + "\n"
    )


def run(
    path: Path, until_ms: int, value_at: Callable[[int], float]
) -> tuple[dict[str, list[int]], np.ndarray]:
    """Send for a while, every signal being ``value_at`` each ms; return times by message, and all frames."""
    database = load_database(path)
    codec, restbus = build_codec(database), build_restbus(database)
    protection = build_protection([message.protection for message in database.messages])
    state = np.zeros(restbus_state_size(restbus), dtype=np.int64)
    reset_restbus(restbus, state, 0)
    enabled = np.ones(len(database.messages), dtype=np.uint8)
    values = np.zeros(len(database.signals))
    on_bus = np.full(len(database.signals), 0.0)
    frames = make_frames(len(database.messages))
    # The same again as a run does it: only what may be due is looked at.
    words = build_protection(
        [m.protection for m in database.messages], [m.length for m in database.messages]
    )
    state2, on_bus2 = state.copy(), on_bus.copy()
    wake, looked_at = (
        new_wake(len(database.messages)),
        np.zeros(len(database.messages), dtype=np.int64),
    )
    frames2 = make_frames(len(database.messages))
    times: dict[str, list[int]] = {message.name: [] for message in database.messages}
    everything = []
    for t in range(until_ms):
        values[:] = value_at(t)
        count = transmit(
            codec,
            protection,
            restbus,
            state,
            enabled,
            values,
            on_bus,
            t * MS,
            frames,
            0,
            len(frames),
        )
        looked = awake(restbus, wake, t * MS, looked_at)
        count2 = transmit_these(
            codec, words, restbus, state2, enabled, values, on_bus2, t * MS, frames2, 0, looked_at,
            looked, wake,
        )  # fmt: skip
        assert frames2[:count2].tobytes() == frames[:count].tobytes()
        assert [database.messages[m].can_id for m in looked_at[:count2]] == frames["id"][
            :count
        ].tolist()
        np.testing.assert_array_equal(on_bus2, on_bus)
        for frame in frames[:count]:
            name = next(m.name for m in database.messages if m.can_id == frame["id"])
            times[name].append(t)
        everything.append(frames[:count].copy())
    return times, np.concatenate(everything)


@pytest.mark.parametrize("maker", LABELS)
def test_send_types_by_their_labels(tmp_path: Path, maker: str) -> None:
    path = tmp_path / "net.dbc"
    path.write_text(dbc(LABELS[maker]))
    # The value leaves its start value, 0, at 31 ms and is back at 71 ms.
    times, _ = run(path, 100, lambda t: 9.0 if 31 <= t < 71 else 0.0)
    expected = {
        "cyclic": [3, 23, 43, 63, 83],
        "change": [31, 71],
        "both": [3, 23, 31, 43, 63, 71, 83],
        "active": [3, 23, *range(31, 71, 5), 91],
        "event": [31, 36, 41, 71, 76, 81],
    }
    assert times == {name: expected[name] for name in times}
    assert set(times) <= set(expected)
    assert len(times) == 5


def test_a_label_that_says_nothing_leaves_the_cycle_time(tmp_path: Path) -> None:
    path = tmp_path / "net.dbc"
    text = dbc(("Cyclic",)).replace('"Cyclic"', '"vendor special"')
    path.write_text(text)
    assert run(path, 50, lambda t: 0.0)[0] == {"cyclic": [3, 23, 43]}


def test_the_bus_is_not_hit_at_once(tmp_path: Path) -> None:
    """Forty messages of 10, 20 and 50 ms without start delays: never more than their mean, rounded up."""
    periods = [10] * 12 + [20] * 20 + [50] * 8
    lines = ['VERSION ""', "BU_: A"]
    lines += [f"BO_ {256 + n} M{n}: 8 A" for n in range(len(periods))]
    lines += ['BA_DEF_ BO_ "GenMsgCycleTime" INT 0 0;', 'BA_DEF_DEF_ "GenMsgCycleTime" 0;']
    lines += [f'BA_ "GenMsgCycleTime" BO_ {256 + n} {period};' for n, period in enumerate(periods)]
    path = tmp_path / "net.dbc"
    path.write_text("\n".join(lines) + "\n")
    times, frames = run(path, 200, lambda t: 0.0)
    for n, period in enumerate(periods):
        assert set(np.diff(times[f"M{n}"])) == {period}
    per_tick = np.bincount(frames["t_ns"] // MS, minlength=200)
    assert per_tick.max() == 3  # 12/10 + 20/20 + 8/50 = 2.36


def test_can_fd_where_the_dbc_says_so(tmp_path: Path) -> None:
    path = tmp_path / "net.dbc"
    path.write_text(
        'VERSION ""\nBU_: A\nBO_ 256 Classic: 8 A\nBO_ 257 Fd: 20 A\nBO_ 2566844926 Slow: 64 A\n'
        f'BA_DEF_ BO_ "VFrameFormat" ENUM {FORMATS};\nBA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";\n'
        'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 0;\nBA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
        'BA_DEF_DEF_ "CANFD_BRS" "1";\nBA_DEF_DEF_ "GenMsgCycleTime" 10;\n'
        'BA_ "VFrameFormat" BO_ 257 14;\nBA_ "VFrameFormat" BO_ 2566844926 15;\n'
        'BA_ "CANFD_BRS" BO_ 2566844926 0;\n'
    )
    _, frames = run(path, 10, lambda t: 0.0)
    mask = EXTENDED | FD | BRS
    found = {int(f["id"]): (int(f["flags"]) & mask, int(f["length"])) for f in frames}
    assert found == {0x100: (0, 8), 0x101: (FD | BRS, 20), 0x18FEF1FE: (EXTENDED | FD, 64)}
