"""Plays a scenario: called at ticks with what is on the bus, it answers with what to send.

No clock and no I/O: time is handed in.  Within one call the order is: the step's trigger, the
stimuli, the expectations.  A step's condition is first tested one tick after the step before it,
so that it never sees the state from before that step's requests could act.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from hev_can_emu.scenario import program
from hev_can_emu.scenario.compiler import compile_scenario
from hev_can_emu.scenario.expectations import NEVER, Monitor
from hev_can_emu.scenario.place import Place, Steps, spell
from hev_can_emu.scenario.schema import Scenario
from hev_can_emu.scenario.signals import Signal, Signals
from hev_can_emu.scenario.stimuli import (
    Follower,
    Instant,
    Line,
    SetSignal,
    Shape,
    Stimulus,
    Wave,
)
from hev_can_emu.scenario.verdict import Outcome, Verdict, worst

TICK_NS = 1_000_000


class Player:
    """One run of one scenario.

    Args:
        scenario: the file's content.
        signals: the network (``Signals(database.messages)``).
        locate: turns a path in the scenario into its place in the file.
        tick_ns: the grid on which :meth:`step` is called.

    Raises:
        InputError: the scenario does not fit the network, or itself.
    """

    def __init__(
        self,
        scenario: Scenario,
        signals: Signals,
        locate: Callable[[Steps], str] = spell,
        tick_ns: int = TICK_NS,
    ) -> None:
        self.program = compile_scenario(scenario, signals, Place(locate))
        self.finished = False
        self._tick_ns = tick_ns
        self._next = 0  #: the step that is waited for
        self._fired_ns: list[int | None] = [None] * len(self.program.steps)
        self._last_ns = 0  #: when the latest step came
        self._true_since_ns: int | None = None
        self._present: dict[int, float] = {}
        self._shapes: dict[int, Shape] = {}
        self._signals: dict[int, Signal] = {}
        self._step_verdicts: list[Verdict] = []
        self._waiting: list[tuple[program.Watch, Monitor]] = []
        self._open: list[Monitor] = []
        self._endless: list[tuple[program.Watch, Monitor]] = []
        self._monitors: list[Monitor] = []
        for watch in self.program.watches:
            monitor = watch.make()
            self._monitors.append(monitor)
            self._waiting.append((watch, monitor))
        self._due_ns = 0  #: the soonest opening among the waiting windows, as far as known

    def step(
        self, t_ns: int, values: npt.NDArray[np.float64], seen_ns: npt.NDArray[np.int64]
    ) -> list[Stimulus]:
        """Advance to ``t_ns`` and return what changes in what is sent.

        Args:
            t_ns: scenario time, never decreasing, on the grid of ticks.
            values: shape ``(signals,)``, physical values as last received, NaN not available.
            seen_ns: shape ``(signals,)``, scenario time of each signal's last frame, -1 never.
        """
        if self.finished:
            return []
        item, seen = values.item, seen_ns.item
        out: list[Stimulus] = []
        now = Instant(t_ns, item, seen, t_ns * 1e-9, (t_ns - self._last_ns) * 1e-9)
        if self._next < len(self.program.steps) and self._advance(now, out):
            now = now._replace(since_step_s=(t_ns - self._last_ns) * 1e-9)
            self._bound_windows()
        if self._shapes:
            self._run_shapes(now, out)
        if t_ns >= self._due_ns and self._waiting:
            self._open_windows(now)
        if self._open:
            self._watch(now)
        if t_ns >= self.program.duration_ns or self.finished:
            self._end(now)
        return out

    def next_wake_ns(self, t_ns: int) -> int:
        """Return the next instant after ``t_ns`` at which :meth:`step` must be called.

        It lies on the grid.  Between the two nothing that is received or that passes can change
        what the player does.
        """
        tick = self._tick_ns
        if self.finished:
            return NEVER
        if self._open or self._shapes:
            return t_ns + tick
        wake = self.program.duration_ns
        if self._next < len(self.program.steps):
            due = self._due_of(self.program.steps[self._next])
            if due is None:
                return t_ns + tick
            wake = min(wake, due)
        if self._waiting:
            wake = min(wake, self._due_ns)
        return max(t_ns + tick, -(-wake // tick) * tick)

    def finish(self, t_ns: int, reason: str) -> None:
        """End early (bus lost, interrupted): what is undecided becomes inconclusive."""
        if self.finished:
            return
        self.finished = True
        self._give_up_steps(t_ns, reason, Outcome.INCONCLUSIVE)
        for monitor in self._monitors:
            monitor.abandon(f"{reason} at {t_ns * 1e-9:.3f} s")

    def verdicts(self) -> list[Verdict]:
        """Return the verdicts of steps, then of expectations, in the order of the file."""
        return [*self._step_verdicts, *(monitor.verdict() for monitor in self._monitors)]

    @property
    def steps_over(self) -> int:
        """How many steps have come, or were given up."""
        return self._next

    @property
    def awaited(self) -> str:
        """The step that is waited for, for a status line; empty after the last."""
        steps = self.program.steps
        return steps[self._next].name if self._next < len(steps) else ""

    @property
    def outcome(self) -> Outcome:
        """The worst outcome of all."""
        return worst(self.verdicts())

    # Steps

    def _due_of(self, step: program.Step) -> int | None:
        if step.at_ns is not None:
            return step.at_ns
        if step.after_ns is not None:
            return self._last_ns + step.after_ns
        return None

    def _advance(self, now: Instant, out: list[Stimulus]) -> bool:
        """Take every step whose time or condition has come; tell whether any was."""
        taken = False
        steps = self.program.steps
        while self._next < len(steps) and not self.finished:
            step = steps[self._next]
            if step.when is None:
                due = self._due_of(step)
                if due is None or now.t_ns < due:
                    break
                self._timed(step, due, now)
            elif taken or not self._conditional(step, now):
                break
            self._fired_ns[self._next] = self._last_ns = now.t_ns
            self._true_since_ns = None
            self._next += 1
            taken = True
            if not self.finished:
                self._act(step, now, out)
                self._due_ns = 0
        return taken

    def _timed(self, step: program.Step, due: int, now: Instant) -> None:
        if step.at_ns is None:
            expected, late = f"{(step.after_ns or 0) * 1e-9:g} s after the step before", False
        else:
            expected, late = f"at {due * 1e-9:g} s", self._last_ns > due
        observed = "the step before came too late" if late else ""
        outcome = Outcome.FAIL if late else Outcome.PASS
        margin = (due - now.t_ns) * 1e-9 if late else None
        self._judge(step, outcome, now.t_ns, expected, observed, margin)

    def _conditional(self, step: program.Step, now: Instant) -> bool:
        """Tell whether the step is over: its condition has come, or its time has run out."""
        assert step.when is not None
        waited_ns = now.t_ns - self._last_ns
        if step.when.function(now.item, now.seen, now.t_s, now.since_step_s):
            if self._true_since_ns is None:
                self._true_since_ns = now.t_ns
            if now.t_ns - self._true_since_ns >= step.held_ns:
                margin = (step.timeout_ns - waited_ns) * 1e-9
                observed = step.when.observe(now.item)
                self._judge(step, Outcome.PASS, now.t_ns, _awaits(step), observed, margin)
                return True
        else:
            self._true_since_ns = None
        if waited_ns < step.timeout_ns:
            return False
        self._judge(step, Outcome.FAIL, now.t_ns, _awaits(step), step.when.observe(now.item), None)
        self.finished = step.stop_on_timeout
        return True

    def _judge(
        self,
        step: program.Step,
        outcome: Outcome,
        t_ns: int | None,
        expected: str,
        observed: str,
        margin: float | None,
    ) -> None:
        unit = "" if margin is None else "s"
        reads = () if step.when is None else step.when.reads
        self._step_verdicts.append(
            Verdict(
                "step",
                step.name,
                outcome,
                t_ns,
                expected,
                observed,
                margin,
                unit,
                step.where,
                reads=reads,
            )
        )

    # Stimuli

    def _act(self, step: program.Step, now: Instant, out: list[Stimulus]) -> None:
        for signal, action in step.actions:
            index = signal.index
            self._shapes.pop(index, None)
            present = self._present.get(index, signal.initial)
            match action:
                case program.Set(value):
                    self._put(index, value, out)
                case program.Release():
                    self._put(index, signal.initial, out)
                    self._present.pop(index, None)
                case program.Ramp(start, end, length_ns):
                    begin = _first_number(start, present)
                    self._shapes[index] = Line(begin, end, now.t_ns, length_ns)
                case program.Sine(offset, amplitude, omega, phase):
                    middle = _first_number(offset, present)
                    self._shapes[index] = Wave(middle, amplitude, omega, phase, now.t_ns)
                case program.Follow(expression, gain, offset):
                    self._shapes[index] = Follower(expression, gain, offset)
                case program.Hold():
                    pass
        out.extend(step.messages)

    def _put(self, index: int, value: float, out: list[Stimulus]) -> None:
        self._present[index] = value
        out.append(SetSignal(index, value))

    def _run_shapes(self, now: Instant, out: list[Stimulus]) -> None:
        present = self._present
        done: list[int] = []
        for index, shape in self._shapes.items():
            value = shape.value(now)
            if value == value and value != present.get(index):
                present[index] = value
                out.append(SetSignal(index, value))
            if shape.done:
                done.append(index)
        for index in done:
            del self._shapes[index]

    # Expectations

    def _resolve(self, instant: program.Instant) -> int | None:
        if instant.step is None:
            return instant.offset_ns
        fired = self._fired_ns[instant.step]
        return None if fired is None else fired + instant.offset_ns

    def _open_windows(self, now: Instant) -> None:
        waiting: list[tuple[program.Watch, Monitor]] = []
        self._due_ns = NEVER
        for watch, monitor in self._waiting:
            opens, closes = self._resolve(watch.opens), self._resolve(watch.closes)
            if opens is None or (closes is None and watch.closes.step is None):
                waiting.append((watch, monitor))
            elif opens > now.t_ns:
                self._due_ns = min(self._due_ns, opens)
                waiting.append((watch, monitor))
            else:
                monitor.opened, monitor.open_ns = True, opens
                self._open.append(monitor)
                if closes is None:
                    self._endless.append((watch, monitor))
                else:
                    monitor.close_ns = closes
        self._waiting = waiting

    def _bound_windows(self) -> None:
        """Give open windows that last until a step their end, once the step has come."""
        for watch, monitor in self._endless:
            closes = self._resolve(watch.closes)
            if closes is not None:
                monitor.close_ns = closes
        self._endless = [pair for pair in self._endless if pair[1].close_ns == NEVER]

    def _watch(self, now: Instant) -> None:
        t_ns = now.t_ns
        decided = False
        for monitor in self._open:
            monitor.check(now)
            if monitor.outcome is None and t_ns >= monitor.close_ns:
                monitor.close(now)
            decided = decided or monitor.outcome is not None
        if decided:
            self._open = [each for each in self._open if each.outcome is None]

    # The end

    def _give_up_steps(self, t_ns: int, reason: str, first: Outcome) -> None:
        """Judge the steps that never came: the one waited for by ``first``, the rest open."""
        for step in self.program.steps[self._next :]:
            observed = f"not reached: {reason} at {t_ns * 1e-9:.3f} s"
            self._judge(step, first, None, _awaits(step), observed, None)
            first = Outcome.INCONCLUSIVE
        self._next = len(self.program.steps)

    def _end(self, now: Instant) -> None:
        stopped = self.finished
        self.finished = True
        reason = "the scenario stopped" if stopped else "the scenario ended"
        first = Outcome.INCONCLUSIVE if stopped else Outcome.FAIL
        self._give_up_steps(now.t_ns, reason, first)
        for monitor in self._monitors:
            monitor.abandon(f"{reason} at {now.t_ns * 1e-9:.3f} s")


def _awaits(step: program.Step) -> str:
    if step.when is None:
        if step.at_ns is not None:
            return f"at {step.at_ns * 1e-9:g} s"
        return f"{(step.after_ns or 0) * 1e-9:g} s after the step before"
    held = f" for {step.held_ns * 1e-9:g} s" if step.held_ns else ""
    return f"{step.when.text}{held} within {step.timeout_ns * 1e-9:g} s"


def _first_number(*values: float) -> float:
    return next((value for value in values if not math.isnan(value)), 0.0)
