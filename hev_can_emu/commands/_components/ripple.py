"""Firing ripple and play in meshes: the car in parallel G1, its half shaft shaken, its idle gear rattling."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.plant import combustion, gas_pulses
from hev_can_emu.plant import combustion_map as maps
from hev_can_emu.plant import detailed_layout as lay
from hev_can_emu.plant.detailed_parameters import Effects
from hev_can_emu.plant.holding import MESH, PARTED
from hev_can_emu.plant.state_space import state_space
from hev_can_emu.plant.structure import ALL_LOCKS, BRANCHES, CONFIGURATIONS, INERTIAS, full_order
from hev_can_emu.report.component_plot import Curve, Fact, Panel
from hev_can_emu.runtime.bench import Bench
from hev_can_emu.runtime.setup import Setup

SPEED, TORQUE = 160.0, 100.0  # of the engine, rad/s and N m
PLAY = 1e-4  # m
WINDOW = 600  # ms
_BRANCH_NAMES = [f"k{name}" for name, *_ in BRANCHES]
_INERTIA = {name: index for index, name in enumerate(INERTIAS)}


def drive(vehicle: str, effects: Effects) -> Bench:
    """Return the car in G1 with C1 closed, its engine fired against EM2, which held the speed until now."""
    car = Bench(Setup(model="detailed", vehicle=vehicle), effects)
    car.command(
        em2_mode=1.0, em2_torque=150.0, external_clutch_capacity=500.0, external_gear=1.0
    )  # fmt: skip
    while car.truth("engine_speed") < SPEED and car.t_ns < 30_000_000_000:
        car.run(10)
    ratio = car.truth("em2_speed") / car.truth("engine_speed")
    car.command(em2_mode=2.0, em2_speed=SPEED * ratio, engine_run=1.0)
    car.run(500)
    for share in np.linspace(0.01, 1.0, 100):  # so slowly that the car does not surge
        car.command(engine_torque=TORQUE * share)
        car.run(10)
    car.run(2000)
    # From here on EM2 knows nothing of the speed: its control would answer the ripple.
    car.command(em2_mode=1.0, em2_torque=float(car.advance(300, ("em2_torque",)).mean()))
    car.run(500)
    return car


def half_shaft(car: Car, bench: Bench) -> np.ndarray:
    """Return time s, crank angle rad, speed rad/s, charge burning, left half shaft's torque N m."""
    count = len(bench.plant.bank.inertia)
    twist = count + _BRANCH_NAMES.index("klh")
    k, c = car.driveline.stiffness["klh"], car.driveline.damping["clh"]
    rows = []
    for _ in range(WINDOW):
        bench.run(1)
        x = bench.driveline
        torque = k * x[twist] + c * (x[_INERTIA["Jfd2"]] - x[_INERTIA["Jlw"]])
        rows.append(
            (1e-9 * bench.t_ns, bench.truth("crank_angle"), bench.truth("engine_speed"),
             bench.x[lay.X_ENGINE + combustion.X_BURNING], torque)
        )  # fmt: skip
    return np.array(rows)


def order_two(rows: np.ndarray) -> float:
    """Return the amplitude of the crank's order 2 in the last column, beside drift and orders 4 and 6."""
    angle, time = np.unwrap(rows[:, 1]), rows[:, 0] - rows[0, 0]
    columns = [np.ones_like(time), time, time**2]
    columns += [f(order * angle) for order in (2, 4, 6) for f in (np.cos, np.sin)]
    fit = np.linalg.lstsq(np.column_stack(columns), rows[:, -1], rcond=None)[0]
    return float(np.hypot(fit[3], fit[4]))


