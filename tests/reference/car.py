"""The whole car on its way from series to parallel: state, right-hand side, modes and crossings.

Left out, because the switch does not need it: brakes, standstill, idle governor, battery and DC link (the
voltage stays far from its limit), gear 2, chamfers of the dogs (they must find a gap).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from reference.combustion import Combustion
from reference.dogs import Dogs
from reference.hybrid import Crossing
from reference.machine import Machine
from reference.mechanics import AT, NB, Chain, N, Pistons
from reference.oil import CLUTCH, N_STATE, PISTON, SPOOL, Circuit
from reference.plates import Plates
from reference.sleeve import Sleeve

GRAVITY = 9.80665
# Places in the state.
TWISTS = N
ANGLE = N + NB
CHARGE, PLATES = ANGLE + 1, ANGLE + 2
OIL = ANGLE + 3
EM1, EM2 = OIL + N_STATE, OIL + N_STATE + 2
X, V, RING, GAP = EM2 + 2, EM2 + 3, EM2 + 4, EM2 + 5
HEAT = GAP + 1
SIZE = HEAT + 1


class Car:
    """One car; what changes by leaps are its modes, what is commanded its inputs."""

    def __init__(self, file: Any, temperature: float) -> None:
        finer = file.detailed
        self.chain = Chain(file.driveline, finer.rear_axle)
        self.pistons = Pistons(finer.engine.crank)
        self.combustion = Combustion(finer.engine)
        self.circuit = Circuit(finer.hydraulics)
        self.plates = Plates(finer.clutch, finer.transmission.clutch_wear)
        self.sleeve = Sleeve(finer.sleeve)
        self.dogs = Dogs(finer.sleeve)
        self.em1 = Machine(finer.em1, temperature)
        self.em2 = Machine(finer.em2, temperature)
        self.temperature = temperature
        self.cooling = finer.transmission.clutch_cooling
        road = file.machines.road
        self.tyre = file.driveline.tyre_radius
        self.weight = file.driveline.inertias.Jv / self.tyre**2 * GRAVITY
        self.road = road
        # Inputs.
        self.currents = [0.0, 0.0, 0.0]
        self.pump = False
        self.engine_request = 0.0
        # Modes: what is held; the sign of C1's slide, of the cone's; what stops the sleeve.
        self.c1_held, self.c1_sign = True, 1.0
        self.g1_held = False
        self.g1_sign = 1.0
        self.stopped = "friction"  # or "ring", "end", "": it moves
        self.moving = 1.0
        self.resting = [True, True, True, False]  # spools and clutch piston at their stops
        self.half = 1.0
        self.kissing = True

    # -- parts of the right-hand side

    def held(self) -> list[str]:
        """Return the constraints that hold now."""
        held = ["C1"] if self.c1_held else []
        return [*held, "G1"] if self.g1_held else held

    def slip(self, y: np.ndarray) -> float:
        """Return C1's slip, engine side faster."""
        return float(y[AT["Jc1"]] - y[AT["Jc2"]])

    def gear_slip(self, y: np.ndarray) -> float:
        """Return the sleeve's slip against G1."""
        return float(y[AT["Jsleeve"]] - y[AT["Jg11"]])

    def pack_force(self, y: np.ndarray) -> float:
        """Return what presses C1's plates."""
        return self.circuit.pack_force(y[OIL + PISTON])

    def capacity(self, y: np.ndarray) -> float:
        """Return what C1 carries while it slides, oil film included."""
        slip, force = self.slip(y), self.pack_force(y)
        kinetic = self.plates.kinetic(slip, force, y[PLATES])
        return kinetic + self.plates.drag(slip, y[OIL + PISTON], force, self.temperature)

    def cone(self, y: np.ndarray) -> float:
        """Return the capacity of G1's cone."""
        if y[X] <= 0.0 or self.dogs.inside:
            return 0.0
        push = self.circuit.shift_force(y[OIL : OIL + N_STATE])
        return self.sleeve.cone * self.sleeve.ring_force(y[X], push, y[RING])

    def torques(self, y: np.ndarray) -> np.ndarray:
        """Return what acts on the inertias beside branches and constraints."""
        out = np.zeros(N)
        w_e = y[0]
        a = y[ANGLE]
        _, slope = self.pistons.inertia(a)
        out[0] = self.combustion.torque(w_e) - self.combustion.drag(w_e) - 0.5 * slope * w_e**2
        for name, machine, at in (("Jm1", self.em1, EM1), ("Jm2", self.em2, EM2)):
            speed = y[AT[name]]
            gap = machine.air_gap(y[at], y[at + 1])
            out[AT[name]] = gap - machine.braking(y[at], y[at + 1], speed)
        speed = y[AT["Jv"]] * self.tyre
        rolling = self.road.rolling_coefficient + self.road.rolling_speed_square * speed**2
        force = 0.5 * self.road.air_density * self.road.drag_area * speed * abs(speed)
        out[AT["Jv"]] = -self.tyre * (force + rolling * self.weight)
        if not self.c1_held:
            out[AT["Jc1"]] -= self.c1_sign * self.capacity(y)
            out[AT["Jc2"]] += self.c1_sign * self.capacity(y)
        if not self.g1_held:
            out[AT["Jsleeve"]] -= self.g1_sign * self.cone(y)
            out[AT["Jg11"]] += self.g1_sign * self.cone(y)
        return out

    def motion(self, y: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
        """Return angular accelerations, and what each constraint carries (on its first side)."""
        extra, _ = self.pistons.inertia(y[ANGLE])
        held = self.held()
        rates, carried = self.chain.accelerate(y[:N], y[N:ANGLE], self.torques(y), extra, held)
        return rates, dict(zip(held, carried, strict=True))

    def sleeve_net(self, y: np.ndarray) -> tuple[float, float]:
        """Return the force on the sleeve without dry friction, and that friction's size."""
        push = self.circuit.shift_force(y[OIL : OIL + N_STATE])
        net = push - self.sleeve.back(y[X])
        flanks = self.dogs.grip * abs(self.gear_torque(y)) if self.dogs.side else 0.0
        return net, self.sleeve.dry(y[X], push, self.moving > 0.0, flanks)

    def gear_torque(self, y: np.ndarray) -> float:
        """Return what holds the sleeve to G1, N m, while it is held."""
        return self.motion(y)[1]["G1"]

    def rates(self, _t: float, y: np.ndarray) -> np.ndarray:
        """Return dy/dt in the present modes."""
        out = np.zeros(SIZE)
        speeds = y[:N]
        accelerations, carried = self.motion(y)
        out[:N] = accelerations
        out[N:ANGLE] = self.chain.reach @ speeds
        out[ANGLE] = y[0]
        out[GAP] = self.gear_slip(y)
        out[CHARGE] = self.combustion.charge_rate(y[CHARGE], self.engine_request, y[0])
        if not self.c1_held:
            out[HEAT] = self.capacity(y) * abs(self.slip(y))
        cool = self.plates.cooling(self.cooling) * (y[PLATES] - self.temperature)
        out[PLATES] = (out[HEAT] - cool) / self.plates.p.heat_capacity
        velocity = 0.0 if self.stopped else y[V]
        oil = y[OIL : OIL + N_STATE]
        out[OIL : OIL + N_STATE] = self.circuit.rates(
            oil, self.currents, self.pump, velocity, self.resting
        )
        out[EM1], out[EM1 + 1] = self.em1.rates(y[EM1], y[EM1 + 1], y[AT["Jm1"]])
        out[EM2], out[EM2 + 1] = self.em2.rates(y[EM2], y[EM2 + 1], y[AT["Jm2"]])
        if not self.stopped:
            net, dry = self.sleeve_net(y)
            p = self.sleeve.p
            out[X] = velocity
            out[V] = (net - p.damping * velocity - self.moving * dry) / p.mass
        if self.stopped == "ring" and self.g1_held:
            push = self.circuit.shift_force(oil)
            out[RING] = self.sleeve.ring_rate(push, -self.g1_sign * carried["G1"])
        return out

    # -- what ends a stretch

    def crossings(self) -> list[Crossing]:
        """Return what may change in the present modes."""
        found = [
            Crossing("half turn", lambda t, y: -self.half * math.sin(y[ANGLE])),
            Crossing("kiss", lambda t, y: (-1.0 if self.kissing else 1.0) * self._squeeze(y)),
            self._piston_stop(),
        ]
        if self.c1_held:
            found.append(Crossing("C1 releases", self._overload))
        else:
            found.append(Crossing("C1 slip", lambda t, y: -self.c1_sign * self.slip(y)))
        found += [self._spool_stop(valve) for valve in range(3)]
        return found + self._gear_crossings() + self._sleeve_crossings()

    def _squeeze(self, y: np.ndarray) -> float:
        return float(y[OIL + PISTON] - self.circuit.p.clutch.kiss_travel)

    def _piston_stop(self) -> Crossing:
        if not self.resting[3]:
            return Crossing("piston stops", lambda t, y: -y[OIL + PISTON])
        return Crossing(
            "piston leaves", lambda t, y: self.circuit.piston_push(y[OIL + CLUTCH], y[OIL + PISTON])
        )

    def _spool_stop(self, valve: int) -> Crossing:
        at = OIL + SPOOL + 2 * valve
        if not self.resting[valve]:
            return Crossing(f"spool {valve} stops", lambda t, y: abs(y[at]) - 1.0)

        def away(_t: float, y: np.ndarray) -> float:
            push = self.circuit.spool_push(valve, y[at], 0.0, self.currents[valve])
            return -push * math.copysign(1.0, y[at])

        return Crossing(f"spool {valve} leaves", away)

    def _overload(self, _t: float, y: np.ndarray) -> float:
        _, carried = self.motion(y)
        return abs(carried["C1"]) - self.plates.holding(self.pack_force(y), y[PLATES])

    def _gear_crossings(self) -> list[Crossing]:
        if self.dogs.inside:
            return self.dogs.crossings(GAP, self.gear_slip, self.gear_torque)
        if not self.g1_held:
            return [Crossing("cone slip", lambda t, y: -self.g1_sign * self.gear_slip(y))]
        return [Crossing("cone lets go", lambda t, y: abs(self.motion(y)[1]["G1"]) - self.cone(y))]

    def _sleeve_crossings(self) -> list[Crossing]:
        if self.stopped == "ring":
            return [Crossing("ring turned", lambda t, y: y[RING] - 1.0)]
        if self.stopped:
            return [Crossing("sleeve leaves", self._urge)]
        found = [Crossing("sleeve stops", lambda t, y: -self.moving * y[V])]
        if self.moving > 0.0:
            found.append(Crossing("sleeve at ring", lambda t, y: self._at_ring(y)))
            name, mark = "sleeve at tips", self.dogs.tips
            if self.dogs.inside:
                name, mark = "sleeve at end", self.sleeve.p.end_position
            elif self.dogs.near:
                name, mark = "sleeve at dogs", self.sleeve.p.dog_position
            found.append(Crossing(name, lambda t, y: y[X] - mark))
        return found

    def _at_ring(self, y: np.ndarray) -> float:
        past = y[RING] >= 1.0
        return -1.0 if past else float(y[X] - self.sleeve.p.blocking_position)

    def _urge(self, _t: float, y: np.ndarray) -> float:
        """Return by how much the force on a resting sleeve exceeds its friction."""
        net, dry = self.sleeve_net(y)
        return (-net if self.stopped == "end" else abs(net)) - dry

    # -- what changes then

    def change(self, name: str, y: np.ndarray) -> np.ndarray:
        """Go over to the modes that ``name`` leads to; return the state after it."""
        y = y.copy()
        if name == "half turn":
            y[ANGLE] %= 2.0 * math.pi
            self.half = -self.half
            self.combustion.half_turn(y[CHARGE], self.engine_request, y[0])
        elif name == "kiss":
            self.kissing = not self.kissing
        elif name == "piston stops":
            self.resting[3], y[OIL + PISTON] = True, 0.0
        elif name == "piston leaves":
            self.resting[3] = False
        elif name.startswith("spool"):
            valve = int(name.split()[1])
            at = OIL + SPOOL + 2 * valve
            self.resting[valve] = name.endswith("stops")
            if self.resting[valve]:
                y[at], y[at + 1] = math.copysign(1.0, y[at]), 0.0
        elif name.startswith("C1"):
            self._change_c1(name, y)
        elif name.startswith("cone"):
            self._change_gear(name, y)
        elif name.startswith("dogs"):
            self._change_dogs(name, y)
        else:
            self._change_sleeve(name, y)
        return y

    def _change_c1(self, name: str, y: np.ndarray) -> None:
        if name == "C1 slip":
            self.c1_held = True
            if self._overload(0.0, y) <= 0.0:
                return
        torque = self.motion(y)[1]["C1"]
        self.c1_held = False
        self.c1_sign = -1.0 if torque > 0.0 else 1.0

    def _change_gear(self, name: str, y: np.ndarray) -> None:
        self.g1_held = True
        torque = self.motion(y)[1]["G1"]
        if abs(torque) > self.cone(y) or name == "cone lets go":
            self.g1_held = False
            self.g1_sign = -1.0 if torque > 0.0 else 1.0
            if self.stopped == "ring":
                y[RING] = 0.0

    def _change_dogs(self, name: str, y: np.ndarray) -> None:
        if name == "dogs part":
            self.dogs.side, self.g1_held = 0, False
            return
        both = [AT["Jsleeve"], AT["Jg11"]]
        first, second = self.chain.inertia[both]
        ahead = name.endswith("ahead")
        y[both] = self.dogs.meet(ahead, first, second, (y[both[0]], y[both[1]]))
        y[GAP] = self.dogs.half if ahead else -self.dogs.half
        self.g1_held = True

    def _change_sleeve(self, name: str, y: np.ndarray) -> None:
        if name == "sleeve at ring":
            self.stopped, y[V] = "ring", 0.0
            y[X] = self.sleeve.p.blocking_position
            return
        if name in ("sleeve at tips", "sleeve at dogs"):
            y[GAP] = self.dogs.place(y[GAP], self.gear_slip(y))
            self.dogs.near = True
            if name == "sleeve at dogs":
                self.dogs.inside, self.g1_held = True, False
            return
        if name == "sleeve at end":
            self.stopped, y[V] = "end", 0.0
            y[X] = self.sleeve.p.end_position
            return
        y[V] = 0.0
        if name == "ring turned":
            y[RING] = 1.0
        self.stopped = "friction"
        if self._urge(0.0, y) > 0.0 or name == "sleeve leaves":
            net, _ = self.sleeve_net(y)
            self.moving = 1.0 if net > 0.0 else -1.0
            self.stopped = ""
