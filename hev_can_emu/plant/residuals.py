"""What a parameter vector predicts for each measurement, with the derivatives."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant.eigen_gradient import (
    Chain,
    Damped,
    Gradient,
    Undamped,
    damped,
    undamped,
    undamped_gradient,
)
from hev_can_emu.plant.observations import MODES_16DOF
from hev_can_emu.plant.problem import Problem
from hev_can_emu.plant.reduction import lump_inertias, paper_half_shafts
from hev_can_emu.plant.structure import (
    BRANCHES,
    CONFIGURATIONS,
    INERTIAS,
    Configuration,
    full_order,
)
from hev_can_emu.plant.vehicle import RATIO_RADII, SECTIONS, DrivelineParameters

Array = npt.NDArray[np.float64]

_COMPLEX_STEP = 1e-30


class Prediction(NamedTuple):
    """Predicted values (m,) in the measurements' units, derivatives (m, p) by the sought logarithms."""

    values: Array
    jacobian: Array


def parameters_at(problem: Problem, sought: Array) -> DrivelineParameters:
    """Return the driveline that the logarithms ``sought``, shape (p,), stand for (unchecked)."""
    logs = problem.base + problem.spread @ sought
    return _parameters(problem, dict(zip(problem.names, np.exp(logs).tolist(), strict=True)))


def _parameters(problem: Problem, values: dict[str, Any]) -> DrivelineParameters:
    """Return the record of named values, which may be complex for differentiation."""

    def section(name: str) -> dict[str, Any]:
        return {
            key.partition(".")[2]: 0.0 * value if key in problem.zero else value
            for key, value in values.items()
            if key.startswith(f"{name}.")
        }

    radii = section("base_radii")
    rounding = section("ratio_rounding")
    reduced = {
        name: radii[driven] / radii[driving] * rounding[name]
        for name, (driven, driving) in RATIO_RADII.items()
    }
    return DrivelineParameters(
        section("inertias"),
        section("stiffness"),
        section("damping"),
        radii,
        reduced,
        values["tyre_radius"],
    )


def predict_modes(problem: Problem, sought: Array, with_damping: bool) -> list[Prediction | None]:
    """Return a prediction for each of ``problem.observations``.

    Args:
        problem: p sought parameters.
        sought: their logarithms, shape (p,).
        with_damping: else None stands for every observation that damping decides.
    """
    parameters = parameters_at(problem, sought)
    chains: dict[tuple[str, str], _Spectrum] = {}
    found: list[Prediction | None] = []
    for observation in problem.observations:
        if observation.quantity != "undamped" and not with_damping:
            found.append(None)
            continue
        key = (observation.model, observation.configuration)
        if key not in chains:
            chains[key] = _Spectrum(problem, parameters, sought, *key)
        values, jacobian = chains[key].predict(observation.quantity)
        orders = list(observation.orders)
        found.append(Prediction(values[orders], jacobian[orders]))
    return found


class _Spectrum:
    """One model in one configuration at one parameter vector; the damped part only when asked for."""

    def __init__(
        self,
        problem: Problem,
        parameters: DrivelineParameters,
        sought: Array,
        model: str,
        configuration: str,
    ) -> None:
        at = CONFIGURATIONS[configuration]
        if model == "16dof":
            self._chain, rigid, self._spread = _full_chain(problem, parameters, at)
        else:
            self._chain, rigid, self._spread = _reduced_chain(problem, sought, at)
        self._modes: Undamped = undamped(self._chain, rigid)
        self._damped: tuple[Damped, Gradient, Gradient] | None = None

    def predict(self, quantity: str) -> Prediction:
        if quantity == "undamped":
            omega = self._modes.omega
            slopes = self._spread.of(undamped_gradient(self._chain, self._modes))
            return Prediction(omega / (2 * np.pi), omega[:, None] / (2 * np.pi) * slopes)
        if self._damped is None:
            self._damped = damped(self._chain, self._modes)
        values, by_log, by_ratio = self._damped
        if quantity == "damping_ratio":
            return Prediction(values.ratio, self._spread.of(by_ratio))
        hertz = values.magnitude / (2 * np.pi)
        return Prediction(hertz, hertz[:, None] * self._spread.of(by_log))


class _Spread(NamedTuple):
    """How a chain's entries' logarithms follow the sought ones: one matrix per kind, p columns.

    ``incidence`` has one row per entry listed in ``entries`` (branch and inertia indices).
    """

    inertia: Array
    stiffness: Array
    damping: Array
    entries: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
    incidence: Array

    def of(self, gradient: Gradient) -> Array:
        """Return derivatives by the sought logarithms, shape (m, p)."""
        total: Array = (
            gradient.inertia @ self.inertia
            + gradient.stiffness @ self.stiffness
            + gradient.damping @ self.damping
        )
        if len(self.incidence):
            total = total + gradient.incidence[:, *self.entries] @ self.incidence
        return total


