"""The driveline as data: inertias, branches, locks and ports, for the full and the reduced model.

Coordinates are sign-flipped so that every speed is positive when the car drives forward: a mesh
deflects by ``r_a*theta_a - r_b*theta_b`` (Dai et al. 2024, Eqs. 6-8, written as ``K = B'*diag(k)*B``).

Unlocked, the full-order model has 18 inertias.  What can hold (clutch C1, the sleeve on G1 or G2,
a brake, the body at rest) is a *lock*: a row ``s`` with slip ``s.w``.  A *configuration* is the set of
locks that hold; :class:`Configuration` names the six driving ones.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.plant.vehicle import INERTIA_NAMES, DrivelineParameters

Array = npt.NDArray[np.float64]

INERTIAS = INERTIA_NAMES

# name, from, to, base radius at "from", at "to" (empty: a shaft, deflection is the angle's difference)
BRANCHES: tuple[tuple[str, str, str, str, str], ...] = (
    ("1", "Je", "Jc1", "", ""),
    ("2", "Jc2", "J1", "", ""),
    ("3", "J1", "Jsleeve", "", ""),
    ("m1", "Jm1", "Jid", "rm1", "rid"),
    ("id", "Jid", "J1", "rid", "r1"),
    ("m2", "Jm2", "J2", "rm2", "r2"),
    ("g1", "Jg11", "Jg12", "rg11", "rg12"),
    ("g2", "Jg21", "Jg22", "rg21", "rg22"),
    ("6", "J2", "Jg12", "", ""),
    ("5", "Jg12", "Jfd1", "", ""),
    ("4", "Jfd1", "Jg22", "", ""),
    ("fd", "Jfd1", "Jfd2", "rfd1", "rfd2"),
    ("lh", "Jfd2", "Jlw", "", ""),
    ("rh", "Jfd2", "Jrw", "", ""),
    ("lw", "Jlw", "Jv", "", ""),
    ("rw", "Jrw", "Jv", "", ""),
)

# Locks, in the order of the bits of a configuration and of the friction torques.  The last one exists
# only where the rear wheels are an inertia of their own.
C1, G1, G2, LEFT, RIGHT, BODY, REAR = range(7)
LOCKS = ("c1", "g1", "g2", "brake_left", "brake_right", "body")
ALL_LOCKS = (*LOCKS, "brake_rear")

# Torque ports ahead of the locks in the input vector.
ENGINE, EM1, EM2, ROAD = range(4)
PORTS = ("engine", "em1", "em2", "road")
N_PORTS = len(PORTS)
N_INPUTS = N_PORTS + len(LOCKS)


class Configuration(NamedTuple):
    """Which locks hold: C1, the gear (0 neutral, 1 G1, 2 G2), and what stands still."""

    clutch: bool
    gear: int
    left: bool = False
    right: bool = False
    body: bool = False
    rear: bool = False

    @property
    def row(self) -> int:
        """The row of this configuration in a bank, 0 to 47, to 95 with the rear wheels."""
        return (
            int(self.clutch)
            + 2 * self.gear
            + 6 * int(self.left)
            + 12 * int(self.right)
            + 24 * int(self.body)
            + 48 * int(self.rear)
        )

    @property
    def driving(self) -> int:
        """Index of the driving configuration (brakes aside), 0 to 5."""
        return int(self.clutch) + 2 * self.gear

    @property
    def locks(self) -> tuple[bool, ...]:
        """One flag per entry of :data:`ALL_LOCKS`."""
        return (
            self.clutch,
            self.gear == 1,
            self.gear == 2,
            self.left,
            self.right,
            self.body,
            self.rear,
        )


N_CONFIGURATIONS = 48  #: per state of the rear wheels
CONFIGURATIONS: dict[str, Configuration] = {
    "series": Configuration(True, 0),
    "parallel_g1": Configuration(True, 1),
    "parallel_g2": Configuration(True, 2),
    "electric_neutral": Configuration(False, 0),
    "electric_g1": Configuration(False, 1),
    "electric_g2": Configuration(False, 2),
}


def configuration_at(index: int) -> Configuration:
    """Return the configuration with the given bank index."""
    rest, driving = divmod(index, 6)
    return Configuration(
        bool(driving % 2),
        driving // 2,
        bool(rest & 1),
        bool(rest & 2),
        bool(rest & 4),
        bool(rest & 8),
    )


class Structure(msgspec.Struct, frozen=True):
    """A driveline's matrices, all locks open.

    Attributes:
        model: ``16dof``, ``4dof`` or ``detailed``.
        names: the inertias, n of them.
        inertia: J, shape (n,), kg m^2.
        incidence: B, shape (nb, n); branch deflections are ``B @ theta``.
        branch_names: nb names.
        stiffness: one (nb, nb) matrix per driving configuration, shape (6, nb, nb).
        damping: likewise, shape (6, nb, nb).
        basis: R, shape (nb, nq): deflections from the independent twists, ``phi = R @ q``.
        independent: the nq rows of B whose deflections are the twists q.
        ports: P, shape (4, n): speed (and torque) at each of :data:`PORTS`.
        locks: S, shape (6, n): slip at each of :data:`LOCKS`; (7, n) with the rear wheels.
        twist_remap: shape (6, 6, nq, nq): twists when the driving configuration changes from the
            first index to the second (identity in the full model).
    """

    model: str
    names: tuple[str, ...]
    inertia: Array
    incidence: Array
    branch_names: tuple[str, ...]
    stiffness: Array
    damping: Array
    basis: Array
    independent: tuple[int, ...]
    ports: Array
    locks: Array
    twist_remap: Array

    @property
    def n(self) -> int:
        """Number of inertias."""
        return len(self.inertia)

    @property
    def nq(self) -> int:
        """Number of independent twists."""
        return len(self.independent)

    def lock_map(self, configuration: Configuration) -> Array:
        """Return T, shape (n, n_free): speeds from free speeds, with the configuration's locks held.

        T spans the null space of the held lock rows; every held pair shares one column, each free
        column is named by its first inertia.  Raises ValueError for locks that depend on each other.
        """
        transform = np.eye(self.n)
        for lock, held in enumerate(configuration.locks[: len(self.locks)]):
            if not held:
                continue
            row = self.locks[lock] @ transform
            pivots = np.flatnonzero(np.abs(row) > 1e-12)
            if pivots.size == 0:
                raise ValueError(f"lock {LOCKS[lock]} is redundant in {configuration}")
            pivot = int(pivots[-1])  # eliminate the later inertia, keep the earlier one's name
            transform -= np.outer(transform[:, pivot], row / row[pivot])
            transform = np.delete(transform, pivot, axis=1)
        return transform

    def free_names(self, configuration: Configuration) -> tuple[str, ...]:
        """Return the names of the free coordinates of :meth:`lock_map`, merged ones joined by ``+``."""
        transform = self.lock_map(configuration)
        members: list[str] = []
        for column in range(transform.shape[1]):
            rows = np.flatnonzero(np.abs(transform[:, column]) > 1e-12)
            members.append("+".join(self.names[row] for row in rows))
        return tuple(members)

    def matrices(self, configuration: Configuration) -> tuple[Array, Array, Array]:
        """Return J, C, K in the configuration's free coordinates (symmetric, K and C semidefinite)."""
        transform = self.lock_map(configuration)
        reach = self.incidence @ transform
        c = configuration.driving
        j = transform.T @ (self.inertia[:, None] * transform)
        return j, reach.T @ self.damping[c] @ reach, reach.T @ self.stiffness[c] @ reach


