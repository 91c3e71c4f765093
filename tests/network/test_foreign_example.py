"""A network that shares nothing with ours drives the same car: dbc/examples, seen from outside.

The controller here is a stranger's: cantools for bytes, the package autosar-e2e and twenty lines of CRC for
the protection, frames in and out of the emulator.
"""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from e2e import p01, p02, p05, p11

from hev_can_emu.messages.frame import EXTENDED, FD, FRAME, REMOTE
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

EXAMPLES = Path(__file__).parents[2] / "dbc" / "examples"
DBC, BINDINGS = EXAMPLES / "alpin.dbc", EXAMPLES / "alpin.bindings.yaml"
MS = 1_000_000
EM1_RATIO, EM2_RATIO, G1_RATIO = 1.298737, 1.850703, 1.843526
SENT_IDS = bytes([17, 34, 51, 68, 85, 102, 119, 136, 153, 170, 187, 204, 221, 238, 255, 16])
GEARBOX_IDS = bytes([9, 8, 7, 6, 5, 4, 3, 2, 1, 0, 19, 18, 17, 16, 15, 14])


def crc16_arc(data: bytes) -> int:
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def protect(name: str, data: bytearray, count: int) -> None:
    """Write counter and CRC as the example's bindings declare them, by other people's code."""
    if name == "SOLL_Antrieb":
        data[2] = count % 256
        p05.e2e_p05_protect(data, 0x4C01, increment_counter=False)
    elif name == "SOLL_Getriebe":
        data[1] = data[1] & 0xF0 | count % 16
        p02.e2e_p02_protect(data, SENT_IDS, increment_counter=False)
    elif name == "SOLL_Hochvolt":
        count %= 1000
        data[0] = data[0] & 0xFC | count >> 8
        data[1] = count & 0xFF
        data[6:8] = crc16_arc(b"\xb7" + data[:6]).to_bytes(2, "big")
    else:
        data[1] = 0x50 | count % 15
        p01.e2e_p01_protect(
            data, 0x5A3, data_id_mode=p01.E2E_P01_DATAID_NIBBLE, increment_counter=False
        )


