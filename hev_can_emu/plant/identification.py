"""Identification: staged least squares on logarithms of the parameters, from a random start.

A start goes through stages, each beginning where the last one ended: frequencies alone, first
loosely, then within their tolerances; damping alone, from several guesses; everything together; then the
step response.  In each, what is most plausible for a parameter pulls weakly (a prior), and a start
that cannot succeed any more is given up.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant.objective import Objective
from hev_can_emu.plant.observations import GRID, Observation
from hev_can_emu.plant.problem import Problem
from hev_can_emu.plant.residuals import Prediction, predict_modes
from hev_can_emu.plant.step_residuals import run_step

Array = npt.NDArray[np.float64]


_HOPELESS = 20.0
"""Largest deviation, in tolerances, that a start may leave a stage with."""


class Row(NamedTuple):
    """A line of the fit table: a measured number, its tolerance, and what the fit gives."""

    what: str
    unit: str
    measured: float
    tolerance: float
    found: float

    @property
    def error(self) -> float:
        """Deviation in tolerances; within -1 to 1 the measured number is met."""
        return (self.found - self.measured) / self.tolerance


class Fit(NamedTuple):
    """What one start came to.

    Attributes:
        start: its number.
        sought: logarithms of the sought parameters, shape (p,).
        worst: largest deviation in tolerances (infinite where the start was given up early).
        stage: the last stage gone through.
        matched: every measured number is met within its tolerance.
    """

    start: int
    sought: Array
    worst: float
    stage: str
    matched: bool


def fit_start(problem: Problem, seed: int, start: int) -> Fit:
    """Return what start number ``start`` comes to; the same seed and number give the same fit."""
    random = np.random.default_rng([seed, start])
    span = problem.upper - problem.lower
    at = problem.lower + span * random.uniform(0.02, 0.98, len(problem.sought))
    everything = np.ones(len(problem.sought), dtype=bool)
    damping = np.array([name.startswith("damping.") for name in problem.sought])
    elastic = ~damping
    has_damping = any(one.quantity != "undamped" for one in problem.observations)

    def stage(free: npt.NDArray[np.bool_], prior: float, **options: object) -> Objective:
        return Objective(problem, at, free, prior, **options)  # type: ignore[arg-type]

    if elastic.any():
        for coarse, prior, iterations in ((1e-2, 0.3, 60), (1e-4, 0.1, 60), (0.0, 0.03, 100)):
            at = stage(elastic, prior, coarse=coarse, with_damping=False).solve(iterations)
    if stage(elastic, 0.0, with_damping=False).worst(at) > _HOPELESS:
        return Fit(start, at, np.inf, "frequencies", False)

    if has_damping and damping.any():
        guesses = []
        for _ in range(6):
            at = np.where(damping, problem.lower + span * random.uniform(0, 1, len(span)), at)
            guess = stage(damping, 0.3).solve(60)
            guesses.append((stage(damping, 0.0).worst(guess), guess))
        at = min(guesses, key=lambda pair: pair[0])[1]
    if has_damping:
        ratio = _guessed_ratio(problem, at)
        for coarse, prior in ((1e-4, 0.3), (1e-5, 0.1)):
            at = stage(everything, prior, coarse=coarse, with_ratio=ratio).solve(100)
        if stage(everything, 0.0).worst(at) > _HOPELESS:
            return Fit(start, at, np.inf, "damping", False)
    if problem.step is not None:
        for coarse, prior in ((1e-4, 0.1), (1e-5, 0.03)):
            at = stage(everything, prior, coarse=coarse, with_step=True).solve(40)
    at = _sharpen(problem, at, with_step=problem.step is not None)
    rows = table(problem, at)
    worst = max(abs(row.error) for row in rows)
    return Fit(start, at, worst, "all", worst <= 1.0)


def _guessed_ratio(problem: Problem, at: Array) -> float | None:
    """Return the first mode's damping ratio, as far as the step response tells it at once.

    The difference of two nearly equal decaying oscillations is largest one time constant after the
    step: ``1/(zeta*w)``.
    """
    if problem.step is None or np.isnan(problem.step.values[4]):
        return None
    first = Observation("16dof", problem.step.configuration, "undamped", (0,), (0.0,), (0.0,))
    only = problem._replace(observations=(first,))
    frequency = float(cast(Prediction, predict_modes(only, at, False)[0]).values[0])
    return 1.0 / (2.0 * np.pi * frequency * (problem.step.values[4] - problem.step.time))


def _sharpen(problem: Problem, at: Array, *, with_step: bool) -> Array:
    """Bring every deviation within its tolerance, if need be at the cost of those that are."""
    everything = np.ones(len(problem.sought), dtype=bool)
    for prior, iterations in ((0.03, 10), (0.01, 20), (0.003, 20)):
        objective = Objective(problem, at, everything, prior, with_step=with_step, slack=0.7)
        if objective.worst(at) <= 0.9:
            break
        at = objective.solve(iterations if with_step else 100)
    return at


def table(problem: Problem, sought: Array) -> list[Row]:
    """Return one line per measured number, the step response's taken from its run."""
    rows: list[Row] = []
    predictions = predict_modes(problem, sought, with_damping=True)
    for observation, prediction in zip(problem.observations, predictions, strict=True):
        assert prediction is not None
        unit = "" if observation.quantity == "damping_ratio" else "Hz"
        for order, measured, tolerance, found in zip(
            observation.orders,
            observation.values,
            observation.tolerances,
            prediction.values.tolist(),
            strict=True,
        ):
            what = f"{observation.model} {observation.configuration} {observation.quantity}"
            rows.append(Row(f"{what} {order + 1}", unit, measured, tolerance, found))
    if problem.step is not None:
        run = run_step(problem, sought)
        found_numbers = (
            float(run.velocity_16[-1]),
            float(run.velocity_4[-1]),
            run.velocity_difference_percent,
            run.acceleration_difference_percent,
            run.acceleration_difference_time,
        )
        names = (
            ("speed, 16dof", "m/s"),
            ("speed, 4dof", "m/s"),
            ("speeds apart", "%"),
            ("accelerations apart", "%"),
            ("when", "s"),
        )
        for (what, unit), measured, tolerance, found in zip(
            names, problem.step.values, problem.step.tolerances, found_numbers, strict=True
        ):
            if not np.isnan(measured):
                rows.append(Row(f"step response: {what}", unit, measured, tolerance, found))
        before = round(problem.step.time / GRID)
        for one in problem.step.samples:
            speed = one.quantity == "vehicle_speed"
            found = float((run.velocity_16 if speed else run.acceleration_16)[before + one.at])
            what = f"step response: {one.quantity[8:]} at {GRID * (before + one.at):g} s"
            rows.append(Row(what, "m/s" if speed else "m/s^2", one.value, one.tolerance, found))
    return rows


