"""``hev-can-emu warm``: compile every kernel into the cache, telling how far it is."""

from __future__ import annotations

import argparse
import sys
import time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--quiet", action="store_true", help="say nothing but errors")


def execute(arguments: argparse.Namespace) -> int:
    """Compile; returns the exit code."""
    started = time.monotonic()

    def say(text: str) -> None:
        if not arguments.quiet:
            print(f"[{time.monotonic() - started:5.1f} s] {text}")
            sys.stdout.flush()

    say("importing")
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.runtime.setup import Setup

    say("preparing the car (propagators, codec)")
    emulator = Emulator(Setup())
    say("compiling the tick (a minute the first time, a second once cached)")
    emulator.advance(50_000_000)
    from hev_can_emu.jit import cache_folder

    say(f"ready; kernels are in {cache_folder()}")
    return 0
