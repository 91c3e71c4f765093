"""The picture of a comparison: the same quantities of several runs over each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hev_can_emu.report import ribbons, style
from hev_can_emu.report.ribbons import StepMarker

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_WIDTHS = (3.6, 2.0, 1.3, 1.3, 1.3, 1.3)
_COLOURS = (style.SKY, style.VERMILION, style.INK, style.GREEN, style.PURPLE, style.ORANGE)


class Curve(NamedTuple):
    """One run's samples: arrays of shape (n,); ``times_s`` may differ from run to run."""

    name: str
    times_s: NDArray[np.float64]
    values: NDArray[np.float64]


class Panel(NamedTuple):
    """One quantity: the label of its axis, and a curve per run."""

    label: str
    curves: Sequence[Curve]


def plot_comparison(
    path: Path, panels: Sequence[Panel], title: str, steps: Sequence[StepMarker] = ()
) -> None:
    """Draw one panel below the other; the first run's curves lie lowest and broadest.

    Args:
        path: the picture's file: .png, .svg or .pdf.
        panels: at least one, each with the same runs in the same order.
        title: the picture's title.
        steps: instants to mark through all panels.

    Raises:
        InputError: matplotlib is missing, or the file cannot be written.
        ValueError: a curve's arrays differ in length.
    """
    style.check_path(path)
    for panel in panels:
        for curve in panel.curves:
            if curve.times_s.shape != curve.values.shape:
                raise ValueError(
                    f"{curve.name}: expected {curve.times_s.shape}, got {curve.values.shape}"
                )
    figure = style.new_figure(height_in=max(4.0, 1.6 + 2.1 * len(panels)))
    height = figure.get_size_inches()[1]
    style.add_title(figure, title)
    grid = figure.add_gridspec(
        len(panels) + 1, 1, height_ratios=[0.5, *(1.0 for _ in panels)], left=0.06, right=0.985,
        top=1.0 - 0.6 / height, bottom=0.55 / height, hspace=0.16,
    )  # fmt: skip
    shown = [figure.add_subplot(grid[1])]
    shown += [figure.add_subplot(grid[row + 2], sharex=shown[0]) for row in range(len(panels) - 1)]
    strip = figure.add_subplot(grid[0], sharex=shown[0])
    strip.set_axis_off()
    for axes, panel in zip(shown, panels, strict=True):
        style.clean(axes, panel.label)
        for index, curve in enumerate(panel.curves):
            axes.plot(
                curve.times_s,
                curve.values,
                color=_COLOURS[index % len(_COLOURS)],
                linewidth=_WIDTHS[index % len(_WIDTHS)],
                label=curve.name,
            )
        for step in steps:
            axes.axvline(step.time_s, color=style.FAINT, linewidth=0.9, linestyle=(0, (3, 3)))
        axes.tick_params(labelbottom=axes is shown[-1])
    shown[-1].set_xlabel("time (s)", size=12, color=style.INK)
    times = panels[0].curves[0].times_s
    if len(times) > 1:
        shown[0].set_xlim(float(times[0]), float(times[-1]))
    ribbons.draw_step_labels(strip, steps)
    handles, names = shown[0].get_legend_handles_labels()
    figure.legend(
        handles, names, loc="upper right", ncols=len(names), frameon=False, fontsize=13,
        labelcolor=style.INK,
    )  # fmt: skip
    style.save(figure, path)
