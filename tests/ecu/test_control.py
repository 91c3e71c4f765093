"""The units' control alone: requests and shares in, plant commands out."""

from __future__ import annotations

import numpy as np
import pytest

from hev_can_emu.ecu import control, ports
from hev_can_emu.ecu.reactions import GONE, HELD
from hev_can_emu.plant import powertrain as plant

BRAKE_MAX = 6000.0


class Units:
    """Arrays for one call of the kernel; ignition on, everything requested, nothing external."""

    def __init__(self, ready: bool = True) -> None:
        self.request = np.zeros(len(ports.REQUESTS))
        self.request[ports.EXTERNAL_ENGINE_TORQUE :] = np.nan
        self.share = np.ones(len(ports.REQUESTS))
        self.statuses = np.zeros(len(ports.STATUSES))
        self.truth = np.zeros(len(plant.TRUTH))
        self.state = np.zeros(control.N_STATE)
        self.command = np.full(len(plant.COMMANDS), -1.0)
        control.start_units(self.state, ready)
        for port, value in (
            (ports.IGNITION, 2.0),
            (ports.ENGINE_RUN_REQUEST, 1.0),
            (ports.ENGINE_TORQUE_REQUEST, 80.0),
            (ports.EM1_CONTROL_MODE, 2.0),
            (ports.EM1_SPEED_REQUEST, 200.0),
            (ports.EM1_TORQUE_MIN, np.nan),
            (ports.EM1_TORQUE_MAX, 50.0),
            (ports.EM2_CONTROL_MODE, 1.0),
            (ports.EM2_TORQUE_REQUEST, 120.0),
            (ports.CLUTCH_CAPACITY_REQUEST, 90.0),
            (ports.GEAR_REQUEST, 1.0),
            (ports.SHIFT_FORCE_REQUEST, 700.0),
            (ports.BRAKE_TORQUE_REQUEST, 300.0),
            (ports.BRAKE_PEDAL, 0.5),
            (ports.CONTACTOR_REQUEST, 1.0),
        ):
            self.request[port] = value
        self.truth[plant.Y_EM1_TORQUE_MIN], self.truth[plant.Y_EM1_TORQUE_MAX] = -130.0, 130.0

    def act(self) -> np.ndarray:
        control.commands_from_requests(
            self.request, self.share, self.statuses, self.truth, BRAKE_MAX, self.state,
            self.command,
        )  # fmt: skip
        return self.command


def test_requests_pass() -> None:
    u = Units().act()
    assert u[plant.U_ENGINE_RUN] == 1.0
    assert u[plant.U_ENGINE_TORQUE] == 80.0
    assert (u[plant.U_EM1_MODE], u[plant.U_EM1_SPEED]) == (2.0, 200.0)
    assert np.isnan(u[plant.U_EM1_TORQUE_MIN])
    assert u[plant.U_EM1_TORQUE_MAX] == 50.0
    assert (u[plant.U_EM2_MODE], u[plant.U_EM2_TORQUE]) == (1.0, 120.0)
    assert (u[plant.U_GEAR], u[plant.U_SHIFT_FORCE]) == (1.0, 700.0)
    assert u[plant.U_CLUTCH_CAPACITY] == 90.0
    assert u[plant.U_BRAKE_TORQUE] == 300.0
    assert u[plant.U_CONTACTOR] == 1.0
    assert np.isnan(u[plant.U_EXTERNAL_ENGINE_TORQUE : plant.U_EXTERNAL_CHARGE_POWER + 1]).all()


def passive(u: np.ndarray) -> None:
    assert u[plant.U_ENGINE_RUN] == 0.0
    assert u[plant.U_EM1_MODE] == u[plant.U_EM2_MODE] == 0.0
    assert u[plant.U_CLUTCH_CAPACITY] == 0.0
    assert np.isnan(u[plant.U_GEAR])
    assert u[plant.U_SHIFT_FORCE] == 0.0


@pytest.mark.parametrize("ignition", [np.nan, 0.0, 1.0])
def test_without_ignition_everything_is_passive_but_the_pedal(ignition: float) -> None:
    units = Units()
    units.request[ports.IGNITION] = ignition
    passive(units.act())
    assert units.command[plant.U_CONTACTOR] == 0.0
    assert units.command[plant.U_BRAKE_TORQUE] == 0.5 * BRAKE_MAX


