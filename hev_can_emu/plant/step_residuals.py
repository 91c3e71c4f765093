"""What a parameter vector predicts for the measured step response, with the derivatives."""

from __future__ import annotations

from typing import cast

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant.eigen_gradient import Chain, step_acceleration
from hev_can_emu.plant.observations import GRID, MODES_16DOF, StepObservation
from hev_can_emu.plant.problem import Problem
from hev_can_emu.plant.residuals import (
    REDUCED_INCIDENCE,
    Prediction,
    full_entries,
    parameters_at,
    reduced_entries,
)
from hev_can_emu.plant.step_response import Step, StepResponse, step_response
from hev_can_emu.plant.structure import CONFIGURATIONS, INERTIAS, Configuration
from hev_can_emu.plant.vehicle import DrivelineParameters

Array = npt.NDArray[np.float64]

_STEP_DIFFERENCE = 1e-6
_CLEARLY_LARGEST = 0.9995


def predict_step(problem: Problem, sought: Array) -> Prediction:
    """Return the step response's numbers, by forward differences in each parameter.

    The first five are those of Figure 12, made smooth: the difference of accelerations is taken at the
    measured instant, with its sign, and the time of the largest from the slope there (NaN where not
    measured).  Then come the samples, and for each half-wave by what part it is larger than the
    measured one, 0 where it is smaller.
    """
    here = _step_numbers(problem, sought)
    jacobian = np.zeros((len(here), len(sought)))
    for index in range(len(sought)):
        moved = sought.copy()
        moved[index] += _STEP_DIFFERENCE
        jacobian[:, index] = (_step_numbers(problem, moved) - here) / _STEP_DIFFERENCE
    return Prediction(here, jacobian)


def run_step(problem: Problem, sought: Array) -> StepResponse:
    """Return the step response itself, on its grid of 0.01 s, by the exact propagators."""
    observed = cast(StepObservation, problem.step)
    step = Step(observed.time, observed.end, observed.engine, 0.0, observed.em2, GRID)
    return step_response(
        parameters_at(problem, sought), CONFIGURATIONS[observed.configuration], step
    )


def _step_numbers(problem: Problem, sought: Array) -> Array:
    observed = cast(StepObservation, problem.step)
    configuration = CONFIGURATIONS[observed.configuration]
    parameters = parameters_at(problem, sought)
    count = round((observed.end - observed.time) / GRID) + 1
    v16, a16 = _full_step(parameters, configuration, observed, count)
    v4, a4 = _reduced_step(parameters, configuration, observed, count)
    # With the sign the measured speeds have, lest the fit end where the models are swapped.
    sign = -1.0 if observed.values[0] < observed.values[1] else 1.0
    apart = 100.0 * sign * (v16[-1] - v4[-1]) / v16[-1]
    numbers = [v16[-1], v4[-1], apart, np.nan, np.nan]
    excess = np.zeros(0)
    if not np.isnan(observed.lowest):
        numbers[3], numbers[4], excess = _furthest_apart(observed, a16, a16 - a4)
    samples = [
        (v16 if one.quantity == "vehicle_speed" else a16)[one.at] for one in observed.samples
    ]
    return np.concatenate([numbers, samples, excess])


def _furthest_apart(
    observed: StepObservation, acceleration: Array, gap: Array
) -> tuple[float, float, Array]:
    """Return difference (%), instant (s), and by what part each half-wave exceeds the measured one."""
    count = len(gap)
    wanted = round((observed.values[4] - observed.time) / GRID)
    wanted = min(max(wanted, 1), count - 2)
    # The gap oscillates as the lowest mode does, so its slope tells how far off its crest is.
    height = 0.01 * observed.values[3] * abs(acceleration[wanted])
    slope = (gap[wanted + 1] - gap[wanted - 1]) / (2.0 * GRID)
    # The reduced model, with all compliances in series, is the softer one: this is the gap's sign.
    phase = observed.lowest * (observed.values[4] - observed.time)
    sign = 1.0 if np.sin(phase) >= 0.0 else -1.0
    percent = 100.0 * sign * gap[wanted] / abs(acceleration[wanted])
    when = observed.values[4] + sign * slope / (observed.lowest**2 * height)
    # Largest of every half-wave, counted from the one that holds the measured instant.
    waves = (GRID * (np.arange(count) - wanted)) * observed.lowest / np.pi
    half = np.floor(waves + 0.5).astype(int)
    largest = np.zeros(half[-1] - half[0] + 1)
    np.maximum.at(largest, half - half[0], np.abs(gap))
    excess = np.maximum(0.0, largest / abs(gap[wanted]) - _CLEARLY_LARGEST)
    excess[-half[0]] = 0.0
    return percent, when, excess


def _full_step(
    parameters: DrivelineParameters,
    configuration: Configuration,
    observed: StepObservation,
    count: int,
) -> tuple[Array, Array]:
    chain, transform = full_entries(parameters, configuration)
    torques = np.zeros(len(INERTIAS))
    torques[INERTIAS.index("Je")] = observed.engine
    torques[INERTIAS.index("Jm2")] = observed.em2
    rigid = transform.shape[1] - MODES_16DOF
    node = transform.shape[1] - 1
    speed, acceleration = step_acceleration(chain, rigid, transform.T @ torques, node, GRID, count)
    return parameters.tyre_radius * speed, parameters.tyre_radius * acceleration


def _reduced_step(
    parameters: DrivelineParameters,
    configuration: Configuration,
    observed: StepObservation,
    count: int,
) -> tuple[Array, Array]:
    inertia, stiffness, damping = reduced_entries(parameters, configuration)
    ratios = parameters.reduced_ratios
    torque = observed.em2 * ratios["m2"] * ratios["fd"]
    if configuration.gear and configuration.clutch:
        torque += observed.engine * ratios["g1" if configuration.gear == 1 else "g2"] * ratios["fd"]
    torques = np.array([torque, 0.0, 0.0, 0.0])
    chain = Chain(inertia, REDUCED_INCIDENCE, stiffness, damping)
    speed, acceleration = step_acceleration(chain, 1, torques, 3, GRID, count)
    return parameters.tyre_radius * speed, parameters.tyre_radius * acceleration
