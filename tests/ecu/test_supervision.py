"""Supervision alone: when a request counts as lost, what acts then, and what heals it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from watched import CAP, CMD, STATE, Watch, network

from hev_can_emu.ecu import ports
from hev_can_emu.ecu.reactions import GONE, GOOD, HELD
from hev_can_emu.ecu.supervision import HEALED, LOST, REFUSED
from hev_can_emu.ecu.ties import OWNER_EMULATED, with_ownership
from hev_can_emu.messages import protection

EM2, GEAR, CLUTCH = ports.EM2_TORQUE_REQUEST, ports.GEAR_REQUEST, ports.CLUTCH_CAPACITY_REQUEST
REAL, SLOPE = ports.EXTERNAL_EM2_TORQUE, ports.ROAD_GRADE


@pytest.fixture
def watch(tmp_path: Path) -> Watch:
    return Watch(network(tmp_path))


def test_never_received(watch: Watch) -> None:
    watch.look(1000)
    assert watch.statuses[ports.S_EM2_REQUEST_STATUS] == ports.REQUEST_NEVER
    assert np.isnan(watch.effective[EM2])
    assert watch.share[EM2] == GONE
    assert watch.failed == 2  # the unit's own message is no request
    assert watch.told == []


def test_lost_when_older_than_three_periods(watch: Watch) -> None:
    watch.take(5, CMD, trq=100.0)
    watch.look(35)
    assert watch.statuses[ports.S_EM2_REQUEST_STATUS] == ports.REQUEST_OK
    assert (watch.effective[EM2], watch.share[EM2]) == (100.0, GOOD)
    watch.look(35.000001)
    assert watch.statuses[ports.S_EM2_REQUEST_STATUS] == ports.REQUEST_TIMEOUT
    assert watch.told == [(LOST, CMD)]


def test_the_ramp_is_a_line_and_ends_at_zero(watch: Watch) -> None:
    watch.take(0, CMD, trq=-80.0, gang=1.0)
    for t, share in ((40, 1.0), (65, 0.75), (90, 0.5), (140, 0.0), (5000, 0.0)):
        watch.look(t)
        assert watch.share[EM2] == pytest.approx(share)
        assert watch.effective[EM2] == pytest.approx(-80.0 * share)
        assert watch.effective[GEAR] == 1.0  # not covered
    assert watch.told == [(LOST, CMD)]
    watch.take(5001, CMD, trq=20.0)
    watch.look(5001)
    assert (watch.effective[EM2], watch.share[EM2]) == (20.0, GOOD)
    assert watch.told == [(LOST, CMD), (HEALED, CMD)]


def test_hold_keeps_the_value_and_says_so(watch: Watch) -> None:
    watch.take(0, CAP, clutch=70.0)
    watch.look(500)
    assert (watch.effective[CLUTCH], watch.share[CLUTCH]) == (70.0, HELD)
    assert watch.statuses[ports.S_CLUTCH_REQUEST_STATUS] == ports.REQUEST_TIMEOUT


BAD = [
    ({"code": protection.CRC_WRONG}, ports.REQUEST_CRC),
    ({"code": protection.COUNTER_REPEATED}, ports.REQUEST_COUNTER),
    ({"code": protection.COUNTER_JUMP}, ports.REQUEST_COUNTER),
    ({"code": protection.LENGTH_WRONG}, ports.REQUEST_LENGTH),
    ({"trq": float("nan")}, ports.REQUEST_NOT_AVAILABLE),
    ({"trq": 800.1}, ports.REQUEST_RANGE),
    ({"gang": 3.0}, ports.REQUEST_RANGE),
]


@pytest.mark.parametrize(("bad", "status"), BAD)
def test_a_bad_frame_is_not_obeyed_and_refreshes_nothing(
    watch: Watch, bad: dict[str, float], status: int
) -> None:
    watch.take(0, CMD, trq=100.0, gang=2.0)
    for t in range(10, 60, 10):
        watch.take(t, CMD, **{"trq": 50.0, "gang": 1.0, **bad})  # type: ignore[arg-type]
    watch.look(30)
    assert (watch.effective[EM2], watch.requests[GEAR]) == (100.0, 2.0)
    watch.look(51)
    assert watch.statuses[ports.S_EM2_REQUEST_STATUS] == status
    assert watch.requests[EM2] == 100.0
    # When even the bad frames stop, that is the reason.
    watch.look(200)
    assert watch.statuses[ports.S_EM2_REQUEST_STATUS] == ports.REQUEST_TIMEOUT
    assert watch.told == [(LOST, CMD)]


@pytest.mark.parametrize(("bad", "status"), BAD)
def test_bad_from_the_first_frame_on(watch: Watch, bad: dict[str, float], status: int) -> None:
    watch.take(0, CMD, **{"trq": 50.0, **bad})  # type: ignore[arg-type]
    watch.look(10)
    assert watch.statuses[ports.S_EM2_REQUEST_STATUS] == status
    assert np.isnan(watch.effective[EM2])
    watch.look(100)
    assert watch.statuses[ports.S_EM2_REQUEST_STATUS] == ports.REQUEST_NEVER


def test_an_optional_signal_may_be_not_available(watch: Watch) -> None:
    watch.take(0, CMD, trq=10.0, top=30.0)
    watch.take(10, CMD, trq=10.0, top=float("nan"))
    watch.look(10)
    assert watch.statuses[ports.S_EM2_REQUEST_STATUS] == ports.REQUEST_OK
    assert np.isnan(watch.effective[ports.EM2_TORQUE_MAX])


@pytest.mark.parametrize(
    ("mode", "code", "used", "counted"),
    [
        (protection.OFF, protection.OK, True, 0),
        (protection.OBSERVE, protection.CRC_WRONG, True, 1),
        (protection.OBSERVE, protection.LENGTH_WRONG, False, 1),
        (protection.ENFORCE, protection.FIRST, True, 0),
        (protection.ENFORCE, protection.COUNTER_JUMP, False, 1),
    ],
)
def test_modes(watch: Watch, mode: int, code: int, used: bool, counted: int) -> None:
    watch.take(0, CMD, code=code, mode=mode, trq=60.0)
    watch.look(0)
    assert (watch.effective[EM2] == 60.0) == used
    assert watch.state[CMD, REFUSED] == counted


def test_an_external_unit_is_gone_after_three_periods(watch: Watch) -> None:
    watch.look(0)
    assert np.isnan(watch.effective[REAL])
    assert watch.share[REAL] == GONE
    watch.take(10, STATE, real=40.0, slope=5.0)
    watch.look(40)
    assert (watch.effective[REAL], watch.share[REAL]) == (40.0, GOOD)
    assert watch.effective[SLOPE] == pytest.approx(0.05)
    watch.look(41)
    assert np.isnan(watch.effective[REAL])
    assert watch.share[REAL] == GONE
    assert watch.effective[SLOPE] == pytest.approx(0.05)  # the road does not vanish
    assert watch.told == [(LOST, STATE)]
    assert watch.failed == 2
    watch.take(50, STATE, real=41.0)
    watch.look(50)
    assert (watch.effective[REAL], watch.share[REAL]) == (41.0, GOOD)


def test_what_an_external_unit_does_not_know_is_not_kept(watch: Watch) -> None:
    watch.take(0, STATE, real=40.0, slope=5.0)
    watch.take(10, STATE, real=float("nan"), slope=float("nan"))
    watch.look(10)
    assert np.isnan(watch.effective[REAL])
    assert watch.share[REAL] == GONE
    assert watch.effective[SLOPE] == pytest.approx(0.05)
    watch.take(20, STATE, real=2000.0)  # beyond its range: nonsense
    watch.look(20)
    assert np.isnan(watch.effective[REAL])
    assert watch.told == []  # it is alive


def test_an_emulated_unit_is_not_listened_to(tmp_path: Path) -> None:
    given = network(tmp_path)
    watch = Watch(given, with_ownership(given.ties, {1: OWNER_EMULATED}))
    watch.take(0, STATE, real=40.0)
    watch.look(0)
    assert np.isnan(watch.requests[REAL])
    assert watch.share[REAL] == GOOD  # emulated: nothing is missing
