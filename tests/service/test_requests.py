"""A controller in another process: its requests move the car, and the car is safe without them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from service_rig import Node, emulator, node

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def kmh_per_rpm(request: pytest.FixtureRequest) -> float:
    """Wheel speed, km/h, over EM2's speed, rpm, from the vehicle file's radii."""
    path = Path(request.config.rootpath) / "vehicles" / "dai2024.yaml"
    driveline = yaml.safe_load(path.read_text())["driveline"]
    radius = {name: entry["value"] for name, entry in driveline["base_radii"].items()}
    em2 = radius["r2"] / radius["rm2"]
    final = radius["rfd2"] / radius["rfd1"]
    return float(math.pi / 30.0 / em2 / final * driveline["tyre_radius"]["value"] * 3.6)


@pytest.fixture(scope="module")
def hcu(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Node]:
    """A controller on one emulator for all tests of this file, in their order."""
    with emulator(tmp_path_factory.mktemp("requests")) as running, node(running.port) as joined:
        joined.until("ESC_Vehicle", lambda _: True)
        yield joined
        running.end()


def drive(hcu: Node, torque: float) -> None:
    hcu.request("HCU_EM2Request", EM2ControlMode="Torque", EM2TorqueRequest=torque)


def test_wheels_follow_em2_by_the_ratio(hcu: Node, kmh_per_rpm: float) -> None:
    drive(hcu, 150.0)
    hcu.until("ESC_Vehicle", lambda s: s["VehicleSpeed"] > 15.0)
    drive(hcu, 0.0)
    hcu.until("MCU2_Status", lambda s: abs(s["EM2Torque"]) < 0.1)
    hcu.wait(2.0)  # the launch has died away
    begin = hcu.now()
    hcu.wait(0.5)
    motor = np.mean([s.signals["EM2Speed"] for s in hcu.samples("MCU2_Status", begin)])
    assert motor > 300.0
    for name in ("WheelSpeedFL", "WheelSpeedFR"):
        wheel = np.mean([s.signals[name] for s in hcu.samples("ESC_WheelSpeeds", begin)])
        assert wheel == pytest.approx(motor * kmh_per_rpm, abs=0.02), name


def test_without_requests_the_car_lets_go_and_comes_back_with_them(hcu: Node) -> None:
    drive(hcu, 60.0)
    hcu.request("HCU_SynchronizerRequest", GearRequest="G1", ShiftForceRequest=900)
    hcu.until("TCU_Synchronizer", lambda s: s["Gear"] == "G1")
    hcu.request("HCU_ClutchRequest", ClutchTorqueCapacityRequest=80)
    hcu.until("TCU_Clutch", lambda s: s["ClutchTorqueCapacity"] > 79.0)
    hcu.until("MCU2_Status", lambda s: s["EM2Torque"] > 59.0 and s["EM2RequestStatus"] == "OK")

    silent = hcu.now()
    hcu.fall_silent()
    lost = hcu.until("MCU2_Status", lambda s: s["EM2RequestStatus"] == "Timeout")
    # The last request may have left up to a period before or after; the status comes every 10 ms.
    assert 0.015 < lost.t - silent < 0.07
    zero = hcu.until("MCU2_Status", lambda s: s["EM2Torque"] == 0.0)
    assert zero.signals["EM2LimitReason"] == "RequestLost"
    ramp = [s for s in hcu.samples("MCU2_Status", lost.t) if s.t <= zero.t]
    torques = [s.signals["EM2Torque"] for s in ramp]
    assert len(torques) > 10
    assert np.all(np.diff(torques) <= 0.0)  # a ramp, not a blow
    # The setpoint is down in 200 ms, the machine's lag adds milliseconds.
    assert all(s.signals["EM2Torque"] < 0.01 * 60.0 for s in ramp if s.t > lost.t + 0.21)
    hcu.wait(0.1)
    setpoints = hcu.samples("MCU2_Torque", lost.t + 0.2)
    assert {s.signals["EM2TorqueSetpoint"] for s in setpoints} == {0.0}
    hcu.until("TCU_Clutch", lambda s: s["ClutchState"] == "Open")
    clutch = hcu.until("TCU_ClutchControl", lambda _: True)
    assert clutch.signals["ClutchRequestStatus"] == "Timeout"
    assert clutch.signals["ClutchTorqueCapacitySetpoint"] == 0.0
    hcu.wait(0.3)
    since = hcu.samples("TCU_Synchronizer", silent)
    assert {s.signals["Gear"] for s in since} == {"G1"}

    drive(hcu, 60.0)
    hcu.until("MCU2_Status", lambda s: s["EM2RequestStatus"] == "OK" and s["EM2Torque"] > 59.0)
    hcu.fall_silent()
    hcu.until("MCU2_Status", lambda s: s["EM2Torque"] == 0.0)


def test_a_wrong_crc_is_refused(hcu: Node) -> None:
    begin = hcu.now()
    hcu.spoil = 0x55
    drive(hcu, 60.0)
    hcu.until("MCU2_Status", lambda s: s["EM2RequestStatus"] == "CRCWrong")
    hcu.until("EMU_PlantState", lambda s: s["RejectedFrames"] > 20)
    assert max(s.signals["EM2Torque"] for s in hcu.samples("MCU2_Status", begin)) <= 0.0
    hcu.spoil = 0
    hcu.until("MCU2_Status", lambda s: s["EM2RequestStatus"] == "OK" and s["EM2Torque"] > 59.0)


@pytest.mark.parametrize("protection", ["off", "observe"])
def test_a_wrong_crc_is_taken_when_not_enforced(tmp_path: Path, protection: str) -> None:
    options = ("--protection", protection, "--model", "4dof")
    with emulator(tmp_path, *options) as running, node(running.port) as hcu:
        hcu.until("ESC_Vehicle", lambda _: True)
        hcu.spoil = 0x55
        drive(hcu, 60.0)
        hcu.until("MCU2_Status", lambda s: s["EM2Torque"] > 59.0)
        running.end()
