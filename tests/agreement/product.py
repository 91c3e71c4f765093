"""The product's plant given the reference's start and commands, stepped by whole milliseconds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from reference import car as places
from reference import switch
from reference.mechanics import AT, BRANCHES
from reference.oil import CLUTCH, PISTON, SPOOL, SUPPLY

from hev_can_emu.plant import (
    battery,
    combustion,
    driveline,
    holding,
    hydraulics,
    shifting,
    sleeve,
    structure,
    teeth,
    thermal,
)
from hev_can_emu.plant import detailed_layout as lay
from hev_can_emu.plant import powertrain as port
from hev_can_emu.plant.detailed import detailed_step, observe
from hev_can_emu.plant.detailed_parameters import Effects
from hev_can_emu.plant.driveline import N_SEEN
from hev_can_emu.plant.events import EVENT
from hev_can_emu.plant.hydraulic_parameters import P_CLUTCH_COMPLIANCE
from hev_can_emu.plant.start import Start
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.setup import Setup

MILLISECOND = 1_000_000
WINDINGS = (lay.X_THERMAL1 + thermal.X_WINDING, lay.X_THERMAL2 + thermal.X_WINDING)
SPEEDS = (*structure.INERTIAS, "Jrear")
TWISTS = (*(name for name, *_ in structure.BRANCHES), "rear")


class Event(NamedTuple):
    """Time s, kind and index as :mod:`hev_can_emu.plant.driveline` has them."""

    time: float
    kind: int
    index: int


class Run(NamedTuple):
    """What came out: one row per millisecond, the start included, in the order of ``SIGNALS``."""

    signals: np.ndarray
    events: list[Event]


SIGNALS = (
    "engine_speed", "input_speed", "em2_speed", "body_speed", "half_shaft_torque",
    "input_shaft_torque", "clutch_slip", "gear_slip", "clutch_heat", "sleeve_position",
)  # fmt: skip


class Product:
    """A detailed car in the state from which the reference starts."""

    def __init__(
        self, start: switch.Start, car: places.Car, y: np.ndarray, step_ns: int = 50_000
    ) -> None:
        self.bench = Bench(
            Setup(model="detailed"), Effects(step_ns=step_ns), Start(temperature=start.temperature)
        )
        plant, x, n = self.bench.plant, self.bench.x, self.bench.n
        self.speeds = self.bench.driveline
        self.twists = self.bench.driveline[len(SPEEDS) :]
        for place, name in enumerate(SPEEDS):
            self.speeds[place] = y[AT[name]]
        n[holding.HELD + structure.C1], n[holding.ROW] = 1, 1
        x[lay.X_BOOKS + teeth.ANGLE] = start.crank_angle
        engine = x[lay.X_ENGINE :]
        engine[combustion.X_PHASE] = combustion.RUNNING
        for place in (combustion.X_CHARGE, combustion.X_CAUGHT, combustion.X_BURNING):
            engine[place] = start.charge
        oil, z = x[lay.X_OIL :], y[places.OIL :]
        oil[hydraulics.X_SUPPLY] = hydraulics.supply_volume(plant.hydraulics, z[SUPPLY])
        oil[hydraulics.X_CLUTCH] = z[CLUTCH] * plant.hydraulics[P_CLUTCH_COMPLIANCE]
        oil[hydraulics.X_PISTON], oil[hydraulics.X_SPOOL] = z[PISTON], z[SPOOL]
        x[lay.X_SYNC + shifting.X_ANGLE] = y[places.GAP]
        # A battery at the engine's temperature would give nothing.
        x[lay.X_BATTERY + battery.X_TEMPERATURE] = 298.15
        self.u = np.full(len(port.COMMANDS), np.nan)
        self.u[: port.U_GRADE] = 0.0
        self.u[port.U_CONTACTOR] = self.u[port.U_ENGINE_RUN] = 1.0
        self.u[port.U_EM1_MODE] = self.u[port.U_EM2_MODE] = port.TORQUE
        self.u[port.U_AMBIENT] = start.temperature
        self.y = np.zeros(len(port.TRUTH))
        self.y[port.Y_BATTERY_VOLTAGE] = x[lay.X_LINK]
        self.work = np.zeros(lay.WORK)
        told = self.work[lay.W_OIL : lay.W_SYNC]
        told[hydraulics.OUT_PISTON] = z[PISTON]
        told[hydraulics.OUT_PACK_FORCE] = car.circuit.pack_force(z[PISTON])
        observe(plant, x, n, np.zeros(len(plant.bank.speed_at)), self.y, np.zeros(N_SEEN))
        self.chain = car.chain
        self.records = np.zeros(4096, dtype=EVENT)

    def run(self, commands: np.ndarray) -> Run:
        """Run one millisecond per row of ``commands``, as :data:`reference.switch.COMMANDS`."""
        rows, events = [self._observe()], []
        for tick, row in enumerate(commands):
            # Oil and windings keep their temperature in the reference.
            for place in (lay.X_COOLANT, *WINDINGS):
                self.bench.x[place] = self.u[port.U_AMBIENT]
            (
                self.u[port.U_CLUTCH_CURRENT], self.u[port.U_SHIFT_CURRENT1],
                self.u[port.U_SHIFT_CURRENT2], self.u[port.U_PUMP], self.u[port.U_ENGINE_TORQUE],
                self.u[port.U_EM1_TORQUE], self.u[port.U_EM2_TORQUE],
            ) = row  # fmt: skip
            count = detailed_step(
                self.bench.plant, self.bench.x, self.bench.n, self.u, self.y, self.work,
                tick * MILLISECOND, self.records, 0,
            )  # fmt: skip
            events += [
                Event(record["t_ns"] * 1e-9, int(record["kind"]), int(record["index"]))
                for record in self.records[:count]
            ]
            rows.append(self._observe())
        return Run(np.array(rows), events)

    def _shaft(self, name: str, start: str, end: str) -> float:
        """Return what a shaft carries, N m."""
        row = BRANCHES.index(name)
        rate = self.speeds[SPEEDS.index(start)] - self.speeds[SPEEDS.index(end)]
        twist = self.twists[TWISTS.index(name)]
        return float(self.chain.k[row] * twist + self.chain.c[row] * rate)

    def _observe(self) -> list[float]:
        w = dict(zip(SPEEDS, self.speeds[: len(SPEEDS)], strict=True))
        return [
            w["Je"], w["J1"], w["Jm2"], w["Jv"], self._shaft("lh", "Jfd2", "Jlw"),
            self._shaft("2", "Jc2", "J1"), w["Jc1"] - w["Jc2"], w["Jsleeve"] - w["Jg11"],
            self.bench.x[lay.X_BOOKS + teeth.FRICTION + structure.C1],
            self.bench.x[lay.X_SYNC + sleeve.X_POSITION],
        ]  # fmt: skip


def changes(run: Run, index: int) -> list[Event]:
    """Return when one lock caught and let go."""
    kinds = (driveline.LOCKED, driveline.RELEASED)
    return [event for event in run.events if event.index == index and event.kind in kinds]
