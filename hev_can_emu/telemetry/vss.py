"""Which quantity goes out under which name of the COVESA Vehicle Signal Specification (VSS), in which unit.

Paths, data types and units are those of VSS 6 (Vehicle.Powertrain, Vehicle.Chassis, ...).  What VSS has
no name for is an *overlay*: EM1 and EM2 become the instances ``EM1`` and ``EM2`` of
``Vehicle.Powertrain.ElectricMotor`` (VSS knows places such as ``Front`` and ``Rear``, while both motors
sit in one gearbox here), and what it lacks altogether stands under ``Vehicle.Powertrain.HEV``.  The sources
are the statuses of the emulated control units, in SI; this module knows them by name only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

FLOAT, INTEGER, BOOLEAN, LABEL = "float", "int32", "boolean", "string"

_RPM = 30.0 / math.pi
_KELVIN = -273.15

MODES = (
    "TRANSITION", "SERIES", "PARALLEL_G1", "PARALLEL_G2",
    "ELECTRIC_NEUTRAL", "ELECTRIC_G1", "ELECTRIC_G2",
)  # fmt: skip
CLUTCH_STATES = ("OPEN", "SLIPPING", "LOCKED")
SYNCHRONIZER_STATES = (
    "NEUTRAL", "TRAVEL", "SYNCHRONISING", "INDEX", "ENGAGED",
    "DISENGAGING", "ABORTED", "BLOCKED_BY_TORQUE", "GRATING",
)  # fmt: skip
SELECTED = {0: 126, 1: -1, 2: 0, 3: 127}  # P, R, N, D as Transmission.SelectedGear has them


class Leaf(NamedTuple):
    """One signal that is published.

    Attributes:
        path: dotted name.
        source: name of the status port it comes from, SI.
        unit: as VSS writes it; empty for none.
        datatype: FLOAT, INTEGER, BOOLEAN or LABEL.
        gain, offset: value = gain * status + offset.
        digits: decimal places that are told; a change below is none.
        labels: of a LABEL, by code.
        codes: of an INTEGER whose codes differ from the status's: status to value.
        overlay: not a name of the catalogue.
    """

    path: str
    source: str
    unit: str = ""
    datatype: str = FLOAT
    gain: float = 1.0
    offset: float = 0.0
    digits: int = 2
    labels: tuple[str, ...] = ()
    codes: dict[int, int] | None = None
    overlay: bool = False

    @property
    def topic(self) -> str:
        """The path as levels of an MQTT topic."""
        return self.path.replace(".", "/")

    def value(self, status: float) -> float | int | bool | str | None:
        """Return what is told of a status; None where it is not available or has no name."""
        if math.isnan(status):
            return None
        if self.datatype == FLOAT:
            # Plus zero: a negative zero would be told as a change.
            return round(self.gain * status + self.offset, self.digits) + 0.0
        code = round(self.gain * status + self.offset)
        if self.datatype == BOOLEAN:
            return code != 0
        if self.datatype == LABEL:
            return self.labels[code] if 0 <= code < len(self.labels) else None
        return code if self.codes is None else self.codes.get(code)


def _motor(number: int) -> tuple[Leaf, ...]:
    path, source = f"Vehicle.Powertrain.ElectricMotor.EM{number}", f"em{number}"
    return (
        Leaf(f"{path}.Speed", f"{source}_speed", "rpm", INTEGER, _RPM, overlay=True),
        Leaf(f"{path}.Torque", f"{source}_torque", "Nm", INTEGER, overlay=True),
        Leaf(f"{path}.Power", f"{source}_dc_power", "kW", INTEGER, 1e-3, overlay=True),
        Leaf(
            f"{path}.Temperature", f"{source}_temperature", "Celsius",
            offset=_KELVIN, digits=1, overlay=True,
        ),
        Leaf(
            f"{path}.InverterTemperature", f"{source}_inverter_temperature", "Celsius",
            offset=_KELVIN, digits=1, overlay=True,
        ),
    )  # fmt: skip


def _wheel(row: int, side: str, source: str) -> Leaf:
    path = f"Vehicle.Chassis.Axle.Row{row}.Wheel.{side}.Speed"
    return Leaf(path, source, "km/h", gain=3.6)


_ENGINE = "Vehicle.Powertrain.CombustionEngine"
_BATTERY = "Vehicle.Powertrain.TractionBattery"
_GEARBOX = "Vehicle.Powertrain.Transmission"
_HEV = "Vehicle.Powertrain.HEV"

LEAVES: tuple[Leaf, ...] = (
    Leaf("Vehicle.Speed", "vehicle_speed", "km/h", gain=3.6),
    Leaf("Vehicle.IsMoving", "vehicle_speed", "", BOOLEAN, 50.0),
    Leaf("Vehicle.Acceleration.Longitudinal", "longitudinal_acceleration", "m/s^2"),
    Leaf("Vehicle.Exterior.AirTemperature", "ambient_temperature_actual", "Celsius", offset=_KELVIN),
    Leaf("Vehicle.Chassis.Accelerator.PedalPosition", "driver_accelerator", "percent", INTEGER, 100.0),
    Leaf("Vehicle.Chassis.Brake.PedalPosition", "driver_brake", "percent", INTEGER, 100.0),
    _wheel(1, "Left", "wheel_speed_fl"),
    _wheel(1, "Right", "wheel_speed_fr"),
    _wheel(2, "Left", "wheel_speed_rl"),
    _wheel(2, "Right", "wheel_speed_rr"),
    Leaf(f"{_ENGINE}.Speed", "engine_speed", "rpm", gain=_RPM, digits=0),
    Leaf(f"{_ENGINE}.IsRunning", "engine_speed", "", BOOLEAN),
    Leaf(f"{_ENGINE}.Torque", "engine_torque", "Nm", INTEGER),
    Leaf(
        f"{_ENGINE}.EngineCoolant.Temperature", "engine_coolant_temperature", "Celsius",
        offset=_KELVIN, digits=1,
    ),
    *_motor(1),
    *_motor(2),
    Leaf(f"{_BATTERY}.StateOfCharge.Current", "state_of_charge", "percent", gain=100.0),
    Leaf(f"{_BATTERY}.CurrentVoltage", "battery_voltage", "V", digits=1),
    Leaf(f"{_BATTERY}.CurrentCurrent", "battery_current", "A", digits=1),
    Leaf(f"{_BATTERY}.Temperature.Average", "battery_temperature", "Celsius", offset=_KELVIN, digits=1),
    Leaf(f"{_GEARBOX}.CurrentGear", "gear", "", INTEGER, codes={0: 0, 1: 1, 2: 2}),
    Leaf(f"{_GEARBOX}.SelectedGear", "driver_selector", "", INTEGER, codes=SELECTED),
    Leaf(f"{_GEARBOX}.ClutchEngagement", "clutch_state", "percent", gain=50.0, digits=0),
    Leaf(f"{_HEV}.DrivingMode", "driving_mode", "", LABEL, labels=MODES, overlay=True),
    Leaf(f"{_HEV}.Clutch.State", "clutch_state", "", LABEL, labels=CLUTCH_STATES, overlay=True),
    Leaf(f"{_HEV}.Clutch.Torque", "clutch_torque", "Nm", digits=1, overlay=True),
    Leaf(f"{_HEV}.Clutch.Capacity", "clutch_capacity", "Nm", digits=1, overlay=True),
    Leaf(f"{_HEV}.Clutch.Slip", "clutch_slip", "rpm", gain=_RPM, digits=0, overlay=True),
    Leaf(
        f"{_HEV}.Synchronizer.State", "synchronizer_state", "", LABEL,
        labels=SYNCHRONIZER_STATES, overlay=True,
    ),
    Leaf(f"{_HEV}.Synchronizer.Position", "sleeve_position", "mm", gain=1e3, overlay=True),
    Leaf(f"{_HEV}.BrakeTorque", "brake_torque", "Nm", digits=0, overlay=True),
    Leaf(f"{_HEV}.RequestsFailed", "requests_failed", "", INTEGER, overlay=True),
    Leaf(f"{_HEV}.FaultsActive", "faults_active", "", INTEGER, overlay=True),
)  # fmt: skip
