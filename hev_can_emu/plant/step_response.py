"""Full-order against reduced model after a torque step from rest (Dai et al. 2024, Figure 12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.state_space import StateSpace, simulate, state_space
from hev_can_emu.plant.structure import Configuration, Structure, full_order
from hev_can_emu.plant.vehicle import DrivelineParameters

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """The experiment; as it stands, that of Figure 12.

    Attributes:
        time: of the torque step, s.
        end: when the speeds are read, s.
        engine, em1, em2: torques after the step, N m.
        grid: spacing of the results, s.
    """

    time: float = 4.0
    end: float = 10.0
    engine: float = 150.0
    em1: float = 0.0
    em2: float = 200.0
    grid: float = 0.01


@dataclass(frozen=True)
class StepResponse:
    """Both models' response.

    Attributes:
        times: shape (n,), s.
        velocity_16, velocity_4: shape (n,), m/s.
        acceleration_16, acceleration_4: shape (n,), m/s^2.
    """

    times: Array
    velocity_16: Array
    velocity_4: Array
    acceleration_16: Array
    acceleration_4: Array

    @property
    def velocity_difference_percent(self) -> float:
        """Of the speeds at the end, in percent of the full order's."""
        last = float(self.velocity_16[-1])
        return _percent(last - float(self.velocity_4[-1]), last)

    @property
    def largest(self) -> int:
        """Where on the grid the accelerations are furthest apart, in m/s^2."""
        return int(np.argmax(np.abs(self.acceleration_16 - self.acceleration_4)))

    @property
    def acceleration_difference_percent(self) -> float:
        """The largest difference in m/s^2, in percent of the full order's acceleration there."""
        at = self.largest
        one = float(self.acceleration_16[at])
        return _percent(one - float(self.acceleration_4[at]), one)

    @property
    def acceleration_difference_time(self) -> float:
        """When the accelerations are furthest apart, s."""
        return float(self.times[self.largest])


def _percent(difference: float, whole: float) -> float:
    return 100.0 * abs(difference / whole) if whole else 0.0


def step_response(
    parameters: DrivelineParameters,
    configuration: Configuration,
    step: Step | None = None,
    rule: str = "paper",
) -> StepResponse:
    """Run both models from rest, without road load, through a torque step.

    The propagators are exact, so the grid only decides where the response is looked at.

    Raises:
        ValueError: a step that does not lie on the grid, or an end before it.
    """
    step = step or Step()
    before, count = round(step.time / step.grid), round(step.end / step.grid)
    if not 0 <= before < count or abs(before * step.grid - step.time) > 1e-6 * step.grid:
        raise ValueError(f"the step at {step.time} s does not lie on the grid before {step.end} s")
    times: Array = np.arange(count + 1, dtype=np.float64) * step.grid
    radius = parameters.tyre_radius
    v16, a16 = _run(full_order(parameters), configuration, radius, step, before, count)
    v4, a4 = _run(reduced(parameters, rule), configuration, radius, step, before, count)
    return StepResponse(times, v16, v4, a16, a4)


def _run(
    structure: Structure,
    configuration: Configuration,
    tyre_radius: float,
    step: Step,
    before: int,
    count: int,
) -> tuple[Array, Array]:
    system: StateSpace = state_space(structure, configuration, tyre_radius)
    inputs = np.zeros((count + 1, len(system.inputs)))
    for name, torque in (("engine", step.engine), ("em1", step.em1), ("em2", step.em2)):
        inputs[before:, system.input(f"{name}_torque")] = torque
    _, outputs = simulate(system, inputs, step.grid)
    return (
        outputs[:, system.output("vehicle_speed")],
        outputs[:, system.output("vehicle_acceleration")],
    )
