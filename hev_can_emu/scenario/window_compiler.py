"""Expectations of a scenario file into windows and monitors."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from itertools import pairwise

from hev_can_emu.errors import did_you_mean
from hev_can_emu.scenario import expectations, schema
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.program import Instant, Watch
from hev_can_emu.scenario.step_compiler import StepCompiler, beyond
from hev_can_emu.scenario.values import Values

_AFTER_STEP = re.compile(r"step (?P<name>.+?)(?: ?\+ ?(?P<offset>[0-9.].*))?")
#: Which keys each expectation's window takes.
_WINDOWS: Mapping[str, tuple[str, ...]] = {
    "always": ("from", "to", "for"),
    "never": ("from", "to", "for"),
    "becomes": ("from", "to", "within"),
    "settles": ("from", "within", "hold"),
    "equals": ("at",),
    "sequence": ("from", "to", "for", "within"),
}


class WindowCompiler:
    """Takes the expectations, once all steps are known."""

    def __init__(self, values: Values, steps: StepCompiler, duration_ns: int) -> None:
        self._values = values
        self._steps = steps
        self._duration_ns = duration_ns

    def watch(self, number: int, each: schema.Expectation, place: Place) -> Watch:
        """Return the expectation ready to be watched; raises InputError."""
        given = [kind for kind in _WINDOWS if getattr(each, kind) is not None]
        if len(given) != 1:
            got = " and ".join(f"'{kind}'" for kind in given) or "none"
            raise place.refuse(f"one of {', '.join(_WINDOWS)}", got)
        kind = given[0]
        opens, closes, hold_ns, window = self._window(kind, each, place)
        name = each.name or f"expectation {number + 1}"
        return Watch(opens, closes, self._monitor(kind, each, place, name, window, hold_ns))

    def _window(
        self, kind: str, each: schema.Expectation, place: Place
    ) -> tuple[Instant, Instant, int, str]:
        values = {
            "at": each.at,
            "from": each.start,
            "to": each.to,
            "for": each.length,
            "within": each.within,
            "hold": each.hold,
        }
        given = {key: value for key, value in values.items() if value is not None}
        allowed = _WINDOWS[kind]
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
            return instant, instant, 0, f"at {each.at}"
        if kind in ("becomes", "settles") and not ends:
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
            if key == "to":
                closes = self._instant(value, place / "to")
            else:
                length = self._values.time(value, place / key) + hold_ns
                closes = Instant(opens.step, opens.offset_ns + length)
            if self._soonest(closes) > self._duration_ns:
                raise (place / key).refuse(*beyond(self._soonest(closes), self._duration_ns))
            if self._soonest(closes) < self._soonest(opens):
                raise (place / key).refuse("a window that ends after it begins", f"'{value}'")
        if hold_ns:
            words.append(f"hold {each.hold}")
        return opens, closes, hold_ns, " ".join(words)

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

    def _monitor(
        self,
        kind: str,
        each: schema.Expectation,
        place: Place,
        name: str,
        window: str,
        hold_ns: int,
    ) -> Callable[[], expectations.Monitor]:
        here, where = place / kind, str(place)
        for text, never in ((each.always, False), (each.never, True)):
            if text is not None:
                condition = self._values.condition(text, here)
                return lambda: expectations.Always(condition, name, window, where, never=never)
        if each.becomes is not None:
            condition = self._values.condition(each.becomes, here)
            return lambda: expectations.Becomes(condition, name, window, where)
        if each.settles is not None:
            value = self._values.expression(each.settles.value, here / "value")
            target = self._values.of(value, each.settles.to, here / "to")
            own = value.unit.name if value.unit is not None else ""
            band = self._values.difference(each.settles.band, own, here / "band")
            return lambda: expectations.Settles(
                value, name, window, where, target=target, band=band, hold_ns=hold_ns
            )
        if each.equals is not None:
            value = self._values.expression(each.equals.value, here / "value")
            target = self._values.of(value, each.equals.to, here / "to")
            own = value.unit.name if value.unit is not None else ""
            band = self._values.difference(each.equals.tolerance, own, here / "tolerance")
            return lambda: expectations.Equals(value, name, window, where, target=target, band=band)
        assert each.sequence is not None
        value = self._values.expression(each.sequence.value, here / "value")
        exactly = each.sequence.exactly
        wanted = [
            self._values.of(value, item, here / "of" / number)
            for number, item in enumerate(each.sequence.of)
        ]
        for number, (first, second) in enumerate(pairwise(wanted), 1):
            if first == second:
                got = f"'{each.sequence.of[number]}' twice"
                raise (here / "of" / number).refuse("another value than the one before", got)
        signal = self._values.signals.find(each.sequence.value.strip())
        return lambda: expectations.InSequence(
            value, name, window, where, wanted=wanted, exactly=exactly, signal=signal
        )
