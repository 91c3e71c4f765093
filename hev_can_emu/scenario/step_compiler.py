"""Steps of a scenario file into steps that can be played."""

from __future__ import annotations

import math
from collections.abc import Iterable

from hev_can_emu.scenario import schema, stimuli
from hev_can_emu.scenario.expression import Expression
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.program import (
    Action,
    Follow,
    Hold,
    Ramp,
    Release,
    Set,
    Sine,
    Step,
)
from hev_can_emu.scenario.signals import Signal
from hev_can_emu.scenario.values import Values


class StepCompiler:
    """Takes the steps one after the other; ``names`` and ``earliest`` grow with them.

    Attributes:
        names: a step's name to its number.
        earliest: per step, the soonest at which it can come, in ns.
    """

    def __init__(self, values: Values, plays: tuple[str, ...], duration_ns: int) -> None:
        self._values = values
        self._plays = plays
        self._duration_ns = duration_ns
        self.names: dict[str, int] = {}
        self.earliest: list[int] = []

    def step(self, number: int, step: schema.Step, place: Place) -> Step:
        """Return the step ready to play; raises InputError."""
        triggers = {"at": step.at, "when": step.when, "after": step.after}
        given = [name for name, value in triggers.items() if value is not None]
        if len(given) != 1:
            got = " and ".join(f"'{name}'" for name in given) or "none"
            raise place.refuse("one of 'at', 'when', 'after'", got)
        if step.name:
            if step.name in self.names:
                first = self.names[step.name]
                got = f"'{step.name}' again"
                raise (place / "name").refuse("each name once", got, f"first in $.steps[{first}]")
            self.names[step.name] = number
        self._order(number, step, place)
        condition, timeout_ns, held_ns = self._trigger(step, place)
        return Step(
            name=step.name or f"step {number + 1}",
            at_ns=None if step.at is None else self._values.time(step.at, place / "at"),
            after_ns=None if step.after is None else self._values.time(step.after, place / "after"),
            when=condition,
            timeout_ns=timeout_ns,
            held_ns=held_ns,
            stop_on_timeout=step.on_timeout == "stop",
            actions=tuple(self._actions(step, place)),
            messages=tuple(self._switches(step, place)),
            where=str(place),
        )

    def _order(self, number: int, step: schema.Step, place: Place) -> None:
        before = self.earliest[-1] if self.earliest else 0
        earliest, key = before, "when"
        if step.at is not None:
            earliest, key = self._values.time(step.at, place / "at"), "at"
            if earliest < before:
                got = f"'{step.at}'"
                hint = f"the step before comes at {say_time(before)} or later"
                raise (place / "at").refuse("steps in the order of their times", got, hint)
        elif step.after is not None:
            earliest, key = before + self._values.time(step.after, place / "after"), "after"
        if earliest > self._duration_ns:
            raise (place / key).refuse(*beyond(earliest, self._duration_ns))
        self.earliest.append(earliest)

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
        timeout_ns = self._values.time(step.timeout, place / "timeout")
        if timeout_ns == 0:
            raise (place / "timeout").refuse("a time above 0 s", f"'{step.timeout}'")
        held_ns = 0 if step.held is None else self._values.time(step.held, place / "held")
        if held_ns > timeout_ns:
            got = f"'{step.held}'"
            raise (place / "held").refuse(f"at most the timeout, {say_time(timeout_ns)}", got)
        return self._values.condition(step.when, place / "when"), timeout_ns, held_ns

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
            yield signal, Set(signal.parse(self._values.resolve(value), here))
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
        signal = self._values.signals.require(name, place)
        plays = self._plays
        if signal.sender not in plays:
            hint = f"{signal.sender or 'no node'} sends it in {signal.message}"
            raise place.refuse(f"a signal sent by {' or '.join(plays)}", f"'{name}'", hint)
        if signal.protected:
            hint = f"the protection of {signal.message} writes it"
            raise place.refuse("a signal to set", f"'{name}'", hint)
        return signal

    def _ramp(self, signal: Signal, ramp: schema.Ramp, place: Place) -> Ramp:
        start = math.nan
        if ramp.start is not None:
            start = signal.parse(self._values.resolve(ramp.start), place / "from")
        end = signal.parse(self._values.resolve(ramp.to), place / "to")
        if math.isnan(end):
            raise (place / "to").refuse("a number", f"'{ramp.to}'", "use set")
        return Ramp(start, end, self._values.time(ramp.over, place / "over"))

    def _follow(self, signal: Signal, text: str, place: Place) -> Follow:
        expression = self._values.expression(text, place)
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
        amplitude = self._values.difference(sine.amplitude, signal.unit, place / "amplitude")
        offset = math.nan
        if sine.offset is not None:
            offset = signal.parse(self._values.resolve(sine.offset), place / "offset")
            for peak in (offset - amplitude, offset + amplitude):
                signal.parse(peak, place)
        frequency = self._values.si(sine.frequency, "Hz", place / "frequency")
        if frequency <= 0.0:
            raise (place / "frequency").refuse("a frequency above 0 Hz", f"'{sine.frequency}'")
        phase = self._values.si(sine.phase, "rad", place / "phase")
        return Sine(offset, amplitude, 2.0 * math.pi * frequency, phase)

    def _switches(self, step: schema.Step, place: Place) -> Iterable[stimuli.SendMessage]:
        taken: set[str] = set()
        for key, names in (("silence", step.silence), ("resume", step.resume)):
            for number, name in enumerate(names):
                here = place / key / number
                message = self._values.signals.require_message(name, here)
                sender = self._values.signals.messages[message]
                if sender not in self._plays:
                    wanted = f"a message sent by {' or '.join(self._plays)}"
                    raise here.refuse(wanted, f"'{name}'", f"{sender or 'no node'} sends it")
                if message in taken:
                    raise here.refuse("each message once in a step", f"'{name}' again")
                taken.add(message)
                yield stimuli.SendMessage(message, key == "resume")


def beyond(time_ns: int, duration_ns: int) -> tuple[str, str, str]:
    """Return expected, got and hint for a time after the scenario's end."""
    end = f"a time up to the scenario's end, {say_time(duration_ns)}"
    return end, say_time(time_ns), "raise duration or move it"


def say_time(time_ns: int) -> str:
    """Return a time in words."""
    return f"{time_ns * 1e-9:g} s"
