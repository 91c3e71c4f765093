from __future__ import annotations

import math

import machine_defaults as defaults
import msgspec
import numpy as np
import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.plant import synchronizer as sync
from hev_can_emu.plant import torque_source as source

S = defaults.SYNCHRONIZER


class Gearbox:
    """A sleeve on an inertia beside a gear of constant speed, with true stick."""

    def __init__(self, parameters=S, slip=0.0, inertia=0.07, drag=0.0):
        self.p = parameters.pack()
        self.x = np.zeros(sync.N_STATE)
        self.out = np.zeros(sync.N_OUT)
        self.slip, self.inertia, self.drag = slip, inertia, drag
        self.stuck, self.dog_torque = 0.0, 0.0
        self.phases: list[int] = [sync.NEUTRAL]
        self.time = 0.0

    def step(self, gear, force):
        slips = (self.slip, self.slip)
        sync.synchronizer_step(
            *(self.p, self.x, gear, force, *slips, self.stuck, self.stuck, self.dog_torque),
            self.out,
        )
        self.time += 1e-3
        phase = int(self.out[sync.OUT_PHASE])
        if phase != self.phases[-1]:
            self.phases.append(phase)
        capacity = self.out[sync.OUT_CONE1] + self.out[sync.OUT_CONE2]
        if self.out[sync.OUT_DOG1] + self.out[sync.OUT_DOG2] > 0.0:
            self.slip, self.stuck = 0.0, 0.0
        elif self.slip == 0.0 and capacity >= abs(self.drag):
            self.stuck = float(capacity > 0.0)
        else:
            resisting = -math.copysign(capacity, self.slip) if self.slip else 0.0
            before = self.slip
            self.slip += 1e-3 * (resisting + self.drag) / self.inertia
            if before * self.slip < 0.0:
                self.slip = 0.0
            self.stuck = 0.0
        return phase

    def run(self, gear, force, ticks=2000, until=None):
        for _ in range(ticks):
            if self.step(gear, force) == until:
                break
        return self


ENGAGING = [sync.NEUTRAL, sync.TRAVEL, sync.SYNCHRONISING, sync.INDEX, sync.TRAVEL, sync.ENGAGED]


@pytest.mark.parametrize(("gear", "side"), [(1, 1.0), (2, -1.0)])
def test_a_shift_passes_all_phases_and_locks_the_dogs(gear, side):
    box = Gearbox(slip=20.0).run(gear, 800.0, until=sync.ENGAGED)
    assert box.phases == ENGAGING
    assert box.out[sync.OUT_POSITION] == side * S.end_position
    assert box.out[sync.OUT_GEAR] == gear
    assert box.out[sync.OUT_FORCE] * side > 0.0
    assert box.out[sync.OUT_DOG1 :].tolist() == ([1.0, 0.0] if gear == 1 else [0.0, 1.0])
    assert box.out[sync.OUT_CONE1] == box.out[sync.OUT_CONE2] == 0.0


def test_travel_time_and_force_follow_the_damped_law():
    quick = msgspec.structs.replace(S, force_time_constant=0.0)
    box = Gearbox(quick).run(1, 450.0, 10)
    assert box.out[sync.OUT_POSITION] == pytest.approx(0.01 * (450.0 - 50.0) / 4000.0)
    assert Gearbox(quick).run(1, 1e5, 5).out[sync.OUT_FORCE] == S.max_force
    slow = Gearbox(S).run(1, 450.0, 10)
    assert slow.out[sync.OUT_FORCE] == pytest.approx(450.0 * (1.0 - math.exp(-1.0)))


def test_cone_capacity_is_the_textbook_formula_and_only_on_the_gear_aimed_at():
    box = Gearbox(slip=500.0).run(1, 1000.0, 150)
    expected = 0.1 * box.out[sync.OUT_FORCE] * 0.035 / math.sin(S.cone_angle) * 2.0
    assert box.out[sync.OUT_CONE1] == pytest.approx(expected)
    assert box.out[sync.OUT_CONE1] == pytest.approx(57.4, abs=0.1)
    assert box.out[sync.OUT_CONE2] == 0.0
    slip = box.slip
    box.step(1, 1000.0)
    assert box.out[sync.OUT_SLIP] == slip


def test_synchronising_takes_inertia_times_slip_over_torque():
    quick = msgspec.structs.replace(S, force_time_constant=0.0)
    box = Gearbox(quick, slip=60.0).run(1, 1000.0, until=sync.SYNCHRONISING)
    begun = box.time
    box.run(1, 1000.0, until=sync.INDEX)
    assert box.time - begun == pytest.approx(0.07 * 60.0 / 57.43, abs=2.5e-3)


def test_too_little_torque_times_out_returns_and_waits_for_another_request():
    box = Gearbox(slip=300.0, drag=60.0).run(1, 1000.0, 3000)
    assert box.phases == [sync.NEUTRAL, sync.TRAVEL, sync.SYNCHRONISING, sync.ABORTED]
    assert box.out[sync.OUT_POSITION] == 0.0
    assert box.out[sync.OUT_REASON] == source.LIMIT_SYNC_TIMEOUT
    assert box.out[sync.OUT_CONE1] == 0.0
    box.slip, box.drag = 0.0, 0.0
    assert box.run(0, 1000.0, 3).phases[-1] == sync.NEUTRAL
    assert box.run(1, 1000.0, until=sync.ENGAGED).phases[-1] == sync.ENGAGED


