"""The command as a process of its own: its end leaves nothing unsaid and no code untold."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import pytest

from hev_can_emu.cli import build_parser

RUN = """\
import atexit, sys
from hev_can_emu import cli
sys.argv = ["hev-can-emu", *sys.argv[1:]]
atexit.register(print, "said at the end")
cli.command()
"""


@pytest.mark.parametrize(
    ("arguments", "code"), [(["modes"], 0), (["modes", "--vehicle", "nobody"], 2), (["--help"], 0)]
)
def test_the_end_is_told(arguments: list[str], code: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", RUN, *arguments], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == code
    assert done.stdout.endswith("said at the end\n")
    assert (len(done.stdout.splitlines()) > 1) == (code == 0)
    assert bool(done.stderr) == (code != 0)


def test_output_that_is_lost_is_told() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "hev_can_emu.cli", "modes"],
            stdout=full, stderr=subprocess.PIPE, text=True, timeout=60,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == "hev-can-emu: output: No space left on device\n"


@pytest.mark.parametrize("columns", ["60", "0", "200", "", "wide", None])
def test_help_is_laid_out_as_argparse_does(
    columns: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    if columns is None:
        monkeypatch.delenv("COLUMNS", raising=False)
    else:
        monkeypatch.setenv("COLUMNS", columns)
    parser = build_parser(["scenario", "run"])
    laid_out = parser.format_help()
    parser.formatter_class = argparse.HelpFormatter
    assert parser.format_help() == laid_out


def test_a_command_alone_is_read_as_among_all_others(capsys: pytest.CaptureFixture[str]) -> None:
    alone, among = build_parser(["modes"]), build_parser(["--", "modes"])
    assert vars(alone.parse_args(["modes"])) == vars(among.parse_args(["modes"]))
    told = []
    for parser in (alone, among):
        with pytest.raises(SystemExit):
            parser.parse_args(["modes", "--help"])
        told.append(capsys.readouterr().out)
    assert told[0] == told[1]
    assert "scenario" in build_parser([]).format_help()
