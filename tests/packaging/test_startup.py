"""The command's face imports nothing heavy: help and errors come at once."""

import subprocess
import sys

HEAVY = (
    "numba",
    "numpy",
    "scipy",
    "can",
    "cantools",
    "pandas",
    "matplotlib",
    "rich",
    "yaml",
    "asyncio",
)
PROGRAM = f"""
import contextlib, io, sys
from hev_can_emu import cli
with contextlib.redirect_stdout(io.StringIO()) as shown:
    try:
        code = cli.main(["--help"])
    except SystemExit as end:
        code = end.code
assert code in (0, None), code
assert "scenario" in shown.getvalue()
print(sorted(set({HEAVY!r}) & set(sys.modules)))
"""


def test_help_imports_nothing_heavy() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"
