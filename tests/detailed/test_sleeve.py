from __future__ import annotations

import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sleeve_bench import Box
from sleeve_defaults import SLEEVE

from hev_can_emu.errors import InputError
from hev_can_emu.plant import sleeve as s
from hev_can_emu.plant.sleeve_motion import elastic_change

WAY = [s.CENTRE, s.FREE, s.PRESYNC, s.BLOCKED, s.INDEXING, s.FLIGHT]
INSIDE = [s.ENTERING, s.ENGAGED, s.STOP]


def changed(**values):
    return msgspec.structs.replace(SLEEVE, **values)


def lever(gear):
    """Torque per force of the cones by the textbook: mu*R*n/sin(alpha)."""
    return 0.1 * 0.035 * (2 if gear == 1 else 1) / math.sin(math.radians(7.0))


def closed(box):
    """The sleeve's books leave nothing open, and the chamfers' work is the driveline's."""
    scale = max(map(abs, box.sums.values()))
    assert abs(box.unbalanced()) <= 1e-12 * scale + 1e-15
    told = box.out[s.OUT_CHAMFER1] + box.out[s.OUT_CHAMFER2]  # not yet done
    if told == 0.0:
        assert box.sums[s.OUT_TOOTH_WORK] == pytest.approx(-box.chamfer_work, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("gear", [1, 2])
@pytest.mark.parametrize("slip", [40.0, -40.0, 0.0])
def test_a_shift_goes_through_all_its_stages(gear, slip):
    box = Box(gear, slip, load=-1.0, place=0.03).run(800.0, 0.5, until=s.STOP)
    # Sometimes tooth meets gap.
    assert [zone for zone in box.zones if zone != s.TOOTH_ON_TOOTH] == [*WAY, *INSIDE]
    assert box.slip_at[s.INDEXING] == 0.0
    assert box.travel == SLEEVE.end_position
    assert box.of_gear(s.OUT_DOG1) == 1.0
    assert abs(box.angle) <= SLEEVE.half_clearance + 1e-12 or box.end
    closed(box)
    box.run(800.0, 0.1)  # now the flanks carry the load
    assert (box.held, box.slip) == (1.0, 0.0)
    assert box.torque == pytest.approx(0.5 / 0.57, rel=1e-9)


@pytest.mark.parametrize("gear", [1, 2])
@pytest.mark.parametrize("slip", [60.0, -60.0])
def test_synchronising_takes_the_time_and_the_heat_of_the_closed_form(gear, slip):
    box = Box(gear, slip, position=SLEEVE.blocking_position).run(700.0, 0.5, until=s.INDEXING)
    inertia = 0.07 * 0.5 / 0.57
    capacity = lever(gear) * (700.0 - SLEEVE.guide_friction)
    begun = box.time - box.dt  # the step that told it found sleeve and gear held already
    assert begun - box.dt <= inertia * abs(slip) / capacity <= begun
    assert box.heat == pytest.approx(0.5 * inertia * slip * slip, rel=1e-12)
    assert box.out[s.OUT_RING_FORCE] == pytest.approx(685.0)


@given(
    st.floats(100.0, 2000.0),
    st.floats(-80.0, 80.0),
    st.sampled_from([1, 2]),
    st.floats(-50.0, 50.0),
)
def test_the_ring_is_never_passed_at_slip(force, load, gear, slip):
    box = Box(gear, slip, load=load)
    before = 0.0
    for _ in range(800):
        held = box.held
        box.step(box.side * force)
        if before <= SLEEVE.blocking_position < box.travel:
            assert held == 1.0
            return
        before = box.travel
        assert before <= SLEEVE.blocking_position


def test_a_drag_beyond_the_cone_blocks_for_good():
    box = Box(2, 20.0, load=40.0).run(800.0, 0.5)
    assert box.zones[-1] == s.BLOCKED
    assert box.slip > 20.0
    assert box.travel == SLEEVE.blocking_position


def test_index_takes_its_time_at_its_force():
    box = Box(1, 0.0, position=SLEEVE.blocking_position)
    box.run(SLEEVE.index_force + SLEEVE.guide_friction, 0.1, until=s.INDEXING)
    began = box.time
    box.run(SLEEVE.index_force + SLEEVE.guide_friction, 0.1, until=s.FLIGHT)
    assert box.time - began == pytest.approx(SLEEVE.index_time, abs=1.01 * box.dt)


@pytest.mark.parametrize("slip", [20.0, -20.0])
def test_a_drag_that_keeps_the_ring_turned_stops_the_index_and_its_reverse_helps(slip):
    force = 815.0
    blocking = math.copysign(1.3 * SLEEVE.index_lever * 800.0 * 0.57 / 0.5, slip)
    assert abs(blocking) < lever(1) * 800.0
    box = Box(1, slip, load=blocking, position=SLEEVE.blocking_position).run(force, 0.6)
    assert box.held == 1.0
    assert box.x[s.X_RING] == 0.0
    assert box.zones == [s.BLOCKED]
    box.load, begun = -box.load, box.time
    box.run(force, 0.1, until=s.FLIGHT)
    assert box.time - begun == pytest.approx(SLEEVE.index_time / 2.3, rel=0.03)


def test_slip_that_comes_back_undoes_the_index():
    box = Box(2, 10.0).run(800.0, 0.3, until=s.INDEXING).run(800.0, 0.004)
    assert 0.3 < box.x[s.X_RING] < 0.7
    box.load = 60.0
    box.run(800.0, 0.01)
    assert box.zones[-1] == s.BLOCKED
    assert box.x[s.X_RING] == 0.0


def test_chamfers_that_rub_too_hard_stand_tooth_on_tooth_until_something_turns_them():
    rough = changed(chamfer_friction=0.45)
    box = Box(1, 10.0, place=0.05, parameters=rough).run(700.0, 0.5)
    assert box.zones[-1] == s.TOOTH_ON_TOOTH
    assert rough.tip_position < box.travel < rough.dog_position
    assert (box.held, box.x[s.X_VELOCITY]) == (1.0, 0.0)
    chamfer, drag = box.of_gear(s.OUT_CHAMFER1), box.of_gear(s.OUT_DRAG1)
    assert abs(chamfer) == pytest.approx(rough.chamfer_slope * 700.0, rel=0.15)
    assert abs(chamfer) < drag + box.of_gear(s.OUT_CONE1)
    closed(box)
    box.load = math.copysign(8.0, chamfer)
    box.run(700.0, 0.2, until=s.STOP)
    assert box.zones[-1] == s.STOP
    closed(box)


def test_dogs_that_slip_grate_and_let_the_sleeve_in_once_the_slip_is_gone():
    box = Box(1, 0.0, place=0.03).run(800.0, 0.3, until=s.FLIGHT)
    box.speed += 60.0
    box.load = 0.8 * SLEEVE.dog_friction * SLEEVE.dog_radius * 800.0  # as strong as the grating
    box.run(800.0, 0.1)
    assert box.zones[-1] == s.GRATING
    assert box.travel < SLEEVE.dog_position
    assert box.out[s.OUT_DOG1] == 0.0
    assert box.of_gear(s.OUT_DRAG1) == pytest.approx(0.15 * 0.038 * 800.0, rel=0.01)
    assert box.heat > 0.0
    closed(box)
    # What throws the sleeve comes out of the turning parts.
    assert box.sums[s.OUT_TOOTH_WORK] > 0.0
    assert abs(box.sums[s.OUT_TOOTH_LAG]) < 0.02 * box.sums[s.OUT_TOOTH_WORK]
    box.load = 0.0
    box.run(800.0, 1.0, until=s.STOP)
    assert box.zones[-1] == s.STOP
    closed(box)


def test_nothing_goes_in_above_the_slip_that_dogs_bear():
    box = Box(2, 0.0, place=0.0).run(800.0, 0.3, until=s.FLIGHT)
    box.speed += 1.5 * SLEEVE.dog_slip
    box.gear_inertia, box.load, box.inertia = 1e9, 0.0, 1e9
    box.run(800.0, 0.3)
    assert box.zones[-1] == s.GRATING
    box.run(-800.0, 0.1)
    assert s.GRATING not in box.zones[box.zones.index(s.GRATING) + 1 :]
    assert box.travel < 0.0


@pytest.mark.parametrize("torque", [0.0, 40.0, -40.0])
def test_pulling_out_needs_more_than_friction_notch_and_the_dogs_torque(torque):
    needed = 15.0 + 80.0 + abs(torque) * SLEEVE.dog_friction / SLEEVE.dog_radius
    for force, stays in ((0.97 * needed, True), (1.03 * needed, False)):
        box = Box(1, 0.0).run(600.0, 0.2, until=s.STOP)
        box.load = -torque * 0.57 / 0.5
        box.run(600.0, 0.2)
        assert box.torque == pytest.approx(torque)
        for k in range(4000):  # slowly: a blow would carry it over the notch
            box.step(-force * min(k / 3000, 1.0))
        assert (box.travel > SLEEVE.end_position - SLEEVE.engaged_width) == stays
        assert (box.of_gear(s.OUT_DOG1) == 1.0) == stays


def test_notches_hold_the_sleeve_at_the_centre_and_in_gear_without_force():
    for position in (0.0, 2e-4, 8.9e-3):
        box = Box(1, 5.0, position=position).run(0.0, 0.3)
        resting = 0.0 if position < 1e-3 else SLEEVE.end_position
        slack = 15.0 / (4.0 * 60.0 / 1.5e-3)  # where the notch is no stronger than the friction
        assert box.travel == pytest.approx(resting, abs=slack)
        assert box.x[s.X_VELOCITY] == 0.0


def test_free_motion_is_of_second_order():
    bare = changed(neutral_force=0.0, strut_force=0.0, damping=400.0)
    m, c, force = bare.mass, bare.damping, 300.0 - bare.guide_friction
    time = 0.004
    exact = force / c * (time - m / c * -math.expm1(-c * time / m))
    errors = []
    for steps in (20, 40, 80):
        box = Box(1, parameters=bare, dt=time / steps)
        for _ in range(steps):
            box.step(300.0)
        errors.append(abs(box.travel - exact))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.05)
    assert exact < bare.strut_position