def test_lost_force_while_synchronising_aborts_and_lost_force_in_travel_stays():
    box = Gearbox(slip=300.0).run(1, 1000.0, until=sync.SYNCHRONISING).run(1, 0.0, 300)
    assert box.phases[-1] == sync.ABORTED
    assert box.out[sync.OUT_POSITION] == 0.0
    box = Gearbox().run(1, 600.0, 15)
    assert box.phases[-1] == sync.TRAVEL
    position = box.run(1, 0.0, 100).out[sync.OUT_POSITION]
    assert 0.0 < position < S.blocking_position
    assert box.run(1, 0.0, 100).out[sync.OUT_POSITION] == position
    assert box.run(0, 0.0, 300).out[sync.OUT_POSITION] == 0.0


def test_without_force_nothing_starts():
    assert Gearbox().run(1, 10.0, 200).phases == [sync.NEUTRAL]
    assert Gearbox().run(1, math.nan, 200).phases == [sync.NEUTRAL]


def test_disengaging_waits_for_the_dogs_to_be_free_of_torque():
    box = Gearbox().run(1, 800.0, until=sync.ENGAGED)
    box.dog_torque = -400.0
    box.run(0, 800.0, 500)
    assert box.phases[-1] == sync.BLOCKED_BY_TORQUE
    assert box.out[sync.OUT_REASON] == source.LIMIT_TORQUE_ON_DOGS
    assert box.out[sync.OUT_DOG1] == 1.0
    assert box.out[sync.OUT_POSITION] == S.end_position
    box.dog_torque = 0.9 * 800.0 * S.dog_radius / S.dog_friction  # just light enough
    box.run(0, 800.0, until=sync.NEUTRAL)
    assert box.phases[-2:] == [sync.DISENGAGING, sync.NEUTRAL]
    assert box.out[sync.OUT_DOG1] == 0.0
    assert box.out[sync.OUT_GEAR] == 0.0


def test_engaged_holds_without_force_and_through_a_lost_request():
    box = Gearbox().run(2, 800.0, until=sync.ENGAGED).run(2, 0.0, 200)
    assert box.run(math.nan, math.nan, 200).out[sync.OUT_GEAR] == 2.0
    assert box.out[sync.OUT_DOG2] == 1.0


def test_from_gear_to_gear_through_neutral():
    box = Gearbox().run(1, 800.0, until=sync.ENGAGED)
    box.phases = [sync.ENGAGED]
    box.slip = -15.0
    box.run(2, 800.0, until=sync.ENGAGED)
    box.run(2, 800.0, until=None, ticks=300)
    assert box.phases == [sync.ENGAGED, sync.DISENGAGING, *ENGAGING]
    assert box.out[sync.OUT_GEAR] == 2.0


def test_slip_at_the_dogs_grates_until_it_is_gone():
    box = Gearbox().run(1, 400.0, until=sync.INDEX)
    box.run(1, 400.0, until=sync.TRAVEL)
    box.drag, box.slip, box.stuck = 60.0, 5.0, 0.0
    box.run(1, 400.0, 60)
    assert box.phases[-1] == sync.GRATING
    assert box.out[sync.OUT_POSITION] == S.dog_position
    assert box.out[sync.OUT_DOG1] == 0.0
    box.slip, box.drag = 0.0, 0.0
    box.run(1, 400.0, until=sync.ENGAGED)
    assert box.phases[-1] == sync.ENGAGED


def test_grating_is_given_up_in_the_end():
    box = Gearbox().run(1, 400.0, until=sync.INDEX)
    box.run(1, 400.0, until=sync.TRAVEL)
    box.drag, box.slip, box.stuck = 60.0, 5.0, 0.0
    box.run(1, 400.0, 3000)
    assert box.phases[-2:] == [sync.GRATING, sync.ABORTED]
    assert box.out[sync.OUT_POSITION] == 0.0


def test_a_changed_mind_turns_the_sleeve_back():
    box = Gearbox(slip=300.0).run(1, 1000.0, until=sync.SYNCHRONISING)
    box.run(2, 1000.0, until=sync.NEUTRAL)
    assert box.phases[-2:] == [sync.DISENGAGING, sync.NEUTRAL]
    assert box.run(2, 1000.0, until=sync.SYNCHRONISING).out[sync.OUT_POSITION] < 0.0


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"dog_position": 0.001}, r"tcu\.dog_position: expected more than blocking_position"),
        ({"cone_angle": 0.0}, r"tcu\.cone_angle: expected a number greater than 0"),
        ({"free_flight_share": 2.0}, r"tcu\.free_flight_share"),
        ({"max_force": math.inf}, r"tcu\.max_force: expected a finite number"),
    ],
)
def test_bad_synchronizer_is_named(change, where):
    with pytest.raises(InputError, match=where):
        msgspec.structs.replace(S, **change).validate("tcu")