def test_units_act_after_their_boot() -> None:
    units = Units(ready=False)
    for _ in range(control.BOOT_TICKS):
        passive(units.act())
    assert units.act()[plant.U_EM2_MODE] == 1.0
    # Off for less than the afterrun: they are still awake.
    units.request[ports.IGNITION] = 0.0
    for _ in range(control.AFTERRUN_TICKS):
        passive(units.act())
    units.request[ports.IGNITION] = 3.0  # cranking
    assert units.act()[plant.U_EM2_MODE] == 1.0
    # Longer: they slept, and boot.
    units.request[ports.IGNITION] = 0.0
    for _ in range(control.AFTERRUN_TICKS + 1):
        units.act()
    units.request[ports.IGNITION] = 2.0
    passive(units.act())


def test_bounds_shrink_with_the_ramp() -> None:
    units = Units()
    units.share[ports.EM1_TORQUE_REQUEST] = 0.25
    u = units.act()
    assert u[plant.U_EM1_TORQUE_MIN] == -32.5  # a quarter of the machine's own
    assert u[plant.U_EM1_TORQUE_MAX] == 12.5  # a quarter of the request's
    units.share[ports.EM1_TORQUE_REQUEST] = HELD
    assert units.act()[plant.U_EM1_TORQUE_MAX] == 50.0


def test_a_short_circuit_ends_when_the_ramp_has() -> None:
    units = Units()
    units.request[ports.EM2_CONTROL_MODE] = 4.0
    for share, mode in ((1.0, 4.0), (0.01, 4.0), (GONE, 0.0)):
        units.share[ports.EM2_TORQUE_REQUEST] = share
        assert units.act()[plant.U_EM2_MODE] == mode


def test_a_lost_shift_holds_or_gives_up() -> None:
    units = Units()
    units.share[ports.GEAR_REQUEST] = HELD
    for phase in (ports.SYNC_NEUTRAL, ports.SYNC_ENGAGED, ports.SYNC_ABORTED):
        units.truth[plant.Y_SYNC_PHASE] = phase
        u = units.act()
        assert np.isnan(u[plant.U_GEAR])
        assert u[plant.U_SHIFT_FORCE] == 0.0
    for phase in (ports.SYNC_TRAVEL, ports.SYNC_SYNCHRONISING, ports.SYNC_INDEX):
        units.truth[plant.Y_SYNC_PHASE] = phase
        assert units.act()[plant.U_GEAR] == 0.0


def test_the_pedal_replaces_a_lost_brake_request_where_it_asks_for_more() -> None:
    units = Units()
    units.share[ports.BRAKE_TORQUE_REQUEST] = 0.5
    assert units.act()[plant.U_BRAKE_TORQUE] == 0.5 * BRAKE_MAX
    units.request[ports.BRAKE_PEDAL] = 0.0
    assert units.act()[plant.U_BRAKE_TORQUE] == 300.0
    units.request[ports.BRAKE_TORQUE_REQUEST] = np.nan
    units.request[ports.BRAKE_PEDAL] = np.nan
    assert units.act()[plant.U_BRAKE_TORQUE] == 0.0


def test_contactors_stay_when_nobody_asks() -> None:
    units = Units()
    for share, request in ((HELD, 0.0), (GONE, np.nan)):
        units.share[ports.CONTACTOR_REQUEST] = share
        units.request[ports.CONTACTOR_REQUEST] = request
        assert units.act()[plant.U_CONTACTOR] == 1.0
    units.share[ports.CONTACTOR_REQUEST], units.request[ports.CONTACTOR_REQUEST] = 1.0, 0.0
    assert units.act()[plant.U_CONTACTOR] == 0.0


@pytest.mark.parametrize(("value", "share"), [(33.0, 1.0), (np.nan, GONE)])
def test_the_emulation_of_an_external_unit_is_passive(value: float, share: float) -> None:
    units = Units()
    for port in range(ports.EXTERNAL_ENGINE_TORQUE, ports.EXTERNAL_BRAKE_TORQUE + 1):
        units.request[port], units.share[port] = value, share
    u = units.act()
    passive(u)
    assert u[plant.U_BRAKE_TORQUE] == 0.5 * BRAKE_MAX
    external = u[plant.U_EXTERNAL_ENGINE_TORQUE : plant.U_EXTERNAL_BRAKE_TORQUE + 1]
    np.testing.assert_array_equal(external, np.full(external.shape, value))