def _full_chain(
    problem: Problem, parameters: DrivelineParameters, configuration: Configuration
) -> tuple[Chain, int, _Spread]:
    chain, transform = full_entries(parameters, configuration)
    rows = {name: problem.spread[index] for index, name in enumerate(problem.names)}
    inertias = np.array([parameters.inertias[name] for name in INERTIAS])
    share = (transform * inertias[:, None]).T / chain.inertia[:, None]
    by_inertia = share @ np.array([rows[f"inertias.{name}"] for name in INERTIAS])
    column = transform.argmax(axis=1)
    branches, nodes, slopes = [], [], []
    for branch, (_, start, end, r_start, r_end) in enumerate(BRANCHES):
        for name, radius in ((start, r_start), (end, r_end)):
            if radius:
                branches.append(branch)
                nodes.append(int(column[INERTIAS.index(name)]))
                slopes.append(rows[f"base_radii.{radius}"])
    spread = _Spread(
        by_inertia,
        np.array([rows[f"stiffness.k{name}"] for name, *_ in BRANCHES]),
        np.array([rows[f"damping.c{name}"] for name, *_ in BRANCHES]),
        (np.array(branches), np.array(nodes)),
        np.array(slopes),
    )
    return chain, transform.shape[1] - MODES_16DOF, spread


def full_entries(
    parameters: DrivelineParameters, configuration: Configuration
) -> tuple[Chain, Array]:
    """Return the full-order chain with the configuration's locks held, and the lock map."""
    transform, pattern = _pattern(configuration)
    radii = parameters.base_radii
    incidence = pattern.copy()
    for branch, (_, start, end, r_start, r_end) in enumerate(BRANCHES):
        for name, radius in ((start, r_start), (end, r_end)):
            if radius:
                incidence[branch, INERTIAS.index(name)] *= radii[radius]
    inertias = np.array([parameters.inertias[name] for name in INERTIAS])
    chain = Chain(
        transform.T @ inertias,
        incidence @ transform,
        np.array([parameters.stiffness[f"k{name}"] for name, *_ in BRANCHES]),
        np.array([parameters.damping[f"c{name}"] for name, *_ in BRANCHES]),
    )
    return chain, transform


@functools.cache
def _pattern(configuration: Configuration) -> tuple[Array, Array]:
    """Return the lock map and the incidence with unit radii; neither depends on a parameter's value."""
    ones = {section: dict.fromkeys(names, 1.0) for section, names in SECTIONS.items()}
    structure = full_order(DrivelineParameters(**ones, tyre_radius=1.0))
    return structure.lock_map(configuration), structure.incidence


REDUCED_INCIDENCE = np.array(
    [[1.0, -1.0, 0.0, 0.0], [1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0], [0.0, 0.0, 1.0, -1.0]]
)


def _reduced_chain(
    problem: Problem, sought: Array, configuration: Configuration
) -> tuple[Chain, int, _Spread]:
    """Return the paper's reduced model: what turns with the differential, wheels and body.

    Its entries are differentiated by complex steps (exact to rounding), all parameters at once.
    """
    count = len(sought)
    steps = sought[:, None] + 1j * _COMPLEX_STEP * np.eye(count)
    logs = problem.base[:, None] + problem.spread @ steps
    columns = dict(zip(problem.names, np.exp(logs), strict=True))
    inertia, stiffness, damping = reduced_entries(_parameters(problem, columns), configuration)
    chain = Chain(
        inertia[:, 0].real.copy(),
        REDUCED_INCIDENCE,
        stiffness[:, 0].real.copy(),
        damping[:, 0].real.copy(),
    )
    none = np.zeros(0, dtype=np.intp)
    by_inertia, by_stiffness, by_damping = (
        entry.imag / np.where(entry.real > 0.0, entry.real, 1.0) / _COMPLEX_STEP
        for entry in (inertia, stiffness, damping)
    )
    spread = _Spread(by_inertia, by_stiffness, by_damping, (none, none), np.zeros((0, count)))
    return chain, 1, spread


def reduced_entries(
    parameters: DrivelineParameters, configuration: Configuration
) -> tuple[Any, Any, Any]:
    """Return four inertias, stiffnesses and dampings; entries are arrays where parameters are."""
    ratios = parameters.reduced_ratios
    engine, shaft, gearbox, left, right, body = lump_inertias(parameters, ratios)
    if configuration.gear:
        driven = shaft + engine if configuration.clutch else shaft
        name = "g1" if configuration.gear == 1 else "g2"
        gearbox = gearbox + driven * (ratios[name] * ratios["fd"]) ** 2
    (kl, kr), (cl, cr) = paper_half_shafts(parameters, ratios, configuration)
    k, c = parameters.stiffness, parameters.damping
    return (
        np.array([gearbox, left, right, body]),
        np.array([kl, kr, k["klw"], k["krw"]]),
        np.array([cl, cr, c["clw"], c["crw"]]),
    )
