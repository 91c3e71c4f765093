"""Expectations of a scenario file into windows and monitors."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise

from hev_can_emu.scenario import expectation_schema as schema
from hev_can_emu.scenario import expectations, shape_expectations
from hev_can_emu.scenario.comfort import DOSE_UNIT, Jerk, VibrationDose
from hev_can_emu.scenario.expression import Expression, Read
from hev_can_emu.scenario.monitor import Head, Monitor
from hev_can_emu.scenario.period import Period
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.program import Watch
from hev_can_emu.scenario.step_compiler import say_time
from hev_can_emu.scenario.values import Values
from hev_can_emu.scenario.window_compiler import WINDOWS, Window, WindowCompiler

_DOSE = re.compile(r"\s*([0-9.]+(?:[eE][+-]?[0-9]+)?)\s*m/s(?:\^|\*\*)1\.75\s*")
Make = Callable[[], Monitor]


class ExpectationCompiler:
    """Takes the expectations, once all steps are known; raises InputError in every method."""

    def __init__(self, values: Values, windows: WindowCompiler, tick_ns: int) -> None:
        self._values = values
        self._windows = windows
        self._tick_ns = tick_ns
        self._name = ""
        self._where = ""
        self._window: Window

    def watch(self, number: int, each: schema.Expectation, place: Place) -> Watch:
        """Return the expectation ready to be watched."""
        given = [kind for kind in WINDOWS if getattr(each, kind) is not None]
        if len(given) != 1:
            got = " and ".join(f"'{kind}'" for kind in given) or "none"
            raise place.refuse(f"one of {', '.join(WINDOWS)}", got)
        kind = given[0]
        self._window = self._windows.window(kind, each, place)
        self._name = each.name or f"expectation {number + 1}"
        self._where = str(place)
        make: Make = getattr(self, f"_{kind}")(getattr(each, kind), place / kind)
        return Watch(self._window.opens, self._window.closes, make, kind == "period")

    def _head(self, says: str, *read: Expression) -> Head:
        reads: dict[int, Read] = {}
        for expression in read:
            reads.update((each.column, each) for each in expression.reads)
        return Head(self._name, says, self._window.words, self._where, tuple(reads.values()))

    # Conditions

    def _always(self, text: str, place: Place) -> Make:
        condition = self._values.condition(text, place)
        head = self._head(f"always: {text}", condition)
        return lambda: expectations.Always(head, condition, never=False)

    def _never(self, text: str, place: Place) -> Make:
        condition = self._values.condition(text, place)
        head = self._head(f"never: {text}", condition)
        return lambda: expectations.Always(head, condition, never=True)

    def _becomes(self, text: str, place: Place) -> Make:
        condition = self._values.condition(text, place)
        head = self._head(f"becomes: {text}", condition)
        return lambda: expectations.Becomes(head, condition)

    def _until(self, each: schema.Until, place: Place) -> Make:
        holds = self._values.condition(each.holds, place / "holds")
        comes = self._values.condition(each.comes, place / "comes")
        head = self._head(f"until: {each.holds} until {each.comes}", holds, comes)
        return lambda: expectations.Until(head, holds, comes)

    def _follows(self, each: schema.Follows, place: Place) -> Make:
        cause = self._values.condition(each.cause, place / "cause")
        effect = self._values.condition(each.effect, place / "effect")
        within_ns = self._values.time(each.within, place / "within")
        says = f"follows: {each.effect} within {say_time(within_ns)} of {each.cause}"
        head = self._head(says, cause, effect)
        return lambda: expectations.Follows(head, cause, effect, within_ns)

    def _count(self, each: schema.Count, place: Place) -> Make:
        condition = self._values.condition(each.of, place / "of")
        if each.max is not None and each.max < each.min:
            raise (place / "max").refuse(f"{each.min} or more, as 'min' says", f"{each.max}")
        if each.max is None and each.min == 0:
            raise place.refuse("'min' or 'max'", "none", "anything would do")
        least = f" at least {each.min}" if each.min else ""
        most = "" if each.max is None else f" at most {each.max}"
        head = self._head(f"count: {each.of}{least}{most} times", condition)
        return lambda: expectations.Count(head, condition, each.min, each.max)

    def _sequence(self, each: schema.Sequence, place: Place) -> Make:
        value = self._values.expression(each.value, place / "value")
        wanted = [
            self._values.of(value, item, place / "of" / number)
            for number, item in enumerate(each.of)
        ]
        for number, (first, second) in enumerate(pairwise(wanted), 1):
            if first == second:
                got = f"'{each.of[number]}' twice"
                raise (place / "of" / number).refuse("another value than the one before", got)

        def say(number: float) -> str:
            return f"{number:g}" if value.signal is None else value.signal.say(number)

        how = "exactly " if each.exactly else ""
        says = f"sequence: {each.value} {how}{' > '.join(say(number) for number in wanted)}"
        head = self._head(says, value)
        return lambda: expectations.InSequence(head, value, wanted, each.exactly, say)

    # A value and its target

    def _settles(self, each: schema.Settles, place: Place) -> Make:
        value, target = self._target(each, place)
        band = self._values.difference(each.band, value.unit_name, place / "band")
        hold_ns = self._window.hold_ns
        head = self._head(_says("settles", value, target, f" ± {band:g}"), value)
        return lambda: shape_expectations.Settles(head, value, target, band, hold_ns)

    def _equals(self, each: schema.Equals, place: Place) -> Make:
        value, target = self._target(each, place)
        band = self._values.difference(each.tolerance, value.unit_name, place / "tolerance")
        head = self._head(_says("equals", value, target, f" ± {band:g}"), value)
        return lambda: shape_expectations.Equals(head, value, target, band)

    def _overshoot(self, each: schema.Overshoot, place: Place) -> Make:
        value, target = self._target(each, place)
        share = isinstance(each.limit, str) and each.limit.rstrip().endswith("%")
        if share:
            limit = self._values.si(each.limit, "%", place / "limit")
        else:
            limit = self._values.difference(each.limit, value.unit_name, place / "limit")
        head = self._head(_says("overshoot", value, target) + f" by at most {each.limit}", value)
        return lambda: shape_expectations.Overshoot(head, value, target, limit, share)

    def _rise_time(self, each: schema.RiseTime, place: Place) -> Make:
        value, target = self._target(each, place)
        limit_ns = self._values.time(each.limit, place / "limit")
        low = self._values.si(each.low, "%", place / "low")
        high = self._values.si(each.high, "%", place / "high")
        if not 0.0 <= low < high:
            raise (place / "high").refuse("a share above 'low'", f"'{each.high}'")
        says = f"{_says('rise_time', value, target)} in {say_time(limit_ns)}"
        head = self._head(says, value)
        return lambda: shape_expectations.RiseTime(head, value, target, limit_ns, (low, high))

    def _monotone(self, each: schema.Monotone, place: Place) -> Make:
        value = self._values.expression(each.value, place / "value")
        tolerance = self._values.difference(each.tolerance, value.unit_name, place / "tolerance")
        sign = 1.0 if each.direction == "rising" else -1.0
        head = self._head(f"monotone: {each.value} {each.direction} ± {tolerance:g}", value)
        return lambda: shape_expectations.Monotone(head, value, sign, tolerance)

    def _target(
        self,
        each: schema.Settles | schema.Equals | schema.Overshoot | schema.RiseTime,
        place: Place,
    ) -> tuple[Expression, float]:
        value = self._values.expression(each.value, place / "value")
        return value, self._values.of(value, each.to, place / "to")

    # Frames and comfort

    def _period(self, each: schema.Period, place: Place) -> Make:
        signals = self._values.signals
        message = signals.require_message(each.message, place / "message")
        period_ns = self._values.time(each.of, place / "of")
        if period_ns == 0:
            raise (place / "of").refuse("a time above 0 s", f"'{each.of}'")
        jitter_ns = self._values.time(each.jitter, place / "jitter")
        identifier, extended = signals.identifiers[message]
        head = self._head(f"period: {message} every {each.of} ± {each.jitter}")
        return lambda: Period(head, identifier, extended, period_ns, jitter_ns)

    def _jerk(self, each: schema.Jerk, place: Place) -> Make:
        value = self._values.expression(each.value, place / "value")
        orders = {"m/s^2": 1, "m/s": 2}
        order = 0 if value.unit is None else orders.get(value.unit.dimension, 0)
        if order == 0 or value.unit is None:
            got = f"{value.unit_name or 'a plain number'} from '{each.value}'"
            raise (place / "value").refuse("an acceleration or a speed", got)
        limit = self._values.si(each.limit, "m/s^3", place / "limit")
        over_ns = self._values.time(each.over, place / "over")
        ticks = round(over_ns / self._tick_ns)
        if ticks < 1:
            raise (place / "over").refuse(f"at least {say_time(self._tick_ns)}", f"'{each.over}'")
        gain, tick_ns = value.unit.gain, self._tick_ns
        head = self._head(f"jerk: {each.value} at most {each.limit} over {each.over}", value)
        return lambda: Jerk(head, value, order, gain, limit, ticks, tick_ns)

    def _vibration_dose(self, each: schema.VibrationDose, place: Place) -> Make:
        value = self._values.expression(each.value, place / "value")
        if value.unit is None or value.unit.dimension != "m/s^2":
            got = f"{value.unit_name or 'a plain number'} from '{each.value}'"
            raise (place / "value").refuse("an acceleration", got)
        match = _DOSE.fullmatch(str(self._values.resolve(each.limit)))
        if match is None:
            wanted = f"a number with a unit such as '1 {DOSE_UNIT}'"
            raise (place / "limit").refuse(wanted, f"'{each.limit}'")
        limit, gain, tick_ns = float(match[1]), value.unit.gain, self._tick_ns
        how = "" if each.weighting == "none" else f" weighted {each.weighting}"
        head = self._head(f"vibration_dose: {each.value}{how} at most {each.limit}", value)
        return lambda: VibrationDose(head, value, gain, limit, each.weighting, tick_ns)


def _says(kind: str, value: Expression, target: float, more: str = "") -> str:
    unit = f" {value.unit_name}" if value.unit_name else ""
    return f"{kind}: {value.text} = {target:g}{more}{unit}"
