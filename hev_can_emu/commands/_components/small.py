"""Two inertias in the car's own driveline kernel: a clutch or a mesh between them."""

from __future__ import annotations

import numpy as np

from hev_can_emu.plant import teeth
from hev_can_emu.plant.bank import build_bank
from hev_can_emu.plant.driveline import TRIAL, step
from hev_can_emu.plant.events import EVENT
from hev_can_emu.plant.holding import N_INTEGERS, ROW, SIGN, row_of
from hev_can_emu.plant.structure import C1, LOCKS, N_PORTS, Structure

MESH = "mesh"


def two_inertias(
    first: float,
    second: float,
    stiffness: float = 1.0,
    damping: float = 0.0,
    joined: bool = False,
    between: int = C1,
) -> Structure:
    """Return two free inertias with the lock ``between`` them; ``joined`` puts a mesh there as well.

    The other locks act on spare inertias, so that all configurations exist.
    """
    m = len(LOCKS)
    n = 2 + m
    locks = np.zeros((m, n))
    for lock in range(m):
        locks[lock, 2 + lock] = 1.0
    locks[between] = 0.0
    locks[between, 0], locks[between, 1] = 1.0, -1.0
    incidence = np.zeros((1, n))
    ends = (0, 1) if joined else (n - 1, n - 2)
    incidence[0, ends[0]], incidence[0, ends[1]] = 1.0, -1.0
    ports = np.zeros((N_PORTS, n))
    for port in range(N_PORTS):
        ports[port, min(port, 1)] = 1.0
    return Structure(
        model="small",
        names=tuple(f"J{i}" for i in range(n)),
        inertia=np.array([first, second, *[1.0] * m]),
        incidence=incidence,
        branch_names=(MESH,),
        stiffness=np.full((6, 1, 1), stiffness),
        damping=np.full((6, 1, 1), damping),
        basis=np.eye(1),
        independent=(0,),
        ports=ports,
        locks=locks,
        twist_remap=np.ones((6, 6, 1, 1)),
    )


class Stand:
    """A small driveline with its state; ``play`` is the whole play of its mesh, rad; ``toothed``: dogs."""

    def __init__(
        self,
        structure: Structure,
        period: float,
        levels: int = 10,
        play: float = 0.0,
        toothed: bool = False,
    ) -> None:
        """Prepare its propagators; it stands still."""
        clearance = {MESH: play} if play else {}
        toothed = toothed or bool(play)
        self.bank = build_bank(
            structure, period, levels, travel=toothed,
            open_branches=teeth.parting(structure, clearance),
        )  # fmt: skip
        self.extras = None
        self.books = np.zeros(1)
        if toothed:
            self.extras = teeth.build_extras(structure, self.bank, np.zeros(0), clearance)
            self.books = np.zeros(teeth.N_BOOKS)
        self.x = np.zeros(structure.n + 1)
        self.state = np.zeros(N_INTEGERS, dtype=np.int64)
        self.state[SIGN : SIGN + len(structure.locks)] = 1
        self.forces = np.zeros(N_PORTS + len(structure.locks))
        self.kinetic, self.static = np.zeros(len(structure.locks)), np.zeros(len(structure.locks))
        self.trial = np.zeros(TRIAL)
        self.period_ns, self.t_ns = round(period * 1e9), 0
        self.record, self.count = np.zeros(4096, dtype=EVENT), 0
        self.torques = (0.0, 0.0)
        self.twist = structure.n
        self.state[ROW] = row_of(self.state, self.extras)

    def advance(self) -> None:
        """Make one step under ``torques`` on the two inertias."""
        self.forces[:] = 0.0
        self.forces[:2] = self.torques
        self.count = step(
            self.bank, self.x, self.state, self.forces, self.kinetic, self.static, self.books,
            self.trial, self.t_ns, self.period_ns, self.record, self.count, self.extras,
        )  # fmt: skip
        self.t_ns += self.period_ns

    def first(self, kind: int) -> float:
        """Return the time of the first event of a kind, s; NaN where there is none."""
        for event in self.record[: self.count]:
            if event["kind"] == kind:
                return float(event["t_ns"]) * 1e-9
        return float("nan")
