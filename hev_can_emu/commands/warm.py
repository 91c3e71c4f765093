"""``hev-can-emu warm``: compile every kernel into the cache, telling how far it is."""

from __future__ import annotations

import argparse
import time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--quiet", action="store_true", help="say nothing but errors")


def execute(arguments: argparse.Namespace) -> int:
    """Compile; returns the exit code."""
    started_s = time.monotonic()
    from hev_can_emu.bus.bits import bits_of
    from hev_can_emu.commands._compiling import compiling
    from hev_can_emu.jit import cache_home
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.runtime.setup import Setup
    from hev_can_emu.runtime.signal_log import SignalLog
    from hev_can_emu.scenario.warming import warm_scenario_kernels
    from hev_can_emu.telemetry.candump import format_candump
    from hev_can_emu.telemetry.table import Network, rows_of

    with compiling(arguments.quiet):
        for model in ("16dof", "detailed"):  # 4dof has the kernels of 16dof
            emulator = Emulator(Setup(model=model))
            log = SignalLog(emulator.database, emulator.constants.codec)
            frames = emulator.advance(50_000_000)
            log.add(frames, len(frames))
            log.series("EM2Speed")
        emulator.ledger()
        bits_of(frames)
        format_candump(frames)
        rows_of(Network(emulator.database, emulator.constants.codec), frames)
        warm_scenario_kernels()
    if not arguments.quiet:
        taken_s = time.monotonic() - started_s
        print(f"kernels ready in {cache_home()} ({taken_s:.1f} s)")
    return 0
