"""A scenario checked against a network and made ready to play: every text has found its meaning.

All errors that a scenario can have are found here, before anything is played.
"""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from typing import NamedTuple

from hev_can_emu.errors import did_you_mean
from hev_can_emu.scenario import expectations, schema, stimuli
from hev_can_emu.scenario.expression import (
    RESERVED,
    Expression,
    Parameter,
    compile_condition,
    compile_expression,
)
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.signals import Signal, Signals
from hev_can_emu.units import parse_quantity, unit

_DEFAULT_PLAYS = schema.Scenario.__struct_defaults__[
    schema.Scenario.__struct_fields__.index("plays") - len(schema.Scenario.__struct_fields__)
]


class Instant(NamedTuple):
    """A time in the scenario: ``offset_ns`` after the start, or after the step with that number."""

    step: int | None
    offset_ns: int


class Ramp(NamedTuple):
    """Line from ``start`` (NaN: the present value) to ``end``."""

    start: float
    end: float
    length_ns: int


class Sine(NamedTuple):
    """Sine around ``offset`` (NaN: the present value); ``omega`` in rad/s, ``phase`` in rad."""

    offset: float
    amplitude: float
    omega: float
    phase: float


class Follow(NamedTuple):
    """``gain * expression + offset`` at every tick."""

    expression: Expression
    gain: float
    offset: float


class Set(NamedTuple):
    """A constant; NaN sends "not available"."""

    value: float


class Hold(NamedTuple):
    """The present value from now on."""


class Release(NamedTuple):
    """The initial value."""


Action = Set | Ramp | Sine | Follow | Hold | Release


class Step(NamedTuple):
    """One step, ready to play; exactly one of ``at_ns``, ``after_ns`` and ``when`` is given."""

    name: str
    at_ns: int | None
    after_ns: int | None
    when: Expression | None
    timeout_ns: int
    held_ns: int
    stop_on_timeout: bool
    actions: tuple[tuple[Signal, Action], ...]
    messages: tuple[stimuli.SendMessage, ...]
    where: str


class Watch(NamedTuple):
    """One expectation: ``make`` gives a fresh monitor for the window."""

    opens: Instant
    closes: Instant
    make: Callable[[], expectations.Monitor]


class Program(NamedTuple):
    """A scenario, ready to play."""

    name: str
    duration_ns: int
    steps: tuple[Step, ...]
    watches: tuple[Watch, ...]


def compile_scenario(scenario: schema.Scenario, signals: Signals, place: Place) -> Program:
    """Check ``scenario`` against the network and return it ready to play.

    Raises:
        InputError: at ``place`` and below: the first thing that cannot be.
    """
    return _Compiler(scenario, signals, place).compile()


