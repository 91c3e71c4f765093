"""The progress of a scenario in real time: a bar, the awaited step, what happens above it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hev_can_emu.commands._live import LiveLine, bar

if TYPE_CHECKING:
    from hev_can_emu.bus.port import Bus
    from hev_can_emu.runtime.event_texts import Event
    from hev_can_emu.runtime.playing import Playing
    from hev_can_emu.runtime.statistics import Statistics

_TOLD = {"lost", "healed", "conflict", "bus"}


class PlayProgress:
    """A bar over the scenario's time that names the step waited for; without a terminal, lines only."""

    def __init__(self, playing: Playing) -> None:
        self._playing = playing
        self._line = LiveLine()
        self._length_s = max(playing.player.program.duration_ns * 1e-9, 1e-3)

    def ready(self, bus: Bus) -> None:
        """Say where the car is, and how to join."""
        self._line.say(f"{self._playing.scenario.name}: {self._length_s:g} s on {bus.describe()}")
        if bus.join_hint():
            self._line.say(f"join from another terminal:  {bus.join_hint()}")

    def status(self, statistics: Statistics) -> None:
        """Move the bar."""
        awaited = self._playing.player.awaited
        self._show(f"waits for: {awaited}" if awaited else "all steps taken")

    def event(self, event: Event) -> None:
        """Print an event that a person follows."""
        if event.kind == "mode" and event.text != "transition":
            words = event.text.replace("_g", " G").replace("_", " ")
            self._line.say(f"{event.t_ns * 1e-9:8.3f} s  {words}")
        elif event.kind in _TOLD:
            self._line.say(f"{event.t_ns * 1e-9:8.3f} s  {event.kind}: {event.text}")

    def end(self, statistics: Statistics) -> None:
        """Complete the bar and tell how well the clock was held."""
        self._show("over" if self._playing.finished else "stopped")
        self._line.end()
        self._line.say(f"{statistics.describe()}; {statistics.sent} frames sent")

    def _show(self, text: str) -> None:
        emulator = self._playing.emulator
        now_s = emulator.now_ns * 1e-9
        self._line.show(
            f"{bar(now_s / self._length_s)} {min(now_s, self._length_s):5.1f} s  "
            f"{emulator.truth('vehicle_speed') * 3.6:5.1f} km/h  {text}"
        )
