"""The traction battery: voltage over current, limits over state of charge, precharge."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.plant import battery, contactors
from hev_can_emu.report.component_plot import Curve, Fact, Panel

WARM, COLD = 298.15, 263.15
SOC = 0.6


def limits_at(p: np.ndarray, soc: float, temperature: float) -> np.ndarray:
    """Return what :func:`battery.battery_limits` writes."""
    out = np.zeros(battery.N_LIM)
    battery.battery_limits(p, np.array([soc, temperature]), out)
    return out


def show(car: Car) -> Card:
    """Compute the card."""
    cells, switches = car.machines.battery, car.machines.contactors
    p = cells.pack()
    warm, cold = limits_at(p, SOC, WARM), limits_at(p, SOC, COLD)
    ocv, resistance = warm[battery.LIM_OCV], warm[battery.LIM_RESISTANCE]
    greatest = ocv**2 / (4.0 * resistance)
    powers = np.linspace(-0.3 * greatest, greatest, 300)
    curves = []
    for name, lim in (("25 degC", warm), ("-10 degC", cold)):
        u, r = lim[battery.LIM_OCV], lim[battery.LIM_RESISTANCE]
        top = u**2 / (4.0 * r)
        within = powers[powers <= top]
        voltages = np.array([u - r * battery.discharge_current(u, r, w) for w in within])
        curves.append(Curve(name, within / 1e3, voltages))
    curves.append(
        Curve("known: half the open-circuit voltage", np.array([greatest / 1e3]),
              np.array([0.5 * ocv]), marker="o")
    )  # fmt: skip
    terminal = Panel(f"Terminal voltage at {SOC:g} charge", "power out (kW)", "voltage (V)", curves)

    charge = np.linspace(0.0, 1.0, 201)
    rows = np.array([limits_at(p, s, WARM) for s in charge])
    cold_rows = np.array([limits_at(p, s, COLD) for s in charge])
    limits = Panel(
        "Published power limits",
        "state of charge",
        "power (kW)",
        [
            Curve("out, 25 degC", charge, rows[:, battery.LIM_DISCHARGE] / 1e3),
            Curve("in, 25 degC", charge, rows[:, battery.LIM_CHARGE] / 1e3),
            Curve("out, -10 degC", charge, cold_rows[:, battery.LIM_DISCHARGE] / 1e3),
            Curve("in, -10 degC", charge, cold_rows[:, battery.LIM_CHARGE] / 1e3),
        ],
    )
    open_circuit = Panel(
        "Open-circuit voltage and resistance",
        "state of charge",
        "V, and mOhm",
        [
            Curve("voltage (V)", charge, rows[:, battery.LIM_OCV]),
            Curve("mOhm, 25 degC", charge, 1e3 * rows[:, battery.LIM_RESISTANCE]),
            Curve("mOhm, -10 degC", charge, 1e3 * cold_rows[:, battery.LIM_RESISTANCE]),
            Curve("known: the map", np.array(cells.soc),
                  np.array(cells.open_circuit_voltage), marker="."),
        ],
    )  # fmt: skip

    # An hour's discharge at constant power, and a precharge.
    x, out, lim = np.array([0.9, WARM]), np.zeros(battery.N_OUT), np.zeros(battery.N_LIM)
    slow = cells.pack(1.0)
    drawn = taken = heat = 0.0
    for _ in range(1200):
        battery.battery_limits(slow, x, lim)
        battery.battery_step(slow, x, 20e3, 1.0, WARM, lim, out)
        current = -out[battery.OUT_CURRENT]
        drawn += lim[battery.LIM_OCV] * current
        taken += out[battery.OUT_POWER]
        heat += out[battery.OUT_HEAT]
    contact, state = switches.pack(), np.zeros(contactors.N_STATE)
    seen: list[float] = []
    while state[contactors.X_PHASE] != contactors.CLOSED and len(seen) < 1000:
        contactors.contactor_step(contact, state, 1.0, ocv, 0.0)
        seen.append(float(state[contactors.X_LINK_VOLTAGE]))
    tau = switches.precharge_resistance * switches.link_capacitance
    time = 1e-3 * np.arange(1, len(seen) + 1)
    known = ocv * (1.0 - np.exp(-time / tau))
    precharge = Panel(
        "Precharge of the DC link",
        "time (ms)",
        "voltage (V)",
        [Curve("computed", 1e3 * time, np.array(seen)),
         Curve("known", 1e3 * time, known, True, color="#22272e")],
    )  # fmt: skip
    back = battery.discharge_current(ocv, resistance, 30e3)
    facts = [
        Fact(
            "greatest power: U0^2/(4R), at half the voltage", "V", 0.5 * ocv,
            ocv - resistance * battery.discharge_current(ocv, resistance, greatest), 1e-6,
        ),
        Fact("30 kW out: U times I", "W", 30e3, (ocv - resistance * back) * back, 1e-12),
        Fact("20 min at 20 kW: source less terminals is heat", "J", drawn - taken, heat, 1e-9),
        Fact(
            "precharged after R C ln(1/(1 - share))", "s",
            tau * math.log(1.0 / (1.0 - switches.precharge_share)), float(time[-1]), 0.02,
        ),
        Fact("full takes nothing", "W", 0.0, float(limits_at(p, 1.0, WARM)[battery.LIM_CHARGE]), 0.0),
        Fact("empty gives nothing", "W", 0.0, float(limits_at(p, 0.0, WARM)[battery.LIM_DISCHARGE]), 0.0),
    ]  # fmt: skip
    return Card("Traction battery", [terminal, limits, open_circuit, precharge], facts)
