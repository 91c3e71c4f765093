"""Trouble codes on the bus, in the Python face, and in a file that survives a restart."""

from __future__ import annotations

from pathlib import Path

import pytest
from can_bench import Bench

from hev_can_emu.ecu.trouble_codes import TroubleCode
from hev_can_emu.errors import InputError
from hev_can_emu.runtime.code_store import CodeStore, read_store
from hev_can_emu.runtime.setup import Setup

CAR = Setup(model="4dof")


def lost(bench: Bench, ms: int = 100) -> Bench:
    """Lose EM2's request for a while."""
    bench.tamper["HCU_EM2Request"] = lambda data, count: None
    bench.run(ms)
    del bench.tamper["HCU_EM2Request"]
    return bench.run(100)


def test_codes_are_counted_on_the_bus() -> None:
    bench = Bench(CAR).run(200)
    assert (bench["TroubleCodesActive"], bench["TroubleCodesConfirmed"]) == (0, 0)
    bench.tamper["HCU_EM2Request"] = lambda data, count: None
    bench.tamper["HCU_EM1Request"] = lambda data, count: data[:5]
    bench.run(200)
    assert (bench["TroubleCodesActive"], bench["TroubleCodesConfirmed"]) == (2, 2)
    bench.tamper.clear()
    bench.run(200)
    assert (bench["TroubleCodesActive"], bench["TroubleCodesConfirmed"]) == (0, 2)
    codes = {code.code: code for code in bench.emulator.trouble_codes}
    assert set(codes) == {"U1101-81", "U1102-87"}
    assert codes["U1102-87"].message == "HCU_EM2Request"
    assert "confirmedDTC" in codes["U1102-87"].bits
    assert "testFailed" not in codes["U1102-87"].bits
    bench.emulator.clear_trouble_codes()
    assert bench.run(100)["TroubleCodesConfirmed"] == 0
    assert bench.emulator.trouble_codes == []


def test_a_snapshot_holds_the_codes() -> None:
    bench = Bench(CAR).run(200)
    before = bench.emulator.snapshot()
    codes = lost(bench).emulator.trouble_codes
    after = bench.emulator.snapshot()
    bench.emulator.restore(before)
    assert bench.emulator.trouble_codes == []
    bench.emulator.restore(after)
    assert bench.emulator.trouble_codes == codes != []


def test_the_ignition_makes_operation_cycles() -> None:
    bench = lost(Bench(Setup(model="4dof", nodes={"VEH": "external"}), sending={}).run(10))
    driver = {"SelectorPosition": "D", "AcceleratorPedal": 0.0, "BrakePedal": 0.0}
    bench = Bench(Setup(model="4dof", nodes={"VEH": "external"}))
    bench.ask_and_run(300, **driver, IgnitionState="On")
    (code,) = lost(bench).emulator.trouble_codes
    assert {"testFailedThisOperationCycle", "pendingDTC"} <= set(code.bits)
    bench.ask_and_run(800, IgnitionState="Off")
    bench.ask_and_run(800, IgnitionState="On")
    (code,) = bench.emulator.trouble_codes
    assert "testFailedThisOperationCycle" not in code.bits
    assert "pendingDTC" in code.bits
    bench.ask_and_run(800, IgnitionState="Off")
    bench.ask_and_run(800, IgnitionState="On")
    (code,) = bench.emulator.trouble_codes
    assert code.bits == ("confirmedDTC", "testFailedSinceLastClear")


def test_codes_survive_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "codes.json"
    bench = Bench(CAR).run(200)
    store = CodeStore(bench.emulator, path)
    assert store.save() == ""
    assert read_store(path) == []
    lost(bench)
    assert store.save() == ""
    (stored,) = read_store(path)
    assert (stored.code, stored.occurrences, stored.first_ns) == ("U1102-87", 1, 0)
    again = Bench(CAR)
    CodeStore(again.emulator, path)
    (code,) = again.run(100).emulator.trouble_codes
    assert code.bits == ("pendingDTC", "confirmedDTC", "testFailedSinceLastClear")
    assert again["TroubleCodesConfirmed"] == 1
    (code,) = lost(again).emulator.trouble_codes
    assert code.occurrences == 2
    assert [each.name for each in tmp_path.iterdir()] == ["codes.json"]


def test_what_a_store_may_not_be(tmp_path: Path) -> None:
    path = tmp_path / "codes.json"
    emulator = Bench(CAR).emulator
    for text, complaint in (
        (
            "",
            "codes.json: expected trouble codes as --dtc-store writes them, got Input data was trunc",
        ),
        ("\xff", "codes.json: expected trouble codes as --dtc-store writes them, got"),
        (
            '{"version": 2, "codes": []}',
            "expected trouble codes as --dtc-store writes them, got Invalid",
        ),
        ('{"version": 1, "codes": [{"code": 3}]}', "expected trouble codes as --dtc-store"),
        (
            '{"version": 1, "codes": [{"code": "U1101-87", "message": "M", "status": 900}]}',
            "got Expected `int` <= 255 - at `$.codes[0].status`",
        ),
        (
            '{"version": 1, "codes": [{"code": "U1101-87", "message": "M", "status": 9, "age": 1e40}]}',
            "got Expected `int`",
        ),
    ):
        path.write_text(text, encoding="latin-1")
        with pytest.raises(InputError) as refused:
            CodeStore(emulator, path)
        assert complaint in str(refused.value)
        assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="expected a file in a folder that exists, got no folder"):
        CodeStore(emulator, tmp_path / "none" / "codes.json")
    with pytest.raises(InputError, match="expected a file of trouble codes, got Is a directory"):
        CodeStore(emulator, tmp_path)
    path.write_text('{"version": 1, "codes": [{"code": "U3F00-87", "message": "M", "status": 8}]}')
    assert CodeStore(emulator, path).strangers == ["U3F00-87"]


def test_a_store_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    store = CodeStore(Bench(CAR).emulator, folder / "codes.json")
    folder.rmdir()
    assert store.save().endswith("codes.json: trouble codes not stored: No such file or directory")


def test_records_name_their_bits() -> None:
    assert TroubleCode(code="U1102-87", message="M", status=0x50).bits == (
        "testNotCompletedSinceLastClear",
        "testNotCompletedThisOperationCycle",
    )
