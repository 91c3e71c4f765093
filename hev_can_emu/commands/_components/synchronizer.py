"""The synchronizer: a shift into G1 with all its phases, beside the closed form of cone and inertia."""

from __future__ import annotations

import itertools

import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.commands._components.small import Stand, two_inertias
from hev_can_emu.ecu import hydraulic_control as valves
from hev_can_emu.ecu import shift_control as control
from hev_can_emu.plant import hydraulics, shifting, sleeve, teeth
from hev_can_emu.plant.driveline import friction_torque
from hev_can_emu.plant.structure import G1
from hev_can_emu.report.component_plot import Curve, Fact, Panel

DT, PER_TICK = 5e-5, 20
INERTIAS, SLIP, DRAG, FORCE = (0.07, 0.5), 30.0, -1.0, 900.0
SUPPLY = 5e6

ZONES = (
    "centre", "free", "presync", "blocked", "index", "flight", "tooth on tooth", "grating",
    "entering", "engaged", "stop",
)  # fmt: skip

T, TRAVEL, ZONE, PUSH, SPEED, OTHER, CONE, PHASE = range(8)


class Gearbox:
    """Sleeve side and gear side as two inertias in the car's driveline kernel, G1's lock between them."""

    def __init__(self, car: Car, slip: float, drag: float, position: float = 0.0) -> None:
        """Start at rest, the sleeve side faster by ``slip`` rad/s."""
        self.p, self.x = car.detailed.sleeve.pack(DT), np.zeros(shifting.N_STATE)
        shifting.start_sleeve(self.p, self.x, position)
        self.x[shifting.X_ANGLE] = 0.02
        self.out = np.zeros(sleeve.N_OUT)
        self.stand = Stand(two_inertias(*INERTIAS, between=G1), DT, 6, toothed=True)
        self.stand.x[:2] = 100.0 + slip, 100.0
        self.stand.torques = (drag, 0.0)

    def step(self, force: float, stiffness: float) -> None:
        """Advance sleeve and driveline by one inner step."""
        stand = self.stand
        shifting.move_sleeve(
            self.p, self.x, force, stiffness, stand.x[0] - stand.x[1], 0.0,
            friction_torque(stand.bank, stand.x, stand.state, stand.forces, G1), 0.0, True,
            stand.state, stand.books, stand.kinetic, stand.static, self.out,
        )  # fmt: skip
        stand.advance()
        shifting.turn_gears(self.p, self.x, stand.books)


def shift(car: Car, slip: float = SLIP, drag: float = DRAG, force: float = FORCE) -> np.ndarray:
    """Return what a shift into G1 through the TCU's control and the hydraulics looks like, shape (n, 8)."""
    box = Gearbox(car, slip, drag)
    circuit = car.detailed.hydraulics
    oil_p, oil, oil_out = circuit.pack(DT), np.zeros(hydraulics.N_STATE), np.zeros(hydraulics.N_OUT)
    hydraulics.hydraulics_start(oil_p, oil, SUPPLY)
    oil_out[hydraulics.OUT_SUPPLY] = SUPPLY
    valve_p, valve = car.tuning.hydraulics.pack(circuit), np.zeros(valves.N_STATE)
    valves.control_start(valve, 0.0)
    told, inputs = np.zeros(valves.N_OUT), np.zeros(valves.N_IN)
    unit_p = car.tuning.shift.pack()
    unit, phase = np.zeros(control.N_STATE), np.zeros(control.N_OUT)
    clutch = car.detailed.clutch.pack(DT)
    rows = []
    for _ in range(400):
        position = box.x[sleeve.X_POSITION]
        w = box.stand.x
        control.shift_control_step(
            unit_p, unit, 1.0, force, position, w[0] - w[1], 0.0, box.x[sleeve.X_ZONE], 0.0, phase
        )
        inputs[:] = (
            0.0, phase[control.OUT_FORCE], *oil_out[: hydraulics.OUT_PISTON], 0.0, 353.15, position
        )  # fmt: skip
        valves.hydraulic_control_step(valve_p, valve, clutch, inputs, told)
        for _ in range(PER_TICK):
            box.step(oil_out[hydraulics.OUT_SHIFT_FORCE], oil_out[hydraulics.OUT_SHIFT_STIFFNESS])
            hydraulics.hydraulics_step(
                oil_p, oil, told[valves.OUT_CURRENT_CLUTCH], told[valves.OUT_CURRENT_SHIFT1],
                told[valves.OUT_CURRENT_SHIFT2], told[valves.OUT_PUMP], box.x[sleeve.X_POSITION],
                oil_out,
            )  # fmt: skip
            rows.append(
                (box.stand.t_ns * 1e-9, box.x[sleeve.X_POSITION], box.x[sleeve.X_ZONE],
                 oil_out[hydraulics.OUT_SHIFT_FORCE], w[0], w[1],
                 box.out[sleeve.OUT_CONE1], phase[control.OUT_PHASE])
            )  # fmt: skip
        if phase[control.OUT_PHASE] == control.ENGAGED:
            break
    return np.array(rows)


