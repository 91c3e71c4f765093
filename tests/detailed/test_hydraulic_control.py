from __future__ import annotations

import math

import hydraulics_defaults as defaults
import msgspec
import numpy as np
import pytest

from hev_can_emu.ecu import hydraulic_control as c
from hev_can_emu.errors import InputError
from hev_can_emu.plant import hydraulics as h
from hev_can_emu.plant import wet_clutch as w

H = defaults.HYDRAULICS
DT = 5e-5
PER_TICK = 20


class Bench:
    """Control unit, circuit and clutch; the sleeve is held, or a mass before a stop."""

    def __init__(self, plant=H, slip=50.0, temperature=353.15, stop=None, tuning=defaults.CONTROL):
        self.p, self.x, self.out = plant.pack(DT), np.zeros(h.N_STATE), np.zeros(h.N_OUT)
        h.hydraulics_start(self.p, self.x, 5e6)
        self.out[h.OUT_SUPPLY] = 5e6
        self.clutch = defaults.WET_CLUTCH.pack(DT)
        self.plates = np.array([temperature])
        self.can = np.zeros(w.N_OUT)
        self.unit, self.memory = tuning.pack(H), np.zeros(c.N_STATE)
        c.control_start(self.memory, 0.0)
        self.inputs, self.told = np.zeros(c.N_IN), np.zeros(c.N_OUT)
        self.slip, self.stop = slip, stop
        self.sleeve = self.speed = 0.0
        self.capacity, self.force, self.supply, self.current = [], [], [], []

    def tick(self, capacity=0.0, force=0.0):
        self.inputs[:] = (
            *(capacity, force, *self.out[: h.OUT_PISTON]),
            *(self.slip, self.plates[0], self.sleeve),
        )
        c.hydraulic_control_step(self.unit, self.memory, self.clutch, self.inputs, self.told)
        for _ in range(PER_TICK):
            if self.stop is not None:
                push = self.out[h.OUT_SHIFT_FORCE] - 300.0 * self.speed
                self.speed += DT * push / 1.0
                self.sleeve += DT * self.speed
                if not 0.0 < self.sleeve < self.stop:
                    self.sleeve = min(max(self.sleeve, 0.0), self.stop)
                    self.speed = 0.0
            h.hydraulics_step(self.p, self.x, *self.told[: c.OUT_PUMP + 1], self.sleeve, self.out)
        force_on_pack, piston = self.out[h.OUT_PACK_FORCE], self.out[h.OUT_PISTON]
        w.capacity_step(
            self.clutch, self.plates, force_on_pack, piston, self.slip, 353.15, self.can
        )
        self.capacity.append(self.can[w.OUT_KINETIC])
        self.force.append(self.out[h.OUT_SHIFT_FORCE])
        self.supply.append(self.out[h.OUT_SUPPLY])
        self.current.append(self.told[: c.OUT_PUMP].copy())

    def run(self, ticks, capacity=0.0, force=0.0):
        for _ in range(ticks):
            self.tick(capacity, force)
        return self


def settling(values, aim, band=0.05):
    """Ticks (ms) after which ``values`` stay within ``band`` of ``aim``."""
    outside = np.nonzero(np.abs(np.array(values) / aim - 1.0) > band)[0]
    return int(outside[-1]) + 1 if outside.size else 0


@pytest.mark.parametrize(
    ("aim", "within"), [(20.0, 90), (50.0, 75), (100.0, 65), (200.0, 60), (300.0, 60)]
)
def test_capacity_step_from_rest_settles_without_overshoot(aim, within):
    bench = Bench().run(300, aim)
    assert settling(bench.capacity, aim) <= within
    assert settling(bench.capacity, aim) > 30  # the fill takes its time
    assert max(bench.capacity) <= 1.05 * aim
    assert bench.capacity[-1] == pytest.approx(aim, rel=0.02)


