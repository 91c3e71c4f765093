"""Bindings: the shipped file is complete, values cross correctly, and every mistake is named."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hev_can_emu import config
from hev_can_emu.ecu import ports, ties
from hev_can_emu.ecu.bindings import (
    Bindings,
    ResolvedBindings,
    requests_from_signals,
    resolve,
    signals_from_statuses,
    with_ownership,
)
from hev_can_emu.errors import InputError
from hev_can_emu.messages.database import Database, load_database

ROOT = Path(__file__).parents[2] / "dbc"
RPM = math.pi / 30.0

FOREIGN = """VERSION ""
BU_: CTRL DRIVE
BO_ 256 Cmd: 8 CTRL
 SG_ Trq : 0|16@1- (0.5,0) [-1000|1000] "N*m" DRIVE
 SG_ Gang : 16|4@1+ (1,0) [0|14] "" DRIVE
 SG_ Temp : 24|8@1+ (1,-40) [-40|200] "degC" DRIVE
BO_ 257 State: 8 DRIVE
 SG_ Speed : 0|16@1- (1,0) [-20000|20000] "U/min" CTRL
 SG_ Gear : 16|4@1+ (1,0) [0|14] "" CTRL
 SG_ Amps : 24|16@1- (0.1,0) [-1000|1000] "A" CTRL
 SG_ Odd : 40|8@1+ (1,0) [0|100] "furlong" CTRL
BO_ 258 Stray: 8 Vector__XXX
 SG_ Volt : 0|16@1+ (0.1,0) [0|1000] "" CTRL
CM_ BO_ 256 "";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 257 20;
VAL_ 256 Gang 1 "Leerlauf" 2 "Erster" 3 "Zweiter" 15 "SNA" ;
VAL_ 257 Gear 1 "Leerlauf" 2 "Erster" 3 "Zweiter" 15 "SNA" ;
"""

FOREIGN_BINDINGS = """
version: 1
nodes:
  CTRL: {role: controller}
  DRIVE: {role: emulated}
  CAR: {role: emulated, ownership: external}
messages:
  Cmd:
    request:
      Trq: em2_torque_request
      Gang: {port: gear_request, values: {Leerlauf: 0, Erster: 1, Zweiter: 2}}
      Temp: ambient_temperature
    optional: [Temp]
    supervision: {status: em2_request_status, period: 5 ms, timeout_periods: 4, reaction: ramp_to_zero,
                  ramp_down: 0.1 s, covers: [em2_torque_request]}
  State:
    status:
      Speed: em2_speed
      Gear: {port: gear, values: {Leerlauf: 0, Erster: 1, Zweiter: 2}}
      Amps: {port: battery_current, factor: -1}
  Stray:
    node: CAR
    external:
      Volt: {port: external_battery_voltage, unit: V}
