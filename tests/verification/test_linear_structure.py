"""What must hold of the linear driveline whatever its numbers."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from random_cars import CARS, car, changed, rigid_shape
from scipy import linalg

from hev_can_emu.plant.linear import held_speeds, modes, state_space
from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.state_space import state_space as minimal
from hev_can_emu.plant.structure import CONFIGURATIONS, Structure, full_order
from hev_can_emu.plant.vehicle import DrivelineParameters

# configuration: degrees of freedom of the full and the reduced model, rigid-body modes
COUNTS = {
    "parallel_g1": (16, 4, 1),
    "parallel_g2": (16, 4, 1),
    "series": (17, 5, 2),
    "electric_g1": (17, 5, 2),
    "electric_g2": (17, 5, 2),
    "electric_neutral": (18, 6, 3),
}
PAPER_NAMES = (
    "Je", "Jc", "Jm1", "Jid", "J1", "Jm2", "J2", "Jsg1",
    "Jg12", "Jfd1", "Jg22", "Jg21", "Jfd2", "Jlw", "Jrw", "Jv",
)  # fmt: skip
ALL = list(itertools.product(CARS, CONFIGURATIONS))


def models(parameters: DrivelineParameters) -> list[Structure]:
    return [full_order(parameters), reduced(parameters), reduced(parameters, "paper")]


@pytest.mark.parametrize(("which", "name"), ALL)
def test_matrices_are_symmetric_and_definite_as_they_must(which: str | int, name: str) -> None:
    full_dof, reduced_dof, rigid = COUNTS[name]
    for structure in models(car(which)):
        j, c, k = structure.matrices(CONFIGURATIONS[name])
        assert len(j) == (full_dof if structure.model == "16dof" else reduced_dof)
        for matrix in (j, c, k):
            assert np.abs(matrix - matrix.T).max() <= 1e-12 * np.abs(matrix).max()
        assert np.linalg.eigvalsh(j).min() > 0.0
        root = np.diag(1.0 / np.sqrt(np.diag(j)))
        for matrix in (c, k):
            # In units of each inertia, so that one scale does not hide another.
            values = np.linalg.eigvalsh(root @ matrix @ root)
            assert values.min() > -1e-9 * values.max()
        assert (
            len(j)
            - np.linalg.matrix_rank(structure.incidence @ structure.lock_map(CONFIGURATIONS[name]))
            == rigid
        )
        assert modes(structure, CONFIGURATIONS[name]).rigid == rigid


def printed_matrix(p: DrivelineParameters, prefix: str) -> np.ndarray:
    """The paper's C (Eq. 8), entry by entry; K is C with every c replaced by k.  True rotations."""
    v = p.damping if prefix == "c" else p.stiffness
    r = p.base_radii
    at = {name: i for i, name in enumerate(PAPER_NAMES)}

    def value(name: str) -> float:
        return v[prefix + name]

    upper = {
        ("Je", "Je"): value("1"),
        ("Je", "Jc"): -value("1"),
        ("Jc", "Jc"): value("1") + value("2"),
        ("Jc", "J1"): -value("2"),
        ("Jm1", "Jm1"): value("m1") * r["rm1"] ** 2,
        ("Jm1", "Jid"): value("m1") * r["rm1"] * r["rid"],
        ("Jid", "Jid"): (value("m1") + value("id")) * r["rid"] ** 2,
        ("Jid", "J1"): value("id") * r["rid"] * r["r1"],
        ("J1", "J1"): value("2") + value("id") * r["r1"] ** 2 + value("3"),
        ("J1", "Jsg1"): -value("3"),
        ("Jm2", "Jm2"): value("m2") * r["rm2"] ** 2,
        ("Jm2", "J2"): value("m2") * r["rm2"] * r["r2"],
        ("J2", "J2"): value("m2") * r["r2"] ** 2 + value("6"),
        ("J2", "Jg12"): -value("6"),
        ("Jsg1", "Jsg1"): value("3") + value("g1") * r["rg11"] ** 2,
        ("Jsg1", "Jg12"): value("g1") * r["rg11"] * r["rg12"],
        ("Jg12", "Jg12"): value("g1") * r["rg12"] ** 2 + value("6") + value("5"),
        ("Jg12", "Jfd1"): -value("5"),
        ("Jfd1", "Jfd1"): value("5") + value("4") + value("fd") * r["rfd1"] ** 2,
        ("Jfd1", "Jg22"): -value("4"),
        ("Jfd1", "Jfd2"): value("fd") * r["rfd1"] * r["rfd2"],
        ("Jg22", "Jg22"): value("4") + value("g2") * r["rg22"] ** 2,
        ("Jg22", "Jg21"): value("g2") * r["rg22"] * r["rg21"],
        ("Jg21", "Jg21"): value("g2") * r["rg21"] ** 2,
        ("Jfd2", "Jfd2"): value("fd") * r["rfd2"] ** 2 + value("lh") + value("rh"),
        ("Jfd2", "Jlw"): -value("lh"),
        ("Jfd2", "Jrw"): -value("rh"),
        ("Jlw", "Jlw"): value("lh") + value("lw"),
        ("Jlw", "Jv"): -value("lw"),
        ("Jrw", "Jrw"): value("rh") + value("rw"),
        ("Jrw", "Jv"): -value("rw"),
        ("Jv", "Jv"): value("lw") + value("rw"),
    }
    matrix = np.zeros((16, 16))
    for (a, b), entry in upper.items():
        matrix[at[a], at[b]] = matrix[at[b], at[a]] = entry
    return matrix