def test_capacity_steps_in_contact_settle_faster_both_ways():
    bench = Bench().run(300, 100.0)
    bench.capacity.clear()
    bench.run(200, 200.0)
    assert settling(bench.capacity, 200.0) <= 40
    assert max(bench.capacity) <= 1.05 * 200.0
    bench.capacity.clear()
    bench.run(200, 100.0)
    assert settling(bench.capacity, 100.0) <= 50
    assert min(bench.capacity) >= 0.9 * 100.0


@pytest.mark.parametrize("aim", [2.0, 5.0, 10.0])
def test_capacity_near_the_kiss_point_is_held_too(aim):
    bench = Bench().run(300, aim)
    assert settling(bench.capacity, aim, 0.1) <= 90
    assert max(bench.capacity) <= aim + 2.0
    assert bench.capacity[-1] == pytest.approx(aim, rel=0.03)


def test_capacity_follows_a_ramp_with_a_small_lag():
    bench = Bench()
    aims = np.minimum(np.arange(700) / 500.0, 1.0) * 100.0
    for aim in aims:
        bench.tick(aim)
    assert np.abs(np.array(bench.capacity) - aims)[100:].max() < 2.0  # 10 ms of the ramp


def test_release_is_quick_and_complete_and_the_next_fill_knows_what_is_left():
    bench = Bench().run(300, 100.0)
    bench.capacity.clear()
    bench.run(60)
    assert next(i for i, value in enumerate(bench.capacity) if value < 2.0) + 1 <= 10
    assert max(bench.capacity[20:]) == 0.0
    # Half emptied: the fill is shorter, and still does not overshoot much.
    bench.capacity.clear()
    bench.run(200, 100.0)
    assert settling(bench.capacity, 100.0) <= 55
    assert max(bench.capacity) <= 1.1 * 100.0
    bench.run(300)
    assert bench.x[h.X_PISTON] == 0.0
    assert bench.memory[c.X_VOLUME] == 0.0


@pytest.mark.parametrize(("slip", "temperature"), [(0.0, 293.15), (5.0, 353.15), (200.0, 450.0)])
def test_capacity_follows_through_the_inverse_map_at_any_slip_and_temperature(slip, temperature):
    bench = Bench(slip=slip, temperature=temperature).run(300, 150.0)
    assert bench.capacity[-1] == pytest.approx(150.0, rel=0.02)


def test_inverse_map_is_the_inverse():
    unit, clutch = defaults.CONTROL.pack(H), defaults.WET_CLUTCH.pack()
    out = np.zeros(w.N_OUT)
    for aim in (5.0, 100.0, 400.0):
        pressure = c.set_pressure(unit, clutch, aim, 30.0, 380.0)
        force = (pressure - H.clutch.kiss_pressure) * H.clutch.area
        w.capacity_step(clutch, np.array([380.0]), force, 0.0, 30.0, 353.15, out)
        assert out[w.OUT_KINETIC] == pytest.approx(aim, rel=1e-5)


@pytest.mark.parametrize(
    ("part", "changes"),
    [
        ("clutch", {"preload": 430.0}),
        ("clutch", {"preload": 470.0}),
        ("clutch", {"kiss_travel": 1.4e-3}),
        ("clutch", {"kiss_travel": 1.6e-3}),
        ("clutch", {"pack": 1.4e7}),
        ("clutch", {"pack": 3e7}),
        ("clutch", {"seal_damping": 1200.0}),
        ("clutch_valve", {"area": 2.8e-6}),
        ("clutch_valve", {"area": 3.2e-6}),
        ("clutch_valve", {"natural_frequency": 500.0}),
    ],
)
def test_a_plant_that_is_not_nominal_is_still_controlled(part, changes):
    changed = msgspec.structs.replace(getattr(H, part), **changes)
    bench = Bench(msgspec.structs.replace(H, **{part: changed})).run(400, 100.0)
    # What the return spring takes no pressure sensor sees.
    error = H.clutch.preload - getattr(changed, "preload", H.clutch.preload)
    aim = 100.0 * (1.0 + error / 1250.0)
    assert bench.capacity[-1] == pytest.approx(aim, rel=0.03)
    assert settling(bench.capacity, bench.capacity[-1]) <= 80
    assert max(bench.capacity) <= 1.15 * aim


