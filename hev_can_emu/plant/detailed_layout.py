"""Layout of the detailed plant: its constants, its state, and the scratch that a tick needs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel
from hev_can_emu.plant import (
    battery,
    brakes,
    combustion,
    contactors,
    dc_link,
    driveline,
    electric_drive,
    freewheel,
    hydraulics,
    ledger,
    power_allocation,
    road,
    shifting,
    sleeve,
    speed_control,
    teeth,
    thermal,
    tyre,
    wet_clutch,
)
from hev_can_emu.plant.bank import Bank
from hev_can_emu.plant.columns import filled_up
from hev_can_emu.plant.teeth import Extras
from hev_can_emu.plant.tyre import TyreSlip

Array = npt.NDArray[np.float64]

# State: the machines' slices one after another, then books and driveline.
X_ENGINE = 0
X_EM1 = X_ENGINE + combustion.N_STATE
X_EM2 = X_EM1 + electric_drive.N_STATE
X_CONTROL1 = X_EM2 + electric_drive.N_STATE
X_CONTROL2 = X_CONTROL1 + speed_control.N_STATE
X_BATTERY = X_CONTROL2 + speed_control.N_STATE
X_CONTACTORS = X_BATTERY + battery.N_STATE
X_LINK = X_CONTACTORS + contactors.N_STATE
X_THERMAL1 = X_LINK + dc_link.N_STATE
X_THERMAL2 = X_THERMAL1 + thermal.N_STATE
X_COOLANT = X_THERMAL2 + thermal.N_STATE
X_BRAKES = X_COOLANT + 1
X_OIL = X_BRAKES + brakes.N_STATE
X_CLUTCH = X_OIL + hydraulics.N_STATE
X_SYNC = X_CLUTCH + wet_clutch.N_STATE
X_BOUNDS = X_SYNC + shifting.N_STATE  # published torques of EM1 and EM2: min, max each
X_FUEL = X_BOUNDS + 4  # burnt, kg
X_HEIGHT = X_FUEL + 1  # gravity's work against the car, J
X_GAS = X_HEIGHT + 1  # pressed into the cylinders by ripple, J
X_LEDGER = X_GAS + 1
X_START = X_LEDGER + ledger.N_TERMS  # what was stored at the start
X_BOOKS = X_START + ledger.N_STORED
X_TYRES = X_BOOKS + teeth.N_BOOKS  # slip speeds, rad/s
X_DRIVELINE = X_TYRES + tyre.N_TYRES

# Scratch.
W_TICK = 0  # the terms of this tick
W_ENGINE = W_TICK + ledger.N_TERMS
W_ENERGY = W_ENGINE + combustion.N_OUT
W_EM1 = W_ENERGY + combustion.N_ENERGY
W_EM2 = W_EM1 + electric_drive.N_OUT
W_LINK = W_EM2 + electric_drive.N_OUT
W_CLUTCH = W_LINK + dc_link.N_OUT
W_HEAT = W_CLUTCH + wet_clutch.N_OUT
W_OIL = W_HEAT + wet_clutch.N_HEAT
W_SYNC = W_OIL + hydraulics.N_OUT
W_BRAKES = W_SYNC + sleeve.N_OUT
W_ROAD = W_BRAKES + brakes.N_OUT
W_LIMITS = W_ROAD + road.N_OUT
W_POWER = W_LIMITS + battery.N_LIM
W_FORCES = W_POWER + power_allocation.N_OUT
W_KINETIC = W_FORCES + 12
W_STATIC = W_KINETIC + 8
W_HOLD = W_STATIC + 8
W_MEAN = W_HOLD + 16
W_SPEEDS = filled_up(W_MEAN + 8)
W_TRIAL = W_SPEEDS + 16
W_TYRES = W_TRIAL + driveline.TRIAL
WORK = W_TYRES + tyre.WORK

# What is held over a tick.
(
    H_REQUEST1, H_GATES1, H_REQUEST2, H_GATES2, H_ENGINE, H_RUN, H_PHASE, H_VOLTAGE, H_RESISTANCE,
    H_AUXILIARY, H_GRADE, H_FRONT, H_REAR, H_CAPACITY, H_EXTERNAL1, H_EXTERNAL2,
) = range(16)  # fmt: skip
# Sums over a tick: engine torque, shaft torques, link current from the source, cut by the battery.
M_ENGINE, M_EM1, M_EM2, M_CURRENT, M_CUT1, M_CUT2, M_DISCHARGE, M_CHARGE = range(8)

# Packed parameters of the car as a whole.
CAR_RADIUS, CAR_COOLING, CAR_PLAY, CAR_WEIGHT = 0, 1, 2, 3
N_CAR = 4

assert electric_drive.N_OUT > freewheel.N_OUT


class DetailedPlant(NamedTuple):
    """Constants: the driveline's bank and each machine's packed parameters.

    ``steps`` inner steps of ``step_ns`` make one tick of 1 ms.  Without ``tyres`` none slips, and the code
    for it is compiled away.
    """

    bank: Bank
    extras: Extras
    engine: Array
    em1: Array
    em2: Array
    control1: Array
    control2: Array
    battery: Array
    contactors: Array
    link: Array
    thermal1: Array
    thermal2: Array
    brakes: Array
    road: Array
    hydraulics: Array
    fine_hydraulics: Array
    clutch: Array
    sleeve: Array
    coolant: Array
    car: Array
    tyres: TyreSlip | None
    steps: int
    step_ns: int


@kernel
def state_size(bank: Bank) -> int:
    """Return the length of the float64 state."""
    return int(X_DRIVELINE + bank.inertia.shape[0] + bank.stiffness.shape[1])
