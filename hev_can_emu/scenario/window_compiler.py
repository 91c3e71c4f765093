"""The windows in which expectations count."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from hev_can_emu.errors import did_you_mean
from hev_can_emu.scenario import expectation_schema as schema
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.program import Instant
from hev_can_emu.scenario.step_compiler import StepCompiler, beyond
from hev_can_emu.scenario.values import Values

_AFTER_STEP = re.compile(r"step (?P<name>.+?)(?: ?\+ ?(?P<offset>[0-9.].*))?")
_SPAN = ("from", "to", "for")
#: Which keys each expectation's window takes.
WINDOWS: Mapping[str, tuple[str, ...]] = {
    "always": _SPAN,
    "never": _SPAN,
    "becomes": ("from", "to", "within"),
    "until": ("from", "to", "within"),
    "settles": ("from", "within", "hold"),
    "equals": ("at",),
    "overshoot": _SPAN,
    "rise_time": _SPAN,
    "monotone": _SPAN,
    "sequence": ("from", "to", "for", "within"),
    "follows": _SPAN,
    "count": _SPAN,
    "period": _SPAN,
    "jerk": _SPAN,
    "vibration_dose": _SPAN,
}
_NEED_AN_END = ("becomes", "until", "settles")


class Window(NamedTuple):
    """When an expectation counts; ``hold_ns`` of it lie after its deadline; ``words``: as written."""

    opens: Instant
    closes: Instant
    hold_ns: int
    words: str


class WindowCompiler:
    """Takes the expectations' windows, once all steps are known; raises InputError in every method."""

    def __init__(self, values: Values, steps: StepCompiler, duration_ns: int) -> None:
        self._values = values
        self._steps = steps
        self._duration_ns = duration_ns

    def window(self, kind: str, each: schema.Expectation, place: Place) -> Window:
        """Return the window of an expectation of the kind."""
        values = {
            "at": each.at,
            "from": each.start,
            "to": each.to,
            "for": each.length,
            "within": each.within,
            "hold": each.hold,
        }
        given = {key: value for key, value in values.items() if value is not None}
        allowed = WINDOWS[kind]
        for key in given:
            if key not in allowed:
                hint = f"{kind} takes {', '.join(allowed)}"
                raise (place / key).refuse(f"no '{key}' beside '{kind}'", "one", hint)
        ends = [key for key in ("to", "for", "within") if key in given]
        if len(ends) > 1:
            raise place.refuse("one end of the window", " and ".join(f"'{key}'" for key in ends))
        hold_ns = self._values.time(each.hold, place / "hold") if each.hold is not None else 0
        if kind == "equals":
            if each.at is None:
                raise place.refuse("'at' beside 'equals'", "none", "say when, such as at: 5 s")
            instant = self._instant(each.at, place / "at")
            return Window(instant, instant, 0, f"at {each.at}")
        if kind in _NEED_AN_END and not ends:
            raise place.refuse(f"'within' beside '{kind}'", "none", "say by when: within: 2 s")
        opens = Instant(None, 0)
        words = []
        if each.start is not None:
            opens = self._instant(each.start, place / "from")
            words.append(f"from {each.start}")
        closes = Instant(None, self._duration_ns)
        if ends:
            key, value = ends[0], given[ends[0]]
            words.append(f"{key} {value}")
            closes = self._end(key, value, opens, hold_ns, place / key)
        if hold_ns:
            words.append(f"hold {each.hold}")
        return Window(opens, closes, hold_ns, " ".join(words))

    def _end(
        self, key: str, value: schema.Value, opens: Instant, hold_ns: int, place: Place
    ) -> Instant:
        if key == "to":
            closes = self._instant(value, place)
        else:
            length = self._values.time(value, place) + hold_ns
            closes = Instant(opens.step, opens.offset_ns + length)
        if self._soonest(closes) > self._duration_ns:
            raise place.refuse(*beyond(self._soonest(closes), self._duration_ns))
        if self._soonest(closes) < self._soonest(opens):
            raise place.refuse("a window that ends after it begins", f"'{value}'")
        return closes

    def _instant(self, value: schema.Value, place: Place) -> Instant:
        value = self._values.resolve(value)
        if value == "end":
            return Instant(None, self._duration_ns)
        match = _AFTER_STEP.fullmatch(value) if isinstance(value, str) else None
        if match is None:
            instant = Instant(None, self._values.time(value, place))
        else:
            name = match["name"]
            if name not in self._steps.names:
                hint = did_you_mean(name, self._steps.names)
                raise place.refuse("a step's name", f"'{name}'", hint)
            offset_ns = self._values.time(match["offset"], place) if match["offset"] else 0
            instant = Instant(self._steps.names[name], offset_ns)
        if self._soonest(instant) > self._duration_ns:
            raise place.refuse(*beyond(self._soonest(instant), self._duration_ns))
        return instant

    def _soonest(self, instant: Instant) -> int:
        before = 0 if instant.step is None else self._steps.earliest[instant.step]
        return before + instant.offset_ns