"""


@pytest.fixture(scope="module")
def network() -> Database:
    return load_database(ROOT / "hev.dbc")


@pytest.fixture(scope="module")
def shipped(network: Database) -> ResolvedBindings:
    document = config.read(ROOT / "hev.bindings.yaml")
    return resolve(document.convert(Bindings), network, document.where)


@pytest.fixture
def foreign(tmp_path: Path) -> Database:
    (tmp_path / "their.dbc").write_text(FOREIGN)
    return load_database(tmp_path / "their.dbc")


def bind(database: Database, text: str) -> ResolvedBindings:
    document = config.parse(text, "their.yaml")
    return resolve(document.convert(Bindings), database, document.where)


def test_every_port_is_bound(shipped: ResolvedBindings) -> None:
    assert sorted(shipped.rx_port) == sorted(
        set(range(len(ports.REQUESTS))) - ports.TESTER_REQUESTS
    )
    assert sorted(shipped.tx_port) == list(range(len(ports.STATUSES)))


def test_every_payload_signal_is_bound(network: Database, shipped: ResolvedBindings) -> None:
    bound = set(shipped.rx_signal) | set(shipped.tx_signal)
    free = {signal.name for signal in network.signals if signal.index not in bound}
    names = [message.name for message in network.messages]
    assert free == {f"{name}_{end}" for name in names for end in ("CRC", "Counter")}


def test_directions(network: Database, shipped: ResolvedBindings) -> None:
    for message in network.messages:
        m = message.index
        received = shipped.rx_start[m + 1] - shipped.rx_start[m]
        sent = shipped.tx_start[m + 1] - shipped.tx_start[m]
        signals = len(message.signals) - 2
        assert (sent == 0 and received == signals) if message.sender == "HCU" else sent == signals
        for tie in range(shipped.rx_start[m], shipped.rx_start[m + 1]):
            assert network.signals[shipped.rx_signal[tie]].message_index == m


def test_codes_of_the_shipped_network_are_the_ports(
    network: Database, shipped: ResolvedBindings
) -> None:
    """Labels against the constants that the units use, for those that have any."""
    families = {
        "DrivingMode": ("MODE_", {"Electric": "ELECTRIC_", "Parallel": "PARALLEL_"}),
        "EM1ControlMode": ("CONTROL_", {}),
        "SynchronizerState": (
            "SYNC_",
            {"BlockedByTorque": "BLOCKED_BY_TORQUE", "ToothOnTooth": "TOOTH_ON_TOOTH"},
        ),
        "EngineLimitReason": (
            "LIMIT_",
            {"BatteryPower": "BATTERY_POWER", "SlewRate": "SLEW", "RequestLost": "REQUEST_LOST",
             "TorqueBound": "TORQUE_BOUND", "TorqueOnDogs": "TORQUE_ON_DOGS",
             "SyncTimeout": "SYNC_TIMEOUT", "PeakTorque": "PEAK"},
        ),
        "EngineRequestStatus": (
            "REQUEST_",
            {"NeverReceived": "NEVER", "CRCWrong": "CRC", "CounterWrong": "COUNTER",
             "LengthWrong": "LENGTH", "OutOfRange": "RANGE", "SignalNotAvailable": "NOT_AVAILABLE",
             "ChangedTooFast": "CHANGED_TOO_FAST"},
        ),
    }  # fmt: skip
    for name, (prefix, words) in families.items():
        signal = network.signal(name)
        found = {}
        for raw, label in signal.labels.items():
            for word, constant in words.items():
                label = label.replace(word, constant)
            if raw != signal.not_available:
                found[prefix + label.upper()] = raw
        constants = {key: value for key, value in vars(ports).items() if key.startswith(prefix)}
        assert found == constants


def test_supervision_of_the_shipped_network(network: Database, shipped: ResolvedBindings) -> None:
    for message in network.messages:
        m = message.index
        assert shipped.supervised[m] == (message.sender == "HCU")
        if message.sender == "HCU":
            assert shipped.timeout_ns[m] == 3 * message.cycle_time_ns
            # Below 200 ms by what the actuator's own lag takes.
            assert 0 < shipped.ramp_ns[m] <= 200_000_000
            assert ports.STATUSES[shipped.status_port[m]].name.endswith("request_status")
            assert shipped.cover_start[m + 1] > shipped.cover_start[m]
    clutch = network.message("HCU_ClutchRequest").index
    assert shipped.reaction[clutch] == ties.REACT_OPEN_CLUTCH
    sleeve = network.message("HCU_SynchronizerRequest").index
    assert shipped.reaction[sleeve] == ties.REACT_HOLD
    engine = network.message("HCU_EngineRequest").index
    assert shipped.reaction[engine] == ties.REACT_RAMP_TO_ZERO
    assert list(
        shipped.cover_port[shipped.cover_start[engine] : shipped.cover_start[engine + 1]]
    ) == [ports.ENGINE_TORQUE_REQUEST]


def test_a_request_arrives_in_si(network: Database, shipped: ResolvedBindings) -> None:
    values = np.full(len(network.signals), np.nan)
    requests = np.full(len(ports.REQUESTS), -1.0)
    message = network.message("HCU_EM2Request")
    for name, value in (("EM2SpeedRequest", 3000.0), ("EM2TorqueRequest", -12.5)):
        values[network.signal_index(message.name, name)] = value
    requests_from_signals(shipped, message.index, values, requests)
    assert requests[ports.EM2_SPEED_REQUEST] == pytest.approx(3000.0 * RPM, rel=1e-15)
    assert requests[ports.EM2_TORQUE_REQUEST] == -12.5
    assert np.isnan(requests[ports.EM2_TORQUE_MAX])
    assert np.isnan(requests[ports.EM2_CONTROL_MODE])
    assert requests[ports.EM1_TORQUE_REQUEST] == -1.0
    optional = shipped.rx_optional.astype(bool)
    assert {ports.REQUESTS[port].name for port in shipped.rx_port[optional]} == {
        f"em{n}_torque_{end}" for n in (1, 2) for end in ("min", "max")
    }


def test_status_leaves_in_the_networks_units(network: Database, shipped: ResolvedBindings) -> None:
    statuses = np.full(len(ports.STATUSES), np.nan)
    values = np.full(len(network.signals), -1.0)
    statuses[ports.S_WHEEL_SPEED_FL] = 10.0
    statuses[ports.S_BATTERY_TEMPERATURE] = 300.0
    statuses[ports.S_SLEEVE_POSITION] = -0.0085
    statuses[ports.S_STATE_OF_CHARGE] = 0.5
    statuses[ports.S_EM1_DC_POWER] = -12_340.0
    signals_from_statuses(shipped, statuses, values)
    for name, expected in (
        ("WheelSpeedFL", 36.0),
        ("BatteryTemperature", 26.85),
        ("SleevePosition", -8.5),
        ("StateOfCharge", 50.0),
        ("EM1DCPower", -12.34),
    ):
        assert values[network.signal(name).index] == pytest.approx(expected, rel=1e-12), name
    assert np.isnan(values[network.signal("EngineSpeed").index])
    assert values[network.signal("EM1TorqueRequest").index] == -1.0


def test_an_external_unit_drives_the_plant(network: Database, shipped: ResolvedBindings) -> None:
    values = np.full(len(network.signals), np.nan)
    values[network.signal("EngineTorque").index] = 80.0
    statuses = np.zeros(len(ports.STATUSES))
    requests = np.full(len(ports.REQUESTS), -1.0)
    ems = network.message("EMS_Status").index
    requests_from_signals(shipped, ems, values, requests)
    assert requests[ports.EXTERNAL_ENGINE_TORQUE] == -1.0
    outside = with_ownership(shipped, {int(shipped.message_node[ems]): ties.OWNER_EXTERNAL})
    requests_from_signals(outside, ems, values, requests)
    assert requests[ports.EXTERNAL_ENGINE_TORQUE] == 80.0
    signals_from_statuses(outside, statuses, values)
    assert values[network.signal("EngineTorque").index] == 80.0
    assert values[network.signal("EM1Torque").index] == 0.0


def test_there_and_back(network: Database, shipped: ResolvedBindings) -> None:
    """What goes out as a status and comes back as an external request is the same value."""
    outside = shipped._replace(
        node_ownership=np.full_like(shipped.node_ownership, ties.OWNER_EXTERNAL)
    )
    statuses = np.linspace(0.1, 300.0, len(ports.STATUSES))
    values = np.full(len(network.signals), np.nan)
    requests = np.full(len(ports.REQUESTS), np.nan)
    signals_from_statuses(shipped, statuses, values)
    for message in network.messages:
        requests_from_signals(outside, message.index, values, requests)
    for request, status in (
        (ports.EXTERNAL_SLEEVE_POSITION, ports.S_SLEEVE_POSITION),
        (ports.EXTERNAL_CHARGE_POWER_LIMIT, ports.S_CHARGE_POWER_LIMIT),
        (ports.AMBIENT_TEMPERATURE, ports.S_AMBIENT_TEMPERATURE_ACTUAL),
        (ports.ACCELERATOR, ports.S_DRIVER_ACCELERATOR),
    ):
        assert requests[request] == pytest.approx(statuses[status], rel=1e-12)


def test_a_foreign_network(foreign: Database) -> None:
    bound = bind(foreign, FOREIGN_BINDINGS)
    values = np.zeros(len(foreign.signals))
    requests = np.full(len(ports.REQUESTS), np.nan)
    for name, value in (("Trq", 20.0), ("Gang", 3.0), ("Temp", 20.0), ("Volt", 380.0)):
        values[foreign.signal(name).index] = value
    for name in ("Cmd", "Stray"):
        requests_from_signals(bound, foreign.message(name).index, values, requests)
    assert requests[ports.EM2_TORQUE_REQUEST] == 20.0
    assert requests[ports.GEAR_REQUEST] == 2.0
    assert requests[ports.AMBIENT_TEMPERATURE] == 293.15
    assert requests[ports.EXTERNAL_BATTERY_VOLTAGE] == 380.0
    values[foreign.signal("Gang").index] = 9.0
    requests_from_signals(bound, foreign.message("Cmd").index, values, requests)
    assert np.isnan(requests[ports.GEAR_REQUEST])

    statuses = np.full(len(ports.STATUSES), np.nan)
    statuses[ports.S_EM2_SPEED], statuses[ports.S_GEAR] = 100.0 * RPM, 1.0
    statuses[ports.S_BATTERY_CURRENT] = 7.0
    signals_from_statuses(bound, statuses, values)
    assert values[foreign.signal("Speed").index] == pytest.approx(100.0)
    assert values[foreign.signal("Gear").index] == 2.0
    assert values[foreign.signal("Amps").index] == -7.0
    statuses[ports.S_GEAR] = 3.0
    signals_from_statuses(bound, statuses, values)
    assert np.isnan(values[foreign.signal("Gear").index])

    command = foreign.message("Cmd").index
    assert bound.timeout_ns[command] == 20_000_000
    assert bound.ramp_ns[command] == 100_000_000
    assert list(bound.node_ownership) == [1, 0, 1]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  Cmd:", "  Cmds:", "their.yaml:8: $.messages.Cmds: expected a message of their.dbc, got 'Cmds'; "
         "did you mean 'Cmd'?"),
        ("      Trq:", "      Torq:", "their.yaml:10: $.messages.Cmd.request.Torq: expected a signal of Cmd, "
         "got 'Torq'; did you mean 'Trq'?"),
        ("em2_torque_request\n", "em2_torque_reqest\n", "their.yaml:10: $.messages.Cmd.request.Trq: expected "
         "a request port, got 'em2_torque_reqest'; did you mean 'em2_torque_request' or "
         "'em1_torque_request' or 'brake_torque_request'?"),
        ("Trq: em2_torque_request\n", "Trq: em2_torque\n", "their.yaml:10: $.messages.Cmd.request.Trq: "
         "expected a request port, got 'em2_torque'; that is a status port"),
        ("Speed: em2_speed", "Speed: em2_speed_request", "their.yaml:18: $.messages.State.status.Speed: "
         "expected a status port, got 'em2_speed_request'; that is a request port"),
        ("Temp: ambient_temperature", "Temp: em2_torque_max", "their.yaml:12: $.messages.Cmd.request.Temp: "
         "expected a unit that converts to N m, got 'degC' of Cmd.Temp; em2_torque_max is upper torque "
         "bound in speed control"),
        ("Temp: ambient_temperature", "Temp: accelerator", "their.yaml:12: $.messages.Cmd.request.Temp: "
         "expected a pure number, got 'degC' of Cmd.Temp; accelerator is accelerator pedal, 0 to 1"),
        ("Speed: em2_speed", "Odd: em2_speed", "their.yaml:18: $.messages.State.status.Odd: expected a unit, "
         "got 'furlong'; say what it is in with 'unit', such as {port: em2_speed, unit: rad/s}"),
        ("unit: V", "unit: vlt", "their.yaml:24: $.messages.Stray.external.Volt: expected a unit, "
         "got 'vlt'; did you mean 'V'?"),
        ("request, values: {Leerlauf: 0, Erster: 1", "request, values: {Leerlauf: 0, Erste: 1",
         "their.yaml:11: $.messages.Cmd.request.Gang.values.Erste: expected a label of Gang, got 'Erste'; "
         "did you mean 'Erster' or 'Zweiter'?"),
        ("Temp: ambient_temperature", "Temp: em2_torque_request", "their.yaml:12: "
         "$.messages.Cmd.request.Temp: expected each request port once, got 'em2_torque_request' again; "
         "first at Cmd.Trq"),
        ("factor: -1", "factor: 0", "their.yaml:20: $.messages.State.status.Amps: expected a finite factor "
         "other than 0, got 0"),
        ("    status:\n      Speed: em2_speed", "    request:\n      Speed: em2_speed_request",
         "their.yaml:17: $.messages.State.request: expected a message that a controller sends, "
         "got one of DRIVE"),
        ("    request:\n      Trq: em2_torque_request", "    status:\n      Trq: em2_torque",
         "their.yaml:9: $.messages.Cmd.status: expected a message that an emulated unit sends, "
         "got one of CTRL"),
        ("  DRIVE:", "  DRVE:", "their.yaml:5: $.nodes.DRVE: expected a node of their.dbc, got 'DRVE'; "
         "did you mean 'DRIVE'?"),
        ("    node: CAR\n", "    node: CAT\n", "their.yaml:6: $.nodes.CAR: expected a node of their.dbc, "
         "got 'CAR'; did you mean 'CTRL'?"),
        ("  DRIVE: {role: emulated}\n", "", "their.yaml:15: $.messages.State: expected a message of one of "
         "the nodes, got 'DRIVE'; add it to 'nodes', or name another with 'node'"),
        ("optional: [Temp]", "optional: [Tmp]", "their.yaml:13: $.messages.Cmd.optional[0]: expected a bound "
         "signal, got 'Tmp'; did you mean 'Temp'?"),
        (" period: 5 ms,", "", "their.yaml:14: $.messages.Cmd.supervision: expected a cyclic message, "
         "got 'Cmd' without cycle time; name its 'period'"),
        ("0.1 s", "0.1 m", "their.yaml:15: $.messages.Cmd.supervision.ramp_down: expected a number with a "
         "unit such as '1 s', got '0.1 m'; the unit does not fit"),
        ("covers: [em2", "covers: [em1", "their.yaml:15: $.messages.Cmd.supervision.covers[0]: expected a "
         "request port of Cmd, got 'em1_torque_request'; did you mean 'em2_torque_request' or "
         "'gear_request'?"),
        ("em2_request_status", "em3_request_status", "their.yaml:14: $.messages.Cmd.supervision.status: "
         "expected a status port, got 'em3_request_status'; did you mean 'em2_request_status' or "
         "'em1_request_status' or 'hv_request_status'?"),
    ],
)  # fmt: skip
def test_mistakes(foreign: Database, old: str, new: str, message: str) -> None:
    assert FOREIGN_BINDINGS.count(old) >= 1
    with pytest.raises(InputError) as caught:
        bind(foreign, FOREIGN_BINDINGS.replace(old, new, 1))
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("reaction: ramp_to_zero", "reaction: panic"),
        ("timeout_periods: 4", "timeout_periods: 0"),
        ("version: 1", "version: 2"),
        ("optional: [Temp]", "optinal: [Temp]"),
        ("role: controller", "role: master"),
    ],
)
def test_the_shape_is_checked(foreign: Database, old: str, new: str) -> None:
    with pytest.raises(InputError, match=r"their\.yaml:\d+: \$\.") as caught:
        bind(foreign, FOREIGN_BINDINGS.replace(old, new, 1))
    assert "expected" in str(caught.value)


def test_counters_and_check_codes_carry_no_port(network: Database) -> None:
    text = (ROOT / "hev.bindings.yaml").read_text()
    with pytest.raises(InputError) as caught:
        bind(network, text.replace("      EngineSpeed:", "      EMS_Status_Counter:"))
    assert str(caught.value).endswith(
        "$.messages.EMS_Status.status.EMS_Status_Counter: expected a signal that carries a value, "
        "got 'EMS_Status_Counter', which the protection of EMS_Status writes"
    )


def test_without_a_file_the_path_is_told(foreign: Database) -> None:
    raw: dict[str, Any] = {"version": 1, "nodes": {"X": {"role": "emulated"}}, "messages": {}}
    with pytest.raises(InputError) as caught:
        resolve(msgspec.convert(raw, Bindings), foreign)
    assert str(caught.value) == "bindings: $.nodes.X: expected a node of their.dbc, got 'X'"
