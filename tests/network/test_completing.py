"""What a bindings file adds to a DBC: protection, sending, constants; and every mistake in it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from hev_can_emu import config
from hev_can_emu.ecu.bindings_file import Bindings
from hev_can_emu.ecu.network import complete
from hev_can_emu.errors import InputError
from hev_can_emu.messages.database import Database, SendType, load_database
from hev_can_emu.messages.protection_spec import CrcSpec, ProtectionSpec

DBC = """VERSION ""
BU_: CTRL DRIVE
BO_ 257 State: 8 DRIVE
 SG_ Sum : 7|8@0+ (1,0) [0|255] "" CTRL
 SG_ Count : 11|4@0+ (1,0) [0|14] "" CTRL
 SG_ Long : 21|10@0+ (1,0) [0|1023] "" CTRL
 SG_ Sum16 : 55|16@0+ (1,0) [0|65535] "" CTRL
 SG_ Speed : 32|8@1+ (1,0) [0|250] "km/h" CTRL
 SG_ Model : 40|4@1+ (2,10) [10|38] "" CTRL
 SG_ Spare : 44|4@1+ (1,0) [0|15] "" CTRL
BO_ 258 Real: 8 DRIVE
 SG_ Ratio : 0|32@1- (1,0) [0|0] "" CTRL
SIG_VALTYPE_ 258 Ratio : 1;
VAL_ 257 Model 3 "Coupe" 15 "SNA" ;
"""
HEAD = """version: 1
nodes:
  DRIVE: {role: emulated}
messages:
  State:
    status: {Speed: vehicle_speed}
