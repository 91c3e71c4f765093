"""Runs a car, or a scenario beside one, in step with controllers in other processes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from hev_can_emu.commands._options import seconds

if TYPE_CHECKING:
    from hev_can_emu.bus.lockstep import LockstepBus
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.runtime.lockstep import Car
    from hev_can_emu.runtime.virtual import FrameSink

DEFAULT_BUS = "socketcand"


def add_lockstep_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what ``--clock lockstep`` needs."""
    group = parser.add_argument_group("--clock lockstep")
    group.add_argument(
        "--partners",
        metavar="N",
        type=int,
        default=1,
        help="controllers that time waits for (default: 1)",
    )
    group.add_argument(
        "--patience",
        metavar="S",
        type=seconds,
        default=10.0,
        help="how long one may take for a step (default: 10 s)",
    )


def open_bus_for(arguments: argparse.Namespace, bus: str | None, emulator: Emulator) -> LockstepBus:
    """Return the bus, yet to be opened; raises InputError for one that cannot be."""
    from hev_can_emu.bus.open import open_lockstep_bus

    return open_lockstep_bus(
        bus or DEFAULT_BUS, lambda: emulator.now_ns, arguments.partners, arguments.patience
    )


def run_lockstep(
    car: Car,
    emulator: Emulator,
    bus: LockstepBus,
    sinks: Sequence[FrameSink],
    *,
    finished: Callable[[], bool],
    longest_ns: int | None = None,
    end_ns: int = 1 << 62,
    tell: Callable[[str], None],
) -> str:
    """Run until ``finished``; return the trace hash of all frames sent.

    Args:
        car: what is stepped.
        emulator: its clock.
        bus: yet to be opened.
        sinks: take what is received and sent.
        finished: asked before each step.
        longest_ns: how long the car may run between two looks at it.
        end_ns: not beyond this.
        tell: takes notices of the bus.

    Raises:
        BusError: a partner has left, or has not answered in time.
    """
    import asyncio

    from hev_can_emu.runtime.lockstep import Lockstep
    from hev_can_emu.runtime.virtual import TraceHash

    async def serve() -> str:
        trace = TraceHash()
        async with bus:
            print(f"{bus.describe()}; docs/lockstep.md tells how a controller joins")
            sys.stdout.flush()
            lockstep = Lockstep(car, lambda: emulator.now_ns, bus, sinks)
            while not finished():
                until = end_ns
                if longest_ns is not None:
                    until = min(until, (emulator.now_ns // longest_ns + 1) * longest_ns)
                _, sent = await lockstep.step(until)
                trace.add(sent, len(sent))
                for notice in bus.take_notices():
                    tell(notice)
        return trace.hexdigest()

    return asyncio.run(serve())
