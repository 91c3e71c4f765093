"""The sleeve in the car's own driveline kernel, beside the tests' independent loop, with all energies."""

from __future__ import annotations

import hydraulics_defaults as hydraulic
import numpy as np
import pytest
from sleeve_bench import Box
from sleeve_defaults import SLEEVE

from hev_can_emu.commands._components.small import Stand, two_inertias
from hev_can_emu.plant import hydraulics as h
from hev_can_emu.plant import shifting, sleeve, teeth
from hev_can_emu.plant.driveline import friction_torque
from hev_can_emu.plant.holding import HELD
from hev_can_emu.plant.structure import G1, G2

DT = 5e-5
INERTIAS = (0.07, 0.5)


class Gears:
    """Two inertias with the lock of one gear between them, and the sleeve."""

    def __init__(self, gear=1, slip=0.0, load=0.0, place=0.0, position=0.0, play=True):
        self.gear, self.side, self.play = gear, 1.0 if gear == 1 else -1.0, play
        self.lock = G1 if gear == 1 else G2
        self.stand = Stand(two_inertias(*INERTIAS, between=self.lock), DT, 6, toothed=True)
        self.stand.x[:2] = 100.0 + slip, 100.0
        self.stand.torques = (load, 0.0)
        self.p, self.x = SLEEVE.pack(DT), np.zeros(shifting.N_STATE)
        shifting.start_sleeve(self.p, self.x, self.side * position)
        self.x[shifting.X_ANGLE + gear - 1] = place
        self.out, self.losses = np.zeros(sleeve.N_OUT), np.zeros(shifting.N_LOSS)
        self.start = self.energy
        self.given = 0.0
        self.zones: list[int] = []

    @property
    def energy(self):
        w = self.stand.x[:2]
        kept = shifting.sleeve_energy(self.p, self.x)
        return 0.5 * float(np.array(INERTIAS) @ w**2) + kept

    @property
    def held(self):
        return bool(self.stand.state[HELD + self.lock])

    def step(self, force, stiffness=0.0):
        stand = self.stand
        slip, torque = [0.0, 0.0], [0.0, 0.0]
        slip[self.gear - 1] = stand.x[0] - stand.x[1]
        torque[self.gear - 1] = friction_torque(
            stand.bank, stand.x, stand.state, stand.forces, self.lock
        )
        shifting.move_sleeve(
            self.p, self.x, force, stiffness, *slip, *torque, self.play, stand.state, stand.books,
            stand.kinetic, stand.static, self.out,
        )  # fmt: skip
        stand.advance()
        self.given += stand.torques[0] * stand.books[teeth.TRAVEL]
        shifting.turn_gears(self.p, self.x, stand.books)
        zone = int(self.out[sleeve.OUT_ZONE])
        if not self.zones or self.zones[-1] != zone:
            self.zones.append(zone)

    def run(self, force, time, until=None):
        for _ in range(round(time / DT)):
            self.step(self.side * force)
            shifting.book_sleeve(self.out, self.out[sleeve.OUT_WORK], self.losses)
            self.given += self.out[sleeve.OUT_WORK]
            if self.zones[-1] == until:
                break
        return self

    def spent(self):
        books = self.stand.books
        turned = books[teeth.FRICTION + self.lock] + books[teeth.LOST_DOGS] + books[teeth.LOST]
        return turned + self.losses.sum() + self.energy - self.start


@pytest.mark.parametrize("gear", [1, 2])
@pytest.mark.parametrize("slip", [25.0, -25.0, 0.0])
def test_the_driveline_shifts_as_the_independent_loop_does(gear, slip):
    mine = Gears(gear, slip, load=-1.0, place=0.03)
    mine.x[shifting.X_FORCE] = mine.side * 800.0  # nothing has just flown in
    mine.run(800.0, 0.5, until=sleeve.STOP)
    other = Box(gear, slip, load=-1.0, place=0.03).run(800.0, 0.5, until=sleeve.STOP)
    assert mine.zones == other.zones
    assert mine.stand.t_ns * 1e-9 == pytest.approx(other.time, abs=1.5 * DT)
    assert mine.stand.x[0] == pytest.approx(other.speed, abs=0.02)
    assert mine.stand.x[1] == pytest.approx(other.gear_speed, abs=0.02)


@pytest.mark.parametrize("play", [True, False])
def test_every_joule_of_a_shift_is_told(play):
    gears = Gears(1, 25.0, load=-2.0, place=0.05, play=play).run(800.0, 0.5, until=sleeve.STOP)
    gears.run(800.0, 0.1)
    assert gears.held
    assert gears.spent() == pytest.approx(gears.given, rel=1e-7)
    assert gears.stand.books[teeth.FRICTION + G1] > 10.0
    gears.run(-500.0, 0.05)
    assert not gears.held
    assert gears.spent() == pytest.approx(gears.given, rel=1e-7)


def test_grating_and_throwing_close_the_sum_too():
    gears = Gears(1, 0.0, place=0.03).run(800.0, 0.3, until=sleeve.FLIGHT)
    gears.stand.torques = (300.0, 0.0)  # tears the cone off in flight
    gears.run(800.0, 0.01)
    assert gears.stand.x[0] - gears.stand.x[1] > 20.0
    gears.stand.torques = (3.0, 0.0)
    gears.run(800.0, 0.05)
    assert sleeve.GRATING in gears.zones
    assert gears.spent() == pytest.approx(gears.given, rel=1e-6, abs=1e-4)


def test_it_starts_in_gear_and_holds_a_load_without_force():
    gears = Gears(2, 0.0, load=30.0, position=SLEEVE.end_position)
    gears.run(0.0, 0.2)
    assert gears.held
    assert gears.zones == [sleeve.STOP]
    assert gears.stand.books[teeth.GAP + 1] == pytest.approx(SLEEVE.half_clearance)
    assert gears.spent() == pytest.approx(gears.given, rel=1e-7)


def test_with_the_cylinder_its_lag_is_part_of_the_sum():
    gears = Gears(1, 20.0, load=-1.0, place=0.04)
    p, x, out = hydraulic.HYDRAULICS.pack(DT), np.zeros(h.N_STATE), np.zeros(h.N_OUT)
    h.hydraulics_start(p, x, 5e6)
    stored = h.stored_energy(p, x)
    out[h.OUT_SUPPLY] = 5e6
    losses = work = 0.0
    for _ in range(5000):
        gears.step(out[h.OUT_SHIFT_FORCE], out[h.OUT_SHIFT_STIFFNESS])
        h.hydraulics_step(p, x, 0.0, 0.62, 0.0, 1.0, gears.x[sleeve.X_POSITION], out)
        shifting.book_sleeve(gears.out, out[h.OUT_SLEEVE_WORK], gears.losses)
        work += out[h.OUT_PUMP_WORK]
        losses += out[h.OUT_PUMP_LOSS : h.OUT_STEP_LOSS + 1].sum()
        if gears.zones[-1] == sleeve.STOP:
            break
    assert gears.zones[-1] == sleeve.STOP
    given = gears.given + work
    spent = gears.spent() + losses + h.stored_energy(p, x) - stored
    assert spent == pytest.approx(given, rel=1e-8)
    assert abs(gears.losses[shifting.J_CYLINDER_LAG]) < 0.1
