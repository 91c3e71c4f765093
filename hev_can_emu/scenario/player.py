"""Plays a scenario: takes its steps, and lets the compiled tick do all between them.

No clock and no I/O: time is handed in.  The order at a tick is: the steps that are due, the stimuli, the
expectations, then the tick itself.  A step's condition is first tested one tick after the step before it,
so that it never sees the state from before that step's requests could act.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.scenario import program, script
from hev_can_emu.scenario.compiler import compile_scenario
from hev_can_emu.scenario.expression import over_rows
from hev_can_emu.scenario.monitor import NEVER
from hev_can_emu.scenario.place import Place, Steps, spell
from hev_can_emu.scenario.schema import Scenario
from hev_can_emu.scenario.script import TICK_NS
from hev_can_emu.scenario.sources import Sources
from hev_can_emu.scenario.verdict import Outcome, Verdict, worst
from hev_can_emu.scenario.watcher import Watcher, Worker

Values = npt.NDArray[np.float64]


class _Phase(NamedTuple):
    """A list of steps: what they are called in verdicts, and what a failure among them means."""

    kind: str
    steps: tuple[program.Step, ...]
    failure: Outcome


class Player:
    """One run of one scenario.

    The caller repeats: :meth:`due` before a tick, then ticks with :attr:`script` up to
    :meth:`horizon_ns`, or until the script stops; :meth:`observe` now and then; where :meth:`ending`
    says so, no tick but :meth:`look`, and :meth:`end` once that lets go on.

    Args:
        scenario: the file's content.
        sources: the network, the plant's truth, events.
        locate: turns a path in the scenario into its place in the file.
        tick_ns: the grid of ticks.

    Attributes:
        script: what to do at every tick.
        finished: nothing is left to do.
        origin_ns: run time at which the steps' time 0 lies, after the setup.

    Raises:
        InputError: the scenario does not fit the network, or itself.
    """

    def __init__(
        self,
        scenario: Scenario,
        sources: Sources,
        locate: Callable[[Steps], str] = spell,
        tick_ns: int = TICK_NS,
    ) -> None:
        self.program = compile_scenario(scenario, sources, Place(locate), tick_ns)
        self.finished = False
        self.origin_ns: int | None = None
        self._tick_ns = tick_ns
        self._phases = (
            _Phase("setup", self.program.setup, Outcome.ERROR),
            _Phase("step", self.program.steps, Outcome.FAIL),
            _Phase("teardown", self.program.teardown, Outcome.ERROR),
        )
        self._phase = 0
        self._next = 0  #: the step that is waited for
        self._begin_ns = 0  #: when the phase began
        self._last_ns = 0  #: when the latest step came
        self._due_ns = 0  #: before it, only the script can call for a step
        self._stopped = ""
        self._fired_ns: dict[int, int] = {}
        self._verdicts: list[Verdict] = []
        everything = [step for phase in self._phases for step in phase.steps]
        shaped = {
            signal.index
            for step in everything
            for signal, action in step.actions
            if isinstance(action, program.Shape)
        }
        self._slots: Mapping[int, int] = {index: slot for slot, index in enumerate(sorted(shaped))}
        code, samples = self.program.tables.arrays()
        self.script = script.make_script(self.program.columns, code, len(shaped), samples)
        self._perform = script.bind_perform(self.script)
        # What is called for the first time may take long: before the clock starts, not in it.
        over_rows(np.zeros((1, 2)), np.zeros((0, 1)))
        self._watcher = Watcher(self.program.watches, self.script, self._resolve)
        self.script.control[script.ACTIVE] = 1

    # What the caller asks

    def due(self, t_ns: int, values: Values) -> list[program.Command]:
        """Take every step that is due at ``t_ns``.

        Args:
            t_ns: run time of the next tick, never decreasing, on the grid.
            values: what is sent, by signal, physical; changed in place.

        Returns:
            What else to do, in order.
        """
        control = self.script.control
        if self.finished or (t_ns < self._due_ns and control[script.STOPPED] == script.GO_ON):
            return []
        commands: list[program.Command] = []
        taken = False
        while not self.finished:
            steps = self._phases[self._phase].steps
            if self._stopped:
                break
            if self._next < len(steps):
                step = steps[self._next]
                if not self._comes(step, t_ns, taken):
                    break
                taken = True
                self._fire(step, t_ns, values, commands)
            elif self._phase == 1:
                break
            elif self._phase == 0:
                self._enter(1, t_ns)
                self.origin_ns = t_ns
                control[script.ORIGIN_NS] = t_ns
                control[script.RECORDING] = int(self._watcher.busy)
            else:
                self.finished = True
        control[script.STOPPED] = script.GO_ON
        self._await(t_ns)
        return commands

    def ending(self, t_ns: int) -> bool:
        """Return whether the scenario's time is over: :meth:`look`, then :meth:`end`, and no tick."""
        if self.finished or self._phase == 2:
            return False
        return bool(self._stopped) or t_ns >= self._end_ns

    def horizon_ns(self, t_ns: int) -> int:
        """Return the time before which no tick needs :meth:`due`, unless the script stops."""
        return max(self._due_ns, t_ns + self._tick_ns)

    def look(
        self,
        t_ns: int,
        on_bus: Values,
        seen_ns: npt.NDArray[np.int64],
        truth: Values,
        values: Values,
    ) -> int:
        """Do what the script does at a tick, outside of one; return script.GO_ON or why to wait."""
        return self._perform(t_ns, on_bus, seen_ns, truth, values)

    def hear(self, frames: npt.NDArray[np.void]) -> None:
        """Take frames that were on the bus."""
        self._watcher.hear(frames)

    def look_behind(self, worker: Worker | None) -> None:
        """Let expectations look on a second thread from now on; None: where :meth:`observe` is called.

        They decide the same, some time later; who asks for verdicts waits for that.
        """
        self._watcher.worker = worker

    def observe(self) -> None:
        """Let the expectations look at what the script has noted."""
        self._watcher.watch()
        if not self._watcher.busy:
            self.script.control[script.RECORDING] = 0

    @property
    def listens(self) -> bool:
        """Whether any expectation needs the frames."""
        return self._watcher.hears

    @property
    def full(self) -> bool:
        """Whether it is time to :meth:`observe`."""
        noted = self.script.control[script.ROWS]
        return bool(noted >= min(256, len(self.script.rows_ns)))

    def end(self, t_ns: int) -> None:
        """End the scenario's own time; the teardown follows, if there is one."""
        self.observe()
        stopped = bool(self._stopped)
        reason = self._stopped or "the scenario ended"
        failure = self._phases[self._phase].failure
        self._give_up(t_ns, reason, Outcome.INCONCLUSIVE if stopped else failure)
        for monitor in self._watcher.monitors:
            monitor.abandon(f"{reason} at {t_ns * 1e-9:.3f} s")
        self.script.control[script.RECORDING] = 0
        self._stopped = ""
        self._enter(2, t_ns)
        self._await(t_ns)
        self.finished = not self.program.teardown
        self.script.control[script.ACTIVE] = int(not self.finished)

    def finish(self, t_ns: int, reason: str) -> None:
        """End early (bus lost, interrupted): what is undecided becomes inconclusive."""
        if self.finished:
            return
        self.observe()
        self.finished = True
        self.script.control[script.ACTIVE] = 0
        self._give_up(t_ns, reason, Outcome.INCONCLUSIVE)
        for monitor in self._watcher.monitors:
            monitor.abandon(f"{reason} at {t_ns * 1e-9:.3f} s")

    def fail(self, t_ns: int, name: str, where: str, observed: str) -> None:
        """Stop, because something that the scenario asks for could not be done."""
        verdict = Verdict(
            "step", name, Outcome.ERROR, t_ns, "it can be done", observed, None, "", where
        )
        self._verdicts.append(verdict)
        self._stopped = "the scenario stopped"

    def distrust(self, t_ns: int, reason: str, expected: str) -> None:
        """Let no failure count, because the host could not keep up; the run is inconclusive."""
        for monitor in self._watcher.monitors:
            monitor.distrust(reason)
        self._verdicts = [
            each._replace(outcome=Outcome.INCONCLUSIVE) if each.outcome is Outcome.FAIL else each
            for each in self._verdicts
        ]
        self._verdicts.append(
            Verdict("clock", "the host keeps up", Outcome.INCONCLUSIVE, t_ns, expected, reason,
                    None, "", "")
        )  # fmt: skip

    def verdicts(self) -> list[Verdict]:
        """Return the verdicts of steps, then of expectations, in the order of the file."""
        return [*self._verdicts, *(each.verdict() for each in self._watcher.monitors)]

    @property
    def outcome(self) -> Outcome:
        """The worst outcome of all."""
        return worst(self.verdicts())

    @property
    def awaited(self) -> str:
        """The step that is waited for, for a status line; empty after the last."""
        left = [*self._phases[self._phase].steps[self._next :]]
        if self._phase == 0:
            left += self.program.steps
        return left[0].name if left else ""

    # Steps

    @property
    def _end_ns(self) -> int:
        return NEVER if self.origin_ns is None else self.origin_ns + self.program.duration_ns

    def _enter(self, phase: int, t_ns: int) -> None:
        self._phase, self._next = phase, 0
        self._begin_ns = self._last_ns = t_ns
        self.script.control[script.LAST_STEP_NS] = t_ns

    def _due_of(self, step: program.Step) -> int | None:
        if step.at_ns is not None:
            return self._begin_ns + step.at_ns
        if step.after_ns is not None:
            return self._last_ns + step.after_ns
        return None

    def _comes(self, step: program.Step, t_ns: int, taken: bool) -> bool:
        """Tell whether the step is over: its time or condition has come, or its time has run out."""
        if step.when is not None:
            return not taken and self._conditional(step, t_ns)
        due = self._due_of(step)
        if due is None or t_ns < due:
            return False
        late = step.at_ns is not None and self._last_ns > due
        observed = "the step before came too late" if late else ""
        margin = (due - t_ns) * 1e-9 if late else None
        outcome = self._phases[self._phase].failure if late else Outcome.PASS
        self._judge(step, outcome, t_ns, observed, margin)
        return True

    def _conditional(self, step: program.Step, t_ns: int) -> bool:
        assert step.when is not None
        stopped = self.script.control[script.STOPPED]
        if stopped not in (script.TRIGGERED, script.TIMED_OUT):
            return False
        self.script.control[script.STOPPED] = script.GO_ON
        observed = step.when.observe(self.script.row)
        if stopped == script.TRIGGERED:
            left = (step.timeout_ns - (t_ns - self._last_ns)) * 1e-9
            self._judge(step, Outcome.PASS, t_ns, observed, left)
        else:
            phase = self._phases[self._phase]
            self._judge(step, phase.failure, t_ns, observed, None)
            if step.stop_on_timeout and self._phase < 2:  # a teardown goes on as well as it can
                self._stopped = "the setup failed" if self._phase == 0 else "the scenario stopped"
        return True

    def _fire(
        self, step: program.Step, t_ns: int, values: Values, commands: list[program.Command]
    ) -> None:
        if self._phase == 1:
            self._fired_ns[self._next] = t_ns
        self._last_ns = t_ns
        self._next += 1
        control = self.script.control
        control[script.LAST_STEP_NS] = t_ns
        if self._stopped:
            return
        self._act(step, t_ns, values)
        commands += step.commands

    def _await(self, t_ns: int) -> None:
        """Tell the script what to wait for, and know when the next step is due."""
        control, steps = self.script.control, self._phases[self._phase].steps
        control[script.CONDITION_FIRST] = control[script.CONDITION_STOP] = 0
        self._due_ns = NEVER if self._phase == 2 else max(self._end_ns, t_ns)
        if self.finished or self._stopped or self._next >= len(steps):
            return
        step = steps[self._next]
        due = self._due_of(step)
        if due is not None:
            self._due_ns = min(self._due_ns, due)
            return
        control[script.CONDITION_FIRST] = step.when_span.first
        control[script.CONDITION_STOP] = step.when_span.first + step.when_span.length
        control[script.HELD_NS] = step.held_ns
        if control[script.ARMED_NS] != self._last_ns or t_ns == self._last_ns:
            control[script.ARMED_NS] = self._last_ns
            control[script.TRUE_SINCE_NS] = -1
        control[script.TIMEOUT_NS] = self._last_ns + step.timeout_ns

    def _act(self, step: program.Step, t_ns: int, values: Values) -> None:
        table, numbers = self.script.shapes, self.script.shape_values
        for signal, action in step.actions:
            slot = self._slots.get(signal.index)
            if slot is not None:
                table[slot, script.KIND] = script.IDLE
            match action:
                case program.Set(value):
                    values[signal.index] = value
                case program.Release():
                    values[signal.index] = signal.initial
                case program.Shape():
                    assert slot is not None
                    table[slot] = (
                        action.kind, signal.index, t_ns, action.length_ns,
                        action.span.first, action.span.length, action.mode,
                    )  # fmt: skip
                    numbers[slot, : len(action.numbers)] = action.numbers
                    if action.numbers and math.isnan(action.numbers[0]):
                        present = values[signal.index]
                        numbers[slot, 0] = 0.0 if math.isnan(present) else present
                case program.Hold():
                    pass
        following = int((table[:, script.KIND] == script.FOLLOW).sum())
        self.script.control[script.FOLLOWING] = following

    def _judge(
        self,
        step: program.Step,
        outcome: Outcome,
        t_ns: int | None,
        observed: str,
        margin: float | None,
    ) -> None:
        self._verdicts.append(
            Verdict(
                kind=self._phases[self._phase].kind,
                name=step.name,
                outcome=outcome,
                instant_ns=t_ns,
                expected=_awaits(step),
                observed=observed,
                margin=margin,
                margin_unit="" if margin is None else "s",
                where=step.where,
                reads=() if step.when is None else tuple(each.source for each in step.when.reads),
            )
        )

    def _give_up(self, t_ns: int, reason: str, first: Outcome) -> None:
        """Judge the steps that never came: the one waited for by ``first``, the rest open."""
        for phase in (0, 1):
            if phase < self._phase:
                continue
            if phase > self._phase:
                self._enter(phase, t_ns)
            for step in self._phases[phase].steps[self._next :]:
                observed = f"not reached: {reason} at {t_ns * 1e-9:.3f} s"
                self._judge(step, first, None, observed, None)
                first = Outcome.INCONCLUSIVE
            self._next = len(self._phases[phase].steps)

    def _resolve(self, instant: program.Instant) -> int | None:
        if instant.step is None:
            return None if self.origin_ns is None else self.origin_ns + instant.offset_ns
        fired = self._fired_ns.get(instant.step)
        return None if fired is None else fired + instant.offset_ns


def _awaits(step: program.Step) -> str:
    if step.when is None:
        if step.at_ns is not None:
            return f"at {step.at_ns * 1e-9:g} s"
        return f"{(step.after_ns or 0) * 1e-9:g} s after the step before"
    held = f" for {step.held_ns * 1e-9:g} s" if step.held_ns else ""
    return f"{step.when.text}{held} within {step.timeout_ns * 1e-9:g} s"
