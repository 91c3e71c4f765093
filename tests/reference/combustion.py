"""The engine above idle: map, drag, intake lag, charges caught and burnt by half turns."""

from __future__ import annotations

from typing import Any

from reference.parameters import line


class Combustion:
    """Constants; the charges that change at half turns are state."""

    def __init__(self, p: Any) -> None:
        self.p = p
        self.columns = [list(column) for column in zip(*p.torque, strict=True)]
        self.burning = self.caught = 0.0

    def drag(self, speed: float) -> float:
        """Return what the unfuelled engine takes, N m."""
        size = line(abs(speed), self.p.speed, self.p.drag)
        return float(size * min(max(speed / self.p.drag_fade_speed, -1.0), 1.0))

    def _row(self, speed: float) -> list[float]:
        """Return the map's torques over load at this speed."""
        return [line(speed, self.p.speed, column) for column in self.columns]

    def torque(self, speed: float) -> float:
        """Return the mean combustion torque of the charge that burns, N m."""
        return line(self.burning, self.p.load, self._row(speed))

    def load(self, request: float, speed: float) -> float:
        """Return the charge that the control unit wants for a torque after friction, N m."""
        row = self._row(speed)
        asked = min(max(request + self.drag(speed), 0.0), row[-1])
        return line(asked, row, self.p.load)

    def charge_rate(self, charge: float, request: float, speed: float) -> float:
        """Return d(charge)/dt: the lag is a crank angle, bounded in time."""
        lag = min(self.p.intake_angle / max(abs(speed), 1e-9), self.p.intake_time_max)
        return (self.load(request, speed) - charge) / lag

    def half_turn(self, charge: float, request: float, speed: float) -> None:
        """At a dead centre: what was caught burns, what the intake holds now is caught."""
        self.burning = self.caught
        fuelled = request + self.drag(speed) > 0.0
        self.caught = charge if fuelled else 0.0
