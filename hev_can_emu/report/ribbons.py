"""Rows of coloured, named segments along a time axis, and the labels of a scenario's steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hev_can_emu.report import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Text
    from numpy.typing import NDArray

# Light fills under dark text; names not listed take the spare ones in order of appearance.
_FILLS = {
    "series": "#fbd9a5",
    "parallel_g1": "#a9d3ee",
    "parallel_g2": "#5fa8d6",
    "electric_neutral": "#c3e6d8",
    "electric_g1": "#8fd0b6",
    "electric_g2": "#54b493",
    "neutral": "#eceff1",
    "g1": "#a9d3ee",
    "g2": "#5fa8d6",
    "open": "#eceff1",
    "slipping": "#f4b183",
    "closed": "#d3b3d3",
    "locked": "#d3b3d3",
}
_LINES = 6
_SPARE_FILLS = ("#e8d5b5", "#cfd8dc", "#f3c6c6", "#d7ccc8", "#dce775")


class Segment(NamedTuple):
    """One stretch of a ribbon: from ``start_s`` to ``end_s``, under ``label``."""

    start_s: float
    end_s: float
    label: str


class Ribbon(NamedTuple):
    """A named row of coloured segments: what the driving mode, the gear or the clutch was, when."""

    name: str
    segments: Sequence[Segment]


class StepMarker(NamedTuple):
    """An instant at which a step of the scenario began."""

    time_s: float
    label: str


def segments_of(
    t_s: NDArray[np.float64], codes: NDArray[np.float64], names: Mapping[int, str]
) -> list[Segment]:
    """Turn a sampled state into segments.

    Args:
        t_s: instants in s, rising, shape (n,).
        codes: the state's raw value at each instant, shape (n,); NaN, not available, leaves a gap.
        names: label of each raw value; a value without one is shown as its number.
    """
    if len(t_s) == 0:
        return []
    changed = np.flatnonzero(
        (codes[1:] != codes[:-1]) & ~(np.isnan(codes[1:]) & np.isnan(codes[:-1]))
    )
    starts = np.concatenate(([0], changed + 1))
    ends = np.concatenate((changed + 1, [len(t_s) - 1]))
    return [
        Segment(float(t_s[a]), float(t_s[b]), names.get(int(codes[a]), str(int(codes[a]))))
        for a, b in zip(starts, ends, strict=True)
        if not np.isnan(codes[a]) and t_s[b] > t_s[a]
    ]


def draw_ribbons(axes: Axes, ribbons: Sequence[Ribbon]) -> None:
    """Draw each ribbon as a row, the first, the main one, higher than the others.

    A label that does not fit into any of its segments is explained in a legend below instead.
    """
    style.clean(axes)
    axes.grid(False)
    axes.spines["left"].set_visible(False)
    axes.set_xlabel("time (s)", size=12, color=style.INK)
    heights = [1.0 if index == 0 else 0.62 for index in range(len(ribbons))]
    bottoms = -np.cumsum(np.asarray(heights) + 0.18)
    fills = _fills_for(ribbons)
    written: set[str] = set()
    for ribbon, height, bottom in zip(ribbons, heights, bottoms, strict=True):
        for segment in ribbon.segments:
            axes.broken_barh(
                [(segment.start_s, segment.end_s - segment.start_s)],
                (float(bottom), height),
                facecolors=fills[segment.label],
                edgecolors="white",
                linewidth=1.2,
            )
            size, weight = (13, "bold") if height == 1.0 else (11, "normal")
            text = axes.text(
                (segment.start_s + segment.end_s) / 2,
                float(bottom) + height / 2,
                readable(segment.label),
                ha="center",
                va="center_baseline",
                size=size,
                weight=weight,
                color=style.INK,
            )
            if _width(text) > _span(axes, segment.start_s, segment.end_s) - 6.0:
                text.remove()
            else:
                written.add(segment.label)
    axes.set_ylim(float(bottoms[-1]) - 0.1 if len(ribbons) else -1.0, 0.0)
    axes.set_yticks(
        [float(b) + h / 2 for b, h in zip(bottoms, heights, strict=True)],
        [ribbon.name for ribbon in ribbons],
    )
    axes.tick_params(axis="y", length=0, labelsize=12)
    _explain(axes, {label: fills[label] for label in fills if label not in written})


def draw_step_labels(axes: Axes, steps: Sequence[StepMarker]) -> None:
    """Write each step's label to the right of its instant, in up to ``_LINES`` lines.

    An earlier label goes above all later ones that it reaches over, so no stem crosses a text.
    Where the lines are too few, the label is left out; its marker through the panels stays.
    """
    axes.set_ylim(0.0, float(_LINES))
    placed: list[tuple[float, int]] = []
    for marker in sorted(steps, reverse=True):
        text = axes.text(
            marker.time_s, 0.0, f" {marker.label}", ha="left", va="bottom", size=11, color=style.INK
        )
        box = text.get_window_extent()
        line = 1 + max((line for left, line in placed if left < box.x1 + 6.0), default=-1)
        if line >= _LINES or box.x1 > axes.figure.bbox.x1:
            text.remove()
            continue
        text.set_y(float(line))
        placed.append((float(box.x0), line))
        axes.plot(
            [marker.time_s] * 2, [0.0, line + 0.8], color=style.FAINT, linewidth=0.9, clip_on=False
        )


def readable(label: str) -> str:
    """Return ``parallel_g1`` as ``parallel G1``: what a person reads in a picture."""
    words = label.replace("_", " ").split(" ")
    return " ".join(word.upper() if word in {"g1", "g2"} else word for word in words)


def _fills_for(ribbons: Sequence[Ribbon]) -> dict[str, str]:
    """Give every label a colour, known ones their own."""
    fills: dict[str, str] = {}
    spare = 0
    for label in (segment.label for ribbon in ribbons for segment in ribbon.segments):
        if label not in fills:
            known = _FILLS.get(label.lower().replace(" ", "_"))
            fills[label] = known or _SPARE_FILLS[spare % len(_SPARE_FILLS)]
            spare += known is None
    return fills


def _explain(axes: Axes, fills: Mapping[str, str]) -> None:
    """Put the colours of labels that found no room under the time axis, right-aligned.

    The axis's label gives way to the left then.
    """
    if not fills:
        return
    axes.xaxis.label.set(horizontalalignment="left", x=0.0)
    from matplotlib.patches import Patch

    axes.legend(
        handles=[Patch(facecolor=fill, label=readable(label)) for label, fill in fills.items()],
        loc="upper right",
        bbox_to_anchor=(1.0, -0.2),
        ncols=len(fills),
        frameon=False,
        fontsize=11,
        borderaxespad=0.0,
        labelcolor=style.INK,
    )


def _width(text: Text) -> float:
    """Return a text's width in dots."""
    return float(text.get_window_extent().width)


def _span(axes: Axes, start: float, end: float) -> float:
    """Return the width in dots between two instants."""
    left, right = axes.transData.transform([(start, 0.0), (end, 0.0)])[:, 0]
    return float(right - left)