class Determinacy(NamedTuple):
    """Which combinations of parameters the measurements fix, at one solution.

    A combination is a product of powers of the parameters; its uncertainty is the relative change
    that moves the measurements by one tolerance (root of the sum of squares).

    Attributes:
        uncertainties: shape (p,), one per combination, smallest first; infinite where none is.
        combinations: shape (p, p), row i the exponents of combination i (length one).
        shares: shape (p,), how much of each parameter lies in determined combinations, 0 to 1.
        determined: how many combinations are known better than ``limit``.
        limit: the relative uncertainty below which a combination counts as determined.
    """

    uncertainties: Array
    combinations: Array
    shares: Array
    determined: int
    limit: float


def determinacy(problem: Problem, sought: Array, limit: float = 0.01) -> Determinacy:
    """Return what the measurements determine, from the singular values of their Jacobian."""
    everything = np.ones(len(problem.sought), dtype=bool)
    objective = Objective(problem, sought, everything, 0.0, with_step=problem.step is not None)
    jacobian = objective.data(sought)[1]
    _, values, rows = np.linalg.svd(jacobian, full_matrices=True)
    uncertainties = np.full(len(sought), np.inf)
    positive = values > 1e-9 * values[0]
    uncertainties[: len(values)][positive] = 1.0 / values[positive]
    determined = int(np.sum(uncertainties < limit))
    shares = np.sum(rows[:determined] ** 2, axis=0)
    return Determinacy(uncertainties, rows, shares, determined, limit)
