"""A small closed loop for the sleeve: an inertia with it, a gear's inertia, locks that truly stick.

Written apart from the product's driveline: within a step torques are constant, so speeds are straight
lines; the instant at which the slip is gone is met exactly.
"""

from __future__ import annotations

import math

import numpy as np
import sleeve_defaults as defaults

from hev_can_emu.plant import sleeve as s

ENERGIES = (
    *(s.OUT_WORK, s.OUT_KINETIC, s.OUT_ELASTIC, s.OUT_DAMPING_LOSS, s.OUT_FRICTION_LOSS),
    *(s.OUT_STOP_LOSS, s.OUT_TOOTH_WORK, s.OUT_TOOTH_LAG),
)


class Box:
    """Sleeve (inertia, load) beside one gear (inertia, load); the other gear turns with the first."""

    def __init__(
        self,
        gear=1,
        slip=0.0,
        inertia=0.07,
        gear_inertia=0.5,
        load=0.0,
        gear_load=0.0,
        place=0.0,
        parameters=defaults.SLEEVE,
        dt=5e-5,
        position=0.0,
    ):
        self.parameters, self.dt, self.gear = parameters, dt, gear
        self.p = parameters.pack(dt)
        self.x, self.out = np.zeros(s.N_STATE), np.zeros(s.N_OUT)
        self.side = 1.0 if gear == 1 else -1.0
        self.x[s.X_POSITION] = self.side * position
        self.speed, self.gear_speed = 100.0 + slip, 100.0
        self.inertia, self.gear_inertia = inertia, gear_inertia
        self.load, self.gear_load = load, gear_load
        self.angle, self.held, self.torque, self.end = place, 0.0, 0.0, 0
        self.locks = True
        self.time = self.heat = self.impacts = self.chamfer_work = 0.0
        self.sums = dict.fromkeys(ENERGIES, 0.0)
        self.zones: list[int] = []
        self.slip_at: dict[int, float] = {}

    @property
    def slip(self):
        return self.speed - self.gear_speed

    @property
    def travel(self):
        return self.side * self.x[s.X_POSITION]

    @property
    def kinetic(self):
        return 0.5 * (self.inertia * self.speed**2 + self.gear_inertia * self.gear_speed**2)

    def of_gear(self, index):
        """An output of the gear under test."""
        return self.out[index + self.gear - 1]

    def step(self, force, stiffness=0.0):
        mine = (self.slip, self.angle, self.held, self.torque)
        other = (self.slip, 0.0, 0.0, 0.0)
        pair = zip(mine, other, strict=True) if self.gear == 1 else zip(other, mine, strict=True)
        s.sleeve_step(
            self.p, self.x, force, stiffness, *(value for two in pair for value in two), self.out
        )
        for key in ENERGIES:
            self.sums[key] += self.out[key]
        zone = int(self.out[s.OUT_ZONE])
        if not self.zones or zone != self.zones[-1]:
            self.zones.append(zone)
            self.slip_at.setdefault(zone, self.slip)
        if self.of_gear(s.OUT_DOG1) > 0.5:
            self._dogs()
        else:
            self.end = 0
            self._friction()
        self.time += self.dt
        return zone

    def _turn(self, torque, time):
        """Turn freely under a torque on the sleeve, reversed on the gear."""
        slip = self.slip
        self.speed += time * (self.load + torque) / self.inertia
        self.gear_speed += time * (self.gear_load - torque) / self.gear_inertia
        turned = 0.5 * time * (slip + self.slip)
        self.angle += turned
        return turned

    def _share(self):
        """Torque on the sleeve that keeps both at one speed."""
        total = self.inertia + self.gear_inertia
        return self.inertia * (self.load + self.gear_load) / total - self.load

    def _merge(self):
        common = self.inertia * self.speed + self.gear_inertia * self.gear_speed
        self.speed = self.gear_speed = common / (self.inertia + self.gear_inertia)

    def _friction(self):
        chamfer = self.of_gear(s.OUT_CHAMFER1)
        capacity = self.of_gear(s.OUT_CONE1) + self.of_gear(s.OUT_DRAG1)
        needed = self._share() - chamfer  # from friction, to hold
        left = self.dt
        if self.slip != 0.0:
            friction = -math.copysign(capacity, self.slip)
            rate = (self.load + chamfer + friction) / self.inertia
            rate -= (self.gear_load - chamfer - friction) / self.gear_inertia
            stops = -self.slip / rate if rate * self.slip < 0.0 else math.inf
            time = min(stops, self.dt)
            before = self.angle
            self.heat -= friction * self._turn(chamfer + friction, time)
            self.chamfer_work += chamfer * (self.angle - before)
            left = self.dt - time
            if left > 0.0:
                self._merge()
        self.held = 0.0
        if self.slip == 0.0 and left >= 0.0:
            if abs(needed) <= capacity and capacity > 0.0 and self.locks:
                self.held, self.torque = 1.0, needed
                self._turn(self._share(), left)
            else:
                friction = math.copysign(min(capacity, abs(needed)), needed)
                before = self.angle
                self.heat -= friction * self._turn(chamfer + friction, left)
                self.chamfer_work += chamfer * (self.angle - before)
        if self.held == 0.0:
            self.torque = 0.0

    def _dogs(self):
        half = self.parameters.half_clearance
        if self.out[s.OUT_GAP1 + self.gear - 1] != 0.0:
            self.angle = self.out[s.OUT_GAP1 + self.gear - 1]
        if self.end and self._share() * self.end <= 0.0:
            self.held, self.torque = 1.0, self._share()
            self._turn(self.torque, self.dt)
            return
        self.end, self.held, self.torque = 0, 0.0, 0.0
        self._turn(0.0, self.dt)
        if abs(self.angle) >= half and self.angle * self.slip > 0.0:
            self.end = 1 if self.angle > 0.0 else -1
            self.angle = self.end * half
            before = self.kinetic
            self._merge()
            self.impacts += before - self.kinetic
            self.held = 1.0

    def run(self, force, time, until=None):
        """Push towards the gear; stop on reaching a zone."""
        for _ in range(round(time / self.dt)):
            if self.step(self.side * force) == until:
                break
        return self

    def unbalanced(self):
        """What the sleeve's own books leave open, J."""
        got = self.sums[s.OUT_WORK] + self.sums[s.OUT_TOOTH_WORK]
        return got - sum(v for k, v in self.sums.items() if k not in (s.OUT_WORK, s.OUT_TOOTH_WORK))
