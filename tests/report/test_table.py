"""The table of verdicts, as it goes into a log."""

import io
import os
import subprocess
import sys

from hev_can_emu.report.table import VerdictRow, log_lines, print_verdicts, summary

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


def test_columns_stand_under_each_other_however_long_a_cell_is() -> None:
    rows = [*ROWS, VerdictRow("long " * 30, "pass", 12.0, "word" * 60, "two\nlines", "1 km/h")]
    lines = log_lines(rows, "title")
    assert len(lines) == len(rows) + 3
    heads = lines[1]
    for line, row in zip(lines[2:-1], rows, strict=True):
        for heading, cell in (
            ("verdict", row.verdict),
            ("expected", row.expected),
            ("observed", row.observed.replace("\n", " ")),
        ):
            assert line[heads.index(heading) :].startswith(cell)


PROGRAM = """\
import sys
from hev_can_emu.report.table import VerdictRow, print_verdicts
print_verdicts([VerdictRow("a [b]", "pass", 1.0, "b", "c")], "d")
print("rich" in sys.modules)
"""


def test_rich_is_for_terminals_and_where_colour_is_asked_for() -> None:
    usual = {key: value for key, value in os.environ.items() if key != "FORCE_COLOR"}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=usual, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == [
        *log_lines([VerdictRow("a [b]", "pass", 1.0, "b", "c")], "d"),
        "False",
    ]
    coloured = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**usual, "FORCE_COLOR": "1"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "\x1b[" in coloured.stdout
    assert "a [b]" in coloured.stdout
    assert coloured.stdout.endswith("True\n")