@pytest.mark.parametrize("which", CARS)
def test_parallel_g1_is_the_printed_matrix_up_to_the_sign_of_rotation(which: str | int) -> None:
    p = car(which)
    structure = full_order(p)
    names = modes(structure, CONFIGURATIONS["parallel_g1"]).names
    order = [names.index(name) for name in PAPER_NAMES]
    # External gears turn against each other: these parts run backwards when the car runs forward.
    sign = np.array(
        [-1.0 if name in ["Jid", "Jg12", "Jfd1", "Jg22", "J2"] else 1.0 for name in PAPER_NAMES]
    )
    _, c, k = structure.matrices(CONFIGURATIONS["parallel_g1"])
    for ours, prefix in ((c, "c"), (k, "k")):
        turned = sign[:, None] * ours[np.ix_(order, order)] * sign
        wanted = printed_matrix(p, prefix)
        assert np.abs(turned - wanted).max() <= 1e-12 * np.abs(wanted).max()


@pytest.mark.parametrize("which", CARS)
def test_mesh_sign_convention_changes_no_frequency(which: str | int) -> None:
    p = car(which)
    found = modes(full_order(p), CONFIGURATIONS["parallel_g1"])
    wanted = linalg.eigh(printed_matrix(p, "k"), np.diag(_paper_inertias(p)), eigvals_only=True)
    hertz = np.sqrt(np.maximum(wanted[1:], 0.0)) / (2 * np.pi)
    assert hertz == pytest.approx(found.undamped_hz, rel=1e-7)


def _paper_inertias(p: DrivelineParameters) -> list[float]:
    j = dict(p.inertias)
    j["Jc"] = j["Jc1"] + j["Jc2"]
    j["Jsg1"] = j["Jsleeve"] + j["Jg11"]
    return [j[name] for name in PAPER_NAMES]


@pytest.mark.parametrize(("which", "name"), ALL)
def test_product_of_eigenvalue_moduli_is_that_of_the_frequencies(
    which: str | int, name: str
) -> None:
    for structure in models(car(which)):
        system = minimal(structure, CONFIGURATIONS[name], 0.33)
        rigid = COUNTS[name][2]
        values = np.sort(np.abs(np.linalg.eigvals(system.a)))
        assert values[rigid - 1] < 1e-4 < values[rigid]
        found = modes(structure, CONFIGURATIONS[name])
        squares = 2 * np.log(2 * np.pi * found.undamped_hz).sum()
        assert np.log(values[rigid:]).sum() == pytest.approx(squares, abs=1e-6)
        assert np.log(found.damped_hz).sum() == pytest.approx(
            np.log(found.undamped_hz).sum(), abs=1e-9
        )