class _Compiler:
    def __init__(self, scenario: schema.Scenario, signals: Signals, place: Place) -> None:
        self._scenario = scenario
        self._signals = signals
        self._place = place
        self._parameters: dict[str, Parameter] = {}
        self._duration_ns = 0
        self._earliest: list[int] = []  #: per step, the soonest at which it can come
        self._names: dict[str, int] = {}

    def compile(self) -> Program:
        for name, value in self._scenario.parameters.items():
            self._parameters[name] = self._parameter(name, value)
        duration = self._place / "duration"
        self._duration_ns = self._time(self._scenario.duration, duration)
        if self._duration_ns <= 0:
            raise duration.refuse("a time above 0 s", f"'{self._scenario.duration}'")
        self._check_players()
        steps = tuple(
            self._step(number, step, self._place / "steps" / number)
            for number, step in enumerate(self._scenario.steps)
        )
        watches = tuple(
            self._watch(number, each, self._place / "expectations" / number)
            for number, each in enumerate(self._scenario.expectations)
        )
        return Program(self._scenario.name, self._duration_ns, steps, watches)

    # Values

    def _parameter(self, name: str, value: schema.Value) -> Parameter:
        place = self._place / "parameters" / name
        if not name.isidentifier() or keyword.iskeyword(name):
            raise place.refuse("a name of letters, digits and _", f"'{name}'")
        if name in RESERVED:
            raise place.refuse("a name of its own", f"'{name}'", "expressions have a word for this")
        if self._signals.find(name) is not None:
            raise place.refuse("a name of its own", f"'{name}'", "a signal is called so")
        if isinstance(value, bool):
            raise place.refuse("a number or quantity", str(value).lower())
        if not isinstance(value, str):
            return Parameter(float(value), "")
        quantity = parse_quantity(value, str(place))
        own = unit(quantity.unit)
        return Parameter(float(f"{own.from_si(quantity.si_value):.15g}"), quantity.unit)

    def _resolve(self, value: schema.Value) -> schema.Value:
        """Return a parameter's quantity where ``value`` is its name."""
        if isinstance(value, str) and value in self._parameters:
            parameter = self._parameters[value]
            return f"{parameter.value!r} {parameter.unit}" if parameter.unit else parameter.value
        return value

    def _si(self, value: schema.Value, expect: str, place: Place) -> float:
        value = self._resolve(value)
        if value == 0 and not isinstance(value, bool):
            return 0.0
        text = str(value).lower() if isinstance(value, bool) else str(value)
        return parse_quantity(text, str(place), expect).si_value

    def _time(self, value: schema.Value, place: Place) -> int:
        seconds = self._si(value, "s", place)
        if not 0.0 <= seconds < 1e9:
            raise place.refuse("a time of 0 s or more", f"'{value}'")
        return round(seconds * 1e9)

    def _difference(self, value: schema.Value, own: str, place: Place) -> float:
        """Return a band, tolerance or amplitude, counted in the unit ``own``."""
        value = self._resolve(value)
        if isinstance(value, bool):
            raise place.refuse("a number", str(value).lower())
        if not isinstance(value, str):
            result = float(value)
        else:
            quantity = parse_quantity(value, str(place), own)
            size = quantity.si_value - unit(quantity.unit).offset
            result = float(f"{size / unit(own).gain:.12g}")
        if result < 0.0:
            raise place.refuse("a number of 0 or more", f"{value}")
        return result

    def _of(self, expression: Expression, value: schema.Value, place: Place) -> float:
        """Return a value with which ``expression`` is compared, in its unit."""
        value = self._resolve(value)
        signal = self._signals.find(expression.text.strip())
        if signal is not None:
            return signal.parse(value, place)
        if isinstance(value, bool):
            raise place.refuse("a number", str(value).lower())
        if not isinstance(value, str):
            return float(value)
        own = expression.unit.name if expression.unit is not None else ""
        quantity = parse_quantity(value, str(place), own)
        return float(f"{unit(own).from_si(quantity.si_value):.12g}")

    def _expression(self, text: str, place: Place) -> Expression:
        expression = compile_expression(text, self._signals, self._parameters, place)
        if expression.boolean:
            raise place.refuse("a number", f"the condition '{text}'")
        return expression

    def _condition(self, text: str, place: Place) -> Expression:
        return compile_condition(text, self._signals, self._parameters, place)

    # Steps

    def _check_players(self) -> None:
        senders = dict.fromkeys(self._signals.messages.values())
        if self._scenario.plays == _DEFAULT_PLAYS:
            return
        for number, node in enumerate(self._scenario.plays):
            if node not in senders:
                place = self._place / "plays" / number
                raise place.refuse("a node that sends", f"'{node}'", did_you_mean(node, senders))

    def _step(self, number: int, step: schema.Step, place: Place) -> Step:
        triggers = {"at": step.at, "when": step.when, "after": step.after}
        given = [name for name, value in triggers.items() if value is not None]
        if len(given) != 1:
            got = " and ".join(f"'{name}'" for name in given) or "none"
            raise place.refuse("one of 'at', 'when', 'after'", got)
        if step.name:
            if step.name in self._names:
                first = self._names[step.name]
                got = f"'{step.name}' again"
                raise (place / "name").refuse("each name once", got, f"first in $.steps[{first}]")
            self._names[step.name] = number
        self._order(number, step, place)
        condition, timeout_ns, held_ns = self._trigger(step, place)
        return Step(
            name=step.name or f"step {number + 1}",
            at_ns=None if step.at is None else self._time(step.at, place / "at"),
            after_ns=None if step.after is None else self._time(step.after, place / "after"),
            when=condition,
            timeout_ns=timeout_ns,
            held_ns=held_ns,
            stop_on_timeout=step.on_timeout == "stop",
            actions=tuple(self._actions(step, place)),
            messages=tuple(self._switches(step, place)),
            where=str(place),
        )

    def _order(self, number: int, step: schema.Step, place: Place) -> None:
        before = self._earliest[-1] if self._earliest else 0
        earliest, key = before, "when"
        if step.at is not None:
            earliest, key = self._time(step.at, place / "at"), "at"
            if earliest < before:
                got = f"'{step.at}'"
                hint = f"the step before comes at {_s(before)} or later"
                raise (place / "at").refuse("steps in the order of their times", got, hint)
        elif step.after is not None:
            earliest, key = before + self._time(step.after, place / "after"), "after"
        if earliest > self._duration_ns:
            raise (place / key).refuse(*self._beyond(earliest))
        self._earliest.append(earliest)

    def _trigger(self, step: schema.Step, place: Place) -> tuple[Expression | None, int, int]:
        if step.when is None:
            for key, value in (("timeout", step.timeout), ("held", step.held)):
                if value is not None:
                    got = f"'{key}' without it"
                    raise (place / key).refuse("'when' beside it", got)
            return None, 0, 0
        if step.timeout is None:
            hint = "say how long to wait, such as timeout: 10 s"
            raise place.refuse("'timeout' beside 'when'", "none", hint)
        timeout_ns = self._time(step.timeout, place / "timeout")
        if timeout_ns == 0:
            raise (place / "timeout").refuse("a time above 0 s", f"'{step.timeout}'")
        held_ns = 0 if step.held is None else self._time(step.held, place / "held")
        if held_ns > timeout_ns:
            got = f"'{step.held}'"
            raise (place / "held").refuse(f"at most the timeout, {_s(timeout_ns)}", got)
        return self._condition(step.when, place / "when"), timeout_ns, held_ns

    def _actions(self, step: schema.Step, place: Place) -> Iterable[tuple[Signal, Action]]:
        taken: dict[int, str] = {}

        def own(name: str, key: str, here: Place) -> Signal:
            signal = self._playable(name, here)
            if signal.index in taken:
                got = f"'{name}' in '{taken[signal.index]}' and '{key}'"
                raise here.refuse("each signal once in a step", got)
            taken[signal.index] = key
            return signal

        for name, value in step.set.items():
            here = place / "set" / name
            signal = own(name, "set", here)
            yield signal, Set(signal.parse(self._resolve(value), here))
        for name, ramp in step.ramp.items():
            here = place / "ramp" / name
            yield (signal := own(name, "ramp", here)), self._ramp(signal, ramp, here)
        for name, text in step.follow.items():
            here = place / "follow" / name
            yield (signal := own(name, "follow", here)), self._follow(signal, text, here)
        for name, sine in step.sine.items():
            here = place / "sine" / name
            yield (signal := own(name, "sine", here)), self._sine(signal, sine, here)
        for number, name in enumerate(step.hold):
            yield own(name, "hold", place / "hold" / number), Hold()
        for number, name in enumerate(step.release):
            yield own(name, "release", place / "release" / number), Release()

    def _playable(self, name: str, place: Place) -> Signal:
        signal = self._signals.require(name, place)
        plays = self._scenario.plays
        if signal.sender not in plays:
            hint = f"{signal.sender or 'no node'} sends it in {signal.message}"
            raise place.refuse(f"a signal sent by {' or '.join(plays)}", f"'{name}'", hint)
        return signal

    def _ramp(self, signal: Signal, ramp: schema.Ramp, place: Place) -> Ramp:
        start = math.nan
        if ramp.start is not None:
            start = signal.parse(self._resolve(ramp.start), place / "from")
        end = signal.parse(self._resolve(ramp.to), place / "to")
        if math.isnan(end):
            raise (place / "to").refuse("a number", f"'{ramp.to}'", "use set")
        return Ramp(start, end, self._time(ramp.over, place / "over"))

    def _follow(self, signal: Signal, text: str, place: Place) -> Follow:
        expression = self._expression(text, place)
        if expression.unit is None:
            return Follow(expression, 1.0, 0.0)
        own = signal.known_unit(place)
        have = expression.unit
        if have.dimension != own.dimension:
            hint = f"{signal.name} is in {signal.unit or 'no unit'}; number(...) drops a unit"
            wanted = f"a value in {signal.unit}" if signal.unit else "a number without unit"
            raise place.refuse(wanted, f"{have.name} from '{text}'", hint)
        return Follow(expression, have.gain / own.gain, (have.offset - own.offset) / own.gain)

    def _sine(self, signal: Signal, sine: schema.Sine, place: Place) -> Sine:
        amplitude = self._difference(sine.amplitude, signal.unit, place / "amplitude")
        offset = math.nan
        if sine.offset is not None:
            offset = signal.parse(self._resolve(sine.offset), place / "offset")
            for peak in (offset - amplitude, offset + amplitude):
                signal.parse(peak, place)
        frequency = self._si(sine.frequency, "Hz", place / "frequency")
        if frequency <= 0.0:
            raise (place / "frequency").refuse("a frequency above 0 Hz", f"'{sine.frequency}'")
        phase = self._si(sine.phase, "rad", place / "phase")
        return Sine(offset, amplitude, 2.0 * math.pi * frequency, phase)

    def _switches(self, step: schema.Step, place: Place) -> Iterable[stimuli.SendMessage]:
        taken: set[str] = set()
        for key, names in (("silence", step.silence), ("resume", step.resume)):
            for number, name in enumerate(names):
                here = place / key / number
                message = self._signals.require_message(name, here)
                sender = self._signals.messages[message]
                if sender not in self._scenario.plays:
                    wanted = f"a message sent by {' or '.join(self._scenario.plays)}"
                    raise here.refuse(wanted, f"'{name}'", f"{sender or 'no node'} sends it")
                if message in taken:
                    raise here.refuse("each message once in a step", f"'{name}' again")
                taken.add(message)
                yield stimuli.SendMessage(message, key == "resume")

    # Expectations

    def _watch(self, number: int, each: schema.Expectation, place: Place) -> Watch:
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
        hold_ns = self._time(each.hold, place / "hold") if each.hold is not None else 0
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
                length = self._time(value, place / key) + hold_ns
                closes = Instant(opens.step, opens.offset_ns + length)
            if self._soonest(closes) > self._duration_ns:
                raise (place / key).refuse(*self._beyond(self._soonest(closes)))
            if self._soonest(closes) < self._soonest(opens):
                raise (place / key).refuse("a window that ends after it begins", f"'{value}'")
        if hold_ns:
            words.append(f"hold {each.hold}")
        return opens, closes, hold_ns, " ".join(words)

    def _instant(self, value: schema.Value, place: Place) -> Instant:
        value = self._resolve(value)
        if value == "end":
            return Instant(None, self._duration_ns)
        match = _AFTER_STEP.fullmatch(value) if isinstance(value, str) else None
        if match is None:
            instant = Instant(None, self._time(value, place))
        else:
            name = match["name"]
            if name not in self._names:
                hint = did_you_mean(name, self._names)
                raise place.refuse("a step's name", f"'{name}'", hint)
            offset_ns = self._time(match["offset"], place) if match["offset"] else 0
            instant = Instant(self._names[name], offset_ns)
        if self._soonest(instant) > self._duration_ns:
            raise place.refuse(*self._beyond(self._soonest(instant)))
        return instant

    def _soonest(self, instant: Instant) -> int:
        before = 0 if instant.step is None else self._earliest[instant.step]
        return before + instant.offset_ns

    def _beyond(self, time_ns: int) -> tuple[str, str, str]:
        end = f"a time up to the scenario's end, {_s(self._duration_ns)}"
        return end, _s(time_ns), "raise duration or move it"

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
                condition = self._condition(text, here)
                return lambda: expectations.Always(condition, name, window, where, never=never)
        if each.becomes is not None:
            condition = self._condition(each.becomes, here)
            return lambda: expectations.Becomes(condition, name, window, where)
        if each.settles is not None:
            value = self._expression(each.settles.value, here / "value")
            target = self._of(value, each.settles.to, here / "to")
            own = value.unit.name if value.unit is not None else ""
            band = self._difference(each.settles.band, own, here / "band")
            return lambda: expectations.Settles(
                value, name, window, where, target=target, band=band, hold_ns=hold_ns
            )
        if each.equals is not None:
            value = self._expression(each.equals.value, here / "value")
            target = self._of(value, each.equals.to, here / "to")
            own = value.unit.name if value.unit is not None else ""
            band = self._difference(each.equals.tolerance, own, here / "tolerance")
            return lambda: expectations.Equals(value, name, window, where, target=target, band=band)
        assert each.sequence is not None
        value = self._expression(each.sequence.value, here / "value")
        exactly = each.sequence.exactly
        wanted = [
            self._of(value, item, here / "of" / number)
            for number, item in enumerate(each.sequence.of)
        ]
        for number, (first, second) in enumerate(pairwise(wanted), 1):
            if first == second:
                got = f"'{each.sequence.of[number]}' twice"
                raise (here / "of" / number).refuse("another value than the one before", got)
        signal = self._signals.find(each.sequence.value.strip())
        return lambda: expectations.InSequence(
            value, name, window, where, wanted=wanted, exactly=exactly, signal=signal
        )


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


def _s(time_ns: int) -> str:
    return f"{time_ns * 1e-9:g} s"
