from __future__ import annotations

import math

import machine_defaults as defaults
import msgspec
import numpy as np
import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.plant import engine, motor
from hev_can_emu.plant import engine_control as phases
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.torque_source import TorqueSourceParameters

PLAIN = TorqueSourceParameters(delay=0.0, slew_rate=1e9, time_constant=0.01, off_slew_rate=10e3)


def run(parameters, requests, enabled=1.0, lower=-1e3, upper=1e3, state=None):
    p = parameters.pack()
    x = np.zeros(source.N_STATE) if state is None else state
    out = np.zeros(source.N_OUT)
    rows = []
    for request in requests:
        source.torque_source_step(p, x, request, enabled, lower, upper, 1.0, 13.0, out)
        rows.append(out.copy())
    return np.array(rows)


def test_lag_step_response_is_exact():
    rows = run(PLAIN, [100.0] * 50)
    t = 1e-3 * np.arange(1, 51)
    assert rows[:, source.OUT_TORQUE] == pytest.approx(100.0 * (1.0 - np.exp(-t / 0.01)), rel=1e-13)
    assert np.all(rows[:, source.OUT_REASON] == source.LIMIT_NONE)


@pytest.mark.parametrize("ticks", [0, 1, 7, 64])
def test_delay_is_whole_periods(ticks):
    parameters = msgspec.structs.replace(PLAIN, delay=ticks * 1e-3, time_constant=0.0)
    requests = np.arange(1.0, 101.0)
    torque = run(parameters, requests)[:, source.OUT_TORQUE]
    assert np.array_equal(torque, np.concatenate([np.zeros(ticks), requests])[:100])


def test_slew_limits_the_setpoint_and_says_so():
    parameters = msgspec.structs.replace(PLAIN, slew_rate=2000.0, time_constant=0.0)
    rows = run(parameters, [10.0] * 7)
    assert rows[:, source.OUT_SETPOINT] == pytest.approx([2, 4, 6, 8, 10, 10, 10])
    reasons = [source.LIMIT_SLEW] * 4 + [source.LIMIT_NONE] * 3
    assert np.array_equal(rows[:, source.OUT_REASON], reasons)


def test_limits_bind_at_once_with_their_reason():
    x = np.zeros(source.N_STATE)
    assert run(PLAIN, [80.0] * 200, state=x)[-1, source.OUT_TORQUE] == pytest.approx(80.0)
    row = run(PLAIN, [80.0], upper=30.0, state=x)[0]
    assert row == pytest.approx([30.0, 30.0, 13.0])
    row = run(PLAIN, [-80.0], lower=-10.0, state=x)[0]
    assert row[source.OUT_SETPOINT] == -10.0
    assert row[source.OUT_REASON] == 1.0


def test_disabled_ramps_to_exactly_zero_and_forgets_the_delay_line():
    parameters = msgspec.structs.replace(PLAIN, delay=0.005)
    x = np.zeros(source.N_STATE)
    run(parameters, [50.0] * 300, state=x)
    rows = run(parameters, [50.0] * 6, enabled=0.0, state=x)
    assert rows[:, source.OUT_TORQUE] == pytest.approx([40, 30, 20, 10, 0, 0], abs=1e-9)
    assert rows[-1, source.OUT_TORQUE] == 0.0
    assert np.all(rows[:, source.OUT_SETPOINT] == 0.0)
    assert np.all(rows[:, source.OUT_REASON] == source.LIMIT_DISABLED)
    again = run(parameters, [50.0] * 6, state=x)[:, source.OUT_TORQUE]
    assert np.all(again[:5] == 0.0)
    assert again[5] > 0.0


def test_nan_request_counts_as_zero():
    assert np.all(run(PLAIN, [math.nan] * 3) == 0.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [("delay", -1.0), ("delay", 1.0), ("slew_rate", 0.0), ("time_constant", math.nan)],
)
def test_bad_source_is_named(name, value):
    with pytest.raises(InputError, match=rf"car\.em1\.{name}: expected"):
        msgspec.structs.replace(PLAIN, **{name: value}).validate("car.em1")


# Motor


def limits(speed, voltage=350.0, winding=300.0, inverter=300.0):
    out = np.zeros(motor.N_LIM)
    motor.motor_limits(defaults.EM2.pack(), speed, voltage, winding, inverter, out)
    return out


def test_motor_envelope_in_four_quadrants():
    corner = 110e3 / 230.0
    for speed in (0.0, 0.9 * corner, -0.9 * corner):
        assert limits(speed)[:2] == pytest.approx([-230.0, 230.0])
        assert np.all(limits(speed)[2:] == source.LIMIT_PEAK)
    for speed in (2.0 * corner, -2.0 * corner):
        assert limits(speed)[:2] == pytest.approx([-115.0, 115.0])
        assert np.all(limits(speed)[2:] == source.LIMIT_SPEED)


def test_motor_power_follows_the_voltage():
    assert limits(1000.0, voltage=280.0)[1] == pytest.approx(110.0 * 280.0 / 350.0)
    assert limits(1000.0, voltage=280.0)[3] == source.LIMIT_VOLTAGE
    assert limits(0.0, voltage=220.0)[1] == pytest.approx(115.0)
    assert np.all(limits(100.0, voltage=0.0)[:2] == 0.0)


