"""Steady power ahead of the currents: against the drive itself, and the torque that a bound leaves."""

from __future__ import annotations

import numpy as np
import pytest
from drive_defaults import EM2

from hev_can_emu.plant import electric_drive
from hev_can_emu.plant.drive_power import steady_power, torque_within_power

DT = 5e-5
WARM = 300.0


@pytest.fixture(scope="module")
def em2():
    return EM2.pack(DT)


@pytest.mark.parametrize("torque", [-80.0, 0.0, 100.0])
@pytest.mark.parametrize("speed", [-700.0, 0.0, 250.0, 1100.0])
def test_steady_power_is_what_the_drive_takes_once_settled(em2, speed, torque):
    x, out = np.zeros(electric_drive.N_STATE), np.zeros(electric_drive.N_OUT)
    for _ in range(900):
        electric_drive.drive_step(
            em2, x, torque, electric_drive.ACTIVE, speed, 350.0, 350.0, WARM, out
        )
    taken = out[electric_drive.OUT_DC] / DT
    assert steady_power(em2, torque, speed, 350.0, 350.0) == pytest.approx(taken, rel=2e-3, abs=5.0)


@pytest.mark.parametrize("speed", [-600.0, 200.0, 900.0])
@pytest.mark.parametrize("request_", [120.0, -120.0])
def test_a_bound_that_binds_is_met_and_one_that_does_not_changes_nothing(em2, speed, request_):
    assert torque_within_power(em2, request_, -1e6, 1e6, speed, 350.0, WARM) == request_
    torque = torque_within_power(em2, request_, -8e3, 10e3, speed, 350.0, WARM)
    assert 0.0 < torque / request_ < 1.0
    bound = 10e3 if request_ * speed > 0.0 else -8e3
    assert steady_power(em2, torque, speed, 350.0, WARM) == pytest.approx(bound, rel=1e-4)


def test_losses_alone_can_pass_a_bound(em2):
    idle = steady_power(em2, 0.0, 1000.0, 350.0, WARM)
    assert idle > 500.0
    assert torque_within_power(em2, 50.0, -1e5, 0.5 * idle, 1000.0, 350.0, WARM) == 0.0
