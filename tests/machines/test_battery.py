from __future__ import annotations

import math

import machine_defaults as defaults
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hev_can_emu.errors import InputError
from hev_can_emu.plant import battery, contactors, motor
from hev_can_emu.plant import power_allocation as allocation
from hev_can_emu.plant import torque_source as source

P = defaults.BATTERY.pack()
EM1 = defaults.EM1.pack()
EM2 = defaults.EM2.pack()


def limits(soc, temperature=298.15, p=P):
    out = np.zeros(battery.N_LIM)
    battery.battery_limits(p, np.array([soc, temperature]), out)
    return out


def step(power, x, connected=1.0, coolant=298.15, p=P):
    lim, out = np.zeros(battery.N_LIM), np.zeros(battery.N_OUT)
    battery.battery_limits(p, x, lim)
    battery.battery_step(p, x, power, connected, coolant, lim, out)
    return out


@pytest.mark.parametrize("power", [-70e3, -1.0, 0.0, 1.0, 30e3, 110e3, 300e3])
def test_current_solves_the_terminal_equation(power):
    current = battery.discharge_current(350.0, 0.1, power)
    assert (350.0 - 0.1 * current) * current == pytest.approx(power, rel=1e-12)
    assert current <= 350.0 / 0.2  # the root on the stable side


def test_current_stops_at_the_most_that_can_be_transferred():
    assert battery.discharge_current(350.0, 0.1, 350.0**2 / 0.4) == pytest.approx(1750.0)
    assert battery.discharge_current(350.0, 0.1, 1e9) == pytest.approx(1750.0)


def test_tables_are_bilinear():
    assert limits(0.5)[battery.LIM_OCV] == pytest.approx(350.0)
    assert limits(0.6)[battery.LIM_OCV] == pytest.approx(355.5)
    assert limits(0.2, 285.65)[battery.LIM_RESISTANCE] == pytest.approx(
        (0.22 + 0.12 + 0.19 + 0.10) / 4.0
    )
    assert limits(0.5, 200.0)[battery.LIM_RESISTANCE] == pytest.approx(0.30)


def test_limits_come_from_the_map_or_from_the_voltage():
    out = limits(0.5)
    assert out[: battery.LIM_REASON_DISCHARGE] == pytest.approx([120e3, 70e3])
    assert out[battery.LIM_REASON_DISCHARGE] == source.LIMIT_BATTERY_POWER
    narrow = msgspec.structs.replace(defaults.BATTERY, voltage_min=340.0, voltage_max=352.0).pack()
    out = limits(0.5, p=narrow)
    assert out[battery.LIM_DISCHARGE] == pytest.approx(100.0 * 340.0)
    assert out[battery.LIM_CHARGE] == pytest.approx(20.0 * 352.0)
    assert out[battery.LIM_REASON_CHARGE] == source.LIMIT_VOLTAGE
    # At its limits the terminals stand exactly at the voltage that makes the limit.
    for power, voltage in ((34e3, 340.0), (-7040.0, 352.0)):
        assert step(power, np.array([0.5, 298.15]), p=narrow)[battery.OUT_VOLTAGE] == pytest.approx(
            voltage
        )


def test_empty_gives_nothing_and_full_takes_nothing():
    assert limits(0.0)[battery.LIM_DISCHARGE] == 0.0
    assert limits(1.0)[battery.LIM_CHARGE] == 0.0


def test_signs_and_the_granted_power():
    out = step(20e3, np.array([0.5, 298.15]))
    assert out[battery.OUT_CURRENT] < 0.0
    assert out[battery.OUT_VOLTAGE] < 350.0
    assert -out[battery.OUT_CURRENT] * out[battery.OUT_VOLTAGE] == pytest.approx(20e3)
    out = step(-20e3, np.array([0.5, 298.15]))
    assert out[battery.OUT_CURRENT] > 0.0
    assert out[battery.OUT_VOLTAGE] > 350.0
    assert out[battery.OUT_REFUSED] == 0.0


