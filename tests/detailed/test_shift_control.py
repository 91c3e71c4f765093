from __future__ import annotations

import math

import hydraulics_defaults as hydraulic
import msgspec
import numpy as np
import pytest
from sleeve_bench import Box
from sleeve_defaults import SHIFT_CONTROL, SLEEVE

from hev_can_emu.ecu import hydraulic_control as valves
from hev_can_emu.ecu import shift_control as c
from hev_can_emu.errors import InputError
from hev_can_emu.plant import hydraulics as h
from hev_can_emu.plant import shifting
from hev_can_emu.plant import sleeve as s
from hev_can_emu.plant import torque_source as source

PER_TICK = 20
ENGAGING = [c.NEUTRAL, c.TRAVEL, c.SYNCHRONISING, c.INDEX, c.TRAVEL, c.ENGAGED]


class Unit(Box):
    """The TCU's shift control and valves, the circuit, the sleeve and two inertias."""

    def __init__(self, gear=1, tuning=SHIFT_CONTROL, **values):
        super().__init__(gear, **values)
        self.pc, self.xc, self.told = tuning.pack(), np.zeros(c.N_STATE), np.zeros(c.N_OUT)
        c.shift_control_start(self.xc, 0.0, 0.0)
        self.ph, self.xh, self.oil = (
            hydraulic.HYDRAULICS.pack(self.dt), np.zeros(h.N_STATE), np.zeros(h.N_OUT)
        )  # fmt: skip
        h.hydraulics_start(self.ph, self.xh, 5e6)
        self.oil[h.OUT_SUPPLY] = 5e6
        self.pv, self.xv, self.set = (
            hydraulic.CONTROL.pack(hydraulic.HYDRAULICS),
            np.zeros(valves.N_STATE),
            np.zeros(valves.N_OUT),
        )
        valves.control_start(self.xv, 0.0)
        self.clutch = hydraulic.WET_CLUTCH.pack(self.dt)
        self.inputs, self.seen = np.zeros(valves.N_IN), np.zeros(shifting.N_STATE)
        self.phases, self.begun = [c.NEUTRAL], {}
        self.hardest = 0.0

    def tick(self, gear, force):
        """One control period of 1 ms."""
        position = self.x[s.X_POSITION]
        c.shift_control_step(
            self.pc, self.xc, gear, force, position, self.slip, self.slip, self.x[s.X_ZONE],
            self.torque if self.held else 0.0, self.told,
        )  # fmt: skip
        phase = int(self.told[c.OUT_PHASE])
        if phase != self.phases[-1]:
            self.phases.append(phase)
            self.begun.setdefault(phase, self.time)
        self.inputs[:] = (
            *(0.0, self.told[c.OUT_FORCE], *self.oil[: h.OUT_PISTON]),
            *(0.0, 353.15, position),
        )
        valves.hydraulic_control_step(self.pv, self.xv, self.clutch, self.inputs, self.set)
        for _ in range(PER_TICK):
            stiffness = self.oil[h.OUT_SHIFT_STIFFNESS]
            self.seen[s.X_POSITION] = self.x[s.X_POSITION]
            push = shifting.foreseen_force(self.seen, self.oil[h.OUT_SHIFT_FORCE], stiffness)
            self.step(push, stiffness)
            h.hydraulics_step(
                self.ph, self.xh, *self.set[: valves.OUT_PUMP + 1], self.x[s.X_POSITION], self.oil
            )
            self.hardest = max(self.hardest, abs(self.oil[h.OUT_SHIFT_FORCE]))
        return phase

    def ask(self, gear, force, ticks=1500, until=None):
        for _ in range(ticks):
            if self.tick(gear, force) == until:
                break
        return self


@pytest.mark.parametrize(("gear", "slip"), [(1, 30.0), (1, -30.0), (2, 30.0), (2, -30.0)])
def test_a_shift_passes_all_phases_through_the_hydraulics(gear, slip):
    unit = Unit(gear, slip=slip, load=-1.0, place=0.02).ask(gear, 900.0, until=c.ENGAGED)
    assert unit.phases == ENGAGING
    assert unit.told[c.OUT_GEAR] == gear
    assert unit.time < 0.3
    assert unit.travel == SLEEVE.end_position
    unit.ask(gear, 900.0, 300)
    assert unit.told[c.OUT_FORCE] == 0.0
    assert unit.travel == pytest.approx(SLEEVE.end_position, abs=1e-5)
    assert (unit.phases[-1], unit.hardest < 1100.0) == (c.ENGAGED, True)


