"""The drive as a whole: current control, torque steps, limits, gates, energy, convergence."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
import pytest
from drive_defaults import CONTROL, EM1, EM2

from hev_can_emu.errors import InputError
from hev_can_emu.plant import (
    current_control,
    electric_drive,
    freewheel,
    inverter,
    pmsm,
    speed_control,
)
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.electric_drive import (
    ACTIVE,
    BLOCKED,
    OUT_DC,
    OUT_INVERTER,
    OUT_REASON,
    OUT_SETPOINT,
    OUT_TORQUE_MAX,
    OUT_TORQUE_MIN,
    SHORT,
)
from hev_can_emu.plant.pmsm import OUT_TORQUE
from hev_can_emu.plant.speed_control import SpeedControlParameters

replace = msgspec.structs.replace
DT = 5e-5
WARM = 300.0
SPENT = [pmsm.OUT_SHAFT, pmsm.OUT_COPPER, pmsm.OUT_IRON, pmsm.OUT_DRAG, OUT_INVERTER]


@pytest.fixture(scope="module", params=[EM1, EM2], ids=["em1", "em2"])
def drive(request):
    return request.param, request.param.pack(DT)


@pytest.fixture(scope="module")
def em2():
    return EM2.pack(DT)


def run(p, parts, speed, link=350.0, winding=WARM, x=None):
    """Run (count, request, gates) parts; return rows of outputs and of states, balance checked."""
    x = np.zeros(electric_drive.N_STATE) if x is None else x
    out = np.zeros(electric_drive.N_OUT)
    rows, states = [], []
    for count, request, gates in parts:
        for _ in range(count):
            before = pmsm.magnetic_energy(p, x[0], x[1])
            electric_drive.drive_step(p, x, request, gates, speed, link, winding, WARM, out)
            spent = out[SPENT].sum() + out[pmsm.OUT_MAGNETIC] - before
            scale = np.abs(out[[*SPENT, OUT_DC]]).sum() + before + out[pmsm.OUT_MAGNETIC]
            assert abs(out[OUT_DC] - spent) <= 1e-11 * scale + 1e-20
            rows.append(out.copy())
            states.append(x.copy())
    return np.array(rows), np.array(states)


def control_loop(speed, refs, periods, resistance_error=0.0, link=400.0):
    """Current controller on an exact machine, one period per step; returns the sampled currents."""
    machine = EM2.machine
    control = CONTROL.pack(machine)
    legs = EM2.inverter.pack(CONTROL.period)
    fine = machine.pack(CONTROL.period / 20)
    x, i, out = np.zeros(current_control.N_STATE), np.zeros(2), np.zeros(pmsm.N_OUT)
    samples = [i.copy()]
    for _ in range(periods):
        current_control.current_control_step(
            control, legs, x, *refs, i[0], i[1], 4.0 * speed, 0.0, link
        )
        for _ in range(20):
            v_d, v_q = x[current_control.X_VD], x[current_control.X_VQ]
            resistance = machine.resistance * (1.0 + resistance_error)
            pmsm.pmsm_step(fine, i, v_d, v_q, speed, resistance, 0.0, out)
        samples.append(i.copy())
    return np.array(samples), x


@pytest.mark.parametrize("speed", [0.0, 300.0, -300.0])
def test_current_steps_are_first_order_on_both_axes(speed):
    samples, _ = control_loop(speed, (-20.0, 30.0), 30)
    pole = math.exp(-CONTROL.bandwidth * CONTROL.period)
    expected = 1.0 - pole ** np.arange(31)
    assert samples[:, 0] / -20.0 == pytest.approx(expected, abs=0.02)
    assert samples[:, 1] / 30.0 == pytest.approx(expected, abs=0.02)


def test_wrong_resistance_leaves_no_lasting_error():
    samples, _ = control_loop(200.0, (-50.0, 80.0), 100, resistance_error=0.5)
    assert samples[-1] == pytest.approx([-50.0, 80.0], abs=1e-6)


def test_integrators_do_not_wind_up_at_the_voltage_limit():
    # Out of reach at this speed; then a reference within reach is met as if nothing had happened.
    machine = EM2.machine
    speed, link = 600.0, 300.0
    control, legs = CONTROL.pack(machine), EM2.inverter.pack(CONTROL.period)
    p = machine.pack(CONTROL.period)
    x, i, out = np.zeros(current_control.N_STATE), np.zeros(2), np.zeros(pmsm.N_OUT)
    largest = 0.0
    for refs, periods in (((-50.0, 450.0), 2000), ((-250.0, 100.0), 60)):
        for _ in range(periods):
            current_control.current_control_step(
                control, legs, x, *refs, i[0], i[1], 4.0 * speed, 0.0, link
            )
            v_d, v_q = x[current_control.X_VD], x[current_control.X_VQ]
            assert math.hypot(v_d, v_q) <= link / math.sqrt(3.0) * (1.0 + 1e-12)
            pmsm.pmsm_step(p, i, v_d, v_q, speed, machine.resistance, 0.0, out)
            largest = max(largest, *np.abs(x[:2]))
    assert largest < 2.0 * link
    assert i == pytest.approx([-250.0, 100.0], abs=0.5)


@pytest.mark.parametrize("theta", np.linspace(0.0, 2.0 * math.pi, 13))
def test_legs_give_the_circle_undistorted_and_never_more_than_the_hexagon(theta):
    legs = replace(EM2.inverter, overmodulation=1.0, voltage_rms=1000.0).pack(DT)
    inner = 350.0 / math.sqrt(3.0)
    for ahead in (0.0, 1.0, 4.0):
        wish = 0.999 * inner * math.cos(ahead), 0.999 * inner * math.sin(ahead)
        angle = theta + ahead
        duties = inverter.leg_duties(
            0.999 * inner * math.cos(angle), 0.999 * inner * math.sin(angle), 350.0
        )
        assert min(duties) >= 0.0
        assert max(duties) <= 1.0
        assert sum((min(duties), max(duties))) == pytest.approx(1.0)
        given = inverter.clarke(*(350.0 * each for each in duties))[:2]
        assert inverter.park(*given, theta) == pytest.approx(wish, abs=1e-9)
    # Asked for far more: on the hexagon's edge, between inner circle and corner.
    size = math.hypot(*inverter.terminal_voltage(legs, 1e4, 0.0, theta, 350.0))
    assert inner * (1.0 - 1e-9) <= size <= 350.0 * 2.0 / 3.0 * (1.0 + 1e-9)
    round_legs = EM2.inverter.pack(DT)
    size = math.hypot(*inverter.terminal_voltage(round_legs, 1e4, -1e4, theta, 350.0))
    assert size == pytest.approx(inner)
    size = math.hypot(*inverter.terminal_voltage(round_legs, 1e4, -1e4, theta, 600.0))
    assert size == pytest.approx(160.0 * math.sqrt(2.0))


@pytest.mark.parametrize("speed", [-1100.0, -300.0, 0.0, 20.0, 400.0, 900.0, 1150.0])
def test_torque_requests_are_met_at_the_shaft(drive, speed):
    _, p = drive
    for request in (40.0, -40.0, 0.0):
        rows, _ = run(p, [(700, request, ACTIVE)], speed)
        assert rows[-1, OUT_REASON] == source.LIMIT_NONE
        assert rows[-1, OUT_TORQUE] == pytest.approx(request, abs=1e-3)


@pytest.mark.parametrize("speed", [-1000.0, 100.0, 700.0, 1100.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_requests_beyond_the_range_end_at_its_published_ends(drive, speed, sign):
    parameters, p = drive
    rows, states = run(p, [(900, sign * 1e3, ACTIVE)], speed)
    end = rows[-1, OUT_TORQUE_MAX] if sign > 0.0 else rows[-1, OUT_TORQUE_MIN]
    assert rows[-1, OUT_SETPOINT] == end
    assert rows[-1, OUT_TORQUE] == pytest.approx(end, rel=1e-3)
    assert rows[-1, OUT_REASON] in (source.LIMIT_PEAK, source.LIMIT_VOLTAGE)
    current = np.hypot(states[:, 0], states[:, 1])
    assert current.max() <= 1.02 * math.sqrt(2.0) * parameters.limits.current_rms


def test_torque_follows_its_slew_within_the_current_loop(drive):
    parameters, p = drive
    rows, _ = run(p, [(200, 100.0, ACTIVE)], 200.0)
    assert rows[:20, OUT_REASON][::2] == pytest.approx(source.LIMIT_SLEW)
    lag = np.abs(rows[:, OUT_TORQUE] - rows[:, OUT_SETPOINT])
    assert lag[10:].max() < parameters.slew_rate / CONTROL.bandwidth * 2.0
    assert rows[:, OUT_TORQUE].max() < 100.5


@pytest.mark.compiled
def test_speed_control_runs_an_inertia_up_inside_its_torque_bounds(em2):
    inertia = 0.5
    control = SpeedControlParameters(inertia, bandwidth=10.0, damping=1.0, setpoint_weight=0.5)
    p, x, work = control.pack(DT), np.zeros(speed_control.N_STATE), np.zeros(speed_control.N_OUT)
    x_drive, out = np.zeros(electric_drive.N_STATE), np.zeros(electric_drive.N_OUT)
    speed, speeds, bound = 0.0, [], 0
    for _ in range(60000):
        speed_control.speed_control_step(
            p, x, 1.0, 150.0, speed, out[OUT_TORQUE_MIN], min(out[OUT_TORQUE_MAX], 60.0),
            out[OUT_TORQUE], 0.0, work,
        )  # fmt: skip
        request = work[speed_control.OUT_REQUEST]
        bound += work[speed_control.OUT_AT_BOUND] == 1.0
        electric_drive.drive_step(em2, x_drive, request, ACTIVE, speed, 350.0, WARM, WARM, out)
        assert out[OUT_TORQUE] <= 60.5
        speed += DT * out[OUT_TORQUE] / inertia
        speeds.append(speed)
    assert bound > 1000
    assert speeds[-1] == pytest.approx(150.0, abs=0.1)
    assert max(speeds) < 152.0


def test_a_hot_winding_needs_more_power_for_less_torque(em2):
    cool, _ = run(em2, [(900, 150.0, ACTIVE)], 300.0)
    hot, _ = run(em2, [(900, 150.0, ACTIVE)], 300.0, winding=408.15)
    assert hot[-1, OUT_TORQUE] == pytest.approx(cool[-1, OUT_TORQUE], abs=1e-3)
    assert hot[-1, pmsm.OUT_COPPER] / cool[-1, pmsm.OUT_COPPER] == pytest.approx(1.413, abs=0.01)
    off, _ = run(em2, [(900, 150.0, ACTIVE)], 300.0, winding=500.0)
    assert off[-1, OUT_TORQUE] < 0.0  # nothing but drag
    assert off[-1, OUT_REASON] == source.LIMIT_TEMPERATURE


def test_efficiency_is_that_of_a_traction_drive(drive):
    _, p = drive
    rows, _ = run(p, [(900, 60.0, ACTIVE)], 500.0)
    efficiency = rows[-1, pmsm.OUT_SHAFT] / rows[-1, OUT_DC]
    assert 0.93 < efficiency < 0.97
    rows, _ = run(p, [(900, -60.0, ACTIVE)], 500.0)
    assert rows[-1, OUT_DC] < 0.0
    assert 0.92 < rows[-1, OUT_DC] / rows[-1, pmsm.OUT_SHAFT] < 0.97


def test_gates_from_active_over_blocked_to_short_and_back(em2):
    rows, states = run(
        em2,
        [(400, 80.0, ACTIVE), (200, 80.0, BLOCKED), (6000, 80.0, SHORT), (600, 80.0, ACTIVE)],
        700.0,
    )
    active, blocked, short, again = rows[399], rows[599], rows[6599], rows[-1]
    assert active[OUT_TORQUE] == pytest.approx(80.0, abs=1e-2)
    assert np.all(states[450:600, :2] == 0.0)
    assert blocked[OUT_REASON] == source.LIMIT_DISABLED
    assert blocked[OUT_TORQUE] == pytest.approx(-blocked[pmsm.OUT_IRON] / (DT * 700.0) - 0.2025)
    assert rows[400:600, OUT_DC].sum() < 0.0  # the inductances empty into the link
    w, machine = 2800.0, EM2.machine
    r = pmsm.phase_resistance(em2, WARM) + EM2.inverter.device_resistance
    below = r * r + w * w * machine.inductance_d * machine.inductance_q
    torque = -6.0 * machine.flux**2 * r * w * (r * r + (w * machine.inductance_q) ** 2) / below**2
    assert short[pmsm.OUT_AIR_GAP] == pytest.approx(torque, rel=1e-6)
    assert short[OUT_DC] == 0.0
    assert again[OUT_TORQUE] == pytest.approx(80.0, abs=1e-2)


def test_blocked_at_high_speed_charges_the_link_and_brakes(em2):
    rows, _ = run(em2, [(1000, 0.0, BLOCKED)], 1300.0)
    assert rows[-1, OUT_DC] < 0.0
    assert rows[-1, OUT_TORQUE] < -20.0
    assert rows[-1, freewheel.OUT_LINK] == -rows[-1, OUT_DC]
    rows, _ = run(em2, [(1000, 0.0, BLOCKED)], 1300.0, link=550.0)
    assert rows[-1, OUT_DC] == 0.0


def test_splitting_the_run_changes_no_bit(em2):
    whole, _ = run(em2, [(300, 90.0, ACTIVE)], 650.0)
    x = np.zeros(electric_drive.N_STATE)
    parts = [run(em2, [(count, 90.0, ACTIVE)], 650.0, x=x)[0] for count in (1, 7, 92, 200)]
    assert np.array_equal(np.concatenate(parts), whole)


def test_with_its_control_period_kept_the_drive_converges_with_fourth_order():
    def currents(dt):
        x, out = np.zeros(electric_drive.N_STATE), np.zeros(electric_drive.N_OUT)
        p = EM2.pack(dt)
        for _ in range(round(4e-3 / dt)):
            electric_drive.drive_step(p, x, 120.0, ACTIVE, 420.0, 350.0, WARM, WARM, out)
        return x[:2].copy()

    values = [currents(dt) for dt in (1e-4, 5e-5, 2.5e-5, 1.25e-5)]
    steps = [np.abs(b - a).max() for a, b in itertools.pairwise(values)]
    assert steps[0] < 0.1
    assert math.log2(steps[0] / steps[1]) == pytest.approx(4.0, abs=0.3)
    assert math.log2(steps[1] / steps[2]) == pytest.approx(4.0, abs=0.3)


def test_overmodulation_leaves_the_circle_while_currents_rise_and_ends_the_same():
    quick = replace(EM2, slew_rate=1e6)
    more = replace(quick, inverter=replace(EM2.inverter, overmodulation=1.0, voltage_rms=400.0))
    inner = 350.0 / math.sqrt(3.0)
    ends, largest = [], []
    for p in (quick.pack(DT), more.pack(DT)):
        rows, states = run(p, [(300, 0.0, ACTIVE), (900, 150.0, ACTIVE)], 640.0)
        voltage = states[:, electric_drive.X_CONTROL + current_control.X_VD :][:, :2]
        largest.append(np.hypot(voltage[:, 0], voltage[:, 1]).max())
        ends.append(rows[-1, OUT_TORQUE])
    assert largest[0] == pytest.approx(inner)
    assert 1.005 * inner < largest[1] < 2.0 / 3.0 * 350.0
    assert ends[1] == pytest.approx(ends[0], abs=0.05)


def test_nothing_requested_and_nan_are_the_same(em2):
    zero, _ = run(em2, [(50, 0.0, ACTIVE)], 300.0)
    missing, _ = run(em2, [(50, math.nan, ACTIVE)], 300.0)
    assert np.array_equal(zero, missing)


def test_a_control_period_that_is_no_multiple_of_the_step_is_refused():
    with pytest.raises(ValueError, match="not a multiple"):
        EM1.pack(3e-5)
    with pytest.raises(ValueError, match="not a multiple"):
        EM1.pack(1e-3)


@pytest.mark.parametrize(
    ("part", "change", "words"),
    [
        ("inverter", {"voltage_rms": -1.0}, "em1.inverter.voltage_rms"),
        ("control", {"bandwidth": 0.0}, "em1.control.bandwidth"),
        ("machine", {"flux": math.nan}, "em1.machine.flux"),
        ("limits", {"voltage_margin": 0.0}, "em1.limits.voltage_margin"),
        (None, {"slew_rate": 0.0}, "em1.slew_rate"),
    ],
)
def test_bad_drives_are_named(part, change, words):
    EM1.validate("em1")
    bad = replace(
        EM1, **(change if part is None else {part: replace(getattr(EM1, part), **change)})
    )
    with pytest.raises(InputError, match=words):
        bad.validate("em1")