def test_excess_is_refused_and_told():
    out = step(150e3, np.array([0.5, 298.15]))
    assert out[battery.OUT_POWER] == pytest.approx(120e3)
    assert out[battery.OUT_REFUSED] == pytest.approx(30e3)
    assert out[battery.OUT_REASON] == source.LIMIT_BATTERY_POWER
    out = step(-90e3, np.array([0.5, 298.15]))
    assert out[battery.OUT_REFUSED] == pytest.approx(-20e3)
    x = np.array([0.5, 298.15])
    out = step(1e3, x, connected=0.0)
    assert out[battery.OUT_CURRENT] == 0.0
    assert out[battery.OUT_VOLTAGE] == pytest.approx(350.0)
    assert x[battery.X_SOC] == 0.5


def test_state_of_charge_is_the_integral_of_the_terminal_current():
    x = np.array([0.6, 298.15])
    charge = 0.0
    for k in range(2000):
        charge += step(60e3 * math.sin(0.01 * k) + 10e3, x)[battery.OUT_CURRENT] * 1e-3
    assert x[battery.X_SOC] - 0.6 == pytest.approx(charge / defaults.BATTERY.capacity, rel=1e-9)
    assert x[battery.X_SOC] < 0.6


def test_cells_warm_up_as_a_first_order_node():
    quick = msgspec.structs.replace(defaults.BATTERY, heat_capacity=50.0, capacity=1e12).pack()
    x = np.array([0.5, 298.15])
    heat = step(50e3, x, p=quick)[battery.OUT_HEAT]
    assert x[battery.X_TEMPERATURE] - 298.15 == pytest.approx(
        0.02 * heat * (1.0 - math.exp(-1e-3 / (50.0 * 0.02)))
    )


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"capacity": 0.0}, r"battery\.capacity: expected a number greater than 0"),
        (
            {"soc": (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 1.0)},
            r"battery\.soc: expected an axis from 0 to 1",
        ),
        ({"open_circuit_voltage": (300.0,)}, r"battery\.open_circuit_voltage: expected 7 values"),
        ({"resistance": ((0.1,) * 5,) * 6}, r"battery\.resistance: expected 7 rows"),
        ({"resistance": ((0.0,) * 5,) * 7}, r"battery\.resistance\[0\]\[0\]"),
        ({"voltage_min": 420.0, "voltage_max": 430.0}, r"battery\.voltage_min, voltage_max"),
    ],
)
def test_bad_battery_is_named(change, where):
    with pytest.raises(InputError, match=where):
        msgspec.structs.replace(defaults.BATTERY, **change).validate("battery")


# Allocation


def loads(torque1, torque2, speed1, speed2, auxiliary):
    return (
        auxiliary
        + torque1 * speed1
        + motor.motor_loss(EM1, torque1, speed1)
        + torque2 * speed2
        + motor.motor_loss(EM2, torque2, speed2)
    )


def allocate(torque1, torque2, speed1, speed2, discharge, charge, auxiliary=500.0, active=1.0):
    out = np.zeros(allocation.N_OUT)
    allocation.allocate(
        *(EM1, EM2, torque1, torque2, speed1, speed2, active, active),
        *(auxiliary, discharge, charge, out),
    )
    return out


def test_within_the_limits_nothing_is_cut():
    out = allocate(50.0, 100.0, 300.0, 300.0, 120e3, 70e3)
    assert out[:4] == pytest.approx([50.0, 100.0, 0.0, 0.0])
    assert out[allocation.OUT_POWER] == pytest.approx(loads(50.0, 100.0, 300.0, 300.0, 500.0))


@pytest.mark.parametrize("limit", [5e3, 20e3, 60e3])
def test_two_drivers_share_the_cut_exactly(limit):
    out = allocate(100.0, 200.0, 400.0, 400.0, limit, 70e3)
    t1, t2 = out[:2]
    assert loads(t1, t2, 400.0, 400.0, 500.0) == pytest.approx(limit, abs=1e-6)
    assert t1 / 100.0 == pytest.approx(t2 / 200.0)


@pytest.mark.parametrize("limit", [1e3, 20e3, 40e3])
def test_two_generators_share_the_cut_exactly(limit):
    out = allocate(-100.0, 200.0, 400.0, -400.0, 70e3, limit)
    assert loads(out[0], out[1], 400.0, -400.0, 500.0) == pytest.approx(-limit, abs=1e-6)
    assert out[0] < 0.0 < out[1]
    assert np.all(out[2:4] == 1.0)


