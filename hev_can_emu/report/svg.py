"""Drawing in SVG: axes, curves, rows.  Colours and strokes are classes; the page's style sheet has them."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

WIDTH = 1000.0
GUTTER = 172.0  #: left of the time axis: names of rows, numbers of scales
RIGHT = 14.0
_CHARACTER = 7.2  #: width of a character in the widest of the fonts, about


class Frame(NamedTuple):
    """Where a panel is drawn and what it shows: pixels from ``top``, time and values."""

    t0: float
    t1: float
    top: float
    height: float
    low: float = 0.0
    high: float = 1.0

    def x(self, t_s: float) -> float:
        """Return the place of an instant, within the frame."""
        share = (min(max(t_s, self.t0), self.t1) - self.t0) / (self.t1 - self.t0)
        return GUTTER + share * (WIDTH - GUTTER - RIGHT)

    def y(self, value: float) -> float:
        """Return the place of a value."""
        return self.top + self.height * (1.0 - (value - self.low) / (self.high - self.low))


def text(x: float, y: float, content: str, kind: str = "", anchor: str = "start") -> str:
    """Return a text."""
    words = html.escape(content)
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}" text-anchor="{anchor}">{words}</text>'


def line(x0: float, y0: float, x1: float, y1: float, kind: str) -> str:
    """Return a line."""
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" class="{kind}"/>'


def box(x: float, y: float, width: float, height: float, kind: str, title: str = "") -> str:
    """Return a rectangle, with a tool tip."""
    inner = f"<title>{html.escape(title)}</title>" if title else ""
    size = f'width="{max(width, 0.0):.1f}" height="{height:.1f}"'
    return f'<rect x="{x:.1f}" y="{y:.1f}" {size} class="{kind}" rx="2">{inner}</rect>'


def picture(height: float, parts: Sequence[str], label: str, frame: Frame) -> str:
    """Return the whole SVG, as wide as the page lets it be."""
    data = f'data-t0="{frame.t0:.6f}" data-t1="{frame.t1:.6f}" data-x0="{GUTTER:.0f}"'
    body = "".join(parts)
    return (
        f'<svg viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="img" aria-label="{html.escape(label)}" '
        f'{data} data-x1="{WIDTH - RIGHT:.0f}">{body}</svg>'
    )


def shorten(content: str, width: float) -> str:
    """Return a text that fits a width, the rest as an ellipsis."""
    fits = max(int(width / _CHARACTER), 1)
    return content if len(content) <= fits else content[: fits - 1] + "…"


def fits(content: str, width: float) -> bool:
    """Return whether a text fits a width."""
    return len(content) * _CHARACTER + 6.0 <= width


def ticks(low: float, high: float, about: int) -> list[float]:
    """Return round numbers from ``low`` to ``high``, about so many."""
    span = high - low
    if not (span > 0.0 and math.isfinite(span)):
        return [low]
    rough = span / max(about, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= rough * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [n * step for n in range(first, last + 1)]


def number(value: float) -> str:
    """Return a number for a scale."""
    return f"{value:.6g}".replace("-", "−")


def time_axis(frame: Frame, bottom: float) -> list[str]:
    """Return the grid's upright lines through a frame, and instants under ``bottom``."""
    parts = []
    for t in ticks(frame.t0, frame.t1, 10):
        x = frame.x(t)
        parts.append(line(x, frame.top, x, frame.top + frame.height, "grid"))
        if bottom:
            parts.append(text(x, bottom + 15.0, number(t), "scale", "middle"))
    if bottom:
        parts.append(text(GUTTER - 8.0, bottom + 15.0, "time, s", "scale", "end"))
    return parts


def value_axis(frame: Frame, unit: str) -> list[str]:
    """Return the grid's level lines and their numbers."""
    parts = []
    for value in ticks(frame.low, frame.high, max(int(frame.height / 27.0), 2)):
        y = frame.y(value)
        kind = "zero" if value == 0.0 else "grid"
        parts.append(line(GUTTER, y, WIDTH - RIGHT, y, kind))
        parts.append(text(GUTTER - 8.0, y + 4.0, number(value), "scale", "end"))
    if unit:
        parts.append(text(GUTTER - 8.0, frame.top - 5.0, unit, "unit", "end"))
    return parts


def value_range(curves: Sequence[tuple[Array, Array]], t0: float, t1: float) -> tuple[float, float]:
    """Return the smallest and largest value of ``(t_s, values)`` between two instants."""
    low, high = math.inf, -math.inf
    for t_s, values in curves:
        seen = values[(t_s >= t0) & (t_s <= t1) & np.isfinite(values)]
        if len(seen):
            low, high = min(low, float(seen.min())), max(high, float(seen.max()))
    return (0.0, 1.0) if low > high else (low, high)


def padded(low: float, high: float) -> tuple[float, float]:
    """Return a range with some room above and below, of some height in any case."""
    room = max(0.07 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-9)
    if high == low:
        room = max(0.5 * abs(high), 0.5)
    return low - room, high + room


def curve(frame: Frame, t_s: Array, values: Array, kind: str) -> str:
    """Return a curve: what was said last holds until the next; no more points than can be seen."""
    first = max(int(np.searchsorted(t_s, frame.t0, side="right")) - 1, 0)
    last = int(np.searchsorted(t_s, frame.t1, side="right"))
    t, v = t_s[first:last], values[first:last]
    if not len(t):
        return ""
    width = WIDTH - GUTTER - RIGHT
    x = GUTTER + width * (np.clip(t, frame.t0, frame.t1) - frame.t0) / (frame.t1 - frame.t0)
    x, v = thinned(x, v)
    y = frame.top + frame.height * (1.0 - (v - frame.low) / (frame.high - frame.low))
    y = np.clip(y, frame.top - 2.0, frame.top + frame.height + 2.0)
    pieces = []
    pen_down = False
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        if py != py:
            pen_down = False
            continue
        pieces.append(f"{'L' if pen_down else 'M'}{px:.1f} {py:.1f}")
        pen_down = True
    return f'<path d="{"".join(pieces)}" class="curve {kind}"/>' if pieces else ""


def thinned(x: Array, v: Array) -> tuple[Array, Array]:
    """Return what can be told apart of a curve: least and greatest value of each half pixel."""
    if len(x) <= 2 * (WIDTH - GUTTER):
        return x, v
    bins = np.floor(2.0 * x).astype(np.int64)
    starts = np.flatnonzero(np.concatenate(([True], bins[1:] != bins[:-1])))
    ends = np.concatenate((starts[1:], [len(x)]))
    chosen: list[int] = []
    for a, b in zip(starts.tolist(), ends.tolist(), strict=True):
        part = v[a:b]
        if np.isnan(part).all():
            chosen.append(a)
        else:
            chosen.extend(sorted({a + int(np.nanargmin(part)), a + int(np.nanargmax(part))}))
    return x[chosen], v[chosen]
