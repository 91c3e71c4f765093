"""The report's figures: the run on one time axis, and what each expectation looked at."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from hev_can_emu.report import svg
from hev_can_emu.report.ribbons import Ribbon, Segment, readable, segments_of
from hev_can_emu.report.run_report import Curve, RunReport, Span
from hev_can_emu.scenario.verdict import Verdict
from hev_can_emu.units import unit as unit_of

_ROW = 20.0
_GAP = 6.0
_PANEL = 132.0
_HEAD = 20.0  # above a panel: its unit and the curves' names
_COLOURS = 6
_KNOWN = {
    "transition", "series", "parallel_g1", "parallel_g2", "electric_neutral", "electric_g1",
    "electric_g2", "neutral", "g1", "g2", "open", "slipping", "closed", "locked",
}  # fmt: skip
_POINT_KINDS = ("lock", "release", "reverse", "synchronizer", "conflict")
_LIMIT = re.compile(
    r"(?P<left>[A-Za-z_][\w.]*)\s*(?P<sign><=|>=|==|<|>)\s*(?P<value>[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?)"
    r"\s*(?P<unit>[A-Za-z°%/²][\w°%/²·]*)?"
)
_JOINT = re.compile(r"\b(and|or|not|if|else)\b")
_ARITHMETIC = re.compile(r"(?<=[\w)] )[-+*/] (?=[A-Za-z(])")
_BAND = re.compile(
    r"(?P<left>[A-Za-z_][\w.]*) = (?P<value>[-+]?[\d.]+(?:e[-+]?\d+)?) ± (?P<band>[\d.]+(?:e[-+]?\d+)?)"
)


def overview(report: RunReport) -> str:
    """Return the run: steps, ribbons, faults and supervision, expectations, then curves."""
    end_s = max(report.car_s, 1e-3)
    parts: list[str] = []
    top = 4.0

    def frame(height: float, low: float = 0.0, high: float = 1.0) -> svg.Frame:
        return svg.Frame(0.0, end_s, top, height, low, high)

    steps = [step for step in report.steps if step.instant_ns is not None]
    if steps:
        parts += _step_row(frame(_ROW), steps)
        top += _ROW + _GAP
    rows_top = top
    for ribbon in report.ribbons:
        parts += _ribbon(frame(_ROW), ribbon)
        top += _ROW + _GAP
    for name, spans in _grouped(report.spans):
        here = frame(_ROW)
        parts.append(_row_name(here, name))
        for span in spans:
            x0, x1 = here.x(span.start_s), here.x(span.end_s)
            told = f"{span.kind}: {span.name}, {span.start_s:.3f} to {span.end_s:.3f} s"
            parts.append(svg.box(x0, top, max(x1 - x0, 2.0), _ROW, f"span {span.kind}", told))
        top += _ROW + _GAP
    points = [each for each in report.happenings if each.kind in _POINT_KINDS]
    if points:
        here = frame(_ROW)
        parts.append(_row_name(here, "locks, shifts"))
        for each in points:
            x = here.x(each.t_s)
            told = f"{each.t_s:.3f} s  {each.kind}: {each.text}"
            parts.append(svg.box(x - 1.0, top + 2.0, 2.0, _ROW - 4.0, f"point {each.kind}", told))
        top += _ROW + _GAP
    for verdict in report.expectations:
        parts += _window_row(svg.Frame(0.0, end_s, top, 12.0), verdict, end_s)
        top += 12.0 + 4.0
    top += _GAP
    for panel in report.panels:
        low, high = svg.value_range([(c.t_s, c.values) for c in panel.curves], 0.0, end_s)
        here = svg.Frame(0.0, end_s, top + _HEAD, _PANEL, *svg.padded(min(low, 0.0), high))
        parts += svg.time_axis(here, 0.0)
        parts += svg.value_axis(here, panel.unit)
        parts += _curves(here, panel.curves)
        top += _HEAD + _PANEL + 8.0
    whole = svg.Frame(0.0, end_s, rows_top, max(top - rows_top - 8.0, 1.0))
    marks = [svg.line(x, whole.top, x, whole.top + whole.height, "step") for x in _xs(whole, steps)]
    parts = [*svg.time_axis(whole, whole.top + whole.height), *marks, *parts]
    return svg.picture(whole.top + whole.height + 24.0, parts, "the run over time", whole)


class Limit(NamedTuple):
    """A range that an expectation names, in its curve's unit.

    ``kind``: ``allowed``, ``forbidden``, or ``named``, where it is but a part of what is expected.
    """

    curve: str
    low: float
    high: float
    kind: str = "allowed"


def check_figure(report: RunReport, verdict: Verdict) -> str:
    """Return what an expectation looked at, around its window; empty where nothing is known of it."""
    curves = [report.curves[name] for name in verdict.reads if name in report.curves]
    if not curves:
        return ""
    t0, t1 = _stretch(verdict, report.car_s)
    opens, closes = _window(verdict, report.car_s)
    limits = limits_of(verdict, curves)
    parts: list[str] = []
    top = 4.0
    first_top = top
    for group in _by_unit(curves):
        labelled = [each for each in group if each.labels]
        if labelled:
            for each in labelled:
                here = svg.Frame(t0, t1, top, _ROW)
                parts += _ribbon(here, ribbon_of(each, report.car_s))
                top += _ROW + _GAP
            continue
        mine = [limit for limit in limits if limit.curve in {each.name for each in group}]
        low, high = svg.value_range([(c.t_s, c.values) for c in group], t0, t1)
        for limit in mine:
            ends = [v for v in (limit.low, limit.high) if math.isfinite(v)]
            low, high = min([low, *ends]), max([high, *ends])
        here = svg.Frame(t0, t1, top + _HEAD, _PANEL, *svg.padded(low, high))
        parts += svg.time_axis(here, 0.0)
        for limit in mine:
            parts += _limit(here, limit, here.x(opens or 0.0), here.x(closes))
        parts += svg.value_axis(here, group[0].unit)
        parts += _curves(here, group)
        top += _HEAD + _PANEL + 8.0
    whole = svg.Frame(t0, t1, first_top, max(top - first_top - 8.0, 1.0))
    bottom = whole.top + whole.height
    under = [*svg.time_axis(whole, bottom)]
    if opens is not None:
        x0, x1 = whole.x(opens), whole.x(closes)
        under.insert(0, svg.box(x0, whole.top, x1 - x0, whole.height, "window"))
    if verdict.instant_ns is not None:
        x = whole.x(verdict.instant_ns * 1e-9)
        parts.append(svg.line(x, whole.top, x, bottom, f"instant {verdict.outcome.value}"))
    return svg.picture(bottom + 24.0, [*under, *parts], verdict.name, whole)


def limits_of(verdict: Verdict, curves: Sequence[Curve]) -> list[Limit]:
    """Return the levels in an expectation's words, as far as they are a signal beside a number."""
    by_name = {each.name.rpartition(".")[2]: each for each in curves if not each.labels}
    by_name |= {each.name: each for each in curves if not each.labels}
    kind = "forbidden" if verdict.expected.startswith("never") else "allowed"
    if _ARITHMETIC.search(verdict.expected):
        return []
    if len(_LIMIT.findall(verdict.expected)) > 1 or _JOINT.search(verdict.expected):
        kind = "named"
    found = []
    for match in _BAND.finditer(verdict.expected):
        curve = by_name.get(match["left"])
        if curve is not None:
            value, band = float(match["value"]), float(match["band"])
            found.append(Limit(curve.name, value - band, value + band))
    for match in _LIMIT.finditer(verdict.expected):
        curve = by_name.get(match["left"])
        if curve is None:
            continue
        level = _in_unit(float(match["value"]), match["unit"] or "", curve.unit)
        if level is None:
            continue
        sign = match["sign"]
        low = level if sign.startswith((">", "=")) else -math.inf
        high = level if sign.startswith(("<", "=")) else math.inf
        found.append(Limit(curve.name, low, high, kind))
    return found


