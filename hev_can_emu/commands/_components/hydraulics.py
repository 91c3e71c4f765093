"""Hydraulics with the TCU's own control: step responses of clutch capacity and shift force."""

from __future__ import annotations

import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.ecu import hydraulic_control as control
from hev_can_emu.plant import hydraulics, wet_clutch
from hev_can_emu.report.component_plot import Curve, Fact, Panel

DT, PER_TICK = 5e-5, 20
SUPPLY, OIL, SLIP = 5e6, 353.15, 50.0


class Bench:
    """Control unit, circuit and clutch at a constant slip; the sleeve is held."""

    def __init__(self, car: Car) -> None:
        """Start at rest, supply charged."""
        circuit = car.detailed.hydraulics
        self.p, self.x = circuit.pack(DT), np.zeros(hydraulics.N_STATE)
        self.out = np.zeros(hydraulics.N_OUT)
        hydraulics.hydraulics_start(self.p, self.x, SUPPLY)
        self.out[hydraulics.OUT_SUPPLY] = SUPPLY
        self.clutch = car.detailed.clutch.pack(DT)
        self.plates, self.can = np.array([OIL]), np.zeros(wet_clutch.N_OUT)
        self.unit, self.memory = car.tuning.hydraulics.pack(circuit), np.zeros(control.N_STATE)
        control.control_start(self.memory, 0.0)
        self.inputs, self.told = np.zeros(control.N_IN), np.zeros(control.N_OUT)

    def run(self, ticks: int, capacity: float = 0.0, force: float = 0.0) -> np.ndarray:
        """Return capacity N m, shift force N, clutch pressure Pa, piston m after each 50 us."""
        rows = []
        for _ in range(ticks):
            self.inputs[:] = (
                *(capacity, force, *self.out[: hydraulics.OUT_PISTON]),
                *(SLIP, self.plates[0], 0.0),
            )
            control.hydraulic_control_step(
                self.unit, self.memory, self.clutch, self.inputs, self.told
            )
            for _ in range(PER_TICK):
                told = self.told
                hydraulics.hydraulics_step(
                    self.p, self.x, told[control.OUT_CURRENT_CLUTCH],
                    told[control.OUT_CURRENT_SHIFT1], told[control.OUT_CURRENT_SHIFT2],
                    told[control.OUT_PUMP], 0.0, self.out,
                )  # fmt: skip
                wet_clutch.capacity_step(
                    self.clutch, self.plates, self.out[hydraulics.OUT_PACK_FORCE],
                    self.out[hydraulics.OUT_PISTON], SLIP, OIL, self.can,
                )  # fmt: skip
                rows.append(
                    (self.can[wet_clutch.OUT_KINETIC], self.out[hydraulics.OUT_SHIFT_FORCE],
                     self.out[hydraulics.OUT_CLUTCH], self.out[hydraulics.OUT_PISTON])
                )  # fmt: skip
        return np.array(rows)


def settled_after(values: np.ndarray, aim: float, band: float) -> float:
    """Return the time after which ``values`` stay within ``band`` of ``aim``, s."""
    outside = np.flatnonzero(np.abs(values - aim) > band * abs(aim))
    return DT * float(outside[-1] + 1) if outside.size else 0.0


def show(car: Car) -> Card:
    """Compute the card."""
    facts, fills, piston = [], [], []
    for aim in (20.0, 100.0, 300.0):
        rows = Bench(car).run(250, aim)
        time = 1e3 * DT * np.arange(1, len(rows) + 1)
        fills.append(Curve(f"{aim:g} N m", time, rows[:, 0]))
        piston.append(Curve(f"{aim:g} N m", time, 1e3 * rows[:, 3]))
        facts.append(
            Fact(f"0 to {aim:g} N m from rest: after 250 ms", "N m", aim, rows[-1, 0], 0.02)
        )
        facts.append(
            Fact("   settled within 5 % (measured before)", "s",
                 {20.0: 0.075, 100.0: 0.052, 300.0: 0.047}[aim], settled_after(rows[:, 0], aim, 0.05), 0.3)
        )  # fmt: skip
    bench = Bench(car)
    parts = [bench.run(150, aim)[:, 0] for aim in (100.0, 200.0, 100.0, 0.0)]
    rows = np.concatenate(parts)
    asked = np.repeat([100.0, 200.0, 100.0, 0.0], 150 * PER_TICK)
    time = 1e3 * DT * np.arange(1, len(rows) + 1)
    steps = Panel(
        "Clutch in contact: up, down, open", "time (ms)", "capacity (N m)",
        [Curve("capacity", time, rows), Curve("asked for", time, asked, True, color="#22272e")],
    )  # fmt: skip
    facts.append(Fact("opened", "N m", 0.0, float(rows[-1]), 1e-6))
    shift = Bench(car).run(120, 0.0, 1000.0)
    time = 1e3 * DT * np.arange(1, len(shift) + 1)
    shifted = Panel(
        "Shift force, sleeve blocked: 0 to 1000 N", "time (ms)", "force (N)",
        [Curve("force", time, shift[:, 1]),
         Curve("asked for", time, np.full(len(time), 1000.0), True, color="#22272e")],
    )  # fmt: skip
    facts.append(Fact("shift force after 120 ms", "N", 1000.0, float(shift[-1, 1]), 0.02))
    kiss = car.detailed.hydraulics.clutch
    slow = Bench(car)
    slow.run(300, 5.0)
    force, pressure = slow.out[hydraulics.OUT_PACK_FORCE], slow.out[hydraulics.OUT_CLUTCH]
    squeezed = slow.x[hydraulics.X_PISTON] - kiss.kiss_travel
    facts.append(
        Fact("pressure at the kiss point: (F0 + k s)/A", "Pa", kiss.kiss_pressure,
             pressure - (force + kiss.spring * squeezed) / kiss.area, 2e-3)
    )  # fmt: skip
    panels = [
        Panel("Clutch from rest: fill, touch, press", "time (ms)", "capacity (N m)", fills),
        Panel("Its piston", "time (ms)", "travel (mm)", piston),
        steps,
        shifted,
    ]
    note = "supply 50 bar, slip 50 rad/s, 80 degC; control once per millisecond"
    return Card("Hydraulics and the TCU's control of them", panels, facts, note)
