"""docs/network.md tells the truth: its tables against the DBC, its examples executed."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest
from e2e import p11

from hev_can_emu import config
from hev_can_emu.cli import main
from hev_can_emu.ecu.bindings import Bindings, resolve
from hev_can_emu.ecu.network import complete
from hev_can_emu.messages.database import load_database
from hev_can_emu.messages.protection import (
    COUNTER_REPEATED,
    FIRST,
    NEVER,
    OK,
    build_protection,
    check,
)

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "network.md").read_text()
NETWORK = load_database(ROOT / "dbc" / "hev.dbc")


def example(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return str(found)


class Recorder:
    """Stands in for a bus: keeps the first 40 frames, then breaks off like Ctrl-C."""

    def __init__(self, **_: Any) -> None:
        self.sent: list[can.Message] = []
        recorders.append(self)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def send(self, message: can.Message) -> None:
        self.sent.append(message)
        if len(self.sent) == 40:
            raise KeyboardInterrupt


recorders: list[Recorder] = []


def test_message_table() -> None:
    rows = re.findall(r"\| `0x(\w+)` \| `(\w+)` \| (\w+) \| (\d+) ms \| (.*) \|", PAGE)
    assert [name for _, name, *_ in rows] == [
        message.name for message in sorted(NETWORK.messages, key=lambda m: m.can_id)
    ]
    for identifier, name, sender, period, content in rows:
        message = NETWORK.message(name)
        assert int(identifier, 16) == message.can_id
        assert sender == message.sender
        assert int(period) * 1_000_000 == message.cycle_time_ns
        told = re.findall(r"(\w+)(?: \[([^\]]+)\])?", content)
        assert told == [
            (signal.name, signal.unit)
            for signal in message.signals
            if not signal.name.startswith(name)
        ]


def test_node_table() -> None:
    rows = re.findall(r"^\| (\w+) \| [^|]+ \| (emulated|external) \|$", PAGE, re.MULTILINE)
    document = config.read(ROOT / "dbc" / "hev.bindings.yaml")
    nodes = document.convert(Bindings).nodes
    assert rows == [(name, node.ownership) for name, node in nodes.items()]


def test_numbers_in_the_text() -> None:
    frames = sum(1e9 / message.cycle_time_ns for message in NETWORK.messages)
    assert f"{frames:.0f} frames/s" in PAGE
    assert f"{len(NETWORK.messages)} messages" in PAGE
    assert f"{frames * 111 / 5000:.0f} % of 500 kbit/s" in PAGE
    assert f"{frames * 135 / 5000:.0f} % if every frame" in PAGE
    for message in NETWORK.messages:
        assert message.protection is not None
        assert message.protection.data_id == 0x2000 + message.can_id


def test_sending_a_request(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames of the example pass two independent checks, in sequence; one spoilt bit fails."""
    recorders.clear()
    pauses: list[float] = []
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("can.Bus", Recorder)
    monkeypatch.setattr("time.sleep", pauses.append)
    with pytest.raises(KeyboardInterrupt):
        exec(compile(example("python"), "network.md", "exec"), {})
    assert set(pauses) == {0.01}

    message = NETWORK.message("HCU_EM2Request")
    protection = build_protection([found.protection for found in NETWORK.messages])
    state = np.array([NEVER], dtype=np.int64)
    reader: Any = cantools.database.load_file(ROOT / "dbc" / "hev.dbc")
    for number, frame in enumerate(recorders[0].sent):
        assert frame.arbitration_id == message.can_id
        data = np.frombuffer(bytes(frame.data), dtype=np.uint8).copy()
        assert check(protection, message.index, data, 8, state) == (OK if number else FIRST)
        assert check(protection, message.index, data, 8, state) == COUNTER_REPEATED
        assert message.protection is not None
        assert p11.e2e_p11_check(bytearray(frame.data), message.protection.data_id)
        spoilt = bytearray(frame.data)
        spoilt[3] ^= 4
        assert not p11.e2e_p11_check(spoilt, message.protection.data_id)
        values = reader.decode_message(message.can_id, frame.data)
        assert values["EM2TorqueRequest"] == 40
        assert values["EM2ControlMode"] == "Torque"
        assert values["EM2TorqueMax"] == "NotAvailable"
        assert values["HCU_EM2Request_Counter"] == number % 15


def test_the_foreign_example(tmp_path: Path) -> None:
    (tmp_path / "their.dbc").write_text(
        'VERSION ""\nBU_: CTRL DRIVE\nBO_ 1 Cmd: 8 CTRL\n'
        ' SG_ Sum : 0|8@1+ (1,0) [0|0] "" DRIVE\n SG_ Count : 8|4@1+ (1,0) [0|0] "" DRIVE\n'
        ' SG_ Trq : 16|16@1- (1,0) [0|0] "Nm" DRIVE\n SG_ Gang : 32|4@1+ (1,0) [0|0] "" DRIVE\n'
        'BO_ 2 State: 8 DRIVE\n SG_ Speed : 0|16@1- (1,0) [0|0] "U/min" CTRL\n'
        ' SG_ Amps : 16|16@1- (1,0) [0|0] "A" CTRL\n SG_ Volts : 32|16@1- (1,0) [0|0] "" CTRL\n'
        ' SG_ Model : 48|4@1+ (1,0) [0|0] "" CTRL\n'
        'VAL_ 1 Gang 1 "Leerlauf" 2 "Erster" 3 "Zweiter" ;\n'
    )
    document = config.parse(example("yaml"), "network.md")
    bindings = document.convert(Bindings)
    foreign = complete(bindings, load_database(tmp_path / "their.dbc"), document.where)
    resolved = resolve(bindings, foreign, document.where)
    assert resolved.tx_gain[1] == -1.0
    assert foreign.message("Cmd").protection is not None
    assert foreign.message("State").cycle_time_ns == 20_000_000
    assert foreign.signal("Model").initial == 3


@pytest.mark.parametrize(
    "command", re.findall(r"^    hev-can-emu (.*dbc/examples.*)$", PAGE, re.MULTILINE)
)
def test_the_worked_example_runs(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    assert main(shlex.split(command)) == 0
    assert "PASS" in (told := capsys.readouterr().out) or "received from the controller (4)" in told


def test_a_foreign_network_is_shown_as_ours_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Picture and report look for ports, not for names: codes and units are theirs no more."""
    monkeypatch.chdir(ROOT)
    examples = "dbc/examples/alpin"
    words = ["scenario", "run", f"{examples}.series_parallel.yaml", "--dbc", f"{examples}.dbc"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    capsys.readouterr()
    page = (tmp_path / "alpin.series_parallel.html").read_text()
    for name in (
        "VKM_Drehzahl",
        "Geschwindigkeit",
        "Betriebsart",
    ):
        assert name in page
    assert (tmp_path / "alpin.series_parallel.png").stat().st_size > 50_000
