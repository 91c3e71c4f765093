"""Reference currents: the closed forms' known answers, and table and kernel against the closed forms."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from drive_defaults import BOOK, BOOK_CURRENT, BOOK_VOLTAGE, EM1, EM2
from scipy.optimize import minimize_scalar

from hev_can_emu.errors import InputError
from hev_can_emu.plant import operating_points as points
from hev_can_emu.plant import torque_map
from hev_can_emu.plant import torque_source as source

replace = msgspec.structs.replace
IDEAL = replace(BOOK, resistance=0.0)
WEAK = replace(BOOK, flux=0.05, resistance=0.0)
ROUND = replace(BOOK, inductance_q=BOOK.inductance_d)
COLD = 300.0


def test_most_torque_per_ampere_of_the_book_machine():
    point = points.most_torque_per_ampere(BOOK, BOOK_CURRENT)
    assert point.i_d == pytest.approx(-305.309, abs=5e-4)
    assert point.i_q == pytest.approx(476.221, abs=5e-4)
    assert point.torque == pytest.approx(339.5916, abs=5e-5)


def test_corner_speed_of_the_book_machine():
    assert points.corner_speed(IDEAL, BOOK_CURRENT, BOOK_VOLTAGE) == pytest.approx(
        2057.75, abs=5e-3
    )
    corner = points.corner_speed(BOOK, BOOK_CURRENT, BOOK_VOLTAGE)
    assert corner == pytest.approx(2033.66, abs=5e-3)
    point = points.most_torque_per_ampere(BOOK, BOOK_CURRENT)
    assert points.terminal_voltage(BOOK, point, corner) == pytest.approx(BOOK_VOLTAGE, rel=1e-12)


def test_most_torque_per_volt_of_the_book_machine():
    entry = points.voltage_limit_entry(WEAK, BOOK_CURRENT, BOOK_VOLTAGE)
    assert entry == pytest.approx(6556.9, abs=0.05)
    point = points.most_torque(WEAK, BOOK_CURRENT, BOOK_VOLTAGE / entry)
    assert point.i_d == pytest.approx(-547.17, abs=5e-3)
    assert point.i_q == pytest.approx(143.55, abs=5e-3)
    assert point.torque == pytest.approx(118.468, abs=5e-4)
    # Faster, less current gives more torque; with more magnet flux there is no such speed.
    beyond = points.most_torque(WEAK, BOOK_CURRENT, BOOK_VOLTAGE / (1.5 * entry))
    assert math.hypot(beyond.i_d, beyond.i_q) < 0.99 * BOOK_CURRENT
    assert points.voltage_limit_entry(BOOK, BOOK_CURRENT, BOOK_VOLTAGE) == math.inf


@pytest.mark.parametrize("machine", [BOOK, WEAK, ROUND, EM1.machine, EM2.machine])
@pytest.mark.parametrize("flux", [0.02, 0.04, 0.07, 0.2])
def test_no_point_inside_both_limits_gives_more_torque(machine, flux):
    current = 500.0
    best = points.most_torque(machine, current, flux)

    def torque(i_d):
        """Greatest torque at one i_d, by the tighter of the limits on i_q."""
        along = machine.flux + machine.inductance_d * i_d
        by_flux = math.sqrt(max(flux**2 - along**2, 0.0)) / machine.inductance_q
        by_current = math.sqrt(max(current**2 - i_d**2, 0.0))
        return points.operating_point(machine, i_d, min(by_flux, by_current)).torque

    grid = np.linspace(-current, 0.0, 2001)
    start = int(np.argmax([torque(i_d) for i_d in grid]))
    bounds = grid[max(start - 1, 0)], grid[min(start + 1, 2000)]
    found = minimize_scalar(
        lambda i_d: -torque(i_d), bounds=bounds, method="bounded", options={"xatol": 1e-9}
    )
    assert best.torque == pytest.approx(max(-found.fun, torque(grid[start])), rel=1e-6, abs=1e-6)


def test_weakened_point_has_torque_and_flux():
    i_d = float(points.weakened(BOOK, np.array(150.0), np.array(0.05)))
    i_q = 150.0 / (6.0 * (BOOK.flux - 1.6e-4 * i_d))
    point = points.operating_point(BOOK, i_d, i_q)
    assert point.torque == pytest.approx(150.0, rel=1e-9)
    assert points.flux_linkage(BOOK, point) == pytest.approx(0.05, rel=1e-9)


def limits_at(drive, packed, speed, link=350.0, winding=COLD, inverter=COLD):
    out = np.zeros(torque_map.N_LIM)
    voltage = min(math.sqrt(2.0) * drive.inverter.voltage_rms, link / math.sqrt(3.0))
    torque_map.torque_limits(packed, speed, voltage, link, winding, inverter, out)
    return out, voltage


@pytest.fixture(scope="module", params=[EM1, EM2], ids=["em1", "em2"])
def packed(request):
    return request.param, request.param.limits.pack(request.param.machine)


@pytest.mark.parametrize("link", [260.0, 350.0, 400.0])
@pytest.mark.parametrize("speed", [0.0, 300.0, 450.0, 700.0, 1000.0, 1200.0])
def test_published_limits_are_the_solvers(packed, speed, link):
    drive, p = packed
    out, voltage = limits_at(drive, p, speed, link)
    current = math.sqrt(2.0) * drive.limits.current_rms
    for sign, limit in (
        (1.0, out[torque_map.LIM_TORQUE_MAX]),
        (-1.0, out[torque_map.LIM_TORQUE_MIN]),
    ):
        true = points.most_torque_at(
            drive.machine, current, 0.95 * voltage, 4.0 * max(speed, 1.0), sign
        )
        assert limit == pytest.approx(true.torque, rel=2e-3)
        mirrored, _ = limits_at(drive, p, -speed, link)
        assert mirrored[torque_map.LIM_TORQUE_MIN] == -out[torque_map.LIM_TORQUE_MAX]


@pytest.mark.parametrize("link", [260.0, 400.0])
@pytest.mark.parametrize("speed", [-1100.0, 0.0, 350.0, 500.0, 800.0, 1200.0])
def test_references_keep_torque_current_and_voltage(packed, speed, link):
    drive, p = packed
    out, voltage = limits_at(drive, p, speed, link)
    for torque in np.linspace(out[torque_map.LIM_TORQUE_MIN], out[torque_map.LIM_TORQUE_MAX], 41):
        i_d, i_q = torque_map.reference_currents(p, torque, speed, voltage)
        point = points.operating_point(drive.machine, i_d, i_q)
        assert point.torque == pytest.approx(torque, rel=1e-12, abs=1e-12)
        assert math.hypot(i_d, i_q) <= math.sqrt(2.0) * drive.limits.current_rms * 1.003
        used = points.terminal_voltage(drive.machine, point, 4.0 * speed)
        assert used <= 0.95 * voltage * 1.005
        # Where the voltage does not bind, least current for the torque.
        best = torque_map.reference_currents(p, torque, 0.0, voltage)
        if i_d < best[0]:
            assert used >= 0.95 * voltage * 0.99
        else:
            assert (i_d, i_q) == best


def test_references_at_low_speed_are_those_of_least_current(packed):
    drive, p = packed
    for current in (10.0, 100.0, 250.0):
        best = points.most_torque_per_ampere(drive.machine, current)
        i_d, i_q = torque_map.reference_currents(p, best.torque, 10.0, 200.0)
        assert math.hypot(i_d, i_q) == pytest.approx(current, rel=1e-5)


def test_every_limit_has_its_reason(packed):
    drive, p = packed
    top, low = torque_map.LIM_REASON_MAX, torque_map.LIM_REASON_MIN
    assert limits_at(drive, p, 100.0)[0][top] == source.LIMIT_PEAK
    assert limits_at(drive, p, 900.0)[0][top] == source.LIMIT_VOLTAGE
    half = 0.5 * (drive.limits.voltage_min + drive.limits.voltage_full)
    out, _ = limits_at(drive, p, 100.0, link=half)
    assert out[top] == source.LIMIT_VOLTAGE
    assert out[torque_map.LIM_TORQUE_MAX] == pytest.approx(0.5 * p[torque_map.P_PEAK_TORQUE])
    out, _ = limits_at(drive, p, 100.0, winding=423.15)
    assert out[top] == out[low] == source.LIMIT_TEMPERATURE
    assert out[torque_map.LIM_TORQUE_MAX] == pytest.approx(0.5 * p[torque_map.P_PEAK_TORQUE])
    assert limits_at(drive, p, 100.0, inverter=400.0)[0][torque_map.LIM_TORQUE_MAX] == 0.0
    speed = 0.5 * (drive.limits.fade_speed + drive.limits.max_speed)
    out, _ = limits_at(drive, p, speed)
    assert out[top] == source.LIMIT_SPEED
    assert out[low] == source.LIMIT_VOLTAGE
    assert out[torque_map.LIM_TORQUE_MAX] < 0.6 * -out[torque_map.LIM_TORQUE_MIN]


def test_no_voltage_gives_no_torque_and_finite_currents(packed):
    drive, p = packed
    out, voltage = limits_at(drive, p, 500.0, link=0.0)
    assert list(out[:2]) == [0.0, 0.0]
    i_d, i_q = torque_map.reference_currents(p, 0.0, 500.0, voltage)
    assert i_q == 0.0
    assert -math.sqrt(2.0) * drive.limits.current_rms <= i_d <= 0.0


def test_a_machine_whose_field_cannot_be_weakened_enough_ends():
    limits = replace(EM1.limits, current_rms=100.0)
    p = limits.pack(EM1.machine)
    assert torque_map.greatest_torque(p, 1.0 / 0.03) == 0.0
    assert torque_map.greatest_torque(p, 1.0 / 0.06) > 0.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"voltage_margin": 1.2}, "voltage_margin: expected a number from 0 to 1"),
        ({"voltage_full": 100.0}, "voltage_full: expected more than voltage_min"),
        ({"current_rms": 0.0}, "current_rms: expected a number greater than 0"),
        ({"max_speed": 10.0}, "max_speed: expected more than fade_speed"),
    ],
)
def test_bad_limits_are_named(change, words):
    with pytest.raises(InputError, match=words):
        replace(EM1.limits, **change).validate("em1.limits")
