"""Linear analysis: natural frequencies, damping, mode shapes and state-space matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant.structure import N_PORTS, Configuration, Structure

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Modes:
    """The elastic modes of a configuration, lowest first.

    Attributes:
        names: what moves on its own (rows of ``shapes``), see :func:`moving_parts`.
        rigid: number of rigid-body modes left out.
        undamped_hz: shape (m,), from ``K v = w^2 J v``.
        damped_hz: shape (m,), ``|lambda|/2pi`` of the damped eigenvalues (what Table 2 calls damped).
        oscillation_hz: shape (m,), ``|Im(lambda)|/2pi``, the frequency at which it really oscillates.
        damping_ratio: shape (m,), ``-Re(lambda)/|lambda|``.
        shapes: shape (n, m), undamped shapes, each part turning at its own speed (not referred to
            the wheels), scaled to a largest entry of one.
    """

    names: tuple[str, ...]
    rigid: int
    undamped_hz: Array
    damped_hz: Array
    oscillation_hz: Array
    damping_ratio: Array
    shapes: Array


_LUMPED_NAMES = {"E": "JE", "M": "JM", "E+M": "JE+JM", "lw": "Jlw", "rw": "Jrw", "v": "Jv"}
_MERGED_NAMES = {"Jc1+Jc2": "Jc", "Jsleeve+Jg11": "Jsg1", "Jsleeve+Jg21": "Jsg2"}


def moving_parts(
    structure: Structure, configuration: Configuration
) -> tuple[tuple[str, ...], Array]:
    """Return what moves on its own, and the rows that turn free speeds into the parts' speeds.

    Inertias that a lock merges are one part, named as in the paper: ``Jc = Jc1+Jc2``,
    ``Jsg1 = Jsleeve+Jg11`` and ``Jsg2 = Jsleeve+Jg21``.  In the reduced model the lump that holds the
    differential is ``Jeq`` and turns at the differential's speed, also as in the paper.

    Returns:
        n names, and an array of shape (n, n).
    """
    transform = structure.lock_map(configuration)
    names, rows = [], []
    for column, name in enumerate(structure.free_names(configuration)):
        members = np.flatnonzero(np.abs(transform[:, column]) > 1e-12)
        rows.append(transform[members[-1]])
        if structure.model == "4dof":
            name = _LUMPED_NAMES.get(name, "Jeq")
        names.append(_MERGED_NAMES.get(name, name))
    return tuple(names), np.array(rows)


def modes(structure: Structure, configuration: Configuration) -> Modes:
    """Return the modes of ``structure`` in ``configuration``.

    The rigid-body space is split off before the eigenvalues are taken: zero eigenvalues of a
    defective pencil would otherwise come out anywhere within the square root of rounding.
    """
    from scipy import linalg  # a tenth of a second that a run need not spend

    transform = structure.lock_map(configuration)
    reach = structure.incidence @ transform
    rigid = transform.shape[1] - int(np.linalg.matrix_rank(reach))
    root = np.linalg.cholesky(transform.T @ (structure.inertia[:, None] * transform))
    whitened = linalg.solve_triangular(root, reach.T, lower=True).T
    stiff = np.linalg.cholesky(structure.stiffness[configuration.driving])
    # Singular values are the frequencies themselves; their squares would cost half the digits.
    _, singular, rows = np.linalg.svd(stiff.T @ whitened)
    m = transform.shape[1] - rigid
    omega = singular[:m][::-1]
    elastic = rows[:m][::-1].T
    names, parts = moving_parts(structure, configuration)
    shapes = parts @ linalg.solve_triangular(root, elastic, lower=True, trans="T")
    shapes = shapes / np.take_along_axis(shapes, np.abs(shapes).argmax(axis=0)[None], axis=0)
    bending = whitened @ elastic
    modal_c = bending.T @ structure.damping[configuration.driving] @ bending
    # Scaled to unit order: with plain w^2 blocks the smallest modes lose digits to the largest.
    state = np.block([[np.zeros((m, m)), np.diag(omega)], [-np.diag(omega), -modal_c]])
    values = linalg.eigvals(state)
    values = values[np.argsort(np.abs(values), kind="stable")]
    pairs = values.reshape(m, 2)
    magnitude = np.sqrt(np.abs(pairs[:, 0]) * np.abs(pairs[:, 1]))
    return Modes(
        names=names,
        rigid=rigid,
        undamped_hz=omega / (2 * np.pi),
        damped_hz=magnitude / (2 * np.pi),
        oscillation_hz=np.abs(pairs[:, 0].imag) / (2 * np.pi),
        damping_ratio=-pairs.real.mean(axis=1) / magnitude,
        shapes=shapes,
    )


def held_speeds(structure: Structure, configuration: Configuration) -> Array:
    """Return ``T (T'JT)^-1 T'``, shape (n, n): accelerations from torques with the locks held.

    Times J it is the momentum-keeping projection of speeds onto the held configuration.
    """
    transform = structure.lock_map(configuration)
    small = transform.T @ (structure.inertia[:, None] * transform)
    inverse: Array = transform @ np.linalg.solve(small, transform.T)
    return inverse


def state_space(structure: Structure, configuration: Configuration) -> tuple[Array, Array]:
    """Return A, B of ``x' = A x + B u`` in full coordinates.

    States are the n speeds (held pairs equal) and the nq independent twists; inputs the four port
    torques, then the friction torques of the locks (each on its lock's first side, against the second).

    Returns:
        A of shape (n+nq, n+nq), B of shape (n+nq, 4 + number of locks).
    """
    n, nq = structure.n, structure.nq
    inverse = held_speeds(structure, configuration)
    driving = configuration.driving
    a = np.zeros((n + nq, n + nq))
    a[:n, :n] = -inverse @ structure.incidence.T @ structure.damping[driving] @ structure.incidence
    a[:n, n:] = -inverse @ structure.incidence.T @ structure.stiffness[driving] @ structure.basis
    a[n:, :n] = structure.incidence[list(structure.independent)]
    b = np.zeros((n + nq, N_PORTS + len(structure.locks)))
    b[:n] = inverse @ np.vstack([structure.ports, structure.locks]).T
    return a, b