def known_order_two(car: Car, rows: np.ndarray) -> float:
    """Return it from the gas torque's order 2 and the linear driveline's answer to it, N m."""
    p = car.detailed.engine.pack()
    speed, charge = float(rows[:, 2].mean()), float(rows[:, 3].mean())
    closed = p[maps.P_CLOSED_PRESSURE]
    pressure = closed + (gas_pulses.ATMOSPHERE - closed) * charge
    burnt = maps.load_torque(p, speed, charge)
    angle = np.linspace(0.0, np.pi, 360, endpoint=False)
    gas = [gas_pulses.ripple(p, maps.P_RIPPLE, a, 0.0, 1.0, pressure, burnt) for a in angle]
    size = abs(2.0 * np.fft.rfft(gas)[1] / len(angle))
    system = state_space(
        full_order(car.driveline), CONFIGURATIONS["parallel_g1"], car.driveline.tyre_radius
    )
    into, out = system.input("engine_torque"), system.output("left_half_shaft_torque")
    resolvent = 2j * speed * np.eye(len(system.a)) - system.a
    answer = system.c[out] @ np.linalg.solve(resolvent, system.b[:, into]) + system.d[out, into]
    return float(size * abs(answer))


def rattle(vehicle: str, mesh: str, ripple: bool) -> tuple[np.ndarray, int, float, Bench]:
    """Return rows of time s, place in the play m; partings; the idle gear's change of speed between
    its flanks over a millisecond, rad/s; the bench.
    """
    bench = drive(vehicle, Effects(firing_ripple=ripple, mesh_play={mesh: PLAY}))
    twist = len(bench.plant.bank.inertia) + _BRANCH_NAMES.index(mesh)
    seen, rows, free = len(bench.events), [], []
    for _ in range(WINDOW):
        before, speed = len(bench.events), bench.driveline[_INERTIA["Jg21"]]
        contact = bench.n[MESH]
        bench.run(1)
        x = bench.driveline
        if contact == 0 and len(bench.events) == before:
            free.append(abs(x[_INERTIA["Jg21"]] - speed))
        place = x[twist] + bench.n[MESH] * 0.5 * PLAY
        rows.append((1e-9 * bench.t_ns, place))
    partings = [
        event for event in bench.events[seen:]
        if event.kind == PARTED and event.which >= len(ALL_LOCKS)
    ]  # fmt: skip
    return np.array(rows), len(partings), max(free, default=math.nan), bench


def show(car: Car) -> Card:
    """Compute the card; without pulses in the vehicle file, rattling by the pistons alone."""
    panels, facts = [], []
    rippling = car.detailed.engine.pulses is not None
    if rippling:
        smooth, rough = (
            half_shaft(
                car, drive(car.name, Effects(firing_ripple=on, pistons=False, dog_play=False))
            )
            for on in (False, True)
        )
        facts += [
            Fact("order 2 in the half shaft: gas torque through the linear driveline", "N m",
                 known_order_two(car, rough), order_two(rough), 0.03),
            Fact("the same without ripple", "N m", 0.0, order_two(smooth), 0.5),
        ]  # fmt: skip
        panels.append(
            Panel("Left half shaft, engine at 100 N m in G1", "time (ms)", "torque (N m)", [
                Curve("firing ripple", np.arange(200.0), rough[:200, -1]),
                Curve("mean torque only", np.arange(200.0), smooth[:200, -1]),
            ])
        )  # fmt: skip
    idle, partings, free, bench = rattle(car.name, "kg2", rippling)
    loaded, parted, _, _ = rattle(car.name, "kg1", rippling)
    ledger = bench.ledger()
    assert ledger is not None
    facts += [
        Fact("first gear, loaded: partings of its teeth", "1", 0.0, float(parted), 0.5),
        Fact("idle gear of G2 between its flanks: change of its speed", "rad/s", 0.0, free, 1e-9),
        Fact("ledger: what does not close over what was moved", "1", 0.0,
             ledger.residue / ledger.moved, 2e-4),
    ]  # fmt: skip
    panels.append(
        Panel("Place in a play of 0.1 mm", "time (ms)", "mm", [
            Curve("second gear, idle", np.arange(200.0), 1e3 * idle[:200, 1]),
            Curve("first gear, loaded", np.arange(200.0), 1e3 * loaded[:200, 1]),
            Curve("flanks", np.array([0.0, 200.0]), np.full(2, 5e2 * PLAY), True, color="#8a929c"),
            Curve("", np.array([0.0, 200.0]), np.full(2, -5e2 * PLAY), True, color="#8a929c"),
        ])
    )  # fmt: skip
    note = f"{partings} partings of the idle gear's teeth in {WINDOW} ms"
    return Card("Firing ripple and rattle", panels, facts, note)