class Controller:
    """A stranger's control unit: knows the DBC, cantools and the clock."""

    def __init__(self, protection: str = "enforce", **setup: Any) -> None:
        files = {"dbc": str(DBC), "bindings": str(BINDINGS)}
        self.emulator = Emulator(Setup(model="4dof", protection=protection, **files, **setup))
        self.network: Any = cantools.database.load_file(DBC)
        self.seen: dict[str, Any] = {}
        self.times: dict[str, list[int]] = {}
        self.raw: dict[str, list[bytes]] = {}
        self.modes: list[str] = []
        self.spoil: set[str] = set()
        self.counts = {m.name: itertools.count() for m in self.network.messages}
        self.values: dict[str, dict[str, Any]] = {}
        for message in self.network.messages:
            if message.senders == ["ZENTRALE"]:
                self.values[message.name] = {signal.name: 0 for signal in message.signals}
        self.ask(
            EMA_Betriebsart="Aus", EMB_Betriebsart="Moment", VKM_Anforderung="Halt",
            Gangwunsch="Neutral", Schuetze="Zu",
        )  # fmt: skip

    def ask(self, **signals: Any) -> None:
        for name, value in signals.items():
            (message,) = [m for m, values in self.values.items() if name in values]
            self.values[message][name] = value

    def _due(self, t_ms: int) -> Iterator[tuple[int, int, bytes]]:
        for name, values in self.values.items():
            message = self.network.get_message_by_name(name)
            if t_ms % message.cycle_time == 0:
                data = bytearray(message.encode(values))
                protect(name, data, next(self.counts[name]))
                if name in self.spoil:
                    data[-1] ^= 1
                flags = EXTENDED | (FD if message.is_fd else 0)
                yield message.frame_id, flags, bytes(data)

    def run(self, ms: int) -> None:
        for _ in range(0, ms, 5):
            t_ms = self.emulator.now_ns // MS
            rows = list(self._due(t_ms))
            frames = np.zeros(len(rows), dtype=FRAME)
            for frame, (can_id, flags, data) in zip(frames, rows, strict=True):
                frame["t_ns"], frame["id"], frame["flags"] = t_ms * MS, can_id, flags
                frame["length"] = len(data)
                frame["data"][: len(data)] = np.frombuffer(data, dtype=np.uint8)
            for frame in self.emulator.advance((t_ms + 5) * MS, frames, len(frames)):
                self._take(frame)

    def _take(self, frame: np.void) -> None:
        assert int(frame["flags"]) & EXTENDED
        assert not int(frame["flags"]) & REMOTE
        message = self.network.get_message_by_frame_id(int(frame["id"]))
        assert bool(int(frame["flags"]) & FD) is message.is_fd
        data = bytes(frame["data"][: frame["length"]])
        self.seen.update(message.decode(data))
        self.times.setdefault(message.name, []).append(int(frame["t_ns"]) // MS)
        self.raw.setdefault(message.name, []).append(data)
        mode = self.seen.get("Betriebsart", "SNA")
        if not self.modes or self.modes[-1] != mode:
            self.modes.append(mode)

    def until(self, condition: Any, limit_ms: int) -> None:
        for _ in range(0, limit_ms, 10):
            if condition(self.seen):
                return
            self.run(10)
        raise AssertionError(f"not met within {limit_ms} ms: {self.seen}")


@pytest.mark.parametrize("protection", ["enforce", "observe"])
def test_series_to_parallel_in_a_strangers_words(protection: str) -> None:
    car = Controller(protection)
    car.run(300)
    car.ask(EMA_Betriebsart="Drehzahl", EMA_DrehzahlSoll=2340, KupplungSoll=200)
    car.run(1200)
    car.ask(VKM_Anforderung="Lauf", VKM_MomentSoll=20)
    car.until(lambda seen: seen["VKM_Zustand"] == "Laeuft", 2000)
    car.run(800)
    assert car.seen["Betriebsart"] == "Seriell"
    assert car.seen["VKM_Moment"] == pytest.approx(20, abs=3), "percent of 200 Nm"
    assert car.seen["Strom"] < -10, "negative charges here"
    car.ask(EMB_MomentSoll=150)
    car.until(lambda seen: seen["Geschwindigkeit"] > 30, 15_000)
    car.ask(VKM_MomentSoll=0, KupplungSoll=0, EMB_MomentSoll=20)
    car.run(500)
    assert car.seen["Kupplung"] == "Offen"
    car.ask(EMA_DrehzahlSoll=car.seen["EMB_Drehzahl"] / EM2_RATIO * G1_RATIO * EM1_RATIO)
    car.run(800)
    car.ask(EMA_Betriebsart="Moment", EMA_MomentSoll=0, Gangwunsch="Langsam", Schaltkraft=0.9)
    car.run(300)
    assert car.seen["Gang"] == "Langsam"
    assert car.seen["Schiebemuffe"] == pytest.approx(9.0, abs=0.05)
    car.ask(KupplungSoll=120)
    car.until(lambda seen: seen["Kupplung"] == "Zu", 1500)
    car.run(200)
    assert car.seen["Anforderungen_Fehler"] == 0
    assert [mode for mode in car.modes if mode != "Uebergang"] == [
        "ElektrischNeutral", "Seriell", "ElektrischNeutral", "ElektrischLangsam", "ParallelLangsam",
    ]  # fmt: skip
    # Nothing between: speeds as the plant has them, each in its own unit and width.
    assert car.seen["EMA_Drehzahl"] == pytest.approx(
        car.emulator.truth("em1_speed") * 30 / np.pi, abs=5
    )
    assert car.seen["Geschwindigkeit"] == pytest.approx(
        car.emulator.truth("vehicle_speed") * 3.6, abs=0.05
    )
    check_what_was_sent(car)


def check_what_was_sent(car: Controller) -> None:
    """Periods as the DBC and the bindings say, every frame protected, no counter skipped."""
    for name, period in (("IST_Antrieb", 5), ("IST_Motor", 10), ("IST_Hochvolt", 10)):
        assert set(np.diff(car.times[name])) == {period}, name
    changes = len(car.modes)
    assert car.emulator.now_ns // (100 * MS) < len(car.times["IST_Betrieb"])
    assert len(car.times["IST_Betrieb"]) <= car.emulator.now_ns // (100 * MS) + 2 * changes + 2
    for n, data in enumerate(car.raw["IST_Antrieb"]):
        assert data[2] == n % 256
        assert p05.e2e_p05_check(bytearray(data), 0x4C02)
    for n, data in enumerate(car.raw["IST_Motor"]):
        assert data[1] & 0xF == n % 15
        assert p11.e2e_p11_check(bytearray(data), 0x77)
    for n, data in enumerate(car.raw["IST_Getriebe"]):
        assert data[1] & 0xF == n % 16
        assert p02.e2e_p02_check(bytearray(data), GEARBOX_IDS)
    for n, data in enumerate(car.raw["IST_Hochvolt"]):
        assert data[0] >> 4 == n % 16, "a counter without CRC"
    assert {data[6] >> 4 for data in car.raw["IST_Fahrwerk"]} == {3}


def test_values_beyond_their_range_go_out_as_its_end_and_are_counted(tmp_path: Path) -> None:
    narrow = DBC.read_text(encoding="utf-8").replace('[0|1600] "V"', '[0|300] "V"')
    (tmp_path / "alpin.dbc").write_text(narrow, encoding="utf-8")
    shutil.copy(BINDINGS, tmp_path)
    emulator = Emulator(Setup(model="4dof", dbc=str(tmp_path / "alpin.dbc")))  # bindings beside it
    sent = emulator.advance(100 * MS)
    assert emulator.signal("Spannung") == 300.0
    assert emulator.saturations == np.count_nonzero(sent["id"] == 0x18DB2005) == 10
    car = Controller()
    car.run(100)
    assert car.seen["Spannung"] > 340.0
    assert car.emulator.saturations == 0


@pytest.mark.parametrize("name", ["SOLL_Antrieb", "SOLL_Getriebe", "SOLL_Hochvolt", "SOLL_Bremse"])
def test_one_spoilt_bit_is_refused_only_where_protection_is_enforced(name: str) -> None:
    refused = {}
    for protection in ("enforce", "observe", "off"):
        car = Controller(protection)
        car.run(200)
        assert car.seen["Anforderungen_Fehler"] == 0
        car.spoil.add(name)
        car.run(400)
        refused[protection] = car.seen["Anforderungen_Fehler"]
    assert refused == {"enforce": 1, "observe": 0, "off": 0}


def test_differs_from_the_shipped_network_in_everything() -> None:
    theirs: Any = cantools.database.load_file(DBC)
    ours: Any = cantools.database.load_file(DBC.parents[1] / "hev.dbc")
    for get in (
        lambda d: {m.name for m in d.messages},
        lambda d: {m.frame_id for m in d.messages},
        lambda d: {m.is_extended_frame for m in d.messages},
        lambda d: {s.name for m in d.messages for s in m.signals},
        lambda d: {s.byte_order for m in d.messages for s in m.signals},
        lambda d: {n.name for n in d.nodes},
    ):
        assert not get(theirs) & get(ours)
    assert any(message.is_fd for message in theirs.messages)
