"""The TCU of the detailed plant: from capacity, gear and shift force to the currents of its valves."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import hydraulic_control as control
from hev_can_emu.ecu import shift_control as shift
from hev_can_emu.jit import kernel
from hev_can_emu.plant import powertrain as plant

if TYPE_CHECKING:  # slow to import, and needed by the detailed plant only
    from hev_can_emu.ecu.transmission_file import TransmissionTuning
    from hev_can_emu.plant.detailed_parameters import DetailedParameters

Array = npt.NDArray[np.float64]

# State: the hydraulic control's, then its inputs and outputs; the shift control's, then its outputs.
X_INPUTS = control.N_STATE
X_OUTPUTS = X_INPUTS + control.N_IN
X_SHIFT = X_OUTPUTS + control.N_OUT
X_TOLD = X_SHIFT + shift.N_STATE
N_STATE = X_TOLD + shift.N_OUT


class TransmissionUnit(NamedTuple):
    """Constants: packed parameters of both controls, and the friction map that it believes."""

    control: Array
    clutch: Array
    shift: Array


def build_unit(
    finer: DetailedParameters, tuning: TransmissionTuning | None = None
) -> TransmissionUnit:
    """Return the unit for a car's nominal hydraulics and clutch; without ``tuning`` the default car's."""
    from hev_can_emu.ecu.transmission_file import TransmissionTuning

    tuning = tuning or TransmissionTuning()
    return TransmissionUnit(
        control=tuning.hydraulics.pack(finer.hydraulics),
        clutch=finer.clutch.pack(1e-3, finer.transmission.clutch_wear),
        shift=tuning.shift.pack(),
    )


def start_unit(state: Array) -> None:
    """Set the unit's state, shape (N_STATE,), to open and at rest."""
    state[:] = 0.0
    control.control_start(state[: control.N_STATE], 0.0)
    shift.shift_control_start(state[X_SHIFT:X_TOLD], 0.0, 0.0)


@kernel
def transmission_step(unit: TransmissionUnit, x: Array, truth: Array, command: Array) -> None:
    """Act once per tick.

    Args:
        unit: constants.
        x: state, shape (N_STATE,), changed in place.
        truth: the plant's, of the last period: pressures, slip, temperature, sleeve.
        command: capacity, gear and shift force come in, currents and pump go out.
    """
    inputs = x[X_INPUTS:X_OUTPUTS]
    out = x[X_OUTPUTS:X_SHIFT]
    gear, force = command[plant.U_GEAR], command[plant.U_SHIFT_FORCE]
    if not math.isnan(command[plant.U_EXTERNAL_GEAR]):
        gear = command[plant.U_EXTERNAL_GEAR]
        force = unit.shift[shift.P_MAX_FORCE]
    told = x[X_TOLD:N_STATE]
    slip = truth[plant.Y_SYNC_SLIP]
    shift.shift_control_step(
        unit.shift, x[X_SHIFT:X_TOLD], gear, force, truth[plant.Y_SLEEVE_POSITION], slip, slip,
        truth[plant.Y_SLEEVE_ZONE], truth[plant.Y_SYNC_TORQUE], told,
    )  # fmt: skip
    capacity = command[plant.U_CLUTCH_CAPACITY]
    inputs[control.IN_CAPACITY] = capacity if capacity > 0.0 else 0.0
    inputs[control.IN_FORCE] = told[shift.OUT_FORCE]
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


@kernel
def tell_shift(x: Array, truth: Array) -> None:
    """Enter phase and gear of the shift, which the unit alone knows, into the plant's truth."""
    told = x[X_TOLD:N_STATE]
    truth[plant.Y_SYNC_PHASE] = told[shift.OUT_PHASE]
    truth[plant.Y_GEAR] = told[shift.OUT_GEAR]
