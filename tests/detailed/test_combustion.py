"""The detailed engine: phases as the simple one has them, charge, fuel, energy, idling."""

from __future__ import annotations

import math

import engine_defaults as defaults
import msgspec
import numpy as np
import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.plant import combustion, crank, engine
from hev_can_emu.plant import combustion_map as maps
from hev_can_emu.plant import engine_control as phases
from hev_can_emu.plant import torque_source as source

ENGINE = defaults.ENGINE
RIPPLING = msgspec.structs.replace(ENGINE, pulses=defaults.PULSES)


class Bench:
    """The engine on its own inertia (or held at a speed), with the pistons' inertial torque."""

    def __init__(self, parameters=ENGINE, speed=0.0, h=1e-3, inertia=defaults.ENGINE_INERTIA):
        self.p, self.pc = parameters.pack(h), parameters.crank.pack(h)
        self.x, self.out = np.zeros(combustion.N_STATE), np.zeros(combustion.N_OUT)
        self.energy = np.zeros(combustion.N_ENERGY)
        self.total = np.zeros(combustion.N_ENERGY)
        self.h, self.inertia, self.speed, self.angle = h, inertia, speed, 0.1

    def step(self, request=0.0, run=1.0, healthy=1.0, load=0.0, free=True):
        h, j = self.h, self.inertia
        combustion.combustion_step(
            self.p, self.x, request, run, healthy, self.speed, self.angle, self.out
        )
        moved, end = h * self.speed, self.speed
        if free:
            torque = self.out[source.OUT_TORQUE] + load
            moved += 0.5 * h * h * torque / j
            end += h * torque / j
            held = crank.crank_torque(
                self.pc, self.angle, self.speed, end, moved, h / j, 0.5 * h * h / j, h, 1.0
            )
            moved += 0.5 * h * h * held / j
            end += h * held / j
        combustion.combustion_energy(self.p, self.out, moved, self.energy)
        self.total += self.energy
        self.angle = crank.wrap(self.angle + moved)
        self.speed = end
        return self.out

    def run(self, seconds, **inputs):
        rows = []
        for _ in range(round(seconds / self.h)):
            self.step(**inputs)
            rows.append(self.speed)
        return np.array(rows)


def test_half_turns_count_from_their_own_instant():
    def torque(h):
        bench, total = Bench(speed=163.0, h=h), 0.0
        bench.x[combustion.X_PHASE] = combustion.RUNNING
        for _ in range(round(0.12 / h)):
            total += bench.step(60.0, free=False)[engine.OUT_COMBUSTION] * h
        return total

    fine = torque(1e-6)
    errors = [abs(torque(h) / fine - 1.0) for h in (4e-4, 2e-4, 1e-4, 5e-5)]
    assert max(errors) < 5e-4
    assert errors[-1] < 2e-5


def test_map_and_its_inverse():
    p = ENGINE.pack()
    assert maps.load_torque(p, ENGINE.speed[3], 1.0) == pytest.approx(163.0)
    assert maps.load_torque(p, ENGINE.speed[3], 0.0) == 0.0
    for speed in (10.0, 52.4, 130.0, 300.0, 700.0):
        for load in (0.0, 0.05, 0.15, 0.5, 0.93, 1.0):
            torque = maps.load_torque(p, speed, load)
            assert maps.torque_load(p, speed, torque) == pytest.approx(load, abs=1e-14)
        assert maps.torque_load(p, speed, 1e3) == 1.0
        assert maps.torque_load(p, speed, -1.0) == 0.0


def test_drag_is_that_of_the_simple_engine():
    p = ENGINE.pack()
    assert maps.drag_torque(p, 0.0) == 0.0
    assert maps.drag_torque(p, 2.0) == pytest.approx(1.4)
    assert maps.drag_torque(p, -2.0) == pytest.approx(-1.4)
    assert maps.drag_torque(p, ENGINE.speed[3]) == pytest.approx(18.0)
    out = Bench(speed=ENGINE.speed[3]).step(request=100.0, run=0.0)
    assert out[source.OUT_TORQUE] == pytest.approx(-18.0)
    assert out[source.OUT_REASON] == source.LIMIT_DISABLED
    assert out[engine.OUT_TORQUE_MAX] == out[engine.OUT_TORQUE_MIN] == pytest.approx(-18.0)


