"""The picture of a run: speeds, torques and driving mode on one time axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hev_can_emu.report import ribbons as rows
from hev_can_emu.report import style
from hev_can_emu.report.ribbons import Ribbon, StepMarker

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

# Key in the series handed in, label, colour, line width.
SPEEDS = (
    ("engine_speed_rpm", "engine", style.VERMILION, 2.0),
    ("em1_speed_rpm", "EM1", style.BLUE, 2.0),
    ("em2_speed_rpm", "EM2", style.GREEN, 2.0),
)
VEHICLE_SPEED = "vehicle_speed_kmh"
TORQUES = (
    ("engine_torque_nm", "engine", style.VERMILION, 2.0),
    ("em1_torque_nm", "EM1", style.BLUE, 2.0),
    ("em2_torque_nm", "EM2", style.GREEN, 2.0),
    ("clutch_torque_nm", "clutch C1, transmitted", style.PURPLE, 1.4),
)


def plot_run(
    path: Path,
    t_s: NDArray[np.float64],
    series: Mapping[str, NDArray[np.float64]],
    ribbons: Sequence[Ribbon],
    title: str,
    steps: Sequence[StepMarker] = (),
) -> None:
    """Draw a run for a person to read at a glance.

    Args:
        path: the picture's file: .png, .svg or .pdf.
        t_s: instants in s, rising, shape (n,).
        series: curves of shape (n,) under the keys of ``SPEEDS``, ``VEHICLE_SPEED`` and ``TORQUES``;
            those absent are left out, NaN leaves a gap.
        ribbons: rows under the curves, the first, usually the driving mode, higher than the others.
        title: the picture's title.
        steps: instants to mark through all panels.

    Raises:
        InputError: matplotlib is missing, or the file cannot be written.
        ValueError: a curve's length is not that of ``t_s``.
    """
    style.check_path(path)
    for key, values in series.items():
        if len(values) != len(t_s):
            raise ValueError(f"series[{key!r}]: expected {len(t_s)} values, got {len(values)}")
    figure = style.new_figure()
    strip, speed, torque, ribbon = _panels(figure, len(ribbons), bool(steps))
    style.add_title(figure, title)
    _draw_speeds(speed, t_s, series)
    _draw_curves(torque, t_s, series, TORQUES, "torque (N·m)")
    if len(t_s):
        speed.set_xlim(float(t_s[0]), float(t_s[-1]) if t_s[-1] > t_s[0] else float(t_s[0]) + 1.0)
    rows.draw_ribbons(ribbon, ribbons)
    for marker in steps:
        for axes in (speed, torque, ribbon):
            axes.axvline(marker.time_s, color=style.FAINT, linewidth=0.9, linestyle=(0, (3, 3)))
    rows.draw_step_labels(strip, steps)
    style.save(figure, path)


def _panels(figure: Figure, rows: int, has_steps: bool) -> tuple[Any, Any, Any, Any]:
    """Lay out the strip of step labels, the speeds, the torques and the ribbons."""
    heights = [1.25 if has_steps else 0.05, 4.0, 3.4, 0.35 + 0.4 * max(rows, 1)]
    grid = figure.add_gridspec(
        4, 1, height_ratios=heights, left=0.075, right=0.925, top=0.945, bottom=0.06, hspace=0.2
    )
    speed = figure.add_subplot(grid[1])
    strip = figure.add_subplot(grid[0], sharex=speed)
    torque = figure.add_subplot(grid[2], sharex=speed)
    ribbon = figure.add_subplot(grid[3], sharex=speed)
    strip.set_axis_off()
    for axes in (speed, torque):
        axes.tick_params(labelbottom=False)
    return strip, speed, torque, ribbon


def _draw_curves(
    axes: Axes,
    t_s: NDArray[np.float64],
    series: Mapping[str, NDArray[np.float64]],
    curves: Sequence[tuple[str, str, str, float]],
    ylabel: str,
) -> None:
    style.clean(axes, ylabel)
    axes.axhline(0.0, color=style.FAINT, linewidth=0.9)
    drawn = 0
    for key, label, colour, width in curves:
        if key in series:
            axes.plot(t_s, series[key], color=colour, linewidth=width, label=label)
            drawn += 1
    axes.margins(y=0.06)
    if drawn:
        style.legend_above(axes)


def _draw_speeds(
    axes: Axes, t_s: NDArray[np.float64], series: Mapping[str, NDArray[np.float64]]
) -> None:
    _draw_curves(axes, t_s, series, SPEEDS, "speed (rpm)")
    if VEHICLE_SPEED not in series:
        return
    right = axes.twinx()
    (line,) = right.plot(
        t_s, series[VEHICLE_SPEED], color=style.INK, linewidth=2.4, linestyle=(0, (5, 1.5))
    )
    right.set_ylabel("vehicle (km/h), dashed", size=12, color=style.INK)
    right.tick_params(colors=style.INK, labelsize=11, length=3, color=style.FAINT)
    for side in ("top", "left", "bottom"):
        right.spines[side].set_visible(False)
    right.spines["right"].set_color(style.FAINT)
    # Both zeros at one height, or a reader takes a standing car for a moving one; and the vehicle lower
    # than EM2, which is geared to it: else one curve would hide the other.
    low, high = axes.get_ylim()
    top = max(1.0, 1.45 * _largest(series[VEHICLE_SPEED]))
    axes.set_ylim(min(low, 0.0), max(high, 1.0))
    low, high = axes.get_ylim()
    right.set_ylim(top * low / high, top)
    line.set_label("vehicle (right axis)")
    style.legend_above(axes, line)


def _largest(values: NDArray[np.float64]) -> float:
    """Return the largest value that is available, or 0."""
    there = values[np.isfinite(values)]
    return float(there.max()) if len(there) else 0.0
