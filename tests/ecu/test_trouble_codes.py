"""Trouble codes: what each event does to the status bits, and how supervision sets them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from watched import BINDINGS, CMD, Watch, network

from hev_can_emu.ecu import supervision
from hev_can_emu.ecu import trouble_codes as dtc
from hev_can_emu.ecu.reasons import FAILURES
from hev_can_emu.ecu.trouble_codes import (
    CONFIRMED,
    CYCLE_BEGINS,
    FAILED,
    FAILED_SINCE_CLEAR,
    FAILED_THIS_CYCLE,
    NOT_COMPLETED_SINCE_CLEAR,
    NOT_COMPLETED_THIS_CYCLE,
    PASSED,
    PENDING,
    TEST_FAILED,
    TroubleCode,
    code_number,
    code_text,
)
from hev_can_emu.messages import protection

FRESH = NOT_COMPLETED_SINCE_CLEAR | NOT_COMPLETED_THIS_CYCLE
HISTORY = PENDING | FAILED_SINCE_CLEAR


def played(events: str, confirm: int = 1) -> int:
    """Return the status after events: f failed, p passed, c a cycle begins."""
    code = np.zeros(dtc.COLUMNS, dtype=np.int64)
    code[dtc.STATUS] = dtc.CLEARED
    for t, letter in enumerate(events):
        dtc.code_event(code, {"f": FAILED, "p": PASSED, "c": CYCLE_BEGINS}[letter], confirm, t)
    return int(code[dtc.STATUS])


@pytest.mark.parametrize(
    ("events", "confirm", "status"),
    [
        ("", 1, FRESH),
        ("p", 1, 0),
        ("c", 1, FRESH),
        ("pc", 1, NOT_COMPLETED_THIS_CYCLE),
        ("f", 1, TEST_FAILED | FAILED_THIS_CYCLE | HISTORY | CONFIRMED),
        ("f", 2, TEST_FAILED | FAILED_THIS_CYCLE | HISTORY),
        ("fp", 2, FAILED_THIS_CYCLE | HISTORY),
        ("fpf", 2, TEST_FAILED | FAILED_THIS_CYCLE | HISTORY),  # twice in one cycle counts once
        ("fpc", 2, HISTORY | NOT_COMPLETED_THIS_CYCLE),
        ("fpcf", 2, TEST_FAILED | FAILED_THIS_CYCLE | HISTORY | CONFIRMED),
        ("fpcp", 2, HISTORY),  # pending until a whole cycle is without failure
        ("fpcpc", 2, FAILED_SINCE_CLEAR | NOT_COMPLETED_THIS_CYCLE),
        ("fpcpcf", 2, TEST_FAILED | FAILED_THIS_CYCLE | HISTORY),  # not in a row
        ("fpcc", 2, HISTORY | NOT_COMPLETED_THIS_CYCLE),  # a cycle without a test tells nothing
        ("f" + "pc" * dtc.AGE_CYCLES, 1, FAILED_SINCE_CLEAR | CONFIRMED | NOT_COMPLETED_THIS_CYCLE),
        ("f" + "pc" * (dtc.AGE_CYCLES + 1), 1, FAILED_SINCE_CLEAR | NOT_COMPLETED_THIS_CYCLE),
    ],
)
def test_status_bits(events: str, confirm: int, status: int) -> None:
    assert played(events, confirm) == status


def test_numbers_and_names() -> None:
    assert code_number("U1101", "w") == 0xD10100
    assert code_text(0xD10187) == "U1101-87"
    for text in ("P0A3C", "C3FFF", "B1234", "U0293"):
        assert code_text(code_number(text, "w") | 0x64) == f"{text}-64"
    assert TroubleCode(code="U1101-87", message="M", status=9).bits == (
        "testFailed",
        "confirmedDTC",
    )


@pytest.fixture
def watch(tmp_path: Path) -> Watch:
    text = BINDINGS.replace("reaction: ramp_to_zero,", "reaction: ramp_to_zero, code: U1102,")
    return Watch(network(tmp_path, text))


def told(watch: Watch) -> dict[str, int]:
    names = ("Cmd", "Cap", "State")
    return {
        code.code: code.status for code in dtc.read_codes(watch.codes, watch.rules.number, names)
    }


def test_a_loss_is_a_code_of_its_reason(watch: Watch) -> None:
    watch.look(50)
    assert told(watch) == {}  # nobody has asked yet
    watch.take(60, CMD)
    watch.look(60)
    assert watch.changed
    assert not watch.look(61).changed
    assert told(watch) == {}
    assert (watch.codes[CMD, :, dtc.STATUS] == 0).all()  # every test has passed
    watch.look(95)
    failed = TEST_FAILED | FAILED_THIS_CYCLE | HISTORY | CONFIRMED
    assert told(watch) == {"U1102-87": failed}
    watch.take(100, CMD)
    watch.look(100)
    assert told(watch) == {"U1102-87": failed & ~TEST_FAILED}
    for t in range(110, 150, 10):
        watch.take(t, CMD, protection.CRC_WRONG)
        watch.look(t)
    assert told(watch) == {"U1102-87": failed & ~TEST_FAILED, "U1102-83": failed}
    record = dtc.read_codes(watch.codes, watch.rules.number, ("Cmd", "Cap", "State"))[0]
    assert (record.occurrences, record.first_ns, record.message) == (1, 95_000_000, "Cmd")


def test_nothing_is_recorded_without_ignition(watch: Watch) -> None:
    watch.operating = False
    watch.take(0, CMD)
    watch.look(0)
    watch.look(500)
    assert told(watch) == {}
    watch.operating = True
    supervision.begin_cycle(watch.state, watch.codes, 600_000_000)
    watch.look(600)
    assert told(watch)["U1102-87"] & TEST_FAILED


def test_stored_codes_come_back(watch: Watch) -> None:
    watch.take(0, CMD)
    watch.look(0)
    watch.look(500)
    names = ("Cmd", "Cap", "State")
    stored = dtc.read_codes(watch.codes, watch.rules.number, names)
    dtc.reset_codes(watch.codes)
    assert told(watch) == {}
    alien = TroubleCode(code="U3FFF-87", message="X", status=9)
    assert dtc.write_codes([*stored, alien], watch.codes, watch.rules.number) == ["U3FFF-87"]
    assert dtc.read_codes(watch.codes, watch.rules.number, names) == stored
    assert dtc.count_codes(watch.codes) == (1, 1)
    assert len(FAILURES) == 9
