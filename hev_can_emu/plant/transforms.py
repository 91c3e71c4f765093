"""Clarke and Park transforms and their inverses, amplitude-invariant.

Phase quantities of peak X in a balanced system become a vector of length X, so that power is
``1.5*(v_d*i_d + v_q*i_q)`` (plus three times the product of the zero components).  The d axis lies on
the magnet flux, at the electrical angle counted from phase a.
"""

from __future__ import annotations

import math

from hev_can_emu.jit import kernel

_ROOT3 = math.sqrt(3.0)


@kernel
def clarke(a: float, b: float, c: float) -> tuple[float, float, float]:
    """Return the alpha, beta and zero components of three phase quantities, in their unit."""
    return (2.0 * a - b - c) / 3.0, (b - c) / _ROOT3, (a + b + c) / 3.0


@kernel
def inverse_clarke(alpha: float, beta: float, zero: float) -> tuple[float, float, float]:
    """Return the phase quantities a, b, c of alpha, beta and zero components."""
    half, side = 0.5 * alpha, 0.5 * _ROOT3 * beta
    return alpha + zero, zero - half + side, zero - half - side


@kernel
def park(alpha: float, beta: float, angle: float) -> tuple[float, float]:
    """Return the d and q components of a vector at rest, seen from a rotor at ``angle``, rad."""
    c, s = math.cos(angle), math.sin(angle)
    return c * alpha + s * beta, c * beta - s * alpha


@kernel
def inverse_park(d: float, q: float, angle: float) -> tuple[float, float]:
    """Return the alpha and beta components of a vector on a rotor at ``angle``, rad."""
    c, s = math.cos(angle), math.sin(angle)
    return c * d - s * q, s * d + c * q