"""


@pytest.fixture
def database(tmp_path: Path) -> Database:
    (tmp_path / "their.dbc").write_text(DBC)
    return load_database(tmp_path / "their.dbc")


def completed(database: Database, text: str) -> Database:
    document = config.parse(HEAD + text, "their.yaml")
    return complete(document.convert(Bindings), database, document.where)


def test_protection_by_the_names_of_signals(database: Database) -> None:
    done = completed(
        database,
        "    protection: {profile: custom, polynomial: 0x1021, init: 0xFFFF, crc: Sum16,"
        "      counter: Long, counter_max: 999, data_id: 0x12, data_id_mode: low, data_id_position: suffix,"
        "      first_byte: 1}\n",
    )
    assert done.message("State").protection == ProtectionSpec(
        profile="custom",
        crc=CrcSpec(width=16, polynomial=0x1021, init=0xFFFF, big_endian=True, first_byte=1),
        crc_offset=48,
        counter_offset=28,
        counter_length=10,
        counter_max=999,
        counter_big_endian=True,
        data_id=0x12,
        data_id_mode="low",
        data_id_position="suffix",
    )
    assert done.message("State").protection.bits() == (
        database.signal("Sum16").bits() | database.signal("Long").bits()
    )
    assert done.message("Real") == database.message("Real")


def test_protection_by_places(database: Database) -> None:
    spec = completed(
        database,
        "    protection: {profile: P11, data_id: 5, crc_bit: 8, counter_bit: 4}\n",
    ).message("State").protection  # fmt: skip
    assert spec == ProtectionSpec(profile="P11", data_id=5, crc_offset=8, counter_offset=4)


def test_none_takes_the_dbcs_protection_away(tmp_path: Path) -> None:
    hev = load_database(Path(__file__).parents[2] / "dbc" / "hev.dbc")
    document = config.parse(
        "version: 1\nnodes: {}\nmessages:\n  EMS_Status: {protection: {profile: none}}\n", "b.yaml"
    )
    done = complete(document.convert(Bindings), hev, document.where)
    assert done.message("EMS_Status").protection is None
    assert done.message("EMS_Torque").protection is not None


def test_sending_stands_in_for_the_dbc(database: Database) -> None:
    done = completed(
        database,
        "    sending: {type: event, fast_period: 5 ms, repetitions: 2, delay: 1 ms, phase: 3 ms}\n",
    ).message("State")
    assert done.send_type is SendType.EVENT
    assert (done.fast_cycle_time_ns, done.repetitions) == (5_000_000, 2)
    assert (done.delay_ns, done.start_delay_ns) == (1_000_000, 3_000_000)
    only = completed(database, "    sending: {period: 0.02 s}\n").message("State")
    assert (only.send_type, only.cycle_time_ns) == (SendType.CYCLIC, 20_000_000)


def test_constants(database: Database) -> None:
    done = completed(
        database, "    constant: {Model: Coupe, Spare: 9}\n  Real: {constant: {Ratio: 2.5}}\n"
    )
    by_name = {signal.name: signal for signal in done.signals}
    assert (by_name["Model"].initial, by_name["Spare"].initial) == (3, 9)
    assert (by_name["Ratio"].initial, by_name["Model"].not_available) == (2.5, None)
    assert msgspec.structs.replace(by_name["Speed"]) == database.signal("Speed")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("protection: {profile: P07}", "protection.profile: expected one of"),
        ("protection: {profile: P01, crc: Summ}", "protection.crc: expected a signal of State, "
         "got 'Summ'; did you mean 'Sum' or 'Sum16'?"),
        ("protection: {profile: P01, crc: Count}", "protection.crc: expected a CRC of one or "
         "two whole bytes, got 4 bits from bit 8"),
        ("protection: {profile: P01, crc: Sum16}", "protection: expected a CRC of 8 bits for "
         "P01 in State, got 16"),
        ("protection: {profile: P01, crc: Sum, counter: Long}", "protection: expected a counter "
         "of 4 bits for P01 in State, got 10"),
        ("protection: {profile: P01, crc: Sum, crc_bit: 8}", "protection.crc_bit: expected "
         "either 'crc' or 'crc_bit', got both"),
        ("protection: {profile: P01, data_id_nibble: Sum}", "protection.data_id_nibble: "
         "expected a signal of 4 bits, got 8"),
        ("protection: {profile: P01, polynomial: 7}", "protection.polynomial: expected the "
         "profile custom beside it, got 'P01'"),
        ("protection: {profile: custom}", "protection: expected a 'polynomial' of the CRC, "
         "got none"),
        ("protection: {profile: P02}", "protection: expected a data ID list of 16 bytes for "
         "P02 in State, got none"),
        ("protection: {profile: P11, crc_bit: 64}", "protection: expected CRC and counter "
         "inside 8 bytes in State, got bit 71 beyond them"),
        ("protection: {profile: P11, data_id: 70000}", "protection: expected a data ID of 16 "
         "bits in State, got 70000"),
        ("sending: {type: sometimes}", "sending.type: expected one of cyclic,"),
        ("sending: {period: 20}", "sending.period: expected text, got 20"),
        ("sending: {period: 20 km}", "sending.period: expected a number with a unit such as "
         "'1 s', got '20 km'; the unit does not fit"),
        ("sending: {type: cyclic}", "sending: expected a 'period' of a cyclic message, got none"),
        ("sending: {type: event, repetitions: 2}", "sending: expected a 'fast_period' between "
         "the repetitions, got none"),
        ("constant: {Modl: 1}", "constant.Modl: expected a signal of State, got 'Modl'; "
         "did you mean 'Model'?"),
        ("constant: {Model: Cabrio}", "constant.Model: expected a label of Model or a number, "
         "got 'Cabrio'"),
        ("constant: {Model: 11}", "constant.Model: expected a value that Model can take, "
         "10 to 40, got 11; its step is 2"),
        ("constant: {Spare: 99}", "constant.Spare: expected a value that Spare can take, 0 to "
         "15, got 99; its step is 1"),
        ("constant: {Speed: 1}", "constant.Speed: expected a signal without port, got 'Speed', "
         "which has one"),
        ("protection: {profile: P11, crc: Sum, counter: Count}\n    constant: {Sum: 1}",
         "constant.Sum: expected a signal that carries a value, got 'Sum', which the "
         "protection of State writes"),
    ],
)  # fmt: skip
def test_mistakes(database: Database, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        completed(database, f"    {text}\n")
    told = str(caught.value)
    line = 8 if "\n" in text else 7
    assert told.startswith(f"their.yaml:{line}: ")
    assert f": $.messages.State.{message}" in told
