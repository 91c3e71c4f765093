"""Frequency weighting of vibration, ISO 2631-1:1997, annex A: filters in second-order sections.

Each section of the standard's transfer functions (band limits, acceleration-velocity transition,
upward step) becomes a digital one by the bilinear transform, which at 1 ms keeps within the standard's
tolerance up to 80 Hz.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel

Array = npt.NDArray[np.float64]


class _Corners(NamedTuple):
    """Corner frequencies, Hz, and resonant quality factors of table A.1; infinite: no such filter."""

    f3: float
    f4: float
    q4: float
    f5: float
    q5: float
    f6: float
    q6: float


_BAND = (0.4, 100.0)
_CORNERS = {
    "Wk": _Corners(12.5, 12.5, 0.63, 2.37, 0.91, 3.35, 0.91),  # vertical
    "Wd": _Corners(2.0, 2.0, 0.63, math.inf, 0.0, math.inf, 0.0),  # horizontal
}
WEIGHTINGS = ("none", *_CORNERS)


def _sections(name: str) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """Return numerators and denominators in s, highest power first."""
    low, high = (2.0 * math.pi * each for each in _BAND)
    corners = _CORNERS[name]
    w3, w4 = 2.0 * math.pi * corners.f3, 2.0 * math.pi * corners.f4
    found = [
        ((1.0, 0.0, 0.0), (1.0, math.sqrt(2.0) * low, low * low)),
        ((0.0, 0.0, high * high), (1.0, math.sqrt(2.0) * high, high * high)),
        ((0.0, w4 * w4 / w3, w4 * w4), (1.0, w4 / corners.q4, w4 * w4)),
    ]
    if math.isfinite(corners.f5):
        w5, w6 = 2.0 * math.pi * corners.f5, 2.0 * math.pi * corners.f6
        found.append(
            ((1.0, w5 / corners.q5, w5 * w5), (1.0, w6 / corners.q6, w6 * w6)),
        )
    return found


def weighting_filter(name: str, period_s: float) -> Array:
    """Return the filter's sections, shape (n, 5): b0, b1, b2, a1, a2; of ``none``, (0, 5)."""
    if name == "none":
        return np.empty((0, 5))
    k = 2.0 / period_s
    rows = []
    for (b0, b1, b2), (a0, a1, a2) in _sections(name):
        norm = a0 * k * k + a1 * k + a2
        rows.append(
            [
                (b0 * k * k + b1 * k + b2) / norm,
                2.0 * (b2 - b0 * k * k) / norm,
                (b0 * k * k - b1 * k + b2) / norm,
                2.0 * (a2 - a0 * k * k) / norm,
                (a0 * k * k - a1 * k + a2) / norm,
            ]
        )
    return np.array(rows)


@kernel
def weigh(sections: Array, memory: Array, values: Array) -> None:
    """Filter ``values`` in place; ``memory``, shape (n, 2), carries the filter's state on."""
    for s in range(sections.shape[0]):
        b0, b1, b2 = sections[s, 0], sections[s, 1], sections[s, 2]
        a1, a2 = sections[s, 3], sections[s, 4]
        m1, m2 = memory[s, 0], memory[s, 1]
        for i in range(values.shape[0]):
            x = values[i]
            y = b0 * x + m1
            m1 = b1 * x - a1 * y + m2
            m2 = b2 * x - a2 * y
            values[i] = y
        memory[s, 0], memory[s, 1] = m1, m2
