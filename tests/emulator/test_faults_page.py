"""docs/faults.md is true: its table, its program, its control message; and the command beside it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from can_bench import MS, Bench

from hev_can_emu.cli import main
from hev_can_emu.ecu.faults import BUS_FAULTS, CATALOGUE
from hev_can_emu.errors import InputError
from hev_can_emu.messages.frame import frame
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.fault_show import as_markdown, show
from hev_can_emu.runtime.setup import Setup, prepared_faults


@pytest.fixture
def page(repository: Path) -> str:
    return (repository / "docs" / "faults.md").read_text()


def test_the_table_is_what_a_client_sees(page: str) -> None:
    faults, _ = prepared_faults(Setup())
    # The others need a bus with bit times.
    kinds = {kind.name for kind in CATALOGUE.values() if kind.spec not in BUS_FAULTS}
    assert {fault.kind for fault in faults} == kinds
    assert as_markdown(show(faults)) in page


def test_the_program_runs(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(program, {})
    assert capsys.readouterr().out.splitlines() == [
        "drop MCU2_Status ended 5 0 41000000",
        "signal_offset EM2Torque ended 5 50000000 100000000",
    ]


DBC = """
BO_ 1528 FaultControl: 2 HCU
 SG_ Command : 0|8@1+ (1,0) [0|3] "" EMS
 SG_ Number : 8|8@1+ (1,0) [0|254] "" EMS
"""
FAULTS = """
version: 1
faults:
  - {fault: drop, message: MCU2_Status}
  - {fault: machine_tripped, machine: em2, duration: 50 ms}
"""


def controlled(folder: Path, repository: Path, page: str, faults: str = FAULTS) -> Setup:
    """Return the shipped network with the page's message in it."""
    (yaml,) = re.findall(r"```yaml\n(nodes:.*?)```", page, re.DOTALL)
    nodes, messages = yaml.split("messages:\n")
    text = (repository / "dbc" / "hev.dbc").read_text()
    (folder / "net.dbc").write_text(text.replace("\n\nCM_ ", f"{DBC}\n\nCM_ ", 1))
    bindings = (repository / "dbc" / "hev.bindings.yaml").read_text()
    bindings = bindings.replace("nodes:\n", nodes, 1).replace(
        "messages:\n", f"messages:\n{messages}", 1
    )
    (folder / "net.bindings.yaml").write_text(bindings)
    (folder / "faults.yaml").write_text(faults)
    return Setup(
        model="4dof", dbc=str(folder / "net.dbc"), bindings=str(folder / "net.bindings.yaml"),
        faults=str(folder / "faults.yaml"),
    )  # fmt: skip


def test_a_message_injects_and_clears(tmp_path: Path, repository: Path, page: str) -> None:
    bench = Bench(controlled(tmp_path, repository, page)).ask_and_run(300, EM2TorqueRequest=50.0)

    def control(command: int, number: int, ms: int) -> None:
        given = frame(1528, bytes([command, number]), bench.now_ms * MS)
        sent = bench.emulator.advance((bench.now_ms + 1) * MS, given, 1)
        bench.log.add(sent, len(sent))
        bench.run(ms)

    control(1, 0, 200)
    assert not (bench.frames["id"] == 0x158).any()
    assert bench["FaultsActive"] == 1
    control(1, 0, 10)  # is live
    control(1, 7, 10)  # is none
    assert [(r.name, r.start_ns) for r in bench.emulator.faults] == [("drop MCU2_Status", 301 * MS)]
    control(2, 0, 100)
    assert (bench.frames["id"] == 0x158).sum() == 10
    for _ in range(2):
        control(1, 1, 30)
        assert bench.emulator.faults[-1].state == "active"
        bench.run(60)
        assert bench.emulator.faults[-1].state == "ended"
    control(1, 0, 5)
    control(1, 1, 5)
    control(3, 0, 5)
    assert {record.state for record in bench.emulator.faults} == {"ended"}
    assert np.isnan(bench.emulator.state.requests[33])


@pytest.mark.parametrize(
    ("faults", "complaint"),
    [
        (FAULTS.replace("MCU2_Status", "MCU3_Status"), "expected a message of the network, got"),
        (FAULTS.replace("drop", "dorp"), "faults.yaml:4: $.faults[0].fault: expected a kind of"),
        (
            FAULTS + "  - {fault: drop, message: MCU2_Status}\n",
            "expected each name once, got 'drop MCU2_S",
        ),
        (
            FAULTS + "  - {fault: drop, message: EMS_Status, name: x}\n" * 95,
            "expected at most 96 faults, got 97 of them",
        ),
        (FAULTS + "  - {fault: bus_off, node: MCU1}\n", "got bus_off, which is of the wire"),
        ("version: 2\nfaults: []\n", "faults.yaml:1: $.version: expected 1, got 2"),
    ],
)
def test_a_bad_file_of_faults(
    tmp_path: Path, repository: Path, page: str, faults: str, complaint: str
) -> None:
    with pytest.raises(InputError) as refused:
        Emulator(controlled(tmp_path, repository, page, faults))
    assert complaint in str(refused.value)
    assert "faults.yaml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["faults"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == list(CATALOGUE)
    assert main(["faults", "delay"]) == 0
    told = capsys.readouterr().out
    assert "delay: The frame arrives later" in told
    assert "  delay [s]: how much later, in whole milliseconds (default: 0.02)" in told
    assert "  message: name of a message of the network (required)" in told
    assert main(["faults", "dealy"]) == 2
    complaint = (
        "hev-can-emu: faults: expected a kind of fault, got 'dealy'; did you mean 'delay'?\n"
    )
    assert capsys.readouterr().err == complaint
