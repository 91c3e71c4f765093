"""The default car's drives as the tests use them: plausible for the class, not published anywhere."""

from __future__ import annotations

import math

from hev_can_emu.plant.current_control import CurrentControlParameters
from hev_can_emu.plant.dc_link import DcLinkParameters
from hev_can_emu.plant.electric_drive import DriveParameters
from hev_can_emu.plant.inverter import InverterParameters
from hev_can_emu.plant.pmsm import PmsmParameters
from hev_can_emu.plant.torque_map import TorqueMapParameters

CONTROL = CurrentControlParameters(period=1e-4, bandwidth=3000.0)

EM1 = DriveParameters(
    machine=PmsmParameters(
        pole_pairs=4.0,
        flux=0.052,
        inductance_d=1.5e-4,
        inductance_q=3.6e-4,
        resistance=0.016,
        copper_coefficient=0.00393,
        copper_reference=293.15,
        hysteresis=22.0,
        eddy=0.012,
        drag=0.05,
        windage=2e-7,
    ),
    inverter=InverterParameters(
        voltage_rms=160.0,
        overmodulation=0.0,
        fixed_loss=40.0,
        device_voltage=0.8,
        device_resistance=1.8e-3,
        switching_energy=2.5e-7,
        switching_frequency=10e3,
    ),
    control=CONTROL,
    limits=TorqueMapParameters(
        current_rms=206.0,
        voltage_margin=0.95,
        voltage_min=200.0,
        voltage_full=240.0,
        fade_speed=1204.0,
        max_speed=1256.0,
        winding_derate=413.15,
        winding_max=433.15,
        inverter_derate=358.15,
        inverter_max=373.15,
    ),
    slew_rate=20000.0,
)

EM2 = DriveParameters(
    machine=PmsmParameters(
        pole_pairs=4.0,
        flux=0.058,
        inductance_d=1.05e-4,
        inductance_q=2.6e-4,
        resistance=0.011,
        copper_coefficient=0.00393,
        copper_reference=293.15,
        hysteresis=25.0,
        eddy=0.01,
        drag=0.08,
        windage=2.5e-7,
    ),
    inverter=InverterParameters(
        voltage_rms=160.0,
        overmodulation=0.0,
        fixed_loss=50.0,
        device_voltage=0.8,
        device_resistance=1.2e-3,
        switching_energy=2.5e-7,
        switching_frequency=10e3,
    ),
    control=CONTROL,
    limits=TorqueMapParameters(
        current_rms=323.0,
        voltage_margin=0.95,
        voltage_min=200.0,
        voltage_full=240.0,
        fade_speed=1414.0,
        max_speed=1466.0,
        winding_derate=413.15,
        winding_max=433.15,
        inverter_derate=358.15,
        inverter_max=373.15,
    ),
    slew_rate=20000.0,
)

LINK = DcLinkParameters(
    capacitance=1.2e-3,
    precharge_resistance=30.0,
    discharge_resistance=300.0,
    bleed_resistance=50e3,
)

# The machine of the closed-form cases: 400 A and 200 V RMS.
BOOK = PmsmParameters(
    pole_pairs=4.0,
    flux=0.07,
    inductance_d=0.12e-3,
    inductance_q=0.28e-3,
    resistance=8e-3,
    copper_coefficient=0.0,
    copper_reference=293.15,
    hysteresis=0.0,
    eddy=0.0,
    drag=0.0,
    windage=0.0,
)
BOOK_CURRENT = 400.0 * math.sqrt(2.0)
BOOK_VOLTAGE = 200.0 * math.sqrt(2.0)