@pytest.mark.parametrize("which", ["winding", "inverter"])
def test_motor_derates_linearly_with_temperature(which):
    low = getattr(defaults.EM2, f"{which}_derate")
    high = getattr(defaults.EM2, f"{which}_max")
    out = limits(0.0, **{which: low + 0.25 * (high - low)})
    assert out == pytest.approx([-172.5, 172.5, source.LIMIT_TEMPERATURE, source.LIMIT_TEMPERATURE])
    assert np.all(limits(0.0, **{which: high})[:2] == 0.0)


def test_driving_torque_fades_at_top_speed_and_braking_stays():
    top = defaults.EM2.max_speed
    out = limits(top)
    assert out[1] == 0.0
    assert out[0] == pytest.approx(-110e3 / top)
    out = limits(-0.5 * (top + defaults.EM2.fade_speed))
    assert out[0] == pytest.approx(-0.5 * out[1])


@pytest.mark.parametrize("speed", [-900.0, -200.0, 0.0, 200.0, 900.0])
@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_torque_for_power_inverts_the_power(speed, direction):
    p = defaults.EM2.pack()
    torque = 37.0 * direction
    power = torque * speed + motor.motor_loss(p, torque, speed)
    assert motor.torque_for_power(p, speed, power, direction) == pytest.approx(torque, rel=1e-9)


def test_motor_step_books_power_and_losses():
    p = defaults.EM1.pack()
    x, out = np.zeros(motor.N_STATE), np.zeros(motor.N_OUT)
    for _ in range(100):
        motor.motor_step(p, x, 60.0, 1.0, 500.0, 350.0, 300.0, 300.0, out)
    loss = 80.0 + 0.4 * 500.0 + 4e-4 * 500.0**2 + 0.3 * 3600.0 + 0.015 * 60.0 * 500.0
    assert out[source.OUT_TORQUE] == pytest.approx(60.0)
    assert out[motor.OUT_LOSS] == pytest.approx(loss)
    assert out[motor.OUT_DC_POWER] == pytest.approx(30e3 + loss)
    assert out[motor.OUT_WINDING_LOSS] == pytest.approx(0.7 * loss)
    assert out[motor.OUT_INVERTER_LOSS] == pytest.approx(0.3 * loss)
    assert out[motor.OUT_TORQUE_MAX] == pytest.approx(130.0)
    for _ in range(10):
        motor.motor_step(p, x, 60.0, 0.0, 500.0, 350.0, 300.0, 300.0, out)
    assert out[source.OUT_TORQUE] == 0.0
    assert out[motor.OUT_DC_POWER] == 0.0
    assert out[motor.OUT_TORQUE_MAX] == pytest.approx(130.0)


def test_bad_motor_is_named():
    bad = msgspec.structs.replace(defaults.EM1, winding_max=400.0)
    with pytest.raises(InputError, match=r"em1\.winding_max: expected more than winding_derate"):
        bad.validate("em1")
    nested = msgspec.structs.replace(
        defaults.EM1, source=msgspec.structs.replace(PLAIN, delay=-1.0)
    )
    with pytest.raises(InputError, match=r"em1\.source\.delay"):
        nested.validate("em1")


# Engine


class Bench:
    """An engine on a bare flywheel."""

    def __init__(self, speed=0.0, inertia=0.16):
        self.p = defaults.ENGINE.pack()
        self.x = np.zeros(engine.N_STATE)
        self.out = np.zeros(engine.N_OUT)
        self.speed = speed
        self.inertia = inertia

    def step(self, request=0.0, run=1.0, healthy=1.0, load=0.0, free=True):
        engine.engine_step(self.p, self.x, request, run, healthy, self.speed, self.out)
        if free:
            self.speed += 1e-3 * (self.out[source.OUT_TORQUE] + load) / self.inertia
        return self.out

    def run_up(self):
        self.speed = 60.0
        for _ in range(5):
            self.step()
        assert self.out[engine.OUT_PHASE] == phases.RUNNING
        return self


def test_engine_starts_when_cranked_and_idles():
    bench = Bench()
    bench.step()
    assert bench.out[engine.OUT_PHASE] == phases.CRANKING
    assert bench.out[source.OUT_TORQUE] == 0.0
    while bench.speed < defaults.ENGINE.crank_speed:
        assert bench.step(load=40.0)[engine.OUT_PHASE] == phases.CRANKING
    speeds = []
    for _ in range(6000):
        bench.step()
        speeds.append(bench.speed)
    assert bench.out[engine.OUT_PHASE] == phases.RUNNING
    assert bench.speed == pytest.approx(defaults.ENGINE.idle_speed, abs=0.5)
    assert max(speeds) < 1.3 * defaults.ENGINE.idle_speed
    assert min(speeds) > defaults.ENGINE.stall_speed