def _in_unit(value: float, written: str, wanted: str) -> float | None:
    """Return a value in another unit; None where the words are no unit or of another kind."""
    if written in ("", wanted):
        return value
    try:
        given, own = unit_of(written), unit_of(wanted)
        return own.from_si(given.to_si(value)) if given.dimension == own.dimension else None
    except ValueError:
        return value if written in ("and", "or", "from", "for", "at", "within") else None


def ribbon_of(curve: Curve, end_s: float) -> Ribbon:
    """Return a labelled signal as a row of segments."""
    if not len(curve.t_s):
        return Ribbon(curve.name.rpartition(".")[2], [])
    t_s = np.append(curve.t_s, max(end_s, curve.t_s[-1]))
    values = np.append(curve.values, curve.values[-1])
    names = {int(value): text for value, text in curve.labels.items() if value == value}
    return Ribbon(curve.name.rpartition(".")[2], segments_of(t_s, values, names))


# Parts of figures


def _row_name(frame: svg.Frame, name: str) -> str:
    shown = svg.shorten(name, svg.GUTTER - 16.0)
    return svg.text(svg.GUTTER - 12.0, frame.top + frame.height / 2 + 4.0, shown, "row", "end")


def _step_row(frame: svg.Frame, steps: Sequence[Verdict]) -> list[str]:
    """Return numbered marks; those of steps that come together overlap, the list below has all."""
    parts = [_row_name(frame, "steps")]
    free = svg.GUTTER - 9.0
    for place, step in enumerate(steps, 1):
        x = frame.x((step.instant_ns or 0) * 1e-9)
        told = f"{place}  {step.name}: {(step.instant_ns or 0) * 1e-9:.3f} s"
        if x >= free - 0.5:
            parts.append(
                svg.box(x - 9.0, frame.top, 18.0, 16.0, f"mark {step.outcome.value}", told)
            )
            parts.append(svg.text(x, frame.top + 12.0, str(place), "mark-number", "middle"))
            free = x + 19.0
    return parts