def synchronise(car: Car, slip: float, force: float) -> tuple[float, float, float, float]:
    """Return time and heat computed from the ring's stop on, and the same by the closed form."""
    box = Gearbox(car, slip, 0.0, car.detailed.sleeve.blocking_position)
    steps = 0
    while box.x[sleeve.X_ZONE] != sleeve.INDEXING and steps < 20000:
        box.step(force, 0.0)
        steps += 1
    inertia = INERTIAS[0] * INERTIAS[1] / sum(INERTIAS)
    # What the guide's friction takes never reaches the ring.
    torque = car.detailed.sleeve.cone_lever(1) * (force - car.detailed.sleeve.guide_friction)
    known = inertia * abs(slip) / torque
    return (
        (steps - 1) * DT,
        float(box.stand.books[teeth.FRICTION + G1]),
        known,
        0.5 * inertia * slip * slip,
    )


def show(car: Car) -> Card:
    """Compute the card."""
    rows = shift(car)
    time = 1e3 * rows[:, T]
    changes = np.flatnonzero(np.diff(rows[:, ZONE])) + 1
    edges = [0, *changes.tolist(), len(rows) - 1]
    bands = [
        (float(time[a]), float(time[b]), ZONES[int(rows[a, ZONE])])
        for a, b in itertools.pairwise(edges)
        if time[b] - time[a] > 1.0
    ]
    took, heat, known_time, known_heat = synchronise(car, 60.0, 800.0)
    made = car.detailed.sleeve
    lever = 0.1 * 0.035 * 2.0 / np.sin(np.radians(7.0))
    facts = [
        Fact("60 rad/s under 800 N: J dw/T", "s", known_time, took, 2e-3),
        Fact("   heat J dw^2/2", "J", known_heat, heat, 1e-9),
        Fact("cone of G1: mu R n/sin(alpha), for 0.1, 35 mm, 2, 7 deg", "m", lever, made.cone_lever(1), 1e-3),
        Fact("slip when the ring lets go", "rad/s", 0.0, _slip_at(rows, sleeve.FLIGHT), 1e-12),
        Fact("the sleeve ends at its stop", "m", made.end_position, float(rows[-1, TRAVEL]), 1e-12),
        Fact("phase told at the end: Engaged", "1", control.ENGAGED, float(rows[-1, PHASE]), 0.0),
    ]  # fmt: skip
    panels = [
        Panel("Sleeve", "time (ms)", "travel (mm)", [Curve("", time, 1e3 * rows[:, TRAVEL])], bands),
        Panel("Force of the cylinder", "time (ms)", "force (N)",
              [Curve("", time, rows[:, PUSH])], bands),
        Panel("Speeds", "time (ms)", "speed (rad/s)",
              [Curve("sleeve side", time, rows[:, SPEED]), Curve("gear", time, rows[:, OTHER])], bands),
        Panel("Capacity of the cone", "time (ms)", "torque (N m)",
              [Curve("", time, rows[:, CONE])], bands),
    ]  # fmt: skip
    note = (
        f"into G1, {FORCE:g} N requested, sleeve side {INERTIAS[0]:g} kg m² and {SLIP:g} rad/s fast"
    )
    return Card("Synchronizer: a shift and its phases", panels, facts, note)


def _slip_at(rows: np.ndarray, zone: int) -> float:
    """Return the slip in the last step before a zone is reached, rad/s."""
    at = int(np.flatnonzero(rows[:, ZONE] == zone)[0]) - 1
    return float(abs(rows[at, SPEED] - rows[at, OTHER]))
