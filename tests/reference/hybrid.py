"""SciPy's Radau between instants at which something changes: a crossing of zero, or a sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import Radau
from scipy.optimize import brentq

Rates = Callable[[float, np.ndarray], np.ndarray]
RTOL = 1e-10


class Crossing(NamedTuple):
    """A function of time and state whose rise through zero ends a stretch."""

    name: str
    value: Callable[[float, np.ndarray], float]


class Stretch:
    """Smooth motion from ``t`` on; ends at the first crossing, or at a given time."""

    def __init__(self, rates: Rates, t: float, y: np.ndarray, atol: np.ndarray) -> None:
        self.rates, self.t, self.y, self.atol = rates, t, y, atol
        self._step: float | None = None

    def until(
        self, end: float, crossings: Sequence[Crossing]
    ) -> Iterator[tuple[float, float, Callable[[float], np.ndarray], str]]:
        """Yield (from, to, dense solution, name of what ended it or "") step by step.

        After a name the caller changes ``y`` or the rates as it must and calls again.
        """
        if end - self.t < 1e-15:
            return
        first = None if self._step is None else min(self._step, end - self.t)
        solver = Radau(self.rates, self.t, self.y, end, rtol=RTOL, atol=self.atol, first_step=first)
        before = [one.value(self.t, self.y) for one in crossings]
        while solver.status == "running":
            message = solver.step()
            if solver.status == "failed":
                raise RuntimeError(f"Radau at {solver.t}: {message}")
            start, stop = solver.t_old, solver.t
            dense = solver.dense_output()
            if solver.status == "running":
                self._step = solver.h_abs
            after = [one.value(stop, solver.y) for one in crossings]
            found: list[tuple[float, str]] = []
            for one, a, b in zip(crossings, before, after, strict=True):
                if a < 0.0 <= b:

                    def gap(t: float, one: Crossing = one, dense: Any = dense) -> float:
                        return one.value(t, dense(t))

                    # The dense solution may miss the state at the ends by its tolerance.
                    at = stop if gap(stop) < 0.0 else brentq(gap, start, stop, xtol=1e-14)
                    found.append((at, one.name))
            if found:
                at, name = min(found)
                self.t, self.y = at, dense(at)
                yield start, at, dense, name
                return
            before = after
            self.t, self.y = stop, solver.y
            yield start, stop, dense, ""
