"""Reduction of the full-order driveline to engine, EM1 shaft, final drive, wheels and body.

All locks open there are six inertias (``E M D lw rw v``); in parallel the three lumps merge and the
paper's 4-DOF model is left.  Two rules for the stiffness between gearbox and wheels:

``paper``
    Dai et al. 2024, Eqs. 10-14, literally: all shaft compliances in series and put into both half
    shafts; ratios as given for the reduced model.
``load_weighted``
    The compliance and loss that each branch has at the load it carries when the gearbox gets the
    rigid-body unit acceleration with the differential held; put between the gearbox and a massless
    differential, which is then condensed statically.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant.structure import (
    BRANCHES,
    CONFIGURATIONS,
    LOCKS,
    N_PORTS,
    Configuration,
    Structure,
    full_order,
)
from hev_can_emu.plant.vehicle import DrivelineParameters

Array = npt.NDArray[np.float64]

LUMPS = ("E", "M", "D", "lw", "rw", "v")
REDUCTIONS = ("load-weighted", "paper")


def lump_inertias(parameters: DrivelineParameters, ratios: dict[str, float]) -> Array:
    """Return the six lumped inertias: E at the engine, M at the sleeve, D at the differential."""
    j = parameters.inertias
    em1_square = (ratios["id1"] * ratios["id2"]) ** 2
    engine = j["Je"] + j["Jc1"]
    sleeve = (
        j["Jc2"] + j["J1"] + j["Jm1"] * em1_square + j["Jid"] * ratios["id2"] ** 2 + j["Jsleeve"]
    )
    intermediate = (
        j["Jg11"] * ratios["g1"] ** 2
        + j["Jg12"] + j["J2"] + j["Jm2"] * ratios["m2"] ** 2
        + j["Jfd1"] + j["Jg22"] + j["Jg21"] * ratios["g2"] ** 2
    )  # fmt: skip
    return np.array(
        [engine, sleeve, intermediate * ratios["fd"] ** 2 + j["Jfd2"], j["Jlw"], j["Jrw"], j["Jv"]]
    )


def paper_half_shafts(
    parameters: DrivelineParameters, ratios: dict[str, float], configuration: Configuration
) -> tuple[Array, Array]:
    """Return stiffness and damping of the (left, right) half shaft by the paper's literal rule.

    Written for parallel G1 in the paper; elsewhere the same rule with the branches that
    the configuration connects: 1, 2, 3 only through an engaged gear, 1 only with C1 closed.

    Returns:
        Two arrays of shape (2,); (2, m) where the parameters are arrays (of m variants).
    """
    gear = ratios["g1"] if configuration.gear == 1 else ratios["g2"]
    final = ratios["fd"] ** 2
    behind_gear: tuple[str, ...] = ()
    if configuration.gear:
        behind_gear = ("1", "2", "3") if configuration.clutch else ("2", "3")

    def both(value: dict[str, float], prefix: str) -> Array:
        links = [value[prefix + name] * final for name in ("4", "5", "6")]
        links += [value[prefix + name] * final * gear**2 for name in behind_gear]
        return np.array([_in_series([*links, value[prefix + side]]) for side in ("lh", "rh")])

    return both(parameters.stiffness, "k"), both(parameters.damping, "c")


def _in_series(links: list[float]) -> float:
    # The rule's sum of 1/c has no value where a damper is missing; its limit is none at all.
    if any(np.any(link == 0.0) for link in links):
        return 0.0 * sum(links)
    return 1.0 / sum(1.0 / link for link in links)


def load_weighted_half_shafts(
    parameters: DrivelineParameters, configuration: Configuration
) -> tuple[Array, Array]:
    """Return the 2x2 stiffness and damping between D and the wheels by the load-weighted rule."""
    full = full_order(parameters)
    transform = full.lock_map(configuration)
    held = full.names.index("Jfd2")
    gearbox_branches = [
        i for i, (name, *_) in enumerate(BRANCHES) if name not in ("lh", "rh", "lw", "rw")
    ]
    reach = (full.incidence @ transform)[gearbox_branches]
    reference = int(np.flatnonzero(np.abs(transform[held]) > 0.5)[0])
    # Rigid-body shape z of what turns with the differential: no deflection in any gearbox branch.
    others = [i for i in range(transform.shape[1]) if i != reference]
    shape = np.zeros(transform.shape[1])
    shape[reference] = 1.0
    shape[others] = np.linalg.lstsq(reach[:, others], -reach[:, reference], rcond=None)[0]
    shape[np.abs(shape) < 1e-9] = 0.0
    outside = [full.names.index(name) for name in ("Jlw", "Jrw", "Jv")]
    inertia = full.inertia.copy()
    inertia[outside] = 0.0
    load = transform.T @ (inertia * (transform @ shape))
    equivalent = float(shape @ load)
    torque = np.linalg.lstsq(reach[:, others].T, load[others], rcond=None)[0]
    k = np.array([parameters.stiffness[f"k{BRANCHES[i][0]}"] for i in gearbox_branches])
    c = np.array([parameters.damping[f"c{BRANCHES[i][0]}"] for i in gearbox_branches])
    ks = equivalent**2 / float(np.sum(torque**2 / k))
    cs = ks**2 * float(np.sum(c * torque**2 / k**2)) / equivalent**2
    klh, krh = parameters.stiffness["klh"], parameters.stiffness["krh"]
    clh, crh = parameters.damping["clh"], parameters.damping["crh"]
    # The differential's angle follows statically: d = (ks*D + klh*lw + krh*rw)/(ks + klh + krh).
    total = ks + klh + krh
    # Deflections (D-d, d-lw, d-rw) from (D-lw, D-rw).
    condense = np.array(
        [
            [klh / total, krh / total],
            [1.0 - klh / total, -krh / total],
            [-klh / total, 1.0 - krh / total],
        ]
    )
    return (
        condense.T @ np.diag([ks, klh, krh]) @ condense,
        condense.T @ np.diag([cs, clh, crh]) @ condense,
    )


def reduced(parameters: DrivelineParameters, rule: str = "load-weighted") -> Structure:
    """Build the reduced model; ``rule`` is one of :data:`REDUCTIONS`.  Raises ValueError otherwise."""
    if rule not in REDUCTIONS:
        raise ValueError(f"reduction: expected one of {REDUCTIONS}, got {rule!r}")
    ratios = parameters.reduced_ratios if rule == "paper" else parameters.ratios
    n = len(LUMPS)
    incidence = np.zeros((4, n))
    for branch, (start, end) in enumerate(((2, 3), (2, 4), (3, 5), (4, 5))):
        incidence[branch, start], incidence[branch, end] = 1.0, -1.0
    stiffness, damping = np.zeros((6, 4, 4)), np.zeros((6, 4, 4))
    for configuration in CONFIGURATIONS.values():
        if rule == "paper":
            k, c = (np.diag(side) for side in paper_half_shafts(parameters, ratios, configuration))
        else:
            k, c = load_weighted_half_shafts(parameters, configuration)
        at = configuration.driving
        stiffness[at, :2, :2], damping[at, :2, :2] = k, c
        stiffness[at, 2:, 2:] = np.diag([parameters.stiffness["klw"], parameters.stiffness["krw"]])
        damping[at, 2:, 2:] = np.diag([parameters.damping["clw"], parameters.damping["crw"]])
    locks = np.zeros((len(LOCKS), n))
    locks[0, 0], locks[0, 1] = 1.0, -1.0
    for lock, gear in ((1, "g1"), (2, "g2")):
        locks[lock, 1], locks[lock, 2] = 1.0, -ratios[gear] * ratios["fd"]
    locks[3, 3] = locks[4, 4] = locks[5, 5] = 1.0
    ports = np.zeros((N_PORTS, n))
    ports[0, 0] = 1.0
    ports[1, 1] = ratios["id1"] * ratios["id2"]
    ports[2, 2] = ratios["m2"] * ratios["fd"]
    ports[3, 5] = 1.0
    basis = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [1.0, -1.0, 1.0]])
    return Structure(
        model="4dof",
        names=LUMPS,
        inertia=lump_inertias(parameters, ratios),
        incidence=incidence,
        branch_names=("eq1", "eq2", "klw", "krw"),
        stiffness=stiffness,
        damping=damping,
        basis=basis,
        independent=(0, 1, 2),
        ports=ports,
        locks=locks,
        twist_remap=_twist_remap(stiffness),
    )


def _twist_remap(stiffness: Array) -> Array:
    """Twists across a switch: torque into the half shafts and left-right difference are continuous.

    The compliance behind the half shafts depends on the driving configuration, so the gearbox
    lump's (immaterial) angle is moved such that the torque it feels does not jump.
    """
    remap = np.zeros((6, 6, 3, 3))
    for old in range(6):
        for new in range(6):
            keep_old = np.array([stiffness[old, 0, :2] + stiffness[old, 1, :2], [1.0, -1.0]])
            keep_new = np.array([stiffness[new, 0, :2] + stiffness[new, 1, :2], [1.0, -1.0]])
            remap[old, new] = np.eye(3)
            if old != new:
                remap[old, new, :2, :2] = np.linalg.solve(keep_new, keep_old)
    return remap