def test_in_series_only_the_motor_that_exceeds_is_cut():
    out = allocate(-60.0, 220.0, 400.0, 450.0, 50e3, 70e3)
    assert out[0] == -60.0
    assert out[1] < 220.0
    assert np.array_equal(out[2:4], [0.0, 1.0])
    assert loads(out[0], out[1], 400.0, 450.0, 500.0) == pytest.approx(50e3, abs=1e-6)
    out = allocate(-120.0, 20.0, 500.0, 300.0, 50e3, 10e3)
    assert out[1] == 20.0
    assert loads(out[0], out[1], 500.0, 300.0, 500.0) == pytest.approx(-10e3, abs=1e-6)


def test_a_limit_below_the_idle_losses_leaves_no_torque_and_tells_the_shortfall():
    out = allocate(100.0, 100.0, 300.0, 300.0, 100.0, 0.0)
    assert np.all(out[:2] == 0.0)
    assert out[allocation.OUT_SHORTFALL] == pytest.approx(loads(0, 0, 300.0, 300.0, 500.0) - 100.0)
    assert allocate(0.0, 0.0, 300.0, 300.0, 0.0, 0.0, 0.0, 0.0)[allocation.OUT_POWER] == 0.0


torques = st.floats(-200.0, 200.0)
speeds = st.floats(-1000.0, 1000.0)
powers = st.floats(0.0, 1e5)


@given(torques, torques, speeds, speeds, powers, powers, powers)
def test_allocation_respects_the_limits_and_is_monotone(t1, t2, w1, w2, low, high, charge):
    low, high = sorted((low, high))
    tight = allocate(t1, t2, w1, w2, low, charge)
    wide = allocate(t1, t2, w1, w2, high, charge)
    for out, limit in ((tight, low), (wide, high)):
        power = loads(out[0], out[1], w1, w2, 500.0)
        assert out[allocation.OUT_POWER] == pytest.approx(power, abs=1e-6)
        assert -charge - 1e-5 <= power <= limit + out[allocation.OUT_SHORTFALL] + 1e-5
        for granted, wanted in ((out[0], t1), (out[1], t2)):
            assert abs(granted) <= abs(wanted)
            assert granted * wanted >= 0.0
    assert abs(tight[0]) <= abs(wide[0]) + 1e-9
    assert abs(tight[1]) <= abs(wide[1]) + 1e-9


@given(speeds, st.floats(-5e4, 5e4))
def test_published_range_stays_within_the_battery(speed, other):
    limit = np.array([-130.0, 130.0])
    allocation.power_torque_range(EM1, speed, other, 60e3, 40e3, limit)
    assert -130.0 <= limit[0] <= 0.0 <= limit[1] <= 130.0
    idle = motor.idle_loss(EM1, speed)
    for torque in np.linspace(limit[0], limit[1], 9):
        power = torque * speed + motor.motor_loss(EM1, torque, speed) + other
        assert power <= max(60e3, other + idle) + 1e-4
        assert power >= min(-40e3, other + idle) - 1e-4


# Contactors

C = defaults.CONTACTORS


def close_for(ticks, x, request=1.0, leak=0.0):
    p = C.pack()
    phases = []
    for _ in range(ticks):
        contactors.contactor_step(p, x, request, 350.0, leak)
        phases.append(int(x[contactors.X_PHASE]))
    return phases


def test_precharge_is_exponential_then_closes():
    x = np.zeros(contactors.N_STATE)
    close_for(20, x)
    tau = C.precharge_resistance * C.link_capacitance
    assert x[contactors.X_LINK_VOLTAGE] == pytest.approx(350.0 * (1.0 - math.exp(-0.02 / tau)))
    phases = close_for(200, x)
    closed = 20 + phases.index(contactors.CLOSED)
    assert closed == math.ceil(-math.log(1.0 - C.precharge_share) * tau / 1e-3)
    assert x[contactors.X_LINK_VOLTAGE] == 350.0


def test_opening_takes_its_time_then_the_link_discharges():
    x = np.zeros(contactors.N_STATE)
    close_for(200, x)
    phases = close_for(100, x, request=0.0)
    assert phases.count(contactors.OPENING) == 50
    assert phases[50] == contactors.OPEN
    tau = C.discharge_resistance * C.link_capacitance
    assert x[contactors.X_LINK_VOLTAGE] == pytest.approx(350.0 * math.exp(-0.05 / tau))
    close_for(200, x)
    close_for(20, x, request=0.0)
    assert close_for(1, x) == [contactors.CLOSED]


