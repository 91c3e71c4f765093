"""The table of verdicts, as it goes into a log."""

import io

from hev_can_emu.report.table import VerdictRow, print_verdicts, summary

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