def test_integrator_takes_out_a_wrong_feed_forward():
    weak = msgspec.structs.replace(H.clutch_valve, full_current=1.22)
    bench = Bench(msgspec.structs.replace(H, clutch_valve=weak)).run(900, 100.0)
    assert bench.capacity[-1] == pytest.approx(100.0, rel=0.03)
    assert bench.memory[c.X_INTEGRAL] > 0.0
    off = msgspec.structs.replace(defaults.CONTROL, integral_share=0.0)
    bench = Bench(msgspec.structs.replace(H, clutch_valve=weak), tuning=off).run(900, 100.0)
    assert bench.capacity[-1] < 95.0


def test_integrator_does_not_wind_up_at_an_aim_out_of_reach():
    # Far beyond what the supply can press: bounded, and back within the usual time.
    bench = Bench().run(800, 5000.0)
    assert bench.told[c.OUT_PRESSURE] < bench.out[h.OUT_SUPPLY]
    bench.capacity.clear()
    bench.run(300, 100.0)
    assert settling(bench.capacity, 100.0) <= 120
    assert min(bench.capacity) >= 0.9 * 100.0


@pytest.mark.parametrize("aim", [500.0, -500.0, 1000.0, -1500.0, 2000.0])
def test_shift_force_step_on_a_blocked_sleeve(aim):
    bench = Bench().run(100, force=aim)
    assert settling(bench.force, aim) <= 15
    assert max(np.array(bench.force) / aim) <= 1.05
    assert bench.force[-1] == pytest.approx(aim, rel=0.02)
    assert bench.current[-1][c.OUT_CURRENT_SHIFT2 if aim > 0.0 else c.OUT_CURRENT_SHIFT1] == 0.0
    bench.force.clear()
    bench.run(20)
    assert abs(bench.force[5]) < 20.0


def test_shift_force_builds_up_without_a_blow_where_the_sleeve_meets_the_ring():
    bench = Bench(stop=3e-3).run(120, force=1000.0)
    # 3 mm in about 35 ms; then the force within 5 ms and at most a tenth too much.
    assert bench.sleeve == 3e-3
    assert settling(bench.force, 1000.0, 0.1) <= 45
    assert max(bench.force) <= 1100.0


def test_the_pump_works_between_two_pressures():
    bench = Bench()
    h.hydraulics_start(bench.p, bench.x, 4.3e6)
    bench.out[h.OUT_SUPPLY] = 4.3e6
    bench.run(5)
    assert bench.told[c.OUT_PUMP] == 0.0
    h.hydraulics_start(bench.p, bench.x, 4.1e6)
    bench.out[h.OUT_SUPPLY] = 4.1e6
    bench.run(1000)
    assert bench.told[c.OUT_PUMP] == 1.0
    bench.run(1200)
    assert bench.told[c.OUT_PUMP] == 0.0
    assert max(bench.supply) < 5.6e6


def test_requests_that_are_not_available_open_everything():
    bench = Bench().run(150, 100.0, 800.0)
    bench.run(40, math.nan, math.nan)
    assert bench.told[: c.OUT_PUMP].tolist() == [0.0, 0.0, 0.0]
    assert bench.told[c.OUT_PHASE] == c.OPEN
    assert bench.capacity[-1] == 0.0


@pytest.mark.parametrize(
    ("field", "value"),
    [("bandwidth", 0.0), ("fill_share", 1.5), ("pump_off", 1e6), ("touch_time", math.inf)],
)
def test_bad_tuning_is_told_by_its_place(field, value):
    defaults.CONTROL.validate("control")
    with pytest.raises(InputError) as caught:
        msgspec.structs.replace(defaults.CONTROL, **{field: value}).validate("control")
    assert str(caught.value).startswith(f"control.{field}: expected")
