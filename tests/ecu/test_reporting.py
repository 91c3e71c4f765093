"""Reporting alone: codes that follow from the plant's truth."""

from __future__ import annotations

import numpy as np
import pytest

from hev_can_emu.ecu import ports, reporting
from hev_can_emu.plant import powertrain as plant


@pytest.mark.parametrize(
    ("clutch", "gear", "mode"),
    [
        (0, 0.0, ports.MODE_ELECTRIC_NEUTRAL),
        (0, 1.0, ports.MODE_ELECTRIC_G1),
        (0, 2.0, ports.MODE_ELECTRIC_G2),
        (2, 0.0, ports.MODE_SERIES),
        (2, 1.0, ports.MODE_PARALLEL_G1),
        (2, 2.0, ports.MODE_PARALLEL_G2),
        (1, 0.0, ports.MODE_TRANSITION),
        (1, 2.0, ports.MODE_TRANSITION),
        (2, 3.0, ports.MODE_TRANSITION),
        (0, 3.0, ports.MODE_TRANSITION),
    ],
)
def test_driving_mode(clutch: int, gear: float, mode: int) -> None:
    assert reporting.driving_mode(clutch, gear) == mode


def report(
    truth: dict[int, float], command: dict[int, float], statuses: dict[int, float] | None = None
) -> np.ndarray:
    """Return the statuses for a plant at rest but for what is given; EM2 is asked for 50 N m."""
    y = np.zeros(len(plant.TRUTH))
    u = np.full(len(plant.COMMANDS), np.nan)
    u[plant.U_EM1_MODE] = u[plant.U_EM2_MODE] = 0.0
    request = np.zeros(len(ports.REQUESTS))
    request[ports.EM2_TORQUE_REQUEST] = 50.0
    out = np.zeros(len(ports.STATUSES))
    for vector, given in ((y, truth), (u, command), (out, statuses or {})):
        for index, value in given.items():
            vector[index] = value
    limited = np.zeros(len(ports.REQUESTS))
    reporting.statuses_from_truth(
        y,
        u,
        request,
        limited,
        0.35,
        1,
        2,
        65540,
        True,
        bool(reporting.supervision_limits(limited, out)),
        out,
    )
    return out


def test_motor_state_and_reasons() -> None:
    closed = {plant.Y_CONTACTOR_PHASE: 2.0, plant.Y_EM2_SETPOINT: 20.0}
    for mode, state in ((0, 1), (1, 2), (2, 3), (3, 4), (4, 5)):
        out = report(closed, {plant.U_EM2_MODE: float(mode)})
        assert out[ports.S_EM2_STATE] == state
        disabled = mode not in (1, 2)
        assert out[ports.S_EM2_LIMIT_REASON] == (ports.LIMIT_DISABLED if disabled else 0)
        assert out[ports.S_EM1_LIMIT_REASON] == 0  # nothing asked, nothing withheld
    out = report({plant.Y_CONTACTOR_PHASE: 0.0}, {plant.U_EM2_MODE: 1.0})
    assert out[ports.S_EM2_STATE] == 1.0  # no high voltage
    assert out[ports.S_EM2_LIMIT_REASON] == ports.LIMIT_DISABLED
    for bound in (plant.U_EM2_TORQUE_MIN, plant.U_EM2_TORQUE_MAX):
        out = report(closed, {plant.U_EM2_MODE: 2.0, bound: 20.0})
        assert out[ports.S_EM2_LIMIT_REASON] == ports.LIMIT_TORQUE_BOUND
        out = report(closed, {plant.U_EM2_MODE: 2.0, bound: 21.0})
        assert out[ports.S_EM2_LIMIT_REASON] == ports.LIMIT_NONE


def test_a_lost_request_is_the_reason_that_counts() -> None:
    truth = {plant.Y_EM2_REASON: float(ports.LIMIT_TEMPERATURE), plant.Y_CONTACTOR_PHASE: 2.0}
    for status, reason in (
        (ports.REQUEST_OK, ports.LIMIT_TEMPERATURE),
        (ports.REQUEST_NEVER, ports.LIMIT_TEMPERATURE),
        (ports.REQUEST_CRC, ports.LIMIT_REQUEST_LOST),
        (ports.REQUEST_TIMEOUT, ports.LIMIT_REQUEST_LOST),
    ):
        out = report(truth, {plant.U_EM2_MODE: 1.0}, {ports.S_EM2_REQUEST_STATUS: float(status)})
        assert out[ports.S_EM2_LIMIT_REASON] == reason


def test_shift_reasons_clutch_states_and_counts() -> None:
    for phase, reason in (
        (ports.SYNC_ABORTED, ports.LIMIT_SYNC_TIMEOUT),
        (ports.SYNC_BLOCKED_BY_TORQUE, ports.LIMIT_TORQUE_ON_DOGS),
        (ports.SYNC_ENGAGED, ports.LIMIT_NONE),
    ):
        out = report({plant.Y_SYNC_PHASE: float(phase)}, {})
        assert out[ports.S_SYNCHRONIZER_LIMIT_REASON] == reason
    for held, capacity, state in ((0.0, 0.0, 0), (0.0, 5.0, 1), (1.0, 5.0, 2)):
        out = report({plant.Y_CLUTCH_HELD: held, plant.Y_CLUTCH_CAPACITY: capacity}, {})
        assert out[ports.S_CLUTCH_STATE] == state
    assert out[ports.S_REQUESTS_FAILED] == 2
    assert out[ports.S_REJECTED_FRAMES] == 4  # modulo 65536


def test_currents_need_a_voltage() -> None:
    truth = {plant.Y_EM2_POWER: -7000.0, plant.Y_LINK_VOLTAGE: 350.0}
    assert report(truth, {})[ports.S_EM2_DC_CURRENT] == pytest.approx(-20.0)
    assert report({plant.Y_LINK_VOLTAGE: 0.0}, {})[ports.S_EM2_DC_CURRENT] == 0.0


def test_every_copy_is_where_the_truth_has_it() -> None:
    assert all(status == truth for status, truth in reporting.COPIES)
    truth = np.arange(1.0, 1.0 + len(plant.TRUTH))
    out = report(dict(enumerate(truth)), {})
    limits = {port for port, _ in reporting.COPIES if ports.STATUSES[port].name.endswith("reason")}
    for status, place in reporting.COPIES:
        if status not in limits:
            assert out[status] == truth[place]
    # What lies between them, and up to a whole vector, is written after.
    assert out[ports.S_REQUESTS_FAILED] == 2
    assert out[ports.S_REJECTED_FRAMES] == 4
    assert out[ports.S_DRIVING_MODE] in range(7)
    assert out[ports.S_EM2_DC_VOLTAGE] == truth[plant.Y_LINK_VOLTAGE]
    for name in ("speed", "torque", "torque_min", "torque_max", "inverter_temperature"):
        for machine in ("em1", "em2"):
            place = plant.TRUTH.index(f"{machine}_{name}")
            port = [each.name for each in ports.STATUSES].index(f"{machine}_{name}")
            assert out[port] == truth[place]
