"""The TCU of the detailed plant: from capacity and shift force to the currents of its valves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import hydraulic_control as control
from hev_can_emu.ecu.hydraulic_control import HydraulicControlParameters
from hev_can_emu.jit import kernel
from hev_can_emu.plant import powertrain as plant
from hev_can_emu.plant.detailed_parameters import DetailedParameters

Array = npt.NDArray[np.float64]

# State: the hydraulic control's, then its inputs and outputs.
X_INPUTS = control.N_STATE
X_OUTPUTS = X_INPUTS + control.N_IN
N_STATE = X_OUTPUTS + control.N_OUT

TUNING = HydraulicControlParameters(
    bandwidth=100.0,
    integral_time=0.15,
    integral_share=0.1,
    fill_share=0.92,
    touch_time=0.008,
    touch_margin=3e4,
    least_capacity=0.5,
    pressure_share=0.95,
    shift_bandwidth=4.0,
    least_force=20.0,
    standing_speed=0.01,
    speed_time=0.002,
    pump_on=4.2e6,
    pump_off=5.5e6,
)
"""Of the default car's hydraulics; docs/detailed/hydraulics.md has the step responses."""


class TransmissionUnit(NamedTuple):
    """Constants: packed parameters of the control, and the friction map that it believes."""

    control: Array
    clutch: Array


def build_unit(finer: DetailedParameters) -> TransmissionUnit:
    """Return the unit for a car's nominal hydraulics and clutch."""
    return TransmissionUnit(
        control=TUNING.pack(finer.hydraulics),
        clutch=finer.clutch.pack(1e-3, finer.transmission.clutch_wear),
    )


def start_unit(state: Array) -> None:
    """Set the unit's state, shape (N_STATE,), to open and at rest."""
    state[:] = 0.0
    control.control_start(state[: control.N_STATE], 0.0)


@kernel
def transmission_step(unit: TransmissionUnit, x: Array, truth: Array, command: Array) -> None:
    """Act once per tick.

    Args:
        unit: constants.
        x: state, shape (N_STATE,), changed in place.
        truth: the plant's, of the last period: pressures, slip, temperature, sleeve.
        command: capacity and shift force come in, currents and pump go out.
    """
    inputs = x[X_INPUTS:X_OUTPUTS]
    out = x[X_OUTPUTS:]
    capacity = command[plant.U_CLUTCH_CAPACITY]
    inputs[control.IN_CAPACITY] = capacity if capacity > 0.0 else 0.0
    inputs[control.IN_FORCE] = 0.0
    inputs[control.IN_SUPPLY] = truth[plant.Y_SUPPLY_PRESSURE]
    inputs[control.IN_CLUTCH] = truth[plant.Y_CLUTCH_PRESSURE]
    inputs[control.IN_SHIFT1] = truth[plant.Y_SHIFT_PRESSURE1]
    inputs[control.IN_SHIFT2] = truth[plant.Y_SHIFT_PRESSURE2]
    inputs[control.IN_SLIP] = truth[plant.Y_CLUTCH_SLIP]
    inputs[control.IN_TEMPERATURE] = truth[plant.Y_CLUTCH_TEMPERATURE]
    inputs[control.IN_SLEEVE] = truth[plant.Y_SLEEVE_POSITION]
    control.hydraulic_control_step(unit.control, x[: control.N_STATE], unit.clutch, inputs, out)
    command[plant.U_CLUTCH_CURRENT] = out[control.OUT_CURRENT_CLUTCH]
    command[plant.U_SHIFT_CURRENT1] = out[control.OUT_CURRENT_SHIFT1]
    command[plant.U_SHIFT_CURRENT2] = out[control.OUT_CURRENT_SHIFT2]
    command[plant.U_PUMP] = out[control.OUT_PUMP]
