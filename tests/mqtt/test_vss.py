"""What goes out under a name of the catalogue has its unit and type; the rest says that it is an overlay."""

import math
from pathlib import Path

import pytest
import yaml

from hev_can_emu.ecu.ports import STATUSES
from hev_can_emu.telemetry.vss import BOOLEAN, FLOAT, INTEGER, LEAVES, Leaf
from hev_can_emu.units import unit

CATALOGUE = yaml.safe_load(Path(__file__).with_name("vss_catalogue.yaml").read_text())
KINDS = {"float": FLOAT, "boolean": BOOLEAN} | dict.fromkeys(
    ("int8", "uint8", "int16", "int32"), INTEGER
)
ENGAGED = "Vehicle.Powertrain.Transmission.ClutchEngagement"  # from a code: open, slipping, locked
STATUS_UNITS = {port.name: port.unit for port in STATUSES}
# How the project's own unit reader spells what VSS spells so.
SPELLING = {"Celsius": "degC", "percent": "%"}


def leaf_of(path: str) -> Leaf:
    return next(leaf for leaf in LEAVES if leaf.path == path)


@pytest.mark.parametrize(
    "leaf", [each for each in LEAVES if not each.overlay], ids=lambda x: x.path
)
def test_a_name_of_the_catalogue_has_its_unit_and_type(leaf: Leaf) -> None:
    entry = CATALOGUE[leaf.path]
    assert leaf.unit == entry.get("unit", "")
    assert leaf.datatype == KINDS[entry["datatype"]]


def test_overlays_are_not_in_the_catalogue_and_motors_have_its_leaves() -> None:
    overlays = [leaf for leaf in LEAVES if leaf.overlay]
    assert not {leaf.path for leaf in overlays} & set(CATALOGUE)
    for leaf in overlays:
        if ".ElectricMotor.EM" in leaf.path and not leaf.path.endswith("InverterTemperature"):
            standard = leaf.path.replace(".EM1.", ".Front.").replace(".EM2.", ".Front.")
            assert CATALOGUE[standard].get("unit", "") == leaf.unit
            assert KINDS[CATALOGUE[standard]["datatype"]] == leaf.datatype
        elif ".ElectricMotor." not in leaf.path:
            assert leaf.path.startswith("Vehicle.Powertrain.HEV.")


def test_every_entry_of_the_catalogue_is_told() -> None:
    told = {leaf.path.replace(".EM1.", ".Front.") for leaf in LEAVES}
    assert set(CATALOGUE) <= told


def test_paths_are_unique_and_sources_exist() -> None:
    assert len({leaf.path for leaf in LEAVES}) == len(LEAVES)
    assert {leaf.source for leaf in LEAVES} <= set(STATUS_UNITS)


@pytest.mark.parametrize(
    "leaf", [each for each in LEAVES if each.unit and each.path != ENGAGED], ids=lambda x: x.path
)
def test_gains_are_those_of_the_units(leaf: Leaf) -> None:
    to = unit(SPELLING.get(leaf.unit, leaf.unit), "test")
    assert to.dimension == unit(STATUS_UNITS[leaf.source], "test").dimension
    for status in (0.0, 0.25, 300.0):
        assert leaf.gain * status + leaf.offset == pytest.approx(to.from_si(status), abs=1e-9)


def test_values() -> None:
    assert leaf_of("Vehicle.Speed").value(10.0) == 36.0
    assert leaf_of("Vehicle.Speed").value(math.nan) is None
    assert math.copysign(1.0, leaf_of("Vehicle.Speed").value(-1e-9) or 0.0) == 1.0
    assert leaf_of("Vehicle.IsMoving").value(0.001) is False
    assert leaf_of("Vehicle.IsMoving").value(0.1) is True
    assert leaf_of("Vehicle.Powertrain.Transmission.CurrentGear").value(3.0) is None
    assert leaf_of("Vehicle.Powertrain.Transmission.SelectedGear").value(3.0) == 127
    assert leaf_of("Vehicle.Powertrain.HEV.DrivingMode").value(2.0) == "PARALLEL_G1"
    assert leaf_of("Vehicle.Powertrain.HEV.DrivingMode").value(99.0) is None
