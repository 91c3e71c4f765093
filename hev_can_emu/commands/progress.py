"""The progress of a scenario in real time: a bar, the present step, what happens above it."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

if TYPE_CHECKING:
    from hev_can_emu.bus.port import Bus
    from hev_can_emu.runtime.emulator import Event
    from hev_can_emu.runtime.playing import Playing
    from hev_can_emu.runtime.service import Statistics

_TOLD = {"mode", "synchronizer", "lost", "healed", "conflict", "bus"}


class PlayProgress:
    """A rich progress bar over the scenario's steps; on anything but a terminal, lines only."""

    def __init__(self, playing: Playing) -> None:
        self._playing = playing
        self._console = Console(stderr=True, highlight=False)
        if not self._console.is_terminal:
            self._console = Console(stderr=True, highlight=False, width=140)
        self._bar = Progress(
            TextColumn("{task.description:24s}"),
            BarColumn(bar_width=30),
            TextColumn("{task.fields[speed]:6.1f} km/h"),
            TimeElapsedColumn(),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._steps = max(len(playing.player.program.steps), 1)
        self._task = self._bar.add_task(playing.scenario.name[:24], total=self._steps, speed=0.0)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def ready(self, bus: Bus) -> None:
        """Say where the car is, and how to join."""
        self._console.print(f"{self._playing.scenario.name} on {bus.describe()}")
        if bus.join_hint():
            self._console.print(f"join from another terminal:  {bus.join_hint()}", soft_wrap=True)

    def status(self, statistics: Statistics) -> None:
        """Move the bar."""
        player = self._playing.player
        taken = sum(verdict.kind == "step" for verdict in player.verdicts())
        step = min(taken, self._steps - 1)
        name = player.program.steps[step].name if player.program.steps else ""
        speed = self._playing.emulator.truth("vehicle_speed") * 3.6
        self._bar.update(self._task, completed=taken, description=name[:24], speed=speed)

    def event(self, event: Event) -> None:
        """Print an event that a person follows."""
        if event.kind in _TOLD:
            self._console.print(
                f"{event.t_ns * 1e-9:8.3f} s  {event.kind}: {event.text}", markup=False
            )

    def end(self, statistics: Statistics) -> None:
        """Complete the bar and tell how well the clock was held."""
        self._bar.update(self._task, completed=self._steps)
        median, p99, worst = statistics.lateness_us()
        self._console.print(
            f"{statistics.ticks} ticks, {statistics.overruns} overruns; tick done {median:.0f} us after its "
            f"deadline (median), {p99:.0f} us (99 %), {worst:.0f} us (most); {statistics.sent} frames sent"
        )
        sys.stderr.flush()