@pytest.mark.parametrize("which", CARS)
def test_with_left_right_symmetry_mode_two_is_the_wheels_alone(which: str | int) -> None:
    p = car(which)
    p = changed(p, "stiffness", krh=p.stiffness["klh"], krw=p.stiffness["klw"])
    p = changed(p, "inertias", Jrw=p.inertias["Jlw"])
    wanted = np.sqrt((p.stiffness["klh"] + p.stiffness["klw"]) / p.inertias["Jlw"]) / (2 * np.pi)
    for structure in models(p)[:1]:
        for configuration in CONFIGURATIONS.values():
            found = modes(structure, configuration)
            at = int(np.argmin(np.abs(found.undamped_hz - wanted)))
            assert found.undamped_hz[at] == pytest.approx(wanted, rel=1e-9)
            shape = dict(zip(found.names, found.shapes[:, at], strict=True))
            assert shape.pop("Jlw") == pytest.approx(-shape.pop("Jrw"), abs=1e-6)
            assert max(abs(value) for value in shape.values()) < 1e-6


@pytest.mark.parametrize(("which", "name"), ALL)
def test_rigid_acceleration_is_force_over_inertia_along_the_rigid_shape(
    which: str | int, name: str
) -> None:
    configuration = CONFIGURATIONS[name]
    torques = np.array([150.0, -30.0, 200.0, -100.0])
    for structure in models(car(which)):
        z = rigid_shape(structure, configuration)
        mass = z.T @ (structure.inertia[:, None] * z)
        wanted = z @ np.linalg.solve(mass, z.T @ (structure.ports.T @ torques))
        # Constant twists exist in which the system itself accelerates so, all parts in step.
        system = minimal(structure, configuration, 0.33)
        free = len(system.states) - structure.nq
        transform = structure.lock_map(configuration)
        alike = np.linalg.lstsq(transform, wanted, rcond=None)[0]
        driven = system.b[:free, :4] @ torques
        twisting = system.a[:free, free:]
        scale = np.linalg.norm(twisting, axis=0)
        twists = np.linalg.lstsq(twisting / scale, alike - driven, rcond=None)[0] / scale
        size = np.abs(twisting * twists).max() + np.abs(driven).max()
        assert np.abs(twisting @ twists + driven - alike).max() < 1e-9 * size
        assert np.abs(system.a[free:, :free] @ alike).max() < 1e-9 * np.abs(alike).max()


@pytest.mark.parametrize(("which", "name"), ALL)
def test_merging_keeps_momentum_along_every_rigid_shape(which: str | int, name: str) -> None:
    random = np.random.default_rng(7)
    configuration = CONFIGURATIONS[name]
    for structure in models(car(which)):
        z = rigid_shape(structure, configuration)
        project = held_speeds(structure, configuration) * structure.inertia
        speeds = random.uniform(-300.0, 300.0, structure.n)
        merged = project @ speeds
        before, after = (z.T @ (structure.inertia * one) for one in (speeds, merged))
        assert after == pytest.approx(before, rel=1e-10)
        assert project @ merged == pytest.approx(merged, rel=1e-9, abs=1e-9)
        for lock, held in enumerate(configuration.locks):
            if held:
                assert abs(structure.locks[lock] @ merged) < 1e-8
        kinetic = [one @ (structure.inertia * one) for one in (speeds, merged)]
        if any(configuration.locks):
            assert kinetic[1] < kinetic[0]  # merging loses energy, never gains


@pytest.mark.parametrize(("which", "name"), ALL)
def test_full_coordinates_and_minimal_ones_move_alike(which: str | int, name: str) -> None:
    configuration = CONFIGURATIONS[name]
    for structure in models(car(which)):
        a, b = state_space(structure, configuration)
        system = minimal(structure, configuration, 0.33)
        transform = structure.lock_map(configuration)
        n, nq = structure.n, structure.nq
        lift = np.block(
            [
                [transform, np.zeros((n, nq))],
                [np.zeros((nq, transform.shape[1])), np.eye(nq)],
            ]
        )
        scale = np.abs(a @ lift).max()
        assert np.abs(a @ lift - lift @ system.a).max() < 1e-11 * scale
        kept = [0, 1, 2, 3, *(4 + lock for lock in range(5) if not configuration.locks[lock])]
        assert np.abs(b[:, kept] - lift @ system.b).max() < 1e-11 * np.abs(b).max()
