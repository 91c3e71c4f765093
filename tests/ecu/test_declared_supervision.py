"""What a bindings file may declare of supervision: checks, debouncing, reactions; and the table behind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from watched import BINDINGS, CAP, CMD, Watch, network

from hev_can_emu.ecu import ports, supervision
from hev_can_emu.ecu.reactions import GOOD, HELD
from hev_can_emu.ecu.reasons import R_HIGH, R_IMPLAUSIBLE, R_LOW, R_SLEW, REASONS
from hev_can_emu.errors import InputError
from hev_can_emu.messages import protection

EM2, GEAR, CLUTCH = ports.EM2_TORQUE_REQUEST, ports.GEAR_REQUEST, ports.CLUTCH_CAPACITY_REQUEST
OLD = "supervision: {status: em2_request_status, reaction: ramp_to_zero, ramp_down: 100 ms,\n"
OLD += "                  covers: [em2_torque_request]}"
assert OLD in BINDINGS


def declared(folder: Path, text: str, covers: str = "[em2_torque_request]") -> Watch:
    """Return the network with this supervision of Cmd."""
    new = f"supervision: {{status: em2_request_status, covers: {covers}, {text}}}"
    return Watch(network(folder, BINDINGS.replace(OLD, new)))


def status(watch: Watch) -> int:
    return int(watch.statuses[ports.S_EM2_REQUEST_STATUS])


# Every phase that a message can be in, and how it gets there: (phase, event, next phase).
WAYS = [
    (phase, event, int(supervision.NEXT[phase, event]))
    for phase in range(len(supervision.PHASE_NAMES))
    for event in range(6)
    if not (phase == supervision.NEVER and event != supervision.E_NOTHING)
    and not (phase in (supervision.WELL, supervision.SUSPECT) and event == supervision.E_HEALED)
    and not (phase >= supervision.LOST_PHASE and event == supervision.E_FAILED)
    and not (phase in (supervision.WELL, supervision.SUSPECT, supervision.HEALING)
             and event == supervision.E_NOTHING)
]  # fmt: skip


@pytest.mark.parametrize(("phase", "event", "following"), WAYS)
def test_the_table_is_what_happens(tmp_path: Path, phase: int, event: int, following: int) -> None:
    """Bring a message into each phase and let each event happen that can happen there."""
    watch = declared(tmp_path, "reaction: hold, debounce: {failed: 3, healed: 3}")
    t = 0.0

    def frame(good: bool) -> None:
        nonlocal t
        t += 10.0
        watch.take(t, CMD, 0 if good else protection.CRC_WRONG, trq=5.0)
        watch.look(t)

    if phase != supervision.NEVER:
        frame(True)
    if phase == supervision.SUSPECT:
        frame(False)
    if phase >= supervision.LOST_PHASE:
        t += 31.0
        watch.look(t)
    if phase == supervision.HEALING:
        frame(True)
    assert watch.state[CMD, supervision.PHASE] == phase
    if event == supervision.E_GOOD:
        frame(True)
    elif event == supervision.E_BAD:
        frame(False)
    elif event == supervision.E_FAILED:
        for _ in range(3):
            frame(False)
    elif event == supervision.E_HEALED:
        for _ in range(3):
            frame(True)
    elif event == supervision.E_SILENT:
        t += 31.0
        watch.look(t)
    else:
        watch.look(t + 1.0)
    assert watch.state[CMD, supervision.PHASE] == following


def test_debouncing_counts_frames_in_a_row(tmp_path: Path) -> None:
    watch = declared(tmp_path, "timeout_periods: 100, debounce: {failed: 3, healed: 2}")
    watch.take(0, CMD, trq=5.0)
    for t, code in ((10, 2), (20, 2), (30, 0), (40, 2), (50, 2)):
        watch.take(t, CMD, code, trq=5.0)
        assert watch.look(t).told == []
    watch.take(60, CMD, protection.CRC_WRONG, trq=5.0)
    assert watch.look(60).told == [(supervision.LOST, CMD)]
    assert status(watch) == ports.REQUEST_CRC
    watch.take(70, CMD, trq=5.0)
    watch.look(70)
    assert status(watch) == ports.REQUEST_CRC
    watch.take(80, CMD, trq=6.0)
    watch.look(80)
    assert status(watch) == ports.REQUEST_OK
    assert (watch.effective[EM2], watch.share[EM2]) == (6.0, GOOD)
    assert watch.state[CMD, supervision.COUNTS + 3] == 5


@pytest.mark.parametrize(
    ("key", "code"),
    [
        ("crc", protection.CRC_WRONG),
        ("counter_frozen", protection.COUNTER_REPEATED),
        ("counter_jump", protection.COUNTER_JUMP),
    ],
)
def test_what_is_ignored_is_obeyed_and_still_counted(tmp_path: Path, key: str, code: int) -> None:
    watch = declared(tmp_path, f"{key}: ignore")
    watch.take(0, CMD, code, trq=44.0)
    watch.look(0)
    assert (status(watch), watch.effective[EM2]) == (ports.REQUEST_OK, 44.0)
    assert watch.state[CMD, supervision.REFUSED] == 1
    other = protection.COUNTER_JUMP if key != "counter_jump" else protection.CRC_WRONG
    watch.take(10, CMD, other, trq=50.0)
    watch.look(10)
    assert watch.effective[EM2] == 44.0


def test_limits_refuse_or_limit(tmp_path: Path) -> None:
    limits = "limits: {em2_torque_request: {low: -50 Nm, high: 0.1 kNm%s}}"
    watch = declared(tmp_path, limits % "")
    for t, torque, reason in ((0, 100.0, None), (10, 100.1, R_HIGH), (20, -50.1, R_LOW)):
        watch.take(t, CMD, trq=torque)
        if reason is not None:
            assert watch.state[CMD, supervision.COUNTS + reason] == 1
    assert watch.look(20).effective[EM2] == 100.0
    watch = declared(tmp_path, limits % ", action: limit")
    watch.take(0, CMD, trq=300.0)
    watch.look(0)
    assert (watch.requests[EM2], watch.effective[EM2]) == (300.0, 100.0)
    assert watch.limited[EM2] == ports.LIMIT_RANGE
    watch.take(10, CMD, trq=30.0)
    assert (watch.look(10).effective[EM2], watch.limited[EM2]) == (30.0, 0.0)


def test_the_range_of_the_database_may_limit_or_count_nothing(tmp_path: Path) -> None:
    watch = declared(tmp_path, "range: limit")
    watch.take(0, CMD, trq=812.0)
    watch.look(0)
    assert watch.effective[EM2] == pytest.approx(800.0)
    assert watch.limited[EM2] == ports.LIMIT_RANGE
    watch = declared(tmp_path, "range: ignore")
    watch.take(0, CMD, trq=812.0)
    assert watch.look(0).effective[EM2] == 812.0


def test_slew_refuses_or_limits(tmp_path: Path) -> None:
    slew = "timeout_periods: 50, slew: {em2_torque_request: {rate: 1000 Nm/s%s}}"
    watch = declared(tmp_path, slew % "")
    watch.take(0, CMD, trq=0.0)
    watch.take(10, CMD, trq=10.1)  # one step of the signal more than 10 ms allow
    watch.take(20, CMD, trq=60.0)
    assert watch.look(20).effective[EM2] == 10.1
    assert watch.state[CMD, supervision.COUNTS + R_SLEW] == 1
    watch.take(60, CMD, trq=60.0)  # 50 ms after the last good one
    assert watch.look(60).effective[EM2] == 60.0
    watch = declared(tmp_path, slew % ", action: limit")
    watch.take(0, CMD, trq=0.0)
    watch.look(0)
    watch.take(1, CMD, trq=-3.0)
    seen = [float(watch.look(t).effective[EM2]) for t in (1, 2, 3, 4)]
    assert seen == pytest.approx([-1.0, -2.0, -3.0, -3.0])
    assert watch.limited[EM2] == 0.0
    watch.take(5, CMD, trq=100.0)
    assert watch.look(5).limited[EM2] == ports.LIMIT_SLEW


def test_what_the_plant_contradicts_is_refused(tmp_path: Path) -> None:
    claims = (
        "plausible: [{port: em2_torque_request, of: em2_torque, within: 40 Nm}, "
        "{port: gear_request, of: vehicle_speed, when: 1, high: 36 km/h}]"
    )
    watch = declared(tmp_path, claims)
    watch.statuses[ports.S_EM2_TORQUE] = 50.0
    watch.take(0, CMD, trq=89.0)
    watch.take(10, CMD, trq=91.0)
    assert watch.look(10).effective[EM2] == 89.0
    watch.statuses[ports.S_VEHICLE_SPEED] = 10.1
    for t, gang, obeyed in ((20, 2.0, 2.0), (30, 1.0, 2.0)):
        watch.take(t, CMD, trq=50.0, gang=gang)
        assert watch.look(t).requests[GEAR] == obeyed
    assert watch.state[CMD, supervision.COUNTS + R_IMPLAUSIBLE] == 2
    watch.look(100)
    assert REASONS[R_IMPLAUSIBLE].status == ports.REQUEST_IMPLAUSIBLE
    watch.take(110, CMD, trq=50.0, gang=1.0)
    assert status(watch.look(110)) == ports.REQUEST_IMPLAUSIBLE


def test_substitutes(tmp_path: Path) -> None:
    watch = declared(
        tmp_path,
        "reaction: substitute, ramp_down: 100 ms, substitute: {em2_torque_request: 20 Nm}",
        "[em2_torque_request, gear_request]",
    )
    watch.take(0, CMD, trq=100.0, gang=2.0)
    for t, torque in ((40, 100.0), (90, 60.0), (140, 20.0), (900, 20.0)):
        watch.look(t)
        assert watch.effective[EM2] == pytest.approx(torque)
        assert (watch.share[EM2], watch.effective[GEAR]) == (HELD, 2.0)


def test_any_message_may_open_the_clutch(tmp_path: Path) -> None:
    watch = declared(tmp_path, "reaction: open_clutch, ramp_down: 100 ms")
    watch.take(0, CMD, trq=100.0)
    for t, share in ((30, 1.0), (40, 1.0), (90, 0.5), (140, 0.0)):
        watch.take(t, CAP, clutch=70.0)
        watch.look(t)
        assert watch.effective[CLUTCH] == pytest.approx(70.0 * share)
        assert watch.effective[EM2] == pytest.approx(100.0 * share)
    watch.take(150, CMD, trq=100.0)
    watch.take(150, CAP, clutch=70.0)
    assert watch.look(150).effective[CLUTCH] == 70.0


def test_limp_home_follows_the_pedal(tmp_path: Path) -> None:
    watch = declared(
        tmp_path,
        "reaction: limp_home, ramp_down: 100 ms, limp_home: {torque: 60 Nm, speed: 36 km/h}",
    )
    watch.requests[ports.ACCELERATOR], watch.requests[ports.SELECTOR] = 0.5, 3.0
    watch.take(0, CMD, trq=100.0)
    for t, torque in ((40, 100.0), (90, 65.0), (140, 30.0)):
        assert watch.look(t).effective[EM2] == pytest.approx(torque)
    assert watch.effective[ports.EM2_CONTROL_MODE] == ports.CONTROL_TORQUE
    for speed, torque in ((8.9, 30.0), (9.5, 15.0), (10.0, 0.0), (12.0, 0.0), (np.nan, 0.0)):
        watch.statuses[ports.S_VEHICLE_SPEED] = speed
        assert watch.look(200).effective[EM2] == pytest.approx(torque)
    watch.statuses[ports.S_VEHICLE_SPEED] = 0.0
    watch.requests[ports.SELECTOR] = 2.0  # neutral
    assert watch.look(210).effective[EM2] == 0.0


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("code: X1100", "code: expected a trouble code such as 'U1101', got 'X1100'"),
        (
            "limits: {clutch_capacity_request: {low: 0 Nm, high: 1 Nm}}",
            "limits.clutch_capacity_request: expected a request port of Cmd, got 'clutch_capacity_request'",
        ),
        (
            "limits: {em2_torque_request: {low: 5 Nm, high: 1 Nm}}",
            "expected low below high, got 5 Nm",
        ),
        (
            "limits: {em2_torque_request: {low: 5 V, high: 9 V}}",
            "low: expected a number with a unit such as '1 N m', got '5 V'",
        ),
        (
            "slew: {em2_torque_request: {rate: 5 Nm}}",
            "rate: expected a positive rate in (N m)/s, got '5 Nm'",
        ),
        (
            "plausible: [{port: em2_torque_request, of: em2_torqe, within: 1 Nm}]",
            "of: expected a status port, got 'em2_torqe'; did you mean 'em2_torque'",
        ),
        (
            "plausible: [{port: em2_torque_request, of: vehicle_speed, within: 1 m/s}]",
            "of: expected a status port in N m, got 'vehicle_speed' in m/s",
        ),
        (
            "plausible: [{port: em2_torque_request, of: em2_torque}]",
            "expected either 'within' or 'when', got neither",
        ),
        (
            "substitute: {em2_torque_request: 5 Nm}",
            "substitute: expected it with the reaction substitute, got reaction hold with it",
        ),
        (
            "reaction: limp_home",
            "limp_home: expected it with the reaction limp_home, got reaction limp_home without it",
        ),
        (
            "reaction: limp_home, limp_home: {torque: 5}",
            "limp_home.torque: expected text",
        ),
        ("debounce: {failed: -1}", "failed: expected a whole number >= 0, got -1"),
        ("reaction: limphome", "reaction: expected one of hold, limp_home, open_clutch"),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(InputError) as refused:
        declared(tmp_path, text)
    assert complaint in str(refused.value)
    assert str(refused.value).startswith("small.yaml:")
    assert "\n" not in str(refused.value)
