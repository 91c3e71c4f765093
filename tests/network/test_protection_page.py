"""docs/protection.md tells the truth: its examples read, its tables against the records."""

from __future__ import annotations

import re
from pathlib import Path

from hev_can_emu import config
from hev_can_emu.ecu.bindings_file import Bindings
from hev_can_emu.ecu.network import complete
from hev_can_emu.ecu.network_file import ProtectionBinding
from hev_can_emu.messages.database import load_database

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "protection.md").read_text()
DBC = """VERSION ""
BU_: A
BO_ 1 Torque_Command: 8 A
 SG_ Checksum : 7|8@0+ (1,0) [0|0] "" A
 SG_ Rolling_Counter : 11|4@0+ (1,0) [0|0] "" A
 SG_ Id_Nibble : 15|4@0+ (1,0) [0|0] "" A
BO_ 2 Gear_Command: 8 A
BO_ 3 Contactor_Command: 8 A
 SG_ Long_Counter : 1|10@0+ (1,0) [0|0] "" A
 SG_ Checksum16 : 55|16@0+ (1,0) [0|0] "" A
"""


def test_the_example_beside_a_dbc(tmp_path: Path) -> None:
    (tmp_path / "their.dbc").write_text(DBC)
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    document = config.parse(f"version: 1\nnodes: {{}}\n{block}", "protection.md")
    done = complete(
        document.convert(Bindings), load_database(tmp_path / "their.dbc"), document.where
    )
    torque, gear, contactor = (message.protection for message in done.messages)
    assert torque is not None
    assert (torque.profile, torque.data_id, torque.nibble_bit) == ("P01", 0x5A3, 12)
    assert gear is not None
    assert (gear.profile, gear.data_id_list[2], gear.counter_bit) == ("P02", 51, 8)
    assert contactor is not None
    assert (contactor.crc.width, contactor.crc.big_endian, contactor.crc_bit) == (16, True, 48)
    assert (contactor.counter_modulus, contactor.is_counter_big_endian) == (1000, True)


def test_every_key_is_told() -> None:
    section = PAGE.partition("## Declaring it beside a DBC")[2].partition("## The profiles")[0]
    told = {
        key
        for row in re.findall(r"^\| (`[^|]+) \|", section, re.MULTILINE)
        for key in re.findall(r"`(\w+)`", row)
    }
    assert told == set(ProtectionBinding.__struct_fields__)


def test_every_attribute_is_told_and_no_other() -> None:
    source = (ROOT / "hev_can_emu" / "messages" / "dbc_attributes.py").read_text()
    assert set(re.findall(r"E2E\w+", PAGE)) == set(re.findall(r'"(E2E\w+)"', source))
