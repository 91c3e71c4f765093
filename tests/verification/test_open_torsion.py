"""The same driveline in openTorsion, a torsional code that shares nothing with this one."""

from __future__ import annotations

import numpy as np
import opentorsion as ot
import pytest
from random_cars import CARS, car, changed

from hev_can_emu.plant.linear import modes
from hev_can_emu.plant.structure import BRANCHES, CONFIGURATIONS, full_order
from hev_can_emu.plant.vehicle import MESHES, DrivelineParameters

MERGED = {
    "parallel_g1": {"Jc2": "Jc1", "Jg11": "Jsleeve"},
    "parallel_g2": {"Jc2": "Jc1", "Jg21": "Jsleeve"},
    "series": {"Jc2": "Jc1"},
    "electric_neutral": {},
    "electric_g1": {"Jg11": "Jsleeve"},
    "electric_g2": {"Jg21": "Jsleeve"},
}


def assembly(p: DrivelineParameters, name: str, elastic: bool) -> ot.Assembly:
    merged = MERGED[name]
    parts = [inertia for inertia in p.inertias if inertia not in merged]
    node = {inertia: parts.index(merged.get(inertia, inertia)) for inertia in p.inertias}
    disks = [ot.Disk(node[inertia], I=value) for inertia, value in p.inertias.items()]
    shafts, gears = [], []
    for branch, start, end, r_start, r_end in BRANCHES:
        k, c = p.stiffness[f"k{branch}"], p.damping[f"c{branch}"]
        if branch not in MESHES:
            shafts.append(ot.Shaft(node[start], node[end], k=k, c=c))
            continue
        first, second = p.base_radii[r_start], p.base_radii[r_end]
        if elastic:
            parent = ot.ElasticGear(node[start], I=0.0, R=first)
            child = ot.ElasticGear(
                node[end], I=0.0, R=second, k=k * first**2, c=c * first**2, parent=parent
            )
        else:
            parent = ot.Gear(node[start], I=0.0, R=first)
            child = ot.Gear(node[end], I=0.0, R=second, parent=parent)
        gears += [parent, child]
    if elastic:
        return ot.Assembly(shafts, disk_elements=disks, elastic_gear_elements=gears)
    return ot.Assembly(shafts, disk_elements=disks, gear_elements=gears)


def frequencies(one: ot.Assembly, rigid: int) -> np.ndarray:
    values, _ = one.undamped_modal_analysis()
    return np.sqrt(np.sort(np.abs(values.real))[rigid:]) / (2 * np.pi)


@pytest.mark.parametrize("name", CONFIGURATIONS)
@pytest.mark.parametrize("which", CARS)
def test_rigid_mesh_limit(which: str | int, name: str) -> None:
    p = car(which)
    rigid = modes(full_order(p), CONFIGURATIONS[name]).rigid
    theirs = frequencies(assembly(p, name, elastic=False), rigid)
    stiff = changed(
        p, "stiffness", **{f"k{mesh}": 1e6 * p.stiffness[f"k{mesh}"] for mesh in MESHES}
    )
    ours = modes(full_order(stiff), CONFIGURATIONS[name]).undamped_hz
    # Six meshes become rigid: six modes leave for infinity.
    assert len(theirs) == len(ours) - len(MESHES)
    assert ours[: len(theirs)] == pytest.approx(theirs, rel=1e-5)


@pytest.mark.parametrize("name", CONFIGURATIONS)
@pytest.mark.parametrize("which", CARS)
def test_elastic_meshes_and_damping(which: str | int, name: str) -> None:
    p = car(which)
    found = modes(full_order(p), CONFIGURATIONS[name])
    one = assembly(p, name, elastic=True)
    assert frequencies(one, found.rigid) == pytest.approx(found.undamped_hz, rel=1e-6)
    moduli, _, ratios = one.modal_analysis()
    elastic = slice(2 * found.rigid, None, 2)
    assert moduli[elastic] / (2 * np.pi) == pytest.approx(found.damped_hz, rel=1e-6)
    assert ratios[elastic] == pytest.approx(found.damping_ratio, rel=1e-5, abs=1e-8)


def test_table_2_in_open_torsion() -> None:
    found = frequencies(assembly(car("default"), "parallel_g1", elastic=True), 1)
    assert [f"{value:.2f}" for value in found[:3]] == ["5.69", "24.68", "26.79"]
    assert f"{found[-1]:.2f}" == "13164.13"
