"""The looks that all pictures share: colours, axes, how a figure is made and saved.

matplotlib is an optional dependency (extra ``plot``) and slow to import: it is imported only when a
picture is drawn, without pyplot and so without any global figure or display.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

INK = "#22272e"
FAINT = "#8a929c"
GRID = "#e4e7ea"

# Okabe and Ito's palette, which stays apart under the common colour vision deficiencies.
VERMILION = "#d55e00"
BLUE = "#0072b2"
GREEN = "#009e73"
PURPLE = "#aa4499"
SKY = "#56b4e9"
ORANGE = "#e69f00"
SEQUENCE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)

FORMATS = (".png", ".svg", ".pdf")
_WIDTH_IN, _HEIGHT_IN, _DOTS_PER_INCH = 16.0, 10.0, 100


def new_figure(width_in: float = _WIDTH_IN, height_in: float = _HEIGHT_IN) -> Figure:
    """Return an empty white figure, by default of 1600 by 1000 dots.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError(
            "plot", "matplotlib", "an installation without it", "pip install 'hev-can-emu[plot]'"
        ) from error
    figure = Figure(figsize=(width_in, height_in), dpi=_DOTS_PER_INCH, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def add_title(figure: Figure, title: str) -> None:
    """Write the title at the top left, in from the corner by the same distance both ways."""
    width, height = figure.get_size_inches()
    figure.text(
        0.3 / width,
        1.0 - 0.2 / height,
        title,
        ha="left",
        va="top",
        size=17,
        weight="bold",
        color=INK,
    )


def clean(axes: Axes, ylabel: str = "") -> None:
    """Take away what is not data: the box, dark ticks, a heavy grid."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
    axes.grid(True, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(colors=INK, labelsize=11, length=3, color=FAINT)
    axes.set_ylabel(ylabel, size=12, color=INK)


def legend_above(axes: Axes, *extra: Line2D) -> None:
    """Put the legend, with ``extra`` lines of another axes, in a row above, out of the data's way."""
    lines, _ = axes.get_legend_handles_labels()
    handles = [*lines, *extra]
    axes.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=max(len(handles), 1),
        frameon=False,
        fontsize=12,
        borderaxespad=0.2,
        borderpad=0.1,
        handlelength=1.8,
        labelcolor=INK,
    )


def check_path(path: Path) -> None:
    """Complain early about a file name whose ending is not one of ``FORMATS``.

    Raises:
        InputError: the ending is another.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            str(path), f"a file name ending in {', '.join(FORMATS)}", repr(path.suffix)
        )


def save(figure: Figure, path: Path) -> None:
    """Write the figure, without the date and the like: the same data, the same bytes.

    Raises:
        InputError: the ending is not one of ``FORMATS``, or the file cannot be written.
    """
    import matplotlib as mpl

    check_path(path)
    suffix = path.suffix.lower()
    metadata = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with mpl.rc_context({"svg.hashsalt": "hev-can-emu"}):
            figure.savefig(path, metadata=metadata[suffix])
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(str(path), "a file that can be written", reason) from error