def test_fuel_of_a_known_operating_point():
    """100 N m at 2500 rpm: (100 + 18) N m at an efficiency of 0.405 and 42.7 MJ/kg."""
    bench = Bench(speed=ENGINE.speed[3])
    bench.run(1.0, request=100.0, free=False)
    assert bench.out[source.OUT_TORQUE] == pytest.approx(100.0, abs=1e-9)
    assert bench.out[source.OUT_REASON] == source.LIMIT_NONE
    bench.total[:] = 0.0
    bench.run(2.0, request=100.0, free=False)
    power = 118.0 * ENGINE.speed[3]
    mass = 2.0 * power / 0.405 / 42.7e6
    assert bench.total[combustion.M_FUEL] == pytest.approx(mass, rel=1e-9)
    assert bench.out[combustion.OUT_FUEL_FLOW] == pytest.approx(0.5 * mass, rel=1e-9)
    per_kwh = bench.total[combustion.M_FUEL] / bench.total[combustion.J_SHAFT] * 3.6e9
    assert per_kwh == pytest.approx(245.6, abs=0.2)  # g/kWh
    heat = 0.45 * power * (1.0 / 0.405 - 1.0) + 18.0 * ENGINE.speed[3]
    assert bench.out[engine.OUT_HEAT] == pytest.approx(heat, rel=1e-9)


def test_willans_line_is_straight():
    flow = []
    for request in (0.0, 50.0, 100.0):
        bench = Bench(speed=ENGINE.speed[2])
        bench.run(1.0, request=request, free=False)
        flow.append(bench.out[combustion.OUT_FUEL_FLOW])
    assert flow[0] > 0.0
    assert flow[1] - flow[0] == pytest.approx(flow[2] - flow[1], rel=1e-9)
    assert flow[0] / (flow[1] - flow[0]) == pytest.approx(16.0 / 50.0, rel=1e-9)


@pytest.mark.parametrize("parameters", [ENGINE, RIPPLING], ids=["mean", "ripple"])
def test_energy_balances_each_term_for_itself(parameters):
    bench = Bench(parameters, speed=150.0, h=100e-6)
    start = bench.speed
    extra = crank.reciprocating_energy(bench.pc, bench.angle, start)
    for request in (80.0, -30.0, 150.0):
        bench.run(0.15, request=request)
        t = bench.total
        heat = t[combustion.J_COMBUSTION] + t[combustion.J_WALL] + t[combustion.J_EXHAUST]
        assert heat == pytest.approx(t[combustion.J_FUEL], rel=1e-12)
        work = t[combustion.J_COMBUSTION] + t[combustion.J_RIPPLE] - t[combustion.J_DRAG]
        assert work == pytest.approx(t[combustion.J_SHAFT], rel=1e-9)
        assert t[combustion.J_FUEL] == pytest.approx(t[combustion.M_FUEL] * 42.7e6, rel=1e-12)
        kinetic = 0.5 * bench.inertia * (bench.speed**2 - start**2)
        kinetic += crank.reciprocating_energy(bench.pc, bench.angle, bench.speed) - extra
        assert kinetic == pytest.approx(t[combustion.J_SHAFT], rel=1e-9)
    assert bench.total[combustion.J_FUEL] > 1e3


def test_charge_lag_is_exact_and_in_crank_angle():
    for speed in (150.0, 300.0):
        bench = Bench(speed=speed, h=50e-6)
        bench.run(0.5, request=20.0, free=False)
        low = bench.out[combustion.OUT_CHARGE]
        bench.run(0.02, request=100.0, free=False)
        high = maps.torque_load(bench.p, speed, 100.0 + maps.drag_torque(bench.p, speed))
        share = 1.0 - math.exp(-0.02 * speed / ENGINE.intake_angle)
        assert bench.out[combustion.OUT_CHARGE] == pytest.approx(low + (high - low) * share)


@pytest.mark.parametrize("h", [25e-6, 50e-6, 100e-6])
def test_torque_follows_by_half_turns(h):
    """A charge caught at one dead centre burns from the next on: half a turn to one turn late."""
    parameters = msgspec.structs.replace(ENGINE, intake_angle=1e-6)
    speed = 200.0
    bench = Bench(parameters, speed=speed, h=h)
    bench.run(0.5, request=20.0, free=False)
    assert bench.out[source.OUT_TORQUE] == pytest.approx(20.0)
    turned = 0.0
    starts_at = bench.angle
    while bench.out[source.OUT_TORQUE] < 100.0 - 1e-6:
        bench.step(request=100.0, free=False)
        turned += speed * h
        assert bench.out[source.OUT_TORQUE] == pytest.approx(20.0) or turned > math.pi
    to_centre = math.pi - starts_at % math.pi
    assert turned == pytest.approx(to_centre + math.pi, abs=3.0 * speed * h)


def test_steps_of_half_the_length_agree():
    """Halving the step: first order, the charge being caught at the first step past a dead centre."""
    ends = []
    for h in (200e-6, 100e-6, 50e-6):
        bench = Bench(speed=150.0, h=h)
        bench.run(0.3, request=100.0)
        ends.append(bench.speed)
    assert ends[1] == pytest.approx(ends[2], abs=0.5)
    assert abs(ends[1] - ends[2]) < abs(ends[0] - ends[2])