def test_flight_is_of_second_order_and_the_ring_feels_the_mean_force():
    m, c, guide, share = SLEEVE.mass, SLEEVE.damping, SLEEVE.guide_friction, SLEEVE.flight_share
    first, stiffness, time = 400.0, 2e5, 0.0025
    left = 1.0 - share
    # m*d'' = left*(first - stiffness*d) - guide - c*d', from rest
    rest = (left * first - guide) / (left * stiffness)
    decay, swing = 0.5 * c / m, math.sqrt(left * stiffness / m - (0.5 * c / m) ** 2)
    turn = swing * time
    wave = math.cos(turn) + decay / swing * math.sin(turn)
    exact = rest * (1.0 - math.exp(-decay * time) * wave)
    speed = rest * math.exp(-decay * time) * (decay**2 + swing**2) / swing * math.sin(turn)
    ring = share / left * (m * speed + c * exact + guide * time)
    errors = []
    for steps in (20, 40, 80):
        box = Box(1, position=SLEEVE.blocking_position, dt=time / steps)
        box.x[s.X_RING], box.held = 1.0, 1.0
        felt = 0.0
        for _ in range(steps):
            way = box.travel - SLEEVE.blocking_position
            box.step(first - stiffness * way, stiffness)
            felt += box.out[s.OUT_RING_FORCE] * box.dt
        way = box.travel - SLEEVE.blocking_position
        errors.append((abs(way - exact), abs(felt - ring)))
        closed(box)
    assert exact < SLEEVE.tip_position - SLEEVE.blocking_position
    for coarse, fine in pairwise(errors):
        assert coarse[0] / fine[0] == pytest.approx(4.0, rel=0.1)
        assert coarse[1] / fine[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("dt", [2.5e-4, 1e-4, 5e-5])
def test_the_sleeve_leaves_the_ring_at_the_instant_at_which_it_has_turned(dt):
    m, c, guide, time = SLEEVE.mass, SLEEVE.damping, SLEEVE.guide_friction, 0.009
    box = Box(1, position=SLEEVE.blocking_position, dt=dt)
    box.held = 1.0
    box.run(900.0, time)
    turned = SLEEVE.index_time * SLEEVE.index_force / (900.0 - guide)
    assert 0.1 < turned / dt % 1.0 < 0.99
    flown, force = time - turned, (1.0 - SLEEVE.flight_share) * 900.0 - guide
    way = force / c * (flown - m / c * -math.expm1(-c * flown / m))
    assert box.travel - SLEEVE.blocking_position == pytest.approx(way, rel=1e-3)


def test_oil_locked_in_swings_without_gain_or_loss():
    bare = changed(neutral_force=0.0, strut_force=0.0, damping=0.0, guide_friction=0.0)
    box = Box(1, parameters=bare, position=1e-3)
    stiffness, seen = 6e7, []
    for _ in range(4000):
        x = box.x[s.X_POSITION]
        box.step(-stiffness * x, stiffness)
        x, v = box.x[s.X_POSITION], box.x[s.X_VELOCITY]
        seen.append(0.5 * stiffness * x * x + 0.5 * bare.mass * v * v)
    assert seen == pytest.approx([0.5 * stiffness * 1e-6] * 4000, rel=1e-9)


@given(
    st.lists(st.floats(-2500.0, 2500.0), min_size=3, max_size=12),
    st.sampled_from([1e-3, 0.05, 0.8, 20.0]),
    st.floats(0.0, 1e7),
    st.floats(-30.0, 30.0),
    st.floats(-0.06, 0.06),
    st.sampled_from([5e-5, 1e-3]),
)
def test_whatever_pushes_books_close_and_the_stops_hold(forces, mass, stiffness, slip, place, dt):
    box = Box(1, slip, place=place, parameters=changed(mass=mass), dt=dt)
    for force in forces:
        for _ in range(60):
            box.step(force, stiffness)
            assert abs(box.x[s.X_POSITION]) <= SLEEVE.end_position
    assert math.isfinite(box.x[s.X_VELOCITY])
    for loss in (s.OUT_DAMPING_LOSS, s.OUT_FRICTION_LOSS, s.OUT_STOP_LOSS):
        assert box.sums[loss] >= 0.0
    scale = max(1e-3, *map(abs, box.sums.values()))
    assert abs(box.unbalanced()) <= 1e-9 * scale + 1e-11
    stored = elastic_change(box.p, 0.0, box.x[s.X_POSITION])
    assert box.sums[s.OUT_ELASTIC] == pytest.approx(stored, abs=1e-9)
    moving = 0.5 * mass * box.x[s.X_VELOCITY] ** 2
    assert box.sums[s.OUT_KINETIC] == pytest.approx(moving, abs=1e-9 * scale)


def test_the_lag_of_the_chamfers_falls_with_the_step():
    lags = []
    for dt in (1e-4, 5e-5, 2.5e-5):
        box = Box(1, 10.0, inertia=2e-3, place=0.05, dt=dt).run(600.0, 0.3, until=s.STOP)
        assert box.zones[-1] == s.STOP
        closed(box)
        lags.append(abs(box.sums[s.OUT_TOOTH_LAG]))
    assert lags[0] > lags[1] > lags[2]
    assert lags[1] < 0.05 * abs(box.sums[s.OUT_TOOTH_WORK])


@pytest.mark.parametrize("inertia", [6e-5, 3e-4, 0.07])
def test_contact_with_the_chamfers_lasts_on_light_and_on_heavy_parts(inertia):
    box = Box(1, 5.0, inertia=inertia, load=-0.01, place=0.05).run(800.0, 0.2, until=s.STOP)
    assert box.zones == [*WAY, s.TOOTH_ON_TOOTH, *INSIDE]
    assert abs(box.sums[s.OUT_TOOTH_LAG]) < 0.05 * abs(box.sums[s.OUT_TOOTH_WORK])
    closed(box)


def test_left_is_the_mirror_of_right():
    alike = changed(cones_g2=2.0)
    right = Box(1, 15.0, place=0.02, load=1.0, parameters=alike)
    left = Box(2, 15.0, place=0.02, load=1.0, parameters=alike)
    for k in range(3000):
        force = 900.0 * math.sin(0.004 * k)
        right.step(force)
        left.step(-force)
    outs = np.array([right.out, left.out])
    outs[1, [s.OUT_POSITION, s.OUT_VELOCITY]] *= -1.0
    for first in (s.OUT_CONE1, s.OUT_DOG1, s.OUT_GAP1, s.OUT_DRAG1, s.OUT_CHAMFER1):
        outs[1, [first, first + 1]] = outs[1, [first + 1, first]]
    assert np.array_equal(*outs)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"chamfer_depth": 0.005}, r"tcu\.tip_position: expected more than blocking_position"),
        ({"ring_chamfer_angle": 0.5}, r"tcu\.ring_chamfer_angle: expected so large that the ring"),
        ({"half_clearance": 0.05}, r"tcu\.half_clearance: expected less than a quarter"),
        ({"least_overlap": 0.004}, r"tcu\.least_overlap: expected less than the way"),
        ({"dog_teeth": 1}, r"tcu\.dog_teeth: expected at least 2"),
        ({"mass": 0.0}, r"tcu\.mass: expected a number greater than 0"),
    ],
)
def test_a_bad_sleeve_is_named(change, where):
    with pytest.raises(InputError, match=where):
        changed(**change).validate("tcu")


def test_the_default_sleeve_makes_sense():
    SLEEVE.validate("tcu")
