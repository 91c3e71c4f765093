"""Runs the tests marked ``socketcan`` on a real kernel's vcan0; run by ``make socketcan``.

Where no such kernel can be had this fails; it never skips.  It leaves in ``out/socketcan`` the candump of
a mode switch that can-utils alone brought about.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from with_vcan0 import NoVcanError, find, run_with_vcan0

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
RESULTS = REPOSITORY / "out" / "socketcan"
TESTS = [
    *(sys.executable, "-B", "-m", "pytest", "-q", "--color=no", "-p", "no:cacheprovider"),
    *("-m", "socketcan", "--durations=3", "tests/bus/test_contract.py", "tests/socketcan"),
]


def main() -> int:
    """Run the stage; returns the exit code."""
    started = time.monotonic()
    os.chdir(REPOSITORY)
    missing = [t for t in ("candump", "cansend", "cangen", "canplayer", "ip") if not find(t)]
    if missing:
        return fail(f"no {', '.join(missing)}; install Debian's can-utils and iproute2")
    shutil.rmtree(RESULTS, ignore_errors=True)
    RESULTS.mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="hev-can-emu-") as folder:
        scratch = Path(folder)
        try:
            code = run_with_vcan0(TESTS, scratch)
        except (NoVcanError, subprocess.TimeoutExpired) as error:
            return fail(str(error))
        for name in ("candump.log", "switch.txt", "emulator.txt"):
            if (scratch / name).exists():
                shutil.copy(scratch / name, RESULTS)
    if code != 0:
        return fail(f"the tests ended with {code}")
    print((RESULTS / "switch.txt").read_text().rstrip())
    where = RESULTS.relative_to(REPOSITORY)
    print(f"socketcan: PASS in {time.monotonic() - started:.0f} s; candump.log in {where}")
    return 0


def fail(why: str) -> int:
    print(f"socketcan: FAIL: {why}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