@pytest.mark.parametrize("parameters", [ENGINE, RIPPLING], ids=["mean", "ripple"])
@pytest.mark.parametrize("inertia", [defaults.ENGINE_INERTIA, 0.23])
def test_idle_is_stable_on_the_engines_own_inertia(parameters, inertia):
    bench = Bench(parameters, speed=50.0, inertia=inertia)
    start = bench.run(6.0)
    assert bench.out[engine.OUT_PHASE] == phases.RUNNING
    assert start.max() < ENGINE.idle_speed + 30.0
    settled = bench.run(1.0)
    assert np.mean(settled) == pytest.approx(ENGINE.idle_speed, abs=0.6)
    assert np.ptp(settled) < (4.5 if parameters.pulses else 1.5)
    assert bench.out[source.OUT_REASON] in (source.LIMIT_SPEED, source.LIMIT_NONE)


def test_idle_carries_a_load_and_returns():
    bench = Bench(speed=89.0)
    bench.run(4.0)
    dip = bench.run(4.0, load=-20.0)
    assert dip.min() > ENGINE.crank_speed
    assert np.mean(dip[-200:]) == pytest.approx(ENGINE.idle_speed, abs=2.0)
    back = bench.run(8.0)
    assert np.mean(back[-200:]) == pytest.approx(ENGINE.idle_speed, abs=2.0)


def test_cranked_it_fires_and_without_a_run_request_it_stops():
    bench = Bench()
    assert bench.step()[engine.OUT_PHASE] == phases.CRANKING
    bench.run(0.3, load=40.0)  # EM1 through C1
    assert bench.out[engine.OUT_PHASE] == phases.RUNNING
    bench.run(1.0)
    assert bench.total[combustion.M_FUEL] > 0.0
    assert bench.speed > 60.0
    assert bench.step(run=0.0)[engine.OUT_PHASE] == phases.OFF
    assert bench.out[engine.OUT_COMBUSTION] == 0.0
    bench.run(3.0, run=0.0)
    assert abs(bench.speed) < 0.5
    assert bench.speed >= 0.0


def test_overload_stalls_and_stays_until_withdrawn_or_cranked():
    bench = Bench(speed=89.0)
    bench.run(2.0)
    while bench.speed > 5.0:
        bench.step(load=-150.0)
    assert bench.out[engine.OUT_PHASE] == phases.STALLED
    bench.run(0.5)
    assert bench.out[engine.OUT_PHASE] == phases.STALLED
    assert bench.out[engine.OUT_COMBUSTION] == bench.out[combustion.OUT_FUEL_FLOW] == 0.0
    assert bench.step(run=0.0)[engine.OUT_PHASE] == phases.OFF
    assert bench.step()[engine.OUT_PHASE] == phases.CRANKING


def test_fuel_is_cut_in_overrun():
    bench = Bench(speed=ENGINE.speed[3])
    bench.run(0.5, request=50.0, free=False)
    bench.run(0.2, request=-100.0, free=False)
    assert bench.out[engine.OUT_COMBUSTION] == bench.out[combustion.OUT_FUEL_FLOW] == 0.0
    assert bench.out[source.OUT_TORQUE] == pytest.approx(-18.0)
    assert bench.out[source.OUT_SETPOINT] == pytest.approx(-18.0)
    assert bench.out[source.OUT_REASON] == source.LIMIT_PEAK
    assert bench.out[engine.OUT_HEAT] == pytest.approx(18.0 * ENGINE.speed[3])


def test_full_load_is_the_most():
    bench = Bench(speed=ENGINE.speed[3])
    bench.run(1.0, request=500.0, free=False)
    assert bench.out[source.OUT_TORQUE] == pytest.approx(145.0)
    assert bench.out[engine.OUT_TORQUE_MAX] == pytest.approx(145.0)
    assert bench.out[engine.OUT_TORQUE_MIN] == pytest.approx(-18.0)
    assert bench.out[source.OUT_REASON] == source.LIMIT_PEAK


def test_overspeed_is_faded_then_cut_with_hysteresis():
    bench = Bench(speed=400.0)
    top = bench.run(3.0, request=150.0).max()
    assert 586.0 < top < 649.0
    assert bench.out[source.OUT_REASON] == source.LIMIT_SPEED
    bench.speed = 660.0
    bench.run(0.2, request=150.0, free=False)
    assert bench.out[source.OUT_TORQUE] == pytest.approx(-26.0)
    assert bench.out[source.OUT_REASON] == source.LIMIT_SPEED
    bench.speed = 630.0
    bench.run(0.2, request=-5.0, free=False)
    assert bench.x[combustion.X_FUEL_CUT] == 1.0
    bench.speed = 600.0
    bench.run(0.2, request=50.0, free=False)
    assert bench.out[source.OUT_TORQUE] == pytest.approx(50.0)


