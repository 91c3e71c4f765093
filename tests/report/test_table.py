"""The table of verdicts, as it goes into a log."""

import io
import os
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from hev_can_emu.report.table import (
    VerdictRow,
    log_table,
    print_verdicts,
    summary,
    verdict_table,
)

ROWS = [
    VerdictRow("engine starts", "pass", 1.2344, "EngineState == running", "running", "0.766 s"),
    VerdictRow("clutch [C1] closes", "fail", None, "ClutchState == closed", "never"),
]


def test_every_row_is_one_line_in_a_log() -> None:
    log = io.StringIO()
    print_verdicts(ROWS, "launch.yaml", log)
    lines = log.getvalue().splitlines()
    starts = next(line for line in lines if line.lstrip().startswith("engine starts"))
    assert starts.split("  ")[0].strip() == "engine starts"
    for part in ("pass", "1.234 s", "EngineState == running", "0.766 s"):
        assert part in starts
    # Square brackets are text, not markup.
    closes = next(line for line in lines if "clutch [C1] closes" in line)
    assert "fail" in closes
    assert "never" in closes
    assert lines[0].strip() == "launch.yaml"
    assert lines[-1].strip() == "1 pass, 1 fail"


def test_summary_counts_in_a_fixed_order() -> None:
    assert summary([ROWS[1], ROWS[0], ROWS[1]]) == "1 pass, 2 fail"
    assert summary([]) == "no expectations"


def as_rich_prints(rows: list[VerdictRow], title: str) -> str:
    log = io.StringIO()
    Console(file=log, highlight=False, width=140).print(verdict_table(rows, title))
    return log.getvalue()


WORDS = st.lists(st.text("ab []:-=.'", max_size=40), max_size=8).map(" ".join)
LONG = st.builds(lambda text, times: text * times, WORDS, st.integers(1, 4))


@given(
    st.lists(
        st.builds(
            VerdictRow,
            LONG,
            st.sampled_from(["pass", "fail", "inconclusive", "error"]),
            st.none() | st.floats(0.0, 1e6),
            LONG,
            LONG,
            st.text("0123456789. km/h", max_size=30),
        ),
        max_size=6,
    ),
    LONG,
)
def test_a_log_has_what_rich_prints(rows: list[VerdictRow], title: str) -> None:
    assert log_table(rows, title) == as_rich_prints(rows, title)


def test_a_log_of_ordinary_rows_is_made_without_rich() -> None:
    rows = [*ROWS, VerdictRow("long " * 30, "pass", 12.0, "word" * 60, "x " * 100, "1 km/h")]
    assert log_table(rows, "title " * 40) == as_rich_prints(rows, "title " * 40)
    head = "import sys; from hev_can_emu.report.table import VerdictRow, print_verdicts\n"
    code = f"{head}print_verdicts([VerdictRow('a', 'pass', 1.0, 'b', 'c')], 'd')\n"
    code += "print('rich' in sys.modules)"
    usual = {key: value for key, value in os.environ.items() if key != "FORCE_COLOR"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=usual, capture_output=True, text=True, check=True
    )
    assert done.stdout == as_rich_prints([VerdictRow("a", "pass", 1.0, "b", "c")], "d") + "False\n"
    coloured = subprocess.run(
        [sys.executable, "-c", code],
        env={**usual, "FORCE_COLOR": "1"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "\x1b[" in coloured.stdout


@pytest.mark.parametrize("text", ["fünf", "車", "two\nlines", "a\ttab"])
def test_other_letters_are_left_to_rich(text: str) -> None:
    rows = [VerdictRow(text, "pass", 1.0, "b", "c")]
    assert log_table(rows, "title") is None
    log = io.StringIO()
    print_verdicts(rows, "title", log)
    assert log.getvalue() == as_rich_prints(rows, "title")
