"""The SI unit of each quantity of the plant's truth, from its name."""

from __future__ import annotations

_BY_NAME = {
    "vehicle_speed": "m/s",
    "acceleration": "m/s^2",
    "accelerometer": "m/s^2",
    "clutch_capacity": "N m",
    "shift_force": "N",
    "sleeve_position": "m",
    "clutch_slip": "rad/s",
    "sync_slip": "rad/s",
    "battery_current": "A",
    "battery_voltage": "V",
    "link_voltage": "V",
    "discharge_limit": "W",
    "charge_limit": "W",
    "ambient": "K",
    "energy_lost": "J",
}
_BY_ENDING = {
    "_speed": "rad/s",
    "_torque": "N m",
    "_setpoint": "N m",
    "_torque_min": "N m",
    "_torque_max": "N m",
    "_temperature": "K",
    "_power": "W",
    "_pressure": "Pa",
    "_flow": "m^3/s",
    "_current": "A",
    "_voltage": "V",
    "_force": "N",
}


def truth_unit(name: str) -> str:
    """Return the unit of ``name``; empty for a plain number: a share, a state, a gear."""
    if name in _BY_NAME:
        return _BY_NAME[name]
    return next((unit for ending, unit in _BY_ENDING.items() if name.endswith(ending)), "")
