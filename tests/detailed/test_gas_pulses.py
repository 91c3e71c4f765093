"""Firing ripple: orders, mean, and the cycle behind it."""

from __future__ import annotations

import math

import engine_defaults as defaults
import msgspec
import numpy as np
import pytest

from hev_can_emu.errors import InputError
from hev_can_emu.plant import gas_pulses
from hev_can_emu.plant.gas_pulses import ripple

P = defaults.PULSES.pack(defaults.CRANK)
FULL = (1.0, 101325.0, 160.0)  # sealed, intake pressure, combustion torque


def at(angle, sealed=1.0, pressure=101325.0, torque=160.0, travel=0.0):
    return ripple(P, 0, angle, travel, sealed, pressure, torque)


def test_two_firings_per_turn_and_even_orders_only():
    grid = 2.0 * math.pi * np.arange(64) / 64
    spectrum = 2.0 * np.abs(np.fft.rfft([at(a) for a in grid])) / 64
    assert spectrum[1::2].max() < 1e-3
    assert spectrum[0] < 1e-3
    assert np.argmax(spectrum) == 2
    # The largest order of a four-cylinder at full load is some one to two times the mean torque.
    assert 160.0 < spectrum[2] < 330.0
    assert spectrum[2] > spectrum[4] > spectrum[6] > 0.0
    assert spectrum[18:].max() < 1e-3


@pytest.mark.parametrize("steps", [7, 64, 209])
@pytest.mark.parametrize("start", [0.0, 1.234])
def test_work_of_half_a_turn_is_zero_however_it_is_stepped(steps, start):
    parts = np.random.default_rng(steps).uniform(0.5, 1.5, steps)
    parts *= math.pi / parts.sum()
    angle, work, size = start, 0.0, 0.0
    for part in parts:
        torque = at(angle, travel=part)
        work += torque * part
        size += abs(torque) * part
        angle += part
    assert abs(work) < 1e-12 * size


def test_a_step_holds_the_mean_over_its_travel():
    fine = np.mean([at(0.3 + (i + 0.5) * 0.2 / 2000) for i in range(2000)])
    assert at(0.3, travel=0.2) == pytest.approx(fine, rel=1e-6)
    assert at(0.5, travel=-0.2) == pytest.approx(fine, rel=1e-6)
    assert at(0.3, travel=1e-9) == pytest.approx(at(0.3), rel=1e-9)


def test_compression_alone_is_a_spring():
    """Unfuelled, the gas brakes before a dead centre as much as it drives after it."""
    for angle in (0.2, 0.5, 1.0, 1.4):
        before, after = at(-angle, torque=0.0), at(angle, torque=0.0)
        assert before == pytest.approx(-after, abs=0.05)
    assert at(0.3, torque=0.0) > 20.0
    assert at(0.3, torque=0.0, sealed=0.5) == pytest.approx(0.5 * at(0.3, torque=0.0))
    assert at(0.3, torque=0.0, pressure=30e3) < 0.5 * at(0.3, torque=0.0)


def test_pressure_part_against_a_cycle_worked_out_here():
    """Four cylinders with the polytropic law written down anew; only orders up to 16 are kept."""
    d, r, k = defaults.PULSES, defaults.CRANK.radius, defaults.CRANK.ratio
    n = 512
    grid = 2.0 * math.pi * np.arange(n) / n
    total = np.zeros(n)
    area = math.pi / 4.0 * d.bore**2
    for shift in (0.0, math.pi, 2.0 * math.pi, 3.0 * math.pi):
        a = np.mod(grid + shift, 4.0 * math.pi)
        x = r * (1.0 - np.cos(a)) + r / k * (1.0 - np.sqrt(1.0 - (k * np.sin(a)) ** 2))
        lever = np.gradient(np.concatenate([x[-1:], x, x[:1]]), grid[1])[1:-1]
        v = (2.0 * r / (d.compression_ratio - 1.0) + x) * area
        squeezed = 50e3 * (v.max() / v) ** d.exponent
        pressure = np.where(a < math.pi, squeezed, 101325.0)
        pressure = np.where(a >= 2.0 * math.pi, 50e3, pressure)
        pressure = np.where(a >= 3.0 * math.pi, squeezed, pressure)
        total += (pressure - 101325.0) * area * lever
    spectrum = np.fft.rfft(total)
    spectrum[0] = 0.0
    spectrum[17:] = 0.0
    expected = np.fft.irfft(spectrum, n)
    own = np.array([at(a, pressure=50e3, torque=0.0) for a in grid])
    assert own == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"bore": 0.0}, r"pulses\.bore"),
        ({"compression_ratio": 1.0}, r"pulses\.compression_ratio: expected more than 1"),
        ({"exponent": 2.0}, r"pulses\.exponent"),
        ({"burn_start": 3.0}, r"pulses\.burn_start"),
    ],
)
def test_bad_pulses_are_named(change, where):
    with pytest.raises(InputError, match=where):
        msgspec.structs.replace(defaults.PULSES, **change).validate("pulses")


def test_shape():
    assert P.shape == (gas_pulses.N_PARAMETERS,)
