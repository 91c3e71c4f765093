"""CPU time of the command's answers that need no plant: python benchmarks/startup.py.

Prints the median and the largest CPU time (user and system, in ms) of fresh processes.
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
from pathlib import Path

ROUNDS = 15
LIMIT_S = 0.15
COMMANDS = (["--help"], ["--version"], ["no-such-command"])


def cpu_seconds(command: list[str]) -> float:
    """Return the CPU time that one run of the command took."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    """Measure the commands in turns, so that a busy machine slows all alike."""
    program = str(Path(sys.executable).parent / "hev-can-emu")
    rounds = [[cpu_seconds([program, *words]) for words in COMMANDS] for _ in range(ROUNDS)]
    for words, times in zip(COMMANDS, zip(*rounds, strict=True), strict=True):
        median, largest = statistics.median(times), max(times)
        print(
            f"hev-can-emu {' '.join(words):16} median {1e3 * median:5.0f} ms   largest"
            f" {1e3 * largest:5.0f} ms   limit {1e3 * LIMIT_S:.0f} ms"
        )


if __name__ == "__main__":
    main()
