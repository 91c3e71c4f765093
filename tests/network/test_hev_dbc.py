"""The shipped network keeps its own rules, as an independent reader sees it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cantools
import pytest

from hev_can_emu.units import unit

FILE = Path(__file__).parents[2] / "dbc" / "hev.dbc"
DATABASE: Any = cantools.database.load_file(FILE, strict=True)
MESSAGES = {message.name: message for message in DATABASE.messages}
PROTECTION = ("CRC", "Counter")
PAYLOAD = [
    (message, signal)
    for message in DATABASE.messages
    for signal in message.signals
    if not signal.name.endswith(PROTECTION)
]

#: What the network's users rely on by name.
PROMISED = {
    "HCU_EngineRequest": ["EngineTorqueRequest", "EngineRunRequest"],
    **{
        f"HCU_EM{n}Request": [
            f"EM{n}{what}"
            for what in ("TorqueRequest", "ControlMode", "SpeedRequest", "TorqueMin", "TorqueMax")
        ]
        for n in (1, 2)
    },
    **{f"MCU{n}_Status": [f"EM{n}Speed", f"EM{n}Torque", f"EM{n}State"] for n in (1, 2)},
    "HCU_ClutchRequest": ["ClutchTorqueCapacityRequest"],
    "HCU_SynchronizerRequest": ["GearRequest", "ShiftForceRequest"],
    "HCU_BrakeRequest": ["BrakeTorqueRequest"],
    "HCU_HVRequest": ["ContactorRequest"],
    "EMS_Status": ["EngineSpeed", "EngineTorque", "EngineState"],
    "TCU_Clutch": [
        "ClutchState",
        "ClutchTorqueCapacity",
        "ClutchTorqueTransmitted",
        "ClutchSlipSpeed",
    ],
    "TCU_Synchronizer": ["Gear", "SynchronizerState", "SleevePosition"],
    "ESC_WheelSpeeds": ["WheelSpeedFL", "WheelSpeedFR"],
    "ESC_WheelSpeedsRear": ["WheelSpeedRL", "WheelSpeedRR"],
    "ESC_Vehicle": ["VehicleSpeed", "LongitudinalAcceleration"],
    "BMS_Status": ["StateOfCharge", "BatteryVoltage", "BatteryCurrent", "ContactorState"],
    "BMS_Limits": ["ChargePowerLimit", "DischargePowerLimit"],
    "VEH_Driver": ["AcceleratorPedal", "BrakePedal", "SelectorPosition", "IgnitionState"],
    "EMU_PlantState": ["DrivingMode", "FaultsActive"],
}


def raw_of(signal: Any, physical: float) -> float:
    return (physical - signal.conversion.offset) / signal.conversion.scale  # type: ignore[no-any-return]


@pytest.mark.parametrize("name", PROMISED)
def test_promised_names(name: str) -> None:
    assert set(PROMISED[name]) <= {signal.name for signal in MESSAGES[name].signals}


def test_nodes() -> None:
    names = [node.name for node in DATABASE.nodes]
    assert names == ["HCU", "EMS", "MCU1", "MCU2", "TCU", "BMS", "ESC", "VEH", "EMU"]
    assert all(node.comment for node in DATABASE.nodes)
    assert all(
        message.senders[0] == message.name.partition("_")[0] for message in DATABASE.messages
    )


def test_signal_names_are_unique_and_short() -> None:
    names = [signal.name for message in DATABASE.messages for signal in message.signals]
    assert len(set(names)) == len(names)
    assert max(map(len, names)) <= 32


def test_no_two_signals_share_a_bit() -> None:
    for message in DATABASE.messages:
        used: set[int] = set()
        for signal in message.signals:
            bits = set(range(signal.start, signal.start + signal.length))
            assert signal.byte_order == "little_endian"
            assert not used & bits
            assert max(bits) < 8 * message.length
            used |= bits


def test_everything_is_explained() -> None:
    for message in DATABASE.messages:
        assert message.comment
        for signal in message.signals:
            assert signal.comment, signal.name
            assert signal.comment.endswith("."), signal.name


@pytest.mark.parametrize(
    ("signal", "says"),
    [
        ("EM1Torque", "positive drives the car forward"),
        ("EM2TorqueRequest", "at the shaft of EM2, positive drives"),
        ("EngineTorque", "at the crankshaft after friction"),
        ("EM1DCPower", "positive consumes"),
        ("BatteryCurrent", "positive charges"),
        ("LongitudinalAcceleration", "without gravity"),
        ("LongitudinalAccelerationSensor", "with gravity"),
        ("EM1TorqueMin", "in control mode Speed"),
        ("ClutchTorqueTransmitted", "positive from the engine"),
    ],
)
def test_signs_are_told(signal: str, says: str) -> None:
    comments = [found.comment for _, found in PAYLOAD if found.name == signal]
    assert says in comments[0]


def test_identifiers_and_data_ids_are_unique() -> None:
    ids = [message.frame_id for message in DATABASE.messages]
    data_ids = [message.dbc.attributes["E2EDataID"].value for message in DATABASE.messages]
    assert len(set(ids)) == len(ids)
    assert len(set(data_ids)) == len(data_ids)
    assert all(not message.is_extended_frame and not message.is_fd for message in DATABASE.messages)


def test_requests_win_arbitration() -> None:
    requests = [m.frame_id for m in DATABASE.messages if m.senders == ["HCU"]]
    others = [m.frame_id for m in DATABASE.messages if m.senders != ["HCU"]]
    assert max(requests) < min(others)


def test_protection() -> None:
    definition = DATABASE.dbc.attribute_definitions["E2EProfile"]
    for message in DATABASE.messages:
        crc, counter = (message.get_signal_by_name(f"{message.name}_{end}") for end in PROTECTION)
        assert (crc.start, crc.length) == (0, 8)
        assert (counter.start, counter.length, counter.maximum) == (8, 4, 14)
        assert definition.choices[message.dbc.attributes["E2EProfile"].value] == "P11"
        assert message.length == 8


@pytest.mark.parametrize(("message", "signal"), PAYLOAD, ids=lambda item: item.name)
def test_not_available_lies_outside_the_range(message: Any, signal: Any) -> None:
    top = (1 << signal.length) - 1
    assert not signal.is_signed
    assert signal.choices[top] == "NotAvailable"
    assert [raw for raw, label in signal.choices.items() if label == "NotAvailable"] == [top]
    assert raw_of(signal, signal.minimum) == 0
    assert raw_of(signal, signal.maximum) <= top - 1 + 1e-6


def test_units_are_known_and_present() -> None:
    counts = {"FaultsActive", "RequestsFailed", "RejectedFrames"}
    counts |= {"TroubleCodesActive", "TroubleCodesConfirmed"}
    for _, signal in PAYLOAD:
        if len(signal.choices) > 1 or signal.name in counts:
            assert signal.unit is None, signal.name
        else:
            assert unit(signal.unit).dimension, signal.name


def test_value_tables() -> None:
    for _, signal in PAYLOAD:
        labels = [str(label) for label in signal.choices.values() if label != "NotAvailable"]
        if labels:
            assert len(set(labels)) == len(labels)
            codes = sorted(raw for raw in signal.choices)[:-1]
            assert codes == list(range(len(labels)))
            assert signal.maximum == codes[-1]


def test_initial_values() -> None:
    for message, signal in PAYLOAD:
        if message.senders != ["HCU"]:
            assert signal.raw_initial == (1 << signal.length) - 1, signal.name
    requests = {signal.name: signal for message, signal in PAYLOAD if message.senders == ["HCU"]}
    idle = {name for name, signal in requests.items() if signal.initial == 0}
    bounds = {"EM1TorqueMin", "EM1TorqueMax", "EM2TorqueMin", "EM2TorqueMax"}
    codes = {"EM1ControlMode": "Off", "EM2ControlMode": "Off", "EngineRunRequest": "Stop"}
    codes |= {"GearRequest": "Neutral", "ContactorRequest": "Open"}
    assert {name: str(requests[name].initial) for name in codes} == codes
    assert {str(requests[name].initial) for name in bounds} == {"NotAvailable"}
    assert idle == set(requests) - bounds - set(codes)


@pytest.mark.parametrize(
    ("signal", "step", "low", "high"),
    [
        ("EM1Speed", 0.25, -8000, 16000),
        ("EM2SpeedRequest", 0.5, -8000, 16000),
        ("EngineSpeed", 0.25, 0, 8000),
        ("WheelSpeedRR", 0.01, -50, 300),
        ("EM2Torque", 0.1, -800, 800),
        ("EngineTorqueRequest", 0.1, -100, 400),
        ("BatteryCurrent", 0.1, -800, 800),
        ("StateOfCharge", 0.01, 0, 100),
        ("SleevePosition", 0.01, -15, 15),
    ],
)
def test_resolution_and_range(signal: str, step: float, low: float, high: float) -> None:
    (found,) = [found for _, found in PAYLOAD if found.name == signal]
    assert found.conversion.scale <= step
    assert found.minimum <= low
    assert found.maximum >= high


def test_periods() -> None:
    for message in DATABASE.messages:
        assert message.cycle_time in (10, 20, 50, 100)
        assert message.send_type == "Cyclic"
        if message.name.endswith("Request") and message.name != "HCU_HVRequest":
            assert message.cycle_time == 10
    assert MESSAGES["ESC_WheelSpeeds"].cycle_time == 10


def test_bus_load() -> None:
    """Without stuff bits 111 bits a frame, with the most possible 135, the gap of 3 included."""
    frames = sum(1000.0 / message.cycle_time for message in DATABASE.messages)
    assert DATABASE.dbc.attributes["Baudrate"].value == 500_000
    assert frames * 111 / 500_000 < 0.48
    assert frames * 135 / 500_000 < 0.60


def test_start_delays_spread_the_load() -> None:
    due = [0] * 100
    for message in DATABASE.messages:
        delay = message.dbc.attributes["GenMsgStartDelayTime"].value
        if message.senders != ["HCU"]:
            for at in range(delay, 100, message.cycle_time):
                due[at] += 1
    assert max(due) <= 2
