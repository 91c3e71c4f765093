"""The high-pressure circuit in pressures: pump, accumulator, relief, three valves, two cylinders."""

from __future__ import annotations

import math
from typing import Any

# Places in the circuit's state.
SUPPLY, CLUTCH, SHIFT1, SHIFT2, PISTON, PUMP = range(6)
SPOOL = 6  # three pairs of position and velocity
N_STATE = 12


class Circuit:
    """Constants and the right-hand side."""

    def __init__(self, p: Any) -> None:
        self.p = p
        oil = p.oil
        self.factor = oil.discharge_coefficient * math.sqrt(2.0 / oil.density)
        self.laminar = oil.laminar_pressure**2
        self.c_line = p.supply.line_volume / oil.bulk_modulus
        self.c_clutch = p.clutch.volume / oil.bulk_modulus
        self.c_shift = (p.shift.volume1 / oil.bulk_modulus, p.shift.volume2 / oil.bulk_modulus)
        self.valves = (p.clutch_valve, p.shift_valve, p.shift_valve)

    def _orifice(self, area: float, drop: float) -> float:
        """Return the flow, m^3/s: turbulent, and linear near zero."""
        return self.factor * area * drop / (drop * drop + self.laminar) ** 0.25

    def flows(self, valve: int, spool: float, supply: float, chamber: float) -> tuple[float, float]:
        """Return the flows from the supply into the chamber and out of it into the tank."""
        v = self.valves[valve]
        full = 1.0 + v.underlap
        drop = supply - chamber
        into = v.leak * drop + self._orifice(v.area * max(v.underlap + spool, 0.0) / full, drop)
        area = v.area * max(v.underlap - spool, 0.0) / full
        if valve > 0 and chamber < 0.0:
            area += self.p.shift.make_up_area
        return into, v.leak * chamber + self._orifice(area, chamber)

    def pack_force(self, piston: float) -> float:
        """Return the force that presses the plates, N."""
        return float(self.p.clutch.pack * max(piston - self.p.clutch.kiss_travel, 0.0))

    def piston_speed(self, pressure: float, piston: float) -> float:
        """Return the massless piston's speed against spring, plates and seal."""
        return self.piston_push(pressure, piston) / float(self.p.clutch.seal_damping)

    def piston_push(self, pressure: float, piston: float) -> float:
        """Return the force that moves the piston against its seal, N."""
        c = self.p.clutch
        push = c.area * pressure - c.preload - c.spring * piston - self.pack_force(piston)
        return float(push)

    def shift_force(self, z: Any) -> float:
        """Return the force on the sleeve, N, towards G1."""
        return float(self.p.shift.area1 * z[SHIFT1] - self.p.shift.area2 * z[SHIFT2])

    def spool_target(self, valve: int, current: float) -> float:
        """Return where the current holds the spool, -1 to 1."""
        if current <= 0.0:
            return -1.0
        return float(min(2.0 * current / self.valves[valve].full_current - 1.0, 1.0))

    def spool_push(self, valve: int, position: float, velocity: float, current: float) -> float:
        """Return a spool's acceleration, 1/s^2."""
        v = self.valves[valve]
        w = v.natural_frequency
        away = self.spool_target(valve, current) - position
        return float(w * w * away - 2.0 * v.damping * w * velocity)

    def rates(
        self, z: Any, currents: Any, pump_on: bool, sleeve_speed: float, resting: Any
    ) -> list[float]:
        """Return dz/dt; ``resting``: whether each spool, then the piston, rests at its stop."""
        p, s = self.p, self.p.supply
        out = [0.0] * N_STATE
        supply = z[SUPPLY]
        tau = s.time_constant
        wanted = s.speed if pump_on else 0.0
        out[PUMP] = (wanted - z[PUMP]) / tau
        pumped = max(s.displacement * z[PUMP] - s.leak * supply, 0.0)
        relieved = s.relief_slope * max(supply - s.relief_pressure, 0.0)
        taken = 0.0
        chambers = (CLUTCH, SHIFT1, SHIFT2)
        net = []
        for valve, chamber in enumerate(chambers):
            into, back = self.flows(valve, z[SPOOL + 2 * valve], supply, z[chamber])
            taken += into
            net.append(into - back)
            at = SPOOL + 2 * valve
            if not resting[valve]:
                out[at] = z[at + 1]
                out[at + 1] = self.spool_push(valve, z[at], z[at + 1], currents[valve])
        compliance = self.c_line if supply <= s.precharge else s.accumulator_compliance
        out[SUPPLY] = (pumped - relieved - taken) / compliance
        if not resting[3]:
            out[PISTON] = self.piston_speed(z[CLUTCH], z[PISTON])
        out[CLUTCH] = (net[0] - p.clutch.area * out[PISTON]) / self.c_clutch
        out[SHIFT1] = (net[1] - p.shift.area1 * sleeve_speed) / self.c_shift[0]
        out[SHIFT2] = (net[2] + p.shift.area2 * sleeve_speed) / self.c_shift[1]
        return out