def _independent_rows(incidence: Array) -> tuple[tuple[int, ...], Array]:
    """Choose rows of B that span its row space, and express all rows by them (R)."""
    chosen: list[int] = []
    for row in range(incidence.shape[0]):
        if np.linalg.matrix_rank(incidence[[*chosen, row]]) > len(chosen):
            chosen.append(row)
    basis = np.linalg.lstsq(incidence[chosen].T, incidence.T, rcond=None)[0].T
    basis[np.abs(basis) < 1e-12] = 0.0
    return tuple(chosen), np.ascontiguousarray(basis)


def full_order(parameters: DrivelineParameters) -> Structure:
    """Build the full-order model (18 inertias unlocked; 16 DOF in parallel G1)."""
    position = {name: index for index, name in enumerate(INERTIAS)}
    radius = parameters.base_radii
    n = len(INERTIAS)
    incidence = np.zeros((len(BRANCHES), n))
    for branch, (_, start, end, r_start, r_end) in enumerate(BRANCHES):
        incidence[branch, position[start]] = radius[r_start] if r_start else 1.0
        incidence[branch, position[end]] = -(radius[r_end] if r_end else 1.0)
    stiffness = np.diag([parameters.stiffness[f"k{name}"] for name, *_ in BRANCHES])
    damping = np.diag([parameters.damping[f"c{name}"] for name, *_ in BRANCHES])
    locks = np.zeros((len(LOCKS), n))
    for lock, (plus, minus) in enumerate(
        (
            ("Jc1", "Jc2"),
            ("Jsleeve", "Jg11"),
            ("Jsleeve", "Jg21"),
            ("Jlw", ""),
            ("Jrw", ""),
            ("Jv", ""),
        )
    ):
        locks[lock, position[plus]] = 1.0
        if minus:
            locks[lock, position[minus]] = -1.0
    ports = np.zeros((N_PORTS, n))
    for port, name in enumerate(("Je", "Jm1", "Jm2", "Jv")):
        ports[port, position[name]] = 1.0
    independent, basis = _independent_rows(incidence)
    nq = len(independent)
    return Structure(
        model="16dof",
        names=INERTIAS,
        inertia=np.array([parameters.inertias[name] for name in INERTIAS]),
        incidence=incidence,
        branch_names=tuple(f"k{name}" for name, *_ in BRANCHES),
        stiffness=np.repeat(stiffness[None], 6, axis=0),
        damping=np.repeat(damping[None], 6, axis=0),
        basis=basis,
        independent=independent,
        ports=ports,
        locks=locks,
        twist_remap=np.broadcast_to(np.eye(nq), (6, 6, nq, nq)).copy(),
    )