def test_out_of_gear_to_the_centre_and_on_to_the_other():
    unit = Unit(1).ask(1, 800.0, until=c.ENGAGED).ask(1, 800.0, 100)
    unit.phases = [c.ENGAGED]
    unit.ask(0, 800.0, until=c.NEUTRAL)
    assert unit.phases == [c.ENGAGED, c.DISENGAGING, c.NEUTRAL]
    unit.ask(0, 0.0, 300)
    assert abs(unit.x[s.X_POSITION]) < 1.5e-4  # where the notch is weaker than the friction
    assert (unit.told[c.OUT_GEAR], unit.x[s.X_VELOCITY]) == (0.0, 0.0)
    unit = Unit(2).ask(2, 800.0, until=c.ENGAGED)
    unit.phases = [c.ENGAGED]
    unit.gear, unit.side = 1, 1.0  # from here on the other gear is the one under test
    unit.ask(1, 800.0, until=c.NEUTRAL)
    unit.speed += 10.0
    unit.ask(1, 800.0, until=c.ENGAGED)
    assert unit.phases == [c.ENGAGED, c.DISENGAGING, *ENGAGING]
    assert unit.travel == SLEEVE.end_position


def test_too_strong_a_drag_times_out_and_the_sleeve_returns():
    unit = Unit(2, slip=20.0, load=40.0).ask(2, 800.0, 1600)
    assert unit.phases == [c.NEUTRAL, c.TRAVEL, c.SYNCHRONISING, c.ABORTED]
    waited = unit.begun[c.ABORTED] - unit.begun[c.SYNCHRONISING]
    assert waited == pytest.approx(SHIFT_CONTROL.timeout, abs=1.1e-3)
    assert unit.told[c.OUT_REASON] == source.LIMIT_SYNC_TIMEOUT
    assert abs(unit.x[s.X_POSITION]) < SHIFT_CONTROL.centre_band
    assert unit.told[c.OUT_GEAR] == 0.0
    unit.load = 0.0
    unit.speed = unit.gear_speed
    assert unit.ask(2, 800.0, 200).phases[-1] == c.ABORTED  # until another request
    assert unit.ask(0, 0.0, 3).phases[-1] == c.NEUTRAL
    assert unit.ask(2, 800.0, until=c.ENGAGED).phases[-1] == c.ENGAGED


def test_lost_force_at_the_ring_aborts():
    unit = Unit(1, slip=200.0).ask(1, 800.0, until=c.SYNCHRONISING).ask(1, 800.0, 20)
    unit.ask(1, 0.0, 400)
    assert unit.phases[-1] == c.ABORTED
    assert abs(unit.x[s.X_POSITION]) < SHIFT_CONTROL.centre_band
    assert unit.ask(math.nan, math.nan, 50).phases[-1] == c.ABORTED


def test_torque_on_the_dogs_keeps_the_gear_until_it_is_gone():
    unit = Unit(1).ask(1, 800.0, until=c.ENGAGED).ask(1, 800.0, 200)
    unit.load = 250.0  # 866 N at the flanks
    unit.ask(1, 0.0, 50).ask(0, 800.0, 300)
    assert unit.phases[-1] == c.BLOCKED_BY_TORQUE
    assert unit.told[c.OUT_REASON] == source.LIMIT_TORQUE_ON_DOGS
    assert unit.of_gear(s.OUT_DOG1) == 1.0
    assert unit.told[c.OUT_GEAR] == c.BETWEEN
    unit.load = 10.0
    unit.ask(0, 800.0, until=c.NEUTRAL)
    assert unit.phases[-2:] == [c.DISENGAGING, c.NEUTRAL]
    assert unit.of_gear(s.OUT_DOG1) == 0.0


