"""Small drivelines with known answers, built from the same records as the car's."""

from __future__ import annotations

import numpy as np

from hev_can_emu.plant.bank import Bank, build_bank
from hev_can_emu.plant.driveline import N_INTEGERS, TRIAL
from hev_can_emu.plant.events import EVENT
from hev_can_emu.plant.structure import Structure
from hev_can_emu.plant.teeth import N_BOOKS, build_extras


def inertias_with_clutches(
    inertia: list[float],
    clutches: dict[int, tuple[int, int]],
    shafts: list[tuple[int, int]] | None = None,
    stiffness: float = 1.0,
) -> Structure:
    """Free inertias, some pairs joined by the locks named (0, 1, 3 ...) and some by shafts.

    Locks that are not used act on spare inertias of their own, so that all 48 configurations exist.
    """
    count = len(inertia)
    spare = {lock: count + i for i, lock in enumerate(sorted(set(range(6)) - set(clutches)))}
    n = count + len(spare)
    locks = np.zeros((6, n))
    for lock, (a, b) in clutches.items():
        locks[lock, a], locks[lock, b] = 1.0, -1.0
    for lock, at in spare.items():
        locks[lock, at] = 1.0
    shafts = shafts or []
    incidence = np.zeros((max(len(shafts), 1), n))
    for branch, (a, b) in enumerate(shafts):
        incidence[branch, a], incidence[branch, b] = 1.0, -1.0
    if not shafts:  # one spring between two spares that never move
        incidence[0, n - 1], incidence[0, n - 2] = 1.0, -1.0
    nb = len(incidence)
    ports = np.zeros((4, n))
    for port in range(4):
        ports[port, min(port, count - 1)] = 1.0
    return Structure(
        model="test",
        names=tuple(f"J{i}" for i in range(n)),
        inertia=np.array([*inertia, *[1.0] * len(spare)]),
        incidence=incidence,
        branch_names=tuple(f"k{i}" for i in range(nb)),
        stiffness=np.repeat(np.eye(nb)[None] * stiffness, 6, axis=0),
        damping=np.zeros((6, nb, nb)),
        basis=np.eye(nb),
        independent=tuple(range(nb)),
        ports=ports,
        locks=locks,
        twist_remap=np.broadcast_to(np.eye(nb), (6, 6, nb, nb)).copy(),
    )


class Bench:
    """A driveline with its state, stepped from Python; ``detailed``: as the detailed plant steps it."""

    def __init__(
        self, structure: Structure, period: float = 1e-3, levels: int = 10, detailed: bool = False
    ) -> None:
        self.structure = structure
        self.bank: Bank = build_bank(structure, period, levels, travel=detailed, dampers=detailed)
        self.extras = None
        if detailed:
            self.extras = build_extras(structure, self.bank, np.zeros(0), damper_work=True)
        self.x = np.zeros(structure.n + structure.nq)
        self.state = np.zeros(N_INTEGERS, dtype=np.int64)
        self.u = np.zeros(10)
        self.kinetic = np.zeros(6)
        self.static = np.zeros(6)
        self.lost = np.zeros(N_BOOKS if detailed else 1)
        self.trial = np.zeros(TRIAL)
        self.period_ns = round(period * 1e9)
        self.t_ns = 0
        self.record = np.zeros(256, dtype=EVENT)
        self.n_events = 0

    def step(self) -> None:
        from hev_can_emu.plant.driveline import step

        self.n_events = step(
            self.bank, self.x, self.state, self.u, self.kinetic, self.static, self.lost,
            self.trial, self.t_ns, self.period_ns, self.record, self.n_events,
            self.extras,
        )  # fmt: skip
        self.t_ns += self.period_ns

    @property
    def events(self) -> list[tuple[float, int, int]]:
        return [
            (e["t_ns"] * 1e-9, int(e["kind"]), int(e["index"]))
            for e in self.record[: self.n_events]
        ]
