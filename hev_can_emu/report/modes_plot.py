"""The picture of mode shapes: relative amplitude over the inertias, a few modes a panel."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hev_can_emu.report import style

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MARKERS = ("o", "s", "^", "D", "v", "P")


def plot_modes(
    path: Path,
    inertias: Sequence[str],
    frequencies_hz: Sequence[float],
    shapes: NDArray[np.float64],
    title: str,
    modes_per_panel: int = 3,
) -> None:
    """Draw mode shapes, each scaled so that its largest amplitude is +1.

    Args:
        path: the picture's file: .png, .svg or .pdf.
        inertias: the inertias' names, in the order of the shapes' rows.
        frequencies_hz: natural frequency of each mode in Hz, for the legend.
        shapes: amplitudes, shape (inertias, modes), of any scale; first column is mode 1.
        title: the picture's title.
        modes_per_panel: how many modes share a panel.

    Raises:
        InputError: matplotlib is missing, or the file cannot be written.
        ValueError: the shapes do not match the inertias or the frequencies.
    """
    style.check_path(path)
    if shapes.shape != (len(inertias), len(frequencies_hz)):
        raise ValueError(
            f"shapes: expected {(len(inertias), len(frequencies_hz))}, got {shapes.shape}"
        )
    modes = len(frequencies_hz)
    panels = max(1, -(-modes // modes_per_panel))
    columns = 1 if panels == 1 else 2
    rows = -(-panels // columns)
    figure = style.new_figure(height_in=0.9 + 3.0 * rows if rows > 1 else 6.0)
    height = figure.get_size_inches()[1]
    grid = figure.add_gridspec(
        rows,
        columns,
        left=0.055,
        right=0.985,
        top=1.0 - 0.95 / height,
        bottom=0.7 / height,
        hspace=0.5,
        wspace=0.1,
    )
    style.add_title(figure, title)
    scaled = unit_shapes(shapes)
    positions = np.arange(len(inertias))
    for panel in range(panels):
        axes = figure.add_subplot(grid[panel // columns, panel % columns])
        style.clean(axes, "relative amplitude" if panel % columns == 0 else "")
        axes.axhline(0.0, color=style.FAINT, linewidth=1.0)
        first = panel * modes_per_panel
        for offset, mode in enumerate(range(first, min(first + modes_per_panel, modes))):
            axes.plot(
                positions,
                scaled[:, mode],
                color=style.SEQUENCE[offset % len(style.SEQUENCE)],
                marker=_MARKERS[offset % len(_MARKERS)],
                markersize=6,
                linewidth=1.8,
                label=f"mode {mode + 1}, {_hertz(frequencies_hz[mode])}",
            )
        axes.set_ylim(-1.1, 1.1)
        axes.set_yticks([-1.0, -0.5, 0.0, 0.5, 1.0])
        axes.set_xticks(positions, inertias, rotation=45 if len(inertias) > 8 else 0)
        style.legend_above(axes)
    style.save(figure, path)


def unit_shapes(shapes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the shapes (inertias, modes), each divided by its amplitude of largest magnitude."""
    peaks = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(shapes.shape[1])]
    return shapes / np.where(peaks == 0.0, 1.0, peaks)


def _hertz(frequency: float) -> str:
    """Return a frequency with four significant digits and its unit."""
    if frequency >= 1000.0:
        return f"{frequency / 1000.0:#.4g} kHz"
    return f"{frequency:#.4g} Hz"