def test_idle_governor_carries_a_load_without_error_left():
    bench = Bench().run_up()
    for _ in range(6000):
        bench.step(load=-15.0)
    assert bench.speed == pytest.approx(defaults.ENGINE.idle_speed, abs=0.5)
    assert bench.out[source.OUT_TORQUE] == pytest.approx(15.0, abs=0.2)
    assert bench.out[source.OUT_REASON] == source.LIMIT_SPEED


def test_overload_stalls_and_the_state_stays_until_withdrawn():
    bench = Bench().run_up()
    for _ in range(3000):
        bench.step(load=-150.0 if bench.speed > 0.0 else 0.0)
        if bench.out[engine.OUT_PHASE] == phases.STALLED:
            break
    assert bench.out[engine.OUT_PHASE] == phases.STALLED
    for _ in range(3000):
        bench.step()
    assert bench.out[engine.OUT_PHASE] == phases.STALLED
    assert bench.out[engine.OUT_COMBUSTION] == 0.0
    assert abs(bench.speed) < 1.0  # drag alone: it comes to rest without ever turning back
    assert bench.speed >= 0.0
    assert bench.step(run=0.0)[engine.OUT_PHASE] == phases.OFF
    assert bench.step()[engine.OUT_PHASE] == phases.CRANKING


def test_drag_when_not_fuelled_is_odd_and_linear_near_rest():
    p = defaults.ENGINE.pack()
    assert engine.engine_drag(p, 0.0) == 0.0
    assert engine.engine_drag(p, 2.0) == pytest.approx(1.4)
    assert engine.engine_drag(p, -2.0) == pytest.approx(-1.4)
    assert engine.engine_drag(p, defaults.ENGINE.speed[3]) == pytest.approx(18.0)
    bench = Bench(speed=defaults.ENGINE.speed[3])
    out = bench.step(request=100.0, run=0.0)
    assert out[source.OUT_TORQUE] == pytest.approx(-18.0)
    assert out[source.OUT_REASON] == source.LIMIT_DISABLED
    assert out[engine.OUT_TORQUE_MAX] == out[engine.OUT_TORQUE_MIN] == pytest.approx(-18.0)


def test_torque_follows_the_request_within_full_load_and_drag():
    bench = Bench(speed=defaults.ENGINE.speed[3])
    for _ in range(1000):
        bench.step(request=80.0, free=False)
    assert bench.out[source.OUT_TORQUE] == pytest.approx(80.0)
    assert bench.out[source.OUT_REASON] == source.LIMIT_NONE
    assert bench.out[engine.OUT_HEAT] == pytest.approx(0.9 * 98.0 * bench.speed)
    for _ in range(1000):
        bench.step(request=500.0, free=False)
    assert bench.out[source.OUT_TORQUE] == pytest.approx(145.0)
    assert bench.out[source.OUT_REASON] == source.LIMIT_PEAK
    for _ in range(1000):
        bench.step(request=-500.0, free=False)
    assert bench.out[source.OUT_TORQUE] == pytest.approx(-18.0, abs=1e-4)
    assert bench.out[source.OUT_REASON] == source.LIMIT_PEAK


def test_overspeed_is_faded_then_cut_with_hysteresis():
    bench = Bench(speed=400.0)
    top = 0.0
    for _ in range(20000):
        bench.step(request=150.0)
        top = max(top, bench.speed)
    assert 586.0 < top < 649.0
    assert bench.out[source.OUT_REASON] == source.LIMIT_SPEED
    bench.speed = 660.0
    bench.step(request=150.0, free=False)
    for _ in range(200):
        bench.step(request=150.0, free=False)
    assert bench.out[engine.OUT_COMBUSTION] == 0.0
    assert bench.out[source.OUT_TORQUE] == pytest.approx(-26.0)
    bench.speed = 630.0
    bench.step(request=50.0, free=False)
    assert bench.out[engine.OUT_COMBUSTION] == 0.0
    bench.speed = 600.0
    for _ in range(100):
        bench.step(request=50.0, free=False)
    assert bench.out[engine.OUT_COMBUSTION] > 0.0


def test_fault_cuts_and_needs_the_request_withdrawn():
    bench = Bench().run_up()
    assert bench.step(healthy=0.0)[engine.OUT_PHASE] == phases.FAULT
    assert bench.step()[engine.OUT_PHASE] == phases.FAULT
    assert bench.step(run=0.0)[engine.OUT_PHASE] == phases.OFF


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"drag": (1.0, 2.0)}, r"engine\.drag: expected 7 values"),
        ({"speed": (0.0, 2.0, 1.0, 4.0, 5.0, 6.0, 7.0)}, r"engine\.speed\[2\]"),
        ({"crank_speed": 30.0}, r"engine\.crank_speed: expected more than stall_speed"),
        ({"resume_speed": 700.0}, r"engine\.cut_speed"),
    ],
)
def test_bad_engine_is_named(change, where):
    with pytest.raises(InputError, match=where):
        msgspec.structs.replace(defaults.ENGINE, **change).validate("engine")


def test_defaults_are_valid():
    for name in dir(defaults):
        record = getattr(defaults, name)
        if name.isupper():
            record.validate(name)
            again = msgspec.convert(msgspec.to_builtins(record), type(record))
            assert again == record