def test_without_force_nothing_starts_and_engaged_holds_through_a_lost_request():
    assert Unit(1).ask(1, 10.0, 100).phases == [c.NEUTRAL]
    assert Unit(1).ask(1, math.nan, 100).phases == [c.NEUTRAL]
    unit = Unit(1).ask(1, 700.0, until=c.ENGAGED).ask(math.nan, math.nan, 300)
    assert (unit.phases[-1], unit.told[c.OUT_GEAR]) == (c.ENGAGED, 1.0)


def test_grating_is_told_and_given_up():
    unit = Unit(1).ask(1, 800.0, until=c.INDEX).ask(1, 800.0, until=c.TRAVEL)
    unit.speed += 40.0
    unit.load, unit.inertia = 0.0, 1e6
    unit.gear_inertia = 1e6
    unit.ask(1, 800.0, 1400)
    assert unit.phases[-2:] == [c.GRATING, c.ABORTED]
    assert abs(unit.x[s.X_POSITION]) < SHIFT_CONTROL.centre_band
    assert unit.told[c.OUT_REASON] == source.LIMIT_SYNC_TIMEOUT


def test_tooth_on_tooth_is_told_and_ends_when_something_turns():
    rough = msgspec.structs.replace(SLEEVE, chamfer_friction=0.5)
    unit = Unit(1, slip=5.0, place=0.02, parameters=rough).ask(1, 700.0, until=c.TOOTH_ON_TOOTH)
    assert unit.phases == [*ENGAGING[:-1], c.TOOTH_ON_TOOTH]
    unit.ask(1, 700.0, 100)
    unit.load = -math.copysign(12.0, s.wrap_pitch(unit.angle, rough.pitch))
    unit.ask(1, 700.0, until=c.ENGAGED)
    assert unit.phases[-2:] == [c.TRAVEL, c.ENGAGED]
    assert abs(unit.angle) <= rough.half_clearance + 1e-9


def test_a_changed_mind_turns_the_sleeve_back_and_forth():
    unit = Unit(1, slip=300.0).ask(1, 900.0, until=c.SYNCHRONISING).ask(0, 900.0, 5)
    assert unit.phases[-1] == c.DISENGAGING
    unit.ask(1, 900.0, until=c.SYNCHRONISING)
    assert unit.phases[-2:] == [c.DISENGAGING, c.SYNCHRONISING]  # it is still at the ring
    unit.ask(0, 0.0, 500)
    assert unit.phases[-1] == c.NEUTRAL


def test_started_in_gear_it_stays_there():
    unit = Unit(2, position=SLEEVE.end_position)
    unit.x[s.X_ZONE] = s.STOP
    unit.xh[h.X_SLEEVE] = unit.x[s.X_POSITION]
    c.shift_control_start(unit.xc, 2.0, unit.x[s.X_POSITION])
    unit.ask(2, 0.0, 200)
    assert unit.told[c.OUT_GEAR] == 2.0
    assert unit.hardest < 1.0


def test_a_unit_that_starts_anew_takes_the_gear_it_finds():
    unit = Unit(1, position=SLEEVE.end_position)
    unit.x[s.X_ZONE] = s.STOP
    unit.xh[h.X_SLEEVE] = unit.seen[shifting.X_PLACE] = unit.x[s.X_POSITION]
    unit.ask(math.nan, math.nan, 200)
    assert (unit.phases[-1], unit.told[c.OUT_GEAR]) == (c.ENGAGED, 1.0)
    assert unit.travel == SLEEVE.end_position
    assert unit.ask(0, 800.0, until=c.NEUTRAL).phases[-2:] == [c.DISENGAGING, c.NEUTRAL]


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"travel_force": 10.0}, r"tcu\.travel_force: expected more than least_force"),
        ({"still_time": -1.0}, r"tcu\.still_time: expected a number of at least 0"),
        ({"timeout": math.nan}, r"tcu\.timeout: expected a finite number"),
    ],
)
def test_a_bad_tuning_is_named(change, where):
    with pytest.raises(InputError, match=where):
        msgspec.structs.replace(SHIFT_CONTROL, **change).validate("tcu")


def test_the_default_tuning_makes_sense():
    SHIFT_CONTROL.validate("tcu")
