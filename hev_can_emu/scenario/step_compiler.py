"""Steps of a scenario file into steps that can be played; loops unrolled."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from hev_can_emu.scenario import schema
from hev_can_emu.scenario.expectation_schema import Value
from hev_can_emu.scenario.expression import Expression
from hev_can_emu.scenario.place import Place, Steps
from hev_can_emu.scenario.program import Span, Step, Tables
from hev_can_emu.scenario.stimulus_compiler import StimulusCompiler
from hev_can_emu.scenario.values import Values

MAX_STEPS = 20_000  #: of a scenario, loops unrolled
_LOOP_KEYS = ("name", "repeat")


class StepCompiler:
    """Takes the steps of one phase, in order.

    Args:
        values: what texts mean.
        stimuli: takes what the steps do.
        tables: where conditions are collected.
        duration_ns: the phase's length; None where it has none of its own.

    Attributes:
        names: a step's name to its number.
        earliest: per step, the soonest at which it can come, in ns.
        steps: what has been made.
    """

    def __init__(
        self,
        values: Values,
        stimuli: StimulusCompiler,
        tables: Tables,
        duration_ns: int | None,
    ) -> None:
        self._values = values
        self._stimuli = stimuli
        self._tables = tables
        self._duration_ns = duration_ns
        self._places: dict[str, str] = {}
        self._alike: dict[Steps, Step] = {}  #: by place, in rounds whose names stand for the same
        self.names: dict[str, int] = {}
        self.earliest: list[int] = []
        self.steps: list[Step] = []

    def take(self, steps: tuple[schema.Step, ...], place: Place, rounds: str = "") -> None:
        """Append ``steps``; ``rounds`` numbers the rounds of the loops around them."""
        for number, step in enumerate(steps):
            here = place / number
            if step.repeat is None:
                self._step(step, here, rounds)
            else:
                self._loop(step, step.repeat, here, rounds)

    def _loop(self, step: schema.Step, repeat: schema.Repeat, place: Place, rounds: str) -> None:
        plain = schema.Step()
        for key in schema.Step.__struct_fields__:
            if key not in _LOOP_KEYS and getattr(step, key) != getattr(plain, key):
                hint = "put it into a step of the loop"
                raise (place / key).refuse("nothing beside 'repeat'", f"'{key}'", hint)
        inside = place / "repeat"
        for number, values in enumerate(self._rounds(repeat, inside)):
            if values:
                self._alike.clear()
            with self._values.given(values, inside / "for", check_use=number == 0):
                self.take(repeat.steps, inside / "steps", f"{rounds}.{number + 1}".lstrip("."))
        if repeat.each:
            self._alike.clear()

    def _rounds(self, repeat: schema.Repeat, place: Place) -> Iterator[dict[str, Value]]:
        """Yield what the loop's names stand for in each round."""
        if (repeat.times is None) == (not repeat.each):
            got = "both" if repeat.each else "none"
            raise place.refuse("'times' or 'for'", got)
        if repeat.times is not None:
            yield from ({} for _ in range(repeat.times))
            return
        first, *others = repeat.each
        length = len(repeat.each[first])
        for name in others:
            if len(repeat.each[name]) != length:
                got = f"{len(repeat.each[name])}"
                raise (place / "for" / name).refuse(f"{length} values, as '{first}' has", got)
        for number in range(length):
            yield {name: each[number] for name, each in repeat.each.items()}

    def _step(self, step: schema.Step, place: Place, rounds: str) -> None:
        triggers = {"at": step.at, "when": step.when, "after": step.after}
        given = [name for name, value in triggers.items() if value is not None]
        if len(given) != 1:
            got = " and ".join(f"'{name}'" for name in given) or "none"
            raise place.refuse("one of 'at', 'when', 'after'", got)
        if rounds and step.at is not None:
            hint = "a loop's rounds have no times of their own"
            raise (place / "at").refuse("'after' or 'when' in a loop", "'at'", hint)
        number = len(self.steps)
        if number >= MAX_STEPS:
            raise place.refuse(f"at most {MAX_STEPS} steps, loops unrolled", "more")
        name = f"{step.name or f'step {number + 1}'}{f' [{rounds}]' if rounds else ''}"
        if step.name:
            if name in self.names:
                got = f"'{step.name}' again"
                hint = f"first in {self._places[name]}"
                raise (place / "name").refuse("each name once", got, hint)
            self.names[name] = number
            self._places[name] = place.path
        made = self._alike.get(place.steps)
        if made is None:
            made = self._made(step, place)
            if rounds:
                self._alike[place.steps] = made
        self._order(made, step, place)
        self.steps.append(msgspec.structs.replace(made, name=name))

    def _made(self, step: schema.Step, place: Place) -> Step:
        """Return a step without its name."""
        at_ns = None if step.at is None else self._values.time(step.at, place / "at")
        after_ns = None if step.after is None else self._values.time(step.after, place / "after")
        condition, timeout_ns, held_ns = self._trigger(step, place)
        span = Span(0, 0) if condition is None else self._tables.add_code(condition.code)
        return Step(
            name="",
            at_ns=at_ns,
            after_ns=after_ns,
            when=condition,
            when_span=span,
            timeout_ns=timeout_ns,
            held_ns=held_ns,
            stop_on_timeout=step.on_timeout == "stop",
            actions=tuple(self._stimuli.actions(step, place)),
            commands=tuple(self._stimuli.commands(step, place)),
            where=str(place),
        )

    def _order(self, made: Step, step: schema.Step, place: Place) -> None:
        before = self.earliest[-1] if self.earliest else 0
        earliest, key = before, "when"
        if made.at_ns is not None:
            earliest, key = made.at_ns, "at"
            if earliest < before:
                got = f"'{step.at}'"
                hint = f"the step before comes at {say_time(before)} or later"
                raise (place / "at").refuse("steps in the order of their times", got, hint)
        elif made.after_ns is not None:
            earliest, key = before + made.after_ns, "after"
        if self._duration_ns is not None and earliest > self._duration_ns:
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


def beyond(time_ns: int, duration_ns: int) -> tuple[str, str, str]:
    """Return expected, got and hint for a time after the scenario's end."""
    end = f"a time up to the scenario's end, {say_time(duration_ns)}"
    return end, say_time(time_ns), "raise duration or move it"


def say_time(time_ns: int) -> str:
    """Return a time in words."""
    return f"{time_ns * 1e-9:g} s"
