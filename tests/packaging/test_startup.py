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


RUN = """
import sys
from hev_can_emu import cli
sys.argv = ["hev-can-emu", "modes", "--help"]
try:
    cli.main()
except SystemExit:
    pass
import msgspec
shown = "typing_extensions" in sys.modules
import typing_extensions
print(shown, typing_extensions.get_type_hints.__module__)
"""


def test_a_command_imports_msgspec_without_what_python_has_already() -> None:
    done = subprocess.run(
        [sys.executable, "-c", RUN], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.splitlines()[-1] == "False typing_extensions"