def _xs(frame: svg.Frame, steps: Iterable[Verdict]) -> list[float]:
    return [frame.x((step.instant_ns or 0) * 1e-9) for step in steps]


def _ribbon(frame: svg.Frame, ribbon: Ribbon) -> list[str]:
    parts = [_row_name(frame, ribbon.name)]
    for segment in ribbon.segments:
        if segment.end_s < frame.t0 or segment.start_s > frame.t1:
            continue
        parts += _segment(frame, segment)
    return parts


def _segment(frame: svg.Frame, segment: Segment) -> list[str]:
    x0, x1 = frame.x(segment.start_s), frame.x(segment.end_s)
    key = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", segment.label).lower().replace(" ", "_")
    known = key if key in _KNOWN else f"other{sum(key.encode()) % 4}"
    label = readable(key) if key in _KNOWN else segment.label
    told = f"{label}: {segment.start_s:.3f} to {segment.end_s:.3f} s"
    parts = [svg.box(x0, frame.top, x1 - x0, frame.height, f"segment {known}", told)]
    if svg.fits(label, x1 - x0):
        parts.append(svg.text((x0 + x1) / 2, frame.top + 14.0, label, "segment-name", "middle"))
    return parts


def _window_row(frame: svg.Frame, verdict: Verdict, end_s: float) -> list[str]:
    shown = svg.shorten(verdict.name, svg.GUTTER - 14.0)
    parts = [svg.text(svg.GUTTER - 12.0, frame.top + 10.0, shown, "row small", "end")]
    opens, closes = _window(verdict, end_s)
    kind = verdict.outcome.value
    if opens is not None:
        x0, x1 = frame.x(opens), frame.x(closes)
        told = f"{verdict.name}: {kind}"
        parts.append(svg.box(x0, frame.top + 2.0, max(x1 - x0, 2.0), 8.0, f"verdict {kind}", told))
    if verdict.instant_ns is not None:
        x = frame.x(verdict.instant_ns * 1e-9)
        parts.append(svg.box(x - 1.5, frame.top - 1.0, 3.0, 14.0, f"decided {kind}"))
    return parts


def _limit(frame: svg.Frame, limit: Limit, x0: float, x1: float) -> list[str]:
    """Return a range over the window, from ``x0`` to ``x1``."""
    parts = []
    high = frame.y(limit.high) if math.isfinite(limit.high) else frame.top
    low = frame.y(limit.low) if math.isfinite(limit.low) else frame.top + frame.height
    if limit.kind != "named":
        parts.append(svg.box(x0, high, x1 - x0, max(low - high, 0.0), limit.kind))
    levels = [frame.y(value) for value in {limit.low, limit.high} if math.isfinite(value)]
    return parts + [svg.line(x0, y, x1, y, f"limit {limit.kind}") for y in levels]


def _curves(frame: svg.Frame, curves: Sequence[Curve]) -> list[str]:
    parts = [
        svg.curve(frame, each.t_s, each.values, f"c{place % _COLOURS}")
        for place, each in enumerate(curves)
    ]
    return parts + _legend(frame, [each.name.rpartition(".")[2] for each in curves])


def _legend(frame: svg.Frame, names: Sequence[str]) -> list[str]:
    """Return the curves' names in a row above the frame."""
    parts = []
    x = svg.GUTTER
    for place, name in enumerate(names):
        y = frame.top - 9.0
        parts.append(svg.line(x, y, x + 16.0, y, f"curve c{place % _COLOURS}"))
        parts.append(svg.text(x + 21.0, y + 4.0, name, "legend"))
        x += 21.0 + 7.0 * len(name) + 16.0
    return parts


def _by_unit(curves: Sequence[Curve]) -> list[list[Curve]]:
    groups: dict[str, list[Curve]] = {}
    for each in curves:
        groups.setdefault("labels" if each.labels else each.unit, []).append(each)
    return list(groups.values())


def _grouped(spans: Sequence[Span]) -> list[tuple[str, list[Span]]]:
    rows: dict[str, list[Span]] = {}
    for span in spans:
        words = f"lost {span.name}" if span.kind == "lost" else span.name
        rows.setdefault(words, []).append(span)
    return list(rows.items())


def _window(verdict: Verdict, end_s: float) -> tuple[float | None, float]:
    opens, closes = verdict.window_ns
    last = end_s if closes is None else min(closes * 1e-9, end_s)
    return (None if opens is None else opens * 1e-9), last


def _stretch(verdict: Verdict, end_s: float) -> tuple[float, float]:
    """Return what to show: the window and a little before and after, the instant in any case."""
    opens, closes = _window(verdict, end_s)
    instants = [] if verdict.instant_ns is None else [verdict.instant_ns * 1e-9]
    instants += [] if opens is None else [opens, closes]
    if not instants:
        return 0.0, max(end_s, 1e-3)
    first, last = min(instants), max(instants)
    room = max(0.12 * (last - first), 0.15)
    return max(first - room, 0.0), max(min(last + room, end_s), first + 1e-3)
