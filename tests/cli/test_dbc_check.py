"""hev-can-emu dbc check: everything that is wrong or missing in one go, each with its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from hev_can_emu.cli import main
from hev_can_emu.ecu import ports

ROOT = Path(__file__).parents[2]

ODD = """VERSION ""
BU_: CTRL DRIVE
BO_ 256 Cmd: 8 CTRL
 SG_ Trq : 0|16@1- (0.5,0) [-20000|1000] "Nm" DRIVE
 SG_ Gear : 16|2@1+ (1,0) [0|7] "" DRIVE
BO_ 257 State: 8 DRIVE
 SG_ Speed : 0|16@1- (1,0) [0|0] "rpm" CTRL
 SG_ Mode : 16|4@1+ (1,0) [9|3] "" CTRL
 SG_ Far : 24|8@1+ (1,0) [300|400] "" CTRL
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 10;
VAL_ 256 Gear 9 "Nine" 1 "One" ;
"""
BROKEN = """BO_ 258 Twice: 8 DRIVE
 SG_ A : 0|9@1+ (1,0) [0|0] "" CTRL
 SG_ B : 8|8@1+ (1,0) [0|0] "" CTRL
BO_ 259 Beyond: 2 DRIVE
 SG_ C : 12|8@1+ (1,0) [0|0] "" CTRL
BO_ 257 Again: 2 DRIVE
"""
BINDINGS = """version: 1
nodes:
  CTRL: {role: controller}
  DRIVE: {role: emulated}
messages:
  Cmd:
    request: {Trq: em2_torque_request}
  State:
    status: {Speed: em2_speed}
    sending: {period: 20 ms}
    constant: {Far: 7}
"""


def check(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = main(["dbc", "check", *words])
    told = capsys.readouterr()
    # With a cold cache the compilation is told of, too.
    lines = [line for line in told.err.splitlines(True) if not line.startswith("compil")]
    return code, told.out, "".join(lines)


def test_without_bindings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "odd.dbc"
    path.write_text(ODD)
    code, out, err = check(capsys, str(path))
    assert (code, err) == (0, "")
    assert (
        out
        == f"""{path}: 2 messages, 5 signals, 2 nodes

cannot be encoded (6)
  {path}:4: Cmd.Trq declares -20000 Nm, its bits reach down to -16384 Nm
  {path}:5: Cmd.Gear declares 7, its bits reach up to 3
  {path}:5: Cmd.Gear: the label 'Nine' belongs to 9, its bits hold 0 to 3
  {path}:8: State.Mode declares a range from 9 down to 3
  {path}:9: State.Far declares 400, its bits reach up to 255
  {path}:9: State.Far: no value of its bits lies in the range that it declares

without cycle time, and with no event that sends them (1)
  State

sent by the DBC's own words (no bindings file: nothing would be sent)
  0x100  Cmd    CTRL   8 bytes classic  cyclic 10 ms  unprotected
  0x101  State  DRIVE  8 bytes classic  none          unprotected
"""
    )


def test_every_defect_is_listed_before_the_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "broken.dbc"
    path.write_text(ODD.replace("BA_DEF_ BO_", BROKEN + "BA_DEF_ BO_", 1))
    code, out, err = check(capsys, str(path))
    assert code == 2
    assert (
        f"""
cannot be used (3)
  {path}:12: expected signals of Twice that do not overlap, got 'B' and 'A' on the same bits
  {path}:14: expected a signal inside Beyond, got 'C' beyond its last bit
  {path}:15: expected identifiers that occur once, got 0x101 for both 'State' and 'Again'
"""
        in out
    )
    assert err == (
        f"hev-can-emu: {path}: expected a network without defects, got 3 messages that cannot be used; "
        "mend them, or name them under 'leave_out' in the bindings\n"
    )
    # Left out, they are nobody's trouble.
    beside = tmp_path / "broken.bindings.yaml"
    beside.write_text(BINDINGS + "leave_out: [Twice, Beyond, Again]\n")
    code, out, err = check(capsys, str(path))
    assert (code, err) == (0, "")
    assert "cannot be used" not in out


def test_with_bindings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, beside = tmp_path / "odd.dbc", tmp_path / "mine.yaml"
    path.write_text(ODD)
    beside.write_text(BINDINGS)
    code, out, err = check(capsys, str(path), "--bindings", str(beside))
    assert (code, err) == (0, "")
    assert "without cycle time" not in out, "the bindings name a period"
    assert (
        """
signals without a port, and what is sent for them (2)
  State.Mode: start value 0
  State.Far: constant 7
"""
        in out
    )
    assert "requests that no signal carries (22)\n  engine_torque_request: torque at" in out
    assert "requests without supervision (1)\n  Cmd\n" in out
    assert "statuses that no signal carries (96)\n  engine_speed, engine_torque, " in out
    assert (
        """
sent in the first second, ignition on: 50 frames
  0x101  State  DRIVE  8 bytes classic  cyclic 20 ms  unprotected  50/s  00 00 00 07 00 00 00 00

received from the controller (1)
  0x100  Cmd  CTRL  8 bytes classic  cyclic 10 ms  unprotected
"""
        in out
    )


def test_the_shipped_network_has_nothing_to_complain_of(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, out, err = check(capsys, str(ROOT / "dbc" / "hev.dbc"))
    assert (code, err) == (0, "")
    head, _, rest = out.partition("\n\n")
    assert head.endswith("hev.dbc: 31 messages, 176 signals, 9 nodes")
    assert rest.startswith("sent in the first second, ignition on: 14")


def test_ports_are_listed_with_unit_and_meaning(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dbc", "ports"]) == 0
    lines = [
        line.split(maxsplit=2) for line in capsys.readouterr().out.splitlines() if line[:2] == "  "
    ]
    assert len(lines) == len(ports.REQUESTS) + len(ports.STATUSES)
    told = {line[0]: line[1:] for line in lines}
    assert told["em2_torque_request"][0] == "N"
    assert "forward" in told["em2_torque_request"][1]
    assert told["gear"] == ["0", "neutral, 1 G1, 2 G2, 3 between"]


def test_a_unit_nobody_knows_gets_a_hint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, beside = tmp_path / "odd.dbc", tmp_path / "mine.yaml"
    path.write_text(ODD.replace('"rpm"', '"Umdr"'))
    beside.write_text(BINDINGS)
    code, _, err = check(capsys, str(path), "--bindings", str(beside))
    assert code == 2
    assert err.endswith(
        "$.messages.State.status.Speed: expected a unit, got 'Umdr'; say what it is in with 'unit', such as "
        "{port: em2_speed, unit: rad/s}\n"
    )


def test_mistakes_in_the_bindings_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, beside = tmp_path / "odd.dbc", tmp_path / "mine.yaml"
    path.write_text(ODD)
    beside.write_text(BINDINGS.replace("em2_speed", "em2_sped"))
    code, _, err = check(capsys, str(path), "--bindings", str(beside))
    assert code == 2
    assert err == (
        f"hev-can-emu: {beside}:9: $.messages.State.status.Speed: expected a status port, got 'em2_sped'; "
        "did you mean 'em2_speed' or 'em1_speed' or 'em2_speed_echo'?\n"
    )
