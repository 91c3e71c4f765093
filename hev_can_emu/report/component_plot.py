"""The picture of a component: what it does in a few panels, and below them known against computed values."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hev_can_emu.report import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

_PANEL_HEIGHT, _ROW_HEIGHT = 4.1, 0.27  # inches
_COLUMNS = (0.04, 0.5, 0.66, 0.82)  # of the facts: where each begins, as a share of the width


class Curve(NamedTuple):
    """A line, or single points where ``marker`` is given; dashed where it says what is known."""

    label: str
    x: NDArray[np.floating[Any]]
    y: NDArray[np.floating[Any]]
    dashed: bool = False
    marker: str = ""
    color: str = ""


class Panel(NamedTuple):
    """Curves over one pair of axes; ``bands`` are named spans of x, ``equal`` asks for equal scales."""

    title: str
    xlabel: str
    ylabel: str
    curves: Sequence[Curve]
    bands: Sequence[tuple[float, float, str]] = ()
    equal: bool = False


class Fact(NamedTuple):
    """A value known beforehand beside the one computed; they agree within ``tolerance`` of ``known``.

    Where ``known`` is 0 the tolerance is absolute.
    """

    what: str
    unit: str
    known: float
    computed: float
    tolerance: float

    @property
    def off(self) -> float:
        """How far they are apart, as a share of what is known, or absolutely where that is 0."""
        apart = abs(self.computed - self.known)
        return apart / abs(self.known) if self.known else apart

    @property
    def holds(self) -> bool:
        """Whether they agree."""
        return bool(self.off <= self.tolerance)


def plot_component(
    path: Path, title: str, panels: Sequence[Panel], facts: Sequence[Fact], note: str = ""
) -> None:
    """Draw a component's panels, two in a row, and its facts as a table below.

    Raises:
        InputError: matplotlib is missing, or the file cannot be written.
    """
    style.check_path(path)
    rows = -(-len(panels) // 2)
    table = _ROW_HEIGHT * (len(facts) + 2) + 0.25
    top = 1.2 + (0.2 if note else 0.0)
    height = top + _PANEL_HEIGHT * rows - 0.45 + table
    figure = style.new_figure(height_in=height)
    style.add_title(figure, title)
    if note:
        figure.text(
            0.0188, 1.0 - 0.52 / height, note, ha="left", va="top", size=11, color=style.FAINT
        )
    grid = figure.add_gridspec(
        rows,
        min(len(panels), 2),
        left=0.06,
        right=0.985,
        top=1.0 - top / height,
        bottom=(table + 0.6) / height,
        hspace=0.42,
        wspace=0.14,
    )
    for index, panel in enumerate(panels):
        _draw(figure.add_subplot(grid[index // 2, index % 2]), panel)
    for line, cells in enumerate(_table(facts)):
        at = (table - _ROW_HEIGHT * (line + 1)) / height
        for column, text in zip(_COLUMNS, cells, strict=True):
            figure.text(
                column,
                at,
                text,
                size=12,
                va="bottom",
                weight="bold" if line == 0 else "normal",
                color=style.INK if line else style.FAINT,
            )
    style.save(figure, path)


def _draw(axes: Axes, panel: Panel) -> None:
    style.clean(axes, panel.ylabel)
    axes.set_xlabel(panel.xlabel, size=12, color=style.INK)
    axes.set_title(panel.title, size=13, loc="left", color=style.INK, pad=26)
    for number, curve in enumerate(panel.curves):
        color = curve.color or style.SEQUENCE[number % len(style.SEQUENCE)]
        axes.plot(
            curve.x,
            curve.y,
            color=color,
            label=curve.label or None,
            linestyle="" if curve.marker else ("--" if curve.dashed else "-"),
            marker=curve.marker or None,
            markersize=8,
            linewidth=1.6 if curve.dashed else 2.2,
        )
    for number, (start, end, name) in enumerate(panel.bands):
        axes.axvspan(start, end, color=style.GRID if number % 2 else "#f5f6f7", zorder=0)
        axes.text(
            0.5 * (start + end),
            0.98,
            name,
            transform=axes.get_xaxis_transform(),
            ha="center",
            va="top",
            rotation=90,
            size=9,
            color=style.FAINT,
        )
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if any(curve.label for curve in panel.curves):
        style.legend_above(axes)
        legend = axes.get_legend()
        if legend is not None and sum(4 + len(curve.label) for curve in panel.curves) > 62:
            for text in legend.get_texts():
                text.set_fontsize(10)


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def _table(facts: Sequence[Fact]) -> list[tuple[str, str, str, str]]:
    lines = [("", "known", "computed", "apart")]
    for fact in facts:
        apart = f"{100.0 * fact.off:.2g} %" if fact.known else f"{fact.off:.2g}{_unit(fact.unit)}"
        lines.append(
            (
                fact.what,
                f"{fact.known:.7g}{_unit(fact.unit)}",
                f"{fact.computed:.7g}{_unit(fact.unit)}",
                f"{apart}{'' if fact.holds else '  TOO FAR'}",
            )
        )
    return lines
