"""Expectations about conditions: always, never, becomes, until, follows, count, sequence."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from hev_can_emu.scenario.expression import Array, Expression, over_rows
from hev_can_emu.scenario.monitor import Block, Head, Monitor, first_true, truth_of
from hev_can_emu.scenario.verdict import Outcome


class Always(Monitor):
    """The condition holds, or (``never``) fails to hold, at every tick of the window."""

    def __init__(self, head: Head, condition: Expression, *, never: bool) -> None:
        super().__init__(head, condition.unit_name)
        self._condition = condition
        self._wanted = not never
        self._sign = -1.0 if never else 1.0
        self._available = False
        self._nearest: tuple[int, Array] | None = None

    def watch(self, block: Block) -> None:
        """Fail at the first tick that contradicts; keep the smallest margin."""
        t_ns, rows, last = block
        bad = first_true(truth_of(self._condition, rows) != self._wanted)
        if self._condition.margin is not None:
            self._approach(block, len(rows) if bad is None else bad + 1)
        if bad is not None:
            self._decide(Outcome.FAIL, t_ns[bad], self._see(rows[bad]))
            return
        self._available = self._available or bool(self._condition.available(rows).any())
        if not last:
            return
        if not self._available:
            told = "a signal was not available all the while"
            self._decide(Outcome.INCONCLUSIVE, t_ns[-1], told)
        elif self._nearest is None:
            self._decide(Outcome.PASS, t_ns[-1], self._see(rows[-1]))
        else:
            at_ns, row = self._nearest
            told = f"nearest at {at_ns * 1e-9:.3f} s: {self._see(row)}"
            self._decide(Outcome.PASS, t_ns[-1], told)

    def _approach(self, block: Block, count: int) -> None:
        assert self._condition.margin is not None
        margins = self._sign * over_rows(self._condition.margin, block.rows[:count])
        known = np.where(np.isnan(margins), np.inf, margins)
        place = int(known.argmin())
        if known[place] < self.margin:
            self.margin = float(known[place])
            self._nearest = int(block.t_ns[place]), block.rows[place].copy()


class Becomes(Monitor):
    """The condition holds at some tick of the window; the margin is the time left."""

    def __init__(self, head: Head, condition: Expression) -> None:
        super().__init__(head, condition.unit_name)
        self._condition = condition

    def watch(self, block: Block) -> None:
        """Pass at the first tick at which the condition holds."""
        t_ns, rows, last = block
        found = first_true(truth_of(self._condition, rows))
        if found is not None:
            self._leave(t_ns[found])
            self._decide(Outcome.PASS, t_ns[found], self._see(rows[found]))
        elif last:
            if self._condition.margin is not None:
                margin = over_rows(self._condition.margin, rows[-1:])[0]
                self.margin = float(margin) if math.isfinite(margin) else math.inf
            self._decide(Outcome.FAIL, t_ns[-1], self._see(rows[-1]))


class Until(Monitor):
    """One condition holds at every tick before the one at which the other comes."""

    def __init__(self, head: Head, holds: Expression, comes: Expression) -> None:
        super().__init__(head, holds.unit_name)
        self._holds = holds
        self._comes = comes

    def watch(self, block: Block) -> None:
        """Fail where the first ceases too early, or where the second does not come in time."""
        t_ns, rows, last = block
        end = first_true(truth_of(self._comes, rows))
        bad = first_true(~truth_of(self._holds, rows[:end]))
        if bad is not None:
            if self._holds.margin is not None:
                margin = over_rows(self._holds.margin, rows[bad : bad + 1])[0]
                self.margin = float(margin) if math.isfinite(margin) else math.inf
            self._decide(Outcome.FAIL, t_ns[bad], f"ceased too early: {self._see(rows[bad])}")
        elif end is not None:
            self._leave(t_ns[end])
            self._decide(Outcome.PASS, t_ns[end], self._see(rows[end]))
        elif last:
            self._decide(Outcome.FAIL, t_ns[-1], f"has not come: {self._see(rows[-1])}")


class Follows(Monitor):
    """Each time the cause comes, the effect holds at some tick of the time allowed from then on."""

    def __init__(self, head: Head, cause: Expression, effect: Expression, within_ns: int) -> None:
        super().__init__(head, "s")
        self._cause = cause
        self._effect = effect
        self._within_ns = within_ns
        self._before = False
        self._pending: list[int] = []
        self._judged = 0
        self._slowest: tuple[int, int] | None = None  #: when, after what time

    def watch(self, block: Block) -> None:
        """Match causes with effects; fail where one has waited too long."""
        t_ns, rows, last = block
        cause = truth_of(self._cause, rows)
        rises = cause & ~np.concatenate([[self._before], cause[:-1]])
        self._before = bool(cause[-1])
        self._pending += [int(each) for each in t_ns[rises]]
        effects = t_ns[truth_of(self._effect, rows)]
        left = []
        for begin in self._pending:
            place = int(np.searchsorted(effects, begin))
            came = int(effects[place]) if place < len(effects) else None
            if came is not None and came - begin <= self._within_ns:
                self._judged += 1
                if self._slowest is None or came - begin > self._slowest[1]:
                    self._slowest = begin, came - begin
                    self.margin = (self._within_ns - (came - begin)) * 1e-9
            elif t_ns[-1] > begin + self._within_ns:
                at = first_true(t_ns > begin + self._within_ns)
                assert at is not None
                self.margin = math.inf
                told = f"nothing followed {begin * 1e-9:.3f} s: {self._see(rows[at])}"
                self._decide(Outcome.FAIL, t_ns[at], told)
                return
            else:
                left.append(begin)
        self._pending = left
        if last:
            self._close(int(t_ns[-1]))

    def _close(self, t_ns: int) -> None:
        if self._slowest is None:
            told = "the cause has not come"
            if self._pending:
                told = f"the window closed before the time allowed from {self._pending[0] * 1e-9:.3f} s on"
            self._decide(Outcome.INCONCLUSIVE, t_ns, told)
            return
        at_ns, delay_ns = self._slowest
        told = f"{self._judged} times, slowest {delay_ns * 1e-9:.3f} s after {at_ns * 1e-9:.3f} s"
        self._decide(Outcome.PASS, t_ns, told)


class Count(Monitor):
    """The condition comes at least and at most so often in the window."""

    def __init__(self, head: Head, condition: Expression, least: int, most: int | None) -> None:
        super().__init__(head, "")
        self._condition = condition
        self._least = least
        self._most = most
        self._before = False
        self._times: list[int] = []

    def watch(self, block: Block) -> None:
        """Count ticks at which the condition comes to hold."""
        t_ns, rows, last = block
        holds = truth_of(self._condition, rows)
        rises = holds & ~np.concatenate([[self._before], holds[:-1]])
        self._before = bool(holds[-1])
        self._times += [int(each) for each in t_ns[rises]]
        count = len(self._times)
        if self._most is not None and count > self._most:
            self.margin = -1.0
            self._decide(Outcome.FAIL, self._times[self._most], self._told(self._most + 1))
        elif last:
            spare = count - self._least
            self.margin = float(spare if self._most is None else min(spare, self._most - count))
            self._decide(Outcome.PASS if spare >= 0 else Outcome.FAIL, t_ns[-1], self._told(count))

    def _told(self, count: int) -> str:
        shown = ", ".join(f"{each * 1e-9:.3f}" for each in self._times[: min(count, 10)])
        more = " s, ..." if count > 10 else " s" if count else ""
        return f"{count} times" + (f": at {shown}{more}" if count else "")


class InSequence(Monitor):
    """The value takes the wanted values one after the other."""

    def __init__(
        self,
        head: Head,
        value: Expression,
        wanted: Sequence[float],
        exactly: bool,
        say: Callable[[float], str],
    ) -> None:
        super().__init__(head, value.unit_name)
        self._value = value
        self._wanted = tuple(wanted)
        self._exactly = exactly
        self._say = say
        self._reached = 0
        self._last = math.nan
        self._met: list[float] = []

    def watch(self, block: Block) -> None:
        """Compare each new value with the next wanted one."""
        values = self._value.values(block.rows)
        known = np.flatnonzero(~np.isnan(values))
        there = values[known]
        changed = there != np.concatenate([[self._last], there[:-1]])
        for place in known[changed]:
            self._take(float(values[place]), int(block.t_ns[place]))
            if self.outcome is not None:
                return
        if block.last:
            complete = self._reached == len(self._wanted)
            met = self._chain() or "no value"
            self._decide(Outcome.PASS if complete else Outcome.FAIL, block.t_ns[-1], met)

    def _take(self, value: float, t_ns: int) -> None:
        self._last = value
        self._met.append(value)
        if self._reached < len(self._wanted) and value == self._wanted[self._reached]:
            self._reached += 1
            if self._reached == len(self._wanted) and not self._exactly:
                self._leave(t_ns)
                self._decide(Outcome.PASS, t_ns, self._chain())
        elif self._exactly:
            self._decide(Outcome.FAIL, t_ns, self._chain())

    def _chain(self) -> str:
        met = self._met
        return ("... > " if len(met) > 20 else "") + " > ".join(self._say(v) for v in met[-20:])