def test_a_leak_makes_precharge_time_out_until_the_request_is_withdrawn():
    x = np.zeros(contactors.N_STATE)
    phases = close_for(600, x, leak=0.01)
    assert contactors.CLOSED not in phases
    assert phases[499] == contactors.PRECHARGE
    assert phases[-1] == contactors.FAULT
    assert close_for(1, x, request=0.0) == [contactors.OPEN]


def test_bad_contactors_are_named():
    with pytest.raises(InputError, match=r"hv\.precharge_share: expected a number from 0 to 1"):
        msgspec.structs.replace(C, precharge_share=1.5).validate("hv")


# Motors and battery together


def drive(ticks, requests, speeds, discharge=math.inf, charge=math.inf):
    """Two motors on a battery; return the last outputs and the energies in J."""
    x1, x2 = np.zeros(motor.N_STATE), np.zeros(motor.N_STATE)
    out1, out2 = np.zeros(motor.N_OUT), np.zeros(motor.N_OUT)
    cells, lim, supply = np.array([0.5, 298.15]), np.zeros(battery.N_LIM), np.zeros(battery.N_OUT)
    energy = dict.fromkeys(("chemical", "shaft", "losses", "auxiliary"), 0.0)
    for k in range(ticks):
        t1, t2 = requests(k)
        w1, w2 = speeds(k)
        battery.battery_limits(P, cells, lim)
        lim[battery.LIM_DISCHARGE] = min(lim[battery.LIM_DISCHARGE], discharge)
        lim[battery.LIM_CHARGE] = min(lim[battery.LIM_CHARGE], charge)
        motor.motor_step(EM1, x1, t1, 1.0, w1, 350.0, 310.0, 310.0, out1)
        motor.motor_step(EM2, x2, t2, 1.0, w2, 350.0, 310.0, 310.0, out2)
        out = allocate(out1[0], out2[0], w1, w2, lim[0], lim[1])
        reason = lim[battery.LIM_REASON_DISCHARGE]
        if out[allocation.OUT_CUT1]:
            motor.motor_grant(EM1, x1, out[0], w1, 1.0, reason, out1)
        if out[allocation.OUT_CUT2]:
            motor.motor_grant(EM2, x2, out[1], w2, 1.0, reason, out2)
        load = out1[motor.OUT_DC_POWER] + out2[motor.OUT_DC_POWER] + 500.0
        battery.battery_step(P, cells, load, 1.0, 310.0, lim, supply)
        assert supply[battery.OUT_REFUSED] == 0.0
        energy["chemical"] -= 1e-3 * lim[battery.LIM_OCV] * supply[battery.OUT_CURRENT]
        energy["shaft"] += 1e-3 * (out1[0] * w1 + out2[0] * w2)
        energy["losses"] += 1e-3 * (
            out1[motor.OUT_LOSS] + out2[motor.OUT_LOSS] + supply[battery.OUT_HEAT]
        )
        energy["auxiliary"] += 0.5
    return out1, out2, supply, energy


def test_energy_is_accounted_for_from_chemistry_to_shaft():
    *_, energy = drive(
        1500,
        lambda k: (-60.0 * math.sin(0.003 * k), 200.0 * math.cos(0.002 * k)),
        lambda k: (400.0 + 0.05 * k, 0.15 * k),
    )
    assert abs(energy["shaft"]) > 1e3
    assert energy["chemical"] == pytest.approx(
        energy["shaft"] + energy["losses"] + energy["auxiliary"], rel=1e-10
    )


def test_a_granted_torque_is_told_with_its_setpoint_and_reason():
    out1, out2, supply, _ = drive(
        100, lambda _: (-40.0, 200.0), lambda _: (400.0, 400.0), discharge=20e3
    )
    assert supply[battery.OUT_POWER] == pytest.approx(20e3, abs=1e-6)
    assert out1[source.OUT_TORQUE] == pytest.approx(-40.0)
    assert out1[source.OUT_REASON] == source.LIMIT_NONE
    assert out2[source.OUT_SETPOINT] == out2[source.OUT_TORQUE] < 150.0
    assert out2[source.OUT_REASON] == source.LIMIT_BATTERY_POWER
