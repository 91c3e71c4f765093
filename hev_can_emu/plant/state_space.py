"""The linear driveline in as few states as it has, with every state, input and output named.

States are the speeds of what moves on its own in the configuration and the independent twists: no
absolute angles, so a rigid-body mode is one integrator, not a growing angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from hev_can_emu.plant.structure import BODY, LEFT, RIGHT, Configuration, Structure

Array = npt.NDArray[np.float64]


class Named(NamedTuple):
    """A state, input or output: its name and SI unit."""

    name: str
    unit: str


@dataclass(frozen=True)
class StateSpace:
    """``x' = A x + B u``, ``y = C x + D u``.

    Attributes:
        a: shape (nx, nx).
        b: shape (nx, nu).
        c: shape (ny, nx).
        d: shape (ny, nu).
        states: nx names with units.
        inputs: nu names with units.
        outputs: ny names with units.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    states: tuple[Named, ...]
    inputs: tuple[Named, ...]
    outputs: tuple[Named, ...]

    def output(self, name: str) -> int:
        """Return the row of the output ``name``; raises ValueError where there is none."""
        return [output.name for output in self.outputs].index(name)

    def input(self, name: str) -> int:
        """Return the column of the input ``name``; raises ValueError where there is none."""
        return [one.name for one in self.inputs].index(name)


# Friction torques as inputs: on the lock's first side, against its second.  The body's own
# lock is left out: its torque would act where the road's does.
_FRICTION = ("c1_torque", "g1_torque", "g2_torque", "brake_left_torque", "brake_right_torque")
_TORQUES = ("engine_torque", "em1_torque", "em2_torque", "road_torque")


def state_space(
    structure: Structure, configuration: Configuration, tyre_radius: float
) -> StateSpace:
    """Return the configuration's linear system in minimal coordinates.

    Args:
        structure: full-order or reduced.
        configuration: one of the driving configurations (nothing held by a brake).
        tyre_radius: m.

    Returns:
        States: free speeds (rad/s), then independent twists (rad, for a mesh m).  Inputs: torques
        at the ports and friction torques of the locks that are open (N m, positive forward; friction
        on the lock's first side, against its second).  Outputs: speeds, vehicle speed and
        acceleration, and the torques in half shafts and tyres.
    """
    transform = structure.lock_map(configuration)
    free = transform.shape[1]
    at = configuration.driving
    stiffness, damping = structure.stiffness[at], structure.damping[at]
    reach = structure.incidence @ transform
    inverse = np.linalg.inv(transform.T @ (structure.inertia[:, None] * transform))
    nx = free + structure.nq
    a = np.zeros((nx, nx))
    a[:free, :free] = -inverse @ reach.T @ damping @ reach
    a[:free, free:] = -inverse @ reach.T @ stiffness @ structure.basis
    a[free:, :free] = reach[list(structure.independent)]

    held = configuration.locks
    open_locks = [lock for lock in range(len(_FRICTION)) if not held[lock]]
    acting = np.vstack([structure.ports, structure.locks[open_locks]])
    b = np.zeros((nx, len(acting)))
    b[:free] = inverse @ (acting @ transform).T
    names = (*_TORQUES, *(_FRICTION[lock] for lock in open_locks))

    c, d, outputs = _outputs(structure, configuration, a, b, tyre_radius)
    speeds = tuple(
        Named(f"speed_{name.partition('+')[0]}", "rad/s")
        for name in structure.free_names(configuration)
    )
    twists = tuple(_twist(structure.branch_names[row]) for row in structure.independent)
    return StateSpace(
        a, b, c, d, speeds + twists, tuple(Named(name, "N m") for name in names), outputs
    )


def _twist(branch: str) -> Named:
    mesh = branch in ("km1", "kid", "km2", "kg1", "kg2", "kfd")
    return Named(f"twist_{branch.removeprefix('k')}", "m" if mesh else "rad")


def _outputs(
    structure: Structure, configuration: Configuration, a: Array, b: Array, tyre_radius: float
) -> tuple[Array, Array, tuple[Named, ...]]:
    transform = structure.lock_map(configuration)
    free = transform.shape[1]
    nx, nu = b.shape
    speeds = {
        "engine_speed": structure.ports[0],
        "em1_speed": structure.ports[1],
        "em2_speed": structure.ports[2],
        "left_wheel_speed": structure.locks[LEFT],
        "right_wheel_speed": structure.locks[RIGHT],
        "body_speed": structure.locks[BODY],
    }
    rows: list[Array] = []
    feeds: list[Array] = []
    outputs: list[Named] = []

    def add(name: str, unit: str, row: Array, feed: Array) -> None:
        outputs.append(Named(name, unit))
        rows.append(row)
        feeds.append(feed)

    for name, weights in speeds.items():
        add(name, "rad/s", np.concatenate([weights @ transform, np.zeros(nx - free)]), np.zeros(nu))
    body = tyre_radius * rows[-1]
    add("vehicle_speed", "m/s", body, np.zeros(nu))
    add("vehicle_acceleration", "m/s^2", body @ a, body @ b)
    at = configuration.driving
    # The last four branches of either model: left and right half shaft, left and right tyre.
    last = slice(len(structure.branch_names) - 4, None)
    twisting = structure.stiffness[at][last] @ structure.basis
    sliding = structure.damping[at][last] @ structure.incidence @ transform
    for side, name in enumerate(("left_half_shaft", "right_half_shaft", "left_tyre", "right_tyre")):
        row = np.concatenate([sliding[side], twisting[side]])
        add(f"{name}_torque", "N m", row, np.zeros(nu))
    return np.array(rows), np.array(feeds), tuple(outputs)


def discrete(system: StateSpace, step: float) -> tuple[Array, Array]:
    """Return the exact zero-order-hold matrices of ``x[k+1] = Ad x[k] + Bd u[k]``; ``step`` in s."""
    nx, nu = system.b.shape
    whole = np.zeros((nx + nu, nx + nu))
    whole[:nx, :nx], whole[:nx, nx:] = system.a, system.b
    propagator = expm(whole * step)
    return propagator[:nx, :nx], propagator[:nx, nx:]


def simulate(
    system: StateSpace, inputs: Array, step: float, start: Array | None = None
) -> tuple[Array, Array]:
    """Return states and outputs on the grid, exact for inputs constant over each step.

    Args:
        system: nx states, nu inputs, ny outputs.
        inputs: shape (steps, nu), in force from each grid point on.
        step: s.
        start: shape (nx,), states at the first grid point; at rest without.

    Returns:
        States of shape (steps, nx) and outputs of shape (steps, ny), at the steps' beginnings.
    """
    ad, bd = discrete(system, step)
    states = np.zeros((len(inputs), len(ad)))
    if start is not None:
        states[0] = start
    for k in range(len(inputs) - 1):
        states[k + 1] = ad @ states[k] + bd @ inputs[k]
    return states, states @ system.c.T + inputs @ system.d.T
