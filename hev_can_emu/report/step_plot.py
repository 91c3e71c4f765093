"""The picture of a step response: two models' speed and acceleration, and what sets them apart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hev_can_emu.report import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

# Of the inset, in fractions of its axes: width and height, room for its labels, where it may stand.
_INSET = (0.31, 0.4)
_MARGIN = 0.08
_CORNERS = ((0.06, 0.44), (0.66, 0.44), (0.66, 0.14), (0.06, 0.14))


class Response(NamedTuple):
    """One model's answer, sampled at the instants that go with it: arrays of shape (n,)."""

    name: str
    velocity_m_s: NDArray[np.float64]
    acceleration_m_s2: NDArray[np.float64]


def plot_step_response(
    path: Path,
    t_s: NDArray[np.float64],
    reference: Response,
    other: Response,
    title: str,
    notes: Sequence[str] = (),
) -> None:
    """Draw two responses over each other, with the difference in an inset of each panel.

    Args:
        path: the picture's file: .png, .svg or .pdf.
        t_s: instants in s, rising, shape (n,).
        reference: the model to compare with, drawn as a broad line.
        other: the model compared, drawn dashed on top; the difference is ``other - reference``.
        title: the picture's title.
        notes: findings, one line for each panel from above, written under its heading.

    Raises:
        InputError: matplotlib is missing, or the file cannot be written.
        ValueError: a response's length is not that of ``t_s``.
    """
    style.check_path(path)
    for response in (reference, other):
        for values in (response.velocity_m_s, response.acceleration_m_s2):
            if values.shape != t_s.shape:
                raise ValueError(f"{response.name}: expected {t_s.shape}, got {values.shape}")
    figure = style.new_figure()
    style.add_title(figure, title)
    grid = figure.add_gridspec(2, 1, left=0.06, right=0.98, top=0.9, bottom=0.065, hspace=0.2)
    speed = figure.add_subplot(grid[0])
    acceleration = figure.add_subplot(grid[1], sharex=speed)
    heading = f"{other.name} − {reference.name}"
    panels = (
        (speed, "velocity (m/s)", reference.velocity_m_s, other.velocity_m_s, "mm/s"),
        (
            acceleration,
            "acceleration (m/s²)",
            reference.acceleration_m_s2,
            other.acceleration_m_s2,
            "mm/s²",
        ),
    )
    for row, (axes, ylabel, first, second, unit) in enumerate(panels):
        style.clean(axes, ylabel)
        axes.plot(t_s, first, color=style.SKY, linewidth=4.0, label=reference.name)
        axes.plot(
            t_s, second, color=style.VERMILION, linewidth=1.5, dashes=(5, 2), label=other.name
        )
        style.legend_above(axes)
        if row < len(notes):
            axes.set_title(notes[row], loc="right", size=12, color=style.INK)
        _draw_difference(axes, t_s, 1e3 * (second - first), f"{heading} ({unit})", first)
    speed.tick_params(labelbottom=False)
    acceleration.set_xlabel("time (s)", size=12, color=style.INK)
    if len(t_s) > 1:
        speed.set_xlim(float(t_s[0]), float(t_s[-1]))
    style.save(figure, path)


def _draw_difference(
    axes: Axes,
    t_s: NDArray[np.float64],
    difference: NDArray[np.float64],
    heading: str,
    curve: NDArray[np.float64],
) -> None:
    """Draw the difference, from where it begins, in an inset that hides little of ``curve``."""
    inset = axes.inset_axes((*_freest_corner(axes, t_s, curve), *_INSET))
    style.clean(inset)
    inset.axhline(0.0, color=style.FAINT, linewidth=0.9)
    inset.plot(t_s, difference, color=style.INK, linewidth=1.3)
    inset.set_title(heading, size=11, color=style.INK, loc="left")
    inset.tick_params(labelsize=10)
    begun = np.flatnonzero(difference)
    first = max(int(begun[0]) - 1, 0) if len(begun) else 0
    if len(t_s) > first + 1:
        inset.set_xlim(float(t_s[first]), float(t_s[-1]))


def _freest_corner(
    axes: Axes, t_s: NDArray[np.float64], curve: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the corner of ``_CORNERS`` where an inset hides the fewest points of the curve."""
    low, high = axes.get_ylim()
    x = (t_s - t_s[0]) / (t_s[-1] - t_s[0]) if len(t_s) > 1 else t_s
    y = (curve - low) / (high - low)

    def hidden(corner: tuple[float, float]) -> int:
        left, bottom = corner
        inside = (x > left - _MARGIN) & (x < left + _INSET[0] + _MARGIN / 2)
        inside &= (y > bottom - _MARGIN) & (y < bottom + _INSET[1] + _MARGIN)
        return int(np.count_nonzero(inside))

    return min(_CORNERS, key=hidden)
