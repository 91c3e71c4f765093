"""The sum of squares that identification lowers: measurements in tolerances, and a weak prior."""

from __future__ import annotations

from typing import cast

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from hev_can_emu.plant.observations import Observation, StepObservation
from hev_can_emu.plant.problem import Problem
from hev_can_emu.plant.residuals import Prediction, predict_modes
from hev_can_emu.plant.step_residuals import predict_step

Array = npt.NDArray[np.float64]

_EXCESS_TOLERANCE = 5e-4
"""How much another half-wave of the step response may exceed the measured one."""
_WEAK, _STRONG = 0.1, 3.0
"""Weights of a deviation within and beyond the slack."""
_RATIO_GUESS = 0.03
"""Relative tolerance of the first mode's damping ratio guessed from the step response."""


class Objective:
    """Residuals and Jacobian over a subset of the sought parameters; remembers the last point."""

    def __init__(
        self,
        problem: Problem,
        at: Array,
        free: npt.NDArray[np.bool_],
        prior: float,
        *,
        coarse: float = 0.0,
        with_damping: bool = True,
        with_step: bool = False,
        slack: float = 0.0,
        with_ratio: float | None = None,
    ) -> None:
        self.problem, self.free, self.prior = problem, free, prior
        self.coarse, self.with_damping, self.with_step = coarse, with_damping, with_step
        self.slack, self.with_ratio = slack, with_ratio
        self._whole = at.copy()
        self._last: tuple[bytes, Array, Array] | None = None

    def whole(self, part: Array) -> Array:
        """Return all sought logarithms, the free ones taken from ``part``."""
        whole = self._whole.copy()
        whole[self.free] = part
        return whole

    def data(self, sought: Array) -> tuple[Array, Array]:
        """Return the measurements' residuals (in tolerances) and derivatives by all sought."""
        residuals: list[Array] = []
        slopes: list[Array] = []
        predictions = predict_modes(self.problem, sought, self.with_damping)
        for index, prediction in enumerate(predictions):
            if prediction is not None:
                one, slope = self._compare(index, predictions)
                residuals.append(one)
                slopes.append(slope)
        if self.with_ratio is not None:
            one, slope = self._compare_ratio(sought, self.with_ratio)
            residuals.append(one)
            slopes.append(slope)
        if self.with_step and self.problem.step is not None:
            one, slope = self._compare_step(sought, self.problem.step)
            residuals.append(one)
            slopes.append(slope)
        return np.concatenate(residuals), np.vstack(slopes)

    def _compare(self, index: int, predictions: list[Prediction | None]) -> tuple[Array, Array]:
        observation = self.problem.observations[index]
        values, jacobian = cast(Prediction, predictions[index])
        wanted = np.array(observation.values)
        tolerances = np.array(observation.tolerances)
        if not self.coarse:
            return (values - wanted) / tolerances, jacobian / tolerances[:, None]
        # Far away, ratios matter: a logarithm does not saturate where a mode is far too low.
        ratio = wanted / np.maximum(tolerances, self.coarse * wanted)
        found = np.maximum(values, 1e-9 * wanted)
        residuals = ratio * np.log(found / wanted)
        slopes = (ratio / found)[:, None] * jacobian
        if observation.quantity == "damped":
            # What damping does is the small difference to the undamped frequency.  Comparing it, not
            # two numbers with seven digits, lets the solver take long steps.
            for row, order in enumerate(observation.orders):
                pair = self._undamped(observation, order, predictions)
                if pair is not None:
                    undamped, measured, slope = pair
                    gap = values[row] - undamped - (wanted[row] - measured)
                    residuals[row] = gap / tolerances[row]
                    slopes[row] = (jacobian[row] - slope) / tolerances[row]
        return residuals, slopes

    def _undamped(
        self, damped: Observation, order: int, predictions: list[Prediction | None]
    ) -> tuple[float, float, Array] | None:
        """Return predicted and measured undamped frequency of the same mode, and its derivatives."""
        for other, prediction in zip(self.problem.observations, predictions, strict=True):
            if (
                prediction is not None
                and other.quantity == "undamped"
                and other[:2] == damped[:2]
                and order in other.orders
            ):
                row = other.orders.index(order)
                return float(prediction.values[row]), other.values[row], prediction.jacobian[row]
        return None

    def _compare_step(self, sought: Array, observed: StepObservation) -> tuple[Array, Array]:
        found = predict_step(self.problem, sought)
        more = len(found.values) - len(observed.values) - len(observed.samples)
        excess = max(_EXCESS_TOLERANCE, 100.0 * self.coarse)
        sampled = [one.tolerance for one in observed.samples]
        tolerance = np.array([*observed.tolerances, *sampled, *(more * [excess])])
        sampled = [one.value for one in observed.samples]
        measured = np.array([*observed.values, *sampled, *(more * [0.0])])
        tolerance[:2] = np.fmax(tolerance[:2], self.coarse * measured[:2])
        given = ~np.isnan(measured)
        deviation = (found.values[given] - measured[given]) / tolerance[given]
        return deviation, found.jacobian[given] / tolerance[given, None]

    def _compare_ratio(self, sought: Array, wanted: float) -> tuple[Array, Array]:
        step = cast(StepObservation, self.problem.step)
        first = Observation("16dof", step.configuration, "damping_ratio", (0,), (wanted,), (0.0,))
        only = self.problem._replace(observations=(first,))
        values, jacobian = cast(Prediction, predict_modes(only, sought, True)[0])
        return np.log(values / wanted) / _RATIO_GUESS, jacobian / values[:, None] / _RATIO_GUESS

    def _evaluate(self, part: Array) -> tuple[Array, Array]:
        key = part.tobytes()
        if self._last is None or self._last[0] != key:
            sought = self.whole(part)
            residuals, slopes = self.data(sought)
            if self.slack:
                # Within the slack a weak pull to the middle, beyond it a strong one.
                beyond = np.maximum(np.abs(residuals) - self.slack, 0.0)
                slopes = slopes * np.where(beyond > 0.0, _STRONG, _WEAK)[:, None]
                residuals = _WEAK * residuals + (_STRONG - _WEAK) * np.copysign(beyond, residuals)
            pull = self.prior / self.problem.width
            residuals = np.concatenate([residuals, pull * (sought - self.problem.middle)])
            slopes = np.vstack([slopes, np.diag(pull)])[:, self.free]
            self._last = (key, residuals, slopes)
        return self._last[1], self._last[2]

    def residuals(self, part: Array) -> Array:
        """Return what is squared and summed: measurements, then the prior's pull."""
        return self._evaluate(part)[0]

    def jacobian(self, part: Array) -> Array:
        """Return the residuals' derivatives by the free logarithms."""
        return self._evaluate(part)[1]

    def solve(self, iterations: int) -> Array:
        """Return the sought logarithms at the least sum of squares, within the bounds."""
        lower, upper = self.problem.lower[self.free], self.problem.upper[self.free]
        margin = 1e-9 * (upper - lower)
        start = np.clip(self._whole[self.free], lower + margin, upper - margin)
        result = least_squares(
            self.residuals,
            start,
            jac=self.jacobian,
            bounds=(lower, upper),
            max_nfev=iterations,
            xtol=1e-12,
            ftol=1e-10,
            gtol=1e-12,
        )
        return self.whole(result.x)

    def worst(self, sought: Array) -> float:
        """Return the largest residual in tolerances."""
        return float(np.max(np.abs(self.data(sought)[0])))
