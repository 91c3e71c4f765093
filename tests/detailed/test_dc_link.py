"""The DC link: closed forms of charge and discharge, its balance, and the way through the contactors."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from drive_defaults import EM2, LINK
from hypothesis import given
from hypothesis import strategies as st

from hev_can_emu.errors import InputError
from hev_can_emu.plant import contactors, dc_link, electric_drive, pmsm
from hev_can_emu.plant.contactors import CLOSED, FAULT, OPEN, OPENING, PRECHARGE
from hev_can_emu.plant.dc_link import (
    OUT_CURRENT,
    OUT_DISCHARGE,
    OUT_LOAD,
    OUT_REFUSED,
    OUT_RESISTANCE,
    OUT_SOURCE,
    OUT_STORED,
    OUT_VOLTAGE,
)

DT = 5e-5
C = LINK.capacitance
SEQUENCE = contactors.ContactorParameters(
    precharge_resistance=30.0, discharge_resistance=300.0, link_capacitance=1.2e-3,
    precharge_share=0.95, precharge_timeout=0.5, opening_time=0.02,
)  # fmt: skip


def run(phase, voltage, count, energy=0.0, source=350.0, resistance=0.1, dt=DT):
    p, x, out = LINK.pack(dt), np.array([voltage]), np.zeros(dc_link.N_OUT)
    rows = []
    for _ in range(count):
        dc_link.link_step(p, x, float(phase), source, resistance, energy, out)
        rows.append(out.copy())
    return np.array(rows)


@pytest.mark.parametrize(
    ("phase", "source_conductance", "drain"),
    [
        (PRECHARGE, 1.0 / 30.1, 1.0 / 50e3),
        (CLOSED, 10.0, 1.0 / 50e3),
        (OPENING, 10.0, 1.0 / 50e3),
        (OPEN, 0.0, 1.0 / 50e3 + 1.0 / 300.0),
        (FAULT, 0.0, 1.0 / 50e3 + 1.0 / 300.0),
    ],
)
def test_unloaded_it_charges_and_discharges_exponentially(phase, source_conductance, drain):
    total = source_conductance + drain
    settled = 350.0 * source_conductance / total
    rows = run(phase, 200.0, 100)
    t = DT * np.arange(1, 101)
    expected = settled + (200.0 - settled) * np.exp(-t * total / C)
    assert rows[:, OUT_VOLTAGE] == pytest.approx(expected, rel=1.5e-5)


def test_voltage_converges_with_fourth_order():
    exact = 350.0 / (1.0 + 0.1 / 50e3)
    exact += (200.0 - exact) * math.exp(-1e-3 * (10.0 + 1.0 / 50e3) / C)
    errors = [
        abs(run(CLOSED, 200.0, round(1e-3 / dt), dt=dt)[-1, OUT_VOLTAGE] - exact)
        for dt in (1e-4, 5e-5, 2.5e-5)
    ]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.2)
    assert math.log2(errors[1] / errors[2]) == pytest.approx(4.0, abs=0.2)


def test_constant_power_settles_where_battery_and_load_agree():
    power = 60e3
    rows = run(CLOSED, 350.0, 400, energy=power * DT)
    settled = 0.5 * (350.0 + math.sqrt(350.0**2 - 4.0 * 0.1 * power))
    assert rows[-1, OUT_VOLTAGE] == pytest.approx(settled, rel=1e-4)
    assert rows[-1, OUT_CURRENT] == pytest.approx(power / settled, rel=1e-3)
    assert np.all(rows[:, OUT_REFUSED] == 0.0)


@given(
    st.sampled_from([OPEN, PRECHARGE, CLOSED, OPENING, FAULT]), st.floats(0.0, 450.0),
    st.floats(-20.0, 20.0), st.floats(0.02, 1.0), st.sampled_from([2.5e-5, 5e-5, 1e-4]),
)  # fmt: skip
def test_energy_of_every_step_closes(phase, voltage, energy, resistance, dt):
    row = run(phase, voltage, 1, energy=energy, resistance=resistance, dt=dt)[0]
    before = 0.5 * C * voltage**2
    spent = row[OUT_LOAD] + row[OUT_RESISTANCE] + row[OUT_DISCHARGE] + row[OUT_STORED] - before
    scale = np.abs(row[:OUT_CURRENT]).sum() + before
    assert abs(row[OUT_SOURCE] - spent) <= 1e-11 * scale
    assert row[OUT_LOAD] + row[OUT_REFUSED] == pytest.approx(energy, rel=1e-9, abs=1e-9)


def test_an_empty_link_refuses_and_says_so():
    rows = run(OPEN, 60.0, 40, energy=0.5)
    assert rows[:, OUT_REFUSED].max() > 0.1
    assert rows[:, OUT_LOAD].sum() <= 0.5 * C * 60.0**2
    assert np.isfinite(rows).all()
    charged = run(OPEN, 0.0, 3, energy=-0.1)
    assert np.all(charged[:, OUT_REFUSED] == 0.0)
    assert charged[-1, OUT_STORED] == pytest.approx(0.3, rel=0.01)


def test_precharge_closes_the_contactors_and_opening_empties_the_link():
    p, x, out = LINK.pack(DT), np.zeros(1), np.zeros(dc_link.N_OUT)
    sequence, state = SEQUENCE.pack(DT), np.zeros(contactors.N_STATE)
    history = []

    def step(close):
        state[contactors.X_LINK_VOLTAGE] = x[0]
        contactors.contactor_step(sequence, state, close, 350.0, 0.0)
        dc_link.link_step(p, x, state[contactors.X_PHASE], 350.0, 0.1, 0.0, out)
        history.append((state[contactors.X_PHASE], x[0], out[OUT_CURRENT]))

    for _ in range(3000):
        step(1.0)
    phases = [row[0] for row in history]
    closed_at = phases.index(CLOSED)
    total = 1.0 / 30.1 + 1.0 / 50e3
    settled = 350.0 / 30.1 / total
    time = -C / total * math.log(1.0 - 0.95 * 350.0 / settled)
    assert closed_at * DT == pytest.approx(time, abs=3 * DT)
    assert max(row[2] for row in history[:closed_at]) <= 350.0 / 30.1
    # What is missing when the contacts close flows at once, limited by the battery's resistance.
    assert history[closed_at][2] == pytest.approx(0.05 * 350.0 / 0.1, rel=0.3)
    assert history[-1][1] == pytest.approx(350.0, rel=1e-5)
    for _ in range(40000):
        step(0.0)
    assert history[-1][0] == OPEN
    opened = 0.02
    left = 350.0 * math.exp(-(40000 * DT - opened) * (1.0 / 300.0 + 1.0 / 50e3) / C)
    assert history[-1][1] == pytest.approx(left, rel=1e-2)


def test_drive_and_link_close_their_balance_together():
    p_drive, p = EM2.pack(DT), LINK.pack(DT)
    x_drive, x = np.zeros(electric_drive.N_STATE), np.array([350.0])
    drive, link = np.zeros(electric_drive.N_OUT), np.zeros(dc_link.N_OUT)
    sums = np.zeros(2)
    spent_by = [pmsm.OUT_SHAFT, pmsm.OUT_COPPER, pmsm.OUT_IRON, pmsm.OUT_DRAG]
    spent_by.append(electric_drive.OUT_INVERTER)
    moved = 0.0
    for k in range(2000):
        request = 150.0 if k % 800 < 400 else -120.0
        electric_drive.drive_step(
            p_drive, x_drive, request, electric_drive.ACTIVE, 500.0, x[0], 300.0, 300.0, drive
        )
        dc_link.link_step(p, x, float(CLOSED), 350.0, 0.1, drive[electric_drive.OUT_DC], link)
        lost = drive[spent_by].sum() + link[OUT_RESISTANCE] + link[OUT_DISCHARGE]
        sums += link[OUT_SOURCE], lost
        moved += abs(link[OUT_SOURCE])
    stored = drive[pmsm.OUT_MAGNETIC] + link[OUT_STORED] - 0.5 * C * 350.0**2
    assert abs(sums[0] - sums[1] - stored) < 1e-9 * moved
    assert 300.0 < x[0] < 400.0


@pytest.mark.parametrize("name", LINK.__struct_fields__)
def test_bad_links_are_named(name):
    LINK.validate("link")
    with pytest.raises(InputError, match=f"link.{name}"):
        msgspec.structs.replace(LINK, **{name: 0.0}).validate("link")
