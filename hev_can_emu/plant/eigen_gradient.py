"""Natural frequencies and damping with their analytic derivatives, for identification.

For ``K v = w^2 J v`` with ``v'Jv = 1``: ``d(w^2) = v'(dK - w^2 dJ)v``.  For the damped problem
``(l^2 J + l C + K) x = 0`` with symmetric matrices the left eigenvector is the right one, so
``dl = -x'(l^2 dJ + l dC + dK)x / x'(2 l J + C)x`` (no conjugation).  With ``K = B'diag(k)B`` and
``C = B'diag(c)B`` each term needs only the branch deflections ``B x``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]


class Chain(NamedTuple):
    """A linear chain: inertias (n,), incidence (nb, n), branch stiffness and damping (nb,)."""

    inertia: Array
    incidence: Array
    stiffness: Array
    damping: Array


class Gradient(NamedTuple):
    """Derivatives of m quantities by the logarithms of a chain's entries.

    ``incidence`` is by the logarithm of each incidence entry, shape (m, nb, n).
    """

    inertia: Array
    stiffness: Array
    damping: Array
    incidence: Array


class Undamped(NamedTuple):
    """Elastic modes, lowest first: rad/s (m,), inertia-normalised shapes (n, m); rigid shapes (n, r)."""

    omega: Array
    shapes: Array
    rigid: Array


class Damped(NamedTuple):
    """Eigenvalue pairs, smallest first: ``|l|`` in rad/s (m,), damping ratios (m,)."""

    magnitude: Array
    ratio: Array


def undamped(chain: Chain, rigid: int) -> Undamped:
    """Return the elastic modes of ``chain``, which has ``rigid`` rigid-body modes."""
    root = 1.0 / np.sqrt(chain.inertia)
    scaled = np.sqrt(chain.stiffness)[:, None] * chain.incidence * root
    # Singular values are the frequencies themselves; their squares would cost half the digits.
    _, omega, rows = np.linalg.svd(scaled)
    elastic = len(chain.inertia) - rigid
    shapes = root[:, None] * rows.T
    return Undamped(omega[:elastic][::-1], shapes[:, :elastic][:, ::-1], shapes[:, elastic:])


def undamped_gradient(chain: Chain, modes: Undamped) -> Gradient:
    """Return the derivatives of ``log w``."""
    bending = chain.incidence @ modes.shapes
    square = modes.omega**2
    by_inertia = -0.5 * (chain.inertia[:, None] * modes.shapes**2).T
    by_stiffness = 0.5 * (chain.stiffness[:, None] * bending**2 / square).T
    by_entry = np.einsum("bm,nm->mbn", chain.stiffness[:, None] * bending / square, modes.shapes)
    return Gradient(
        by_inertia, by_stiffness, np.zeros_like(by_stiffness), by_entry * chain.incidence
    )


def damped_modes(chain: Chain, modes: Undamped) -> tuple[Complex, Complex, Complex]:
    """Return eigenvalues (2m,), smallest first, shapes (n, 2m), and ``x'(2 l J + C)x`` (2m,)."""
    omega, shapes, _ = modes
    m = len(omega)
    bending = chain.incidence @ shapes
    modal = bending.T @ (chain.damping[:, None] * bending)
    # Scaled to unit order: with plain w^2 blocks the lowest modes lose digits to the highest.
    state = np.zeros((2 * m, 2 * m))
    state[:m, m:] = np.diag(omega)
    state[m:, :m] = -np.diag(omega)
    state[m:, m:] = -modal
    values, vectors = np.linalg.eig(state)
    order = np.argsort(np.abs(values), kind="stable")
    values = values[order].astype(complex)
    q = vectors[:m, order] / omega[:, None]
    norm: Complex = 2.0 * values * np.sum(q * q, axis=0) + np.sum(q * (modal @ q), axis=0)
    return values, (shapes @ q).astype(complex), norm


def step_acceleration(
    chain: Chain, rigid: int, torques: Array, node: int, step: float, count: int
) -> tuple[Array, Array]:
    """Return a node's speed and acceleration after a torque step from rest, by modal superposition.

    Args:
        chain: with ``rigid`` rigid-body modes, none of its damped modes critically damped.
        rigid: their number.
        torques: shape (n,), constant from time 0 on.
        node: whose motion.
        step: spacing of the results, s.
        count: their number; the first is at time 0.

    Returns:
        Speeds and accelerations, shape (count,).
    """
    modes = undamped(chain, rigid)
    values, x, norm = damped_modes(chain, modes)
    steady = float(modes.rigid[node] @ (modes.rigid.T @ torques))
    residues = x[node] * (torques @ x) / norm
    factors = np.tile(np.exp(values * step), (count, 1))
    factors[0] = 1.0
    waves = np.cumprod(factors, axis=0)
    times = step * np.arange(count)
    speed: Array = (waves @ residues).real + steady * times
    acceleration: Array = (waves @ (residues * values)).real + steady
    return speed, acceleration


def damped(chain: Chain, modes: Undamped) -> tuple[Damped, Gradient, Gradient]:
    """Return the damped modes and the derivatives of ``log |l|`` and of the damping ratio.

    Rigid-body modes feel no damping and are left out.  Where a mode is overdamped, its two real
    eigenvalues count as a pair.
    """
    values, x, norm = damped_modes(chain, modes)
    m = len(modes.omega)
    phi = chain.incidence @ x
    scale = -1.0 / norm
    impedance = chain.stiffness[:, None] + values * chain.damping[:, None]
    by_inertia = (values**2 * chain.inertia[:, None] * x**2 * scale).T
    by_stiffness = (chain.stiffness[:, None] * phi**2 * scale).T
    by_damping = (values * chain.damping[:, None] * phi**2 * scale).T
    by_entry = np.einsum("bm,nm->mbn", 2.0 * impedance * phi * scale, x) * chain.incidence

    magnitude = np.sqrt(np.abs(values[0::2]) * np.abs(values[1::2]))
    ratio = -0.5 * (values[0::2].real + values[1::2].real) / magnitude
    logarithms, ratios = [], []
    for part in (by_inertia, by_stiffness, by_damping, by_entry):
        flat = part.reshape(2 * m, -1)
        relative = (flat / values[:, None]).real
        log_magnitude = 0.5 * (relative[0::2] + relative[1::2])
        real = 0.5 * (flat[0::2].real + flat[1::2].real)
        by_ratio = -real / magnitude[:, None] - ratio[:, None] * log_magnitude
        logarithms.append(log_magnitude.reshape(m, *part.shape[1:]))
        ratios.append(by_ratio.reshape(m, *part.shape[1:]))
    return Damped(magnitude, ratio), Gradient(*logarithms), Gradient(*ratios)