def test_fault_switches_off_at_once_and_needs_the_request_withdrawn():
    bench = Bench(speed=200.0)
    bench.run(0.5, request=80.0, free=False)
    assert bench.out[engine.OUT_COMBUSTION] > 80.0
    assert bench.step(healthy=0.0)[engine.OUT_PHASE] == phases.FAULT
    assert bench.out[engine.OUT_COMBUSTION] == 0.0
    assert bench.step()[engine.OUT_PHASE] == phases.FAULT
    assert bench.step(run=0.0)[engine.OUT_PHASE] == phases.OFF


def test_phases_are_those_of_the_simple_engine():
    simple = engine.EngineParameters(
        source=source.TorqueSourceParameters(
            delay=0.0, slew_rate=1e9, time_constant=0.0, off_slew_rate=1e9
        ),
        speed=ENGINE.speed,
        full_load=tuple(row[-1] for row in ENGINE.torque),
        coolant_heat_ratio=0.9,
        **{
            name: getattr(ENGINE, name)
            for name in engine.EngineParameters.__struct_fields__
            if name in ENGINE.__struct_fields__ and name != "speed"
        },
    )
    p, x, out = simple.pack(), np.zeros(engine.N_STATE), np.zeros(engine.N_OUT)
    bench = Bench()
    rng = np.random.default_rng(4)
    seen = set()
    run = healthy = 1.0
    for _ in range(600):
        speed = rng.choice([0.0, 20.0, 35.0, 60.0, 400.0])
        run = rng.choice([run, run, run, 1.0, 1.0, 0.0])
        healthy = 0.0 if rng.random() < 0.05 else 1.0
        engine.engine_step(p, x, 0.0, run, healthy, speed, out)
        bench.speed = speed
        bench.step(run=run, healthy=healthy, free=False)
        assert bench.out[engine.OUT_PHASE] == out[engine.OUT_PHASE]
        assert bench.out[engine.OUT_TORQUE_MIN] == pytest.approx(out[engine.OUT_TORQUE_MIN])
        seen.add(int(out[engine.OUT_PHASE]))
    assert seen == {
        phases.OFF,
        phases.CRANKING,
        phases.RUNNING,
        phases.STALLED,
        phases.FAULT,
    }


def test_ripple_leaves_the_mean_torque():
    speed = 200.0
    plain, rippling = Bench(speed=speed, h=50e-6), Bench(RIPPLING, speed=speed, h=50e-6)
    for bench in (plain, rippling):
        bench.run(0.5, request=100.0, free=False)
        bench.total[:] = 0.0
        bench.run(20.0 * math.pi / speed, request=100.0, free=False)
    assert rippling.total[combustion.J_FUEL] == plain.total[combustion.J_FUEL]
    assert abs(rippling.total[combustion.J_RIPPLE]) < 0.02 * plain.total[combustion.J_SHAFT] / 20.0
    assert abs(rippling.out[combustion.OUT_RIPPLE]) > 1.0


def test_missing_request_counts_as_zero():
    one, two = Bench(speed=200.0), Bench(speed=200.0)
    assert np.array_equal(one.step(request=math.nan), two.step(request=0.0))


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"drag": (1.0, 2.0)}, r"engine\.drag: expected 7 values"),
        ({"efficiency": (1.2,) * 7}, r"engine\.efficiency: expected at most 1"),
        ({"load": (0.0, 0.2, 0.4, 0.6, 0.9)}, r"engine\.load: expected values from 0 to 1"),
        ({"torque": ENGINE.torque[:-1]}, r"engine\.torque: expected 7 rows"),
        ({"torque": ((1.0, 2.0, 3.0, 4.0, 5.0),) * 7}, r"engine\.torque\[0\]\[0\]: expected 0"),
        ({"torque": ((0.0, 2.0, 1.0, 4.0, 5.0),) * 7}, r"engine\.torque\[0\]\[2\]"),
        ({"crank_speed": 30.0}, r"engine\.crank_speed: expected more than stall_speed"),
        ({"resume_speed": 700.0}, r"engine\.cut_speed"),
        ({"wall_share": 1.5}, r"engine\.wall_share"),
        ({"crank": msgspec.structs.replace(defaults.CRANK, radius=0.0)}, r"engine\.crank\.radius"),
    ],
)
def test_bad_engine_is_named(change, where):
    with pytest.raises(InputError, match=where):
        msgspec.structs.replace(ENGINE, **change).validate("engine")


def test_defaults_are_valid_and_survive_serialisation():
    for record in (ENGINE, RIPPLING):
        record.validate("engine")
        record.crank.validate("engine.crank", defaults.ENGINE_INERTIA)
        again = msgspec.convert(msgspec.to_builtins(record), type(record))
        assert again == record
