"""From a car's parameters to a plant that steps: packed constants, and the state to start from."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant import battery, contactors, driveline, powertrain, thermal
from hev_can_emu.plant.bank import Bank, build_bank
from hev_can_emu.plant.columns import aligned
from hev_can_emu.plant.machines import Machines
from hev_can_emu.plant.powertrain import Plant
from hev_can_emu.plant.reduction import reduced
from hev_can_emu.plant.start import Start
from hev_can_emu.plant.structure import Structure, full_order
from hev_can_emu.plant.teeth import N_LOCKS
from hev_can_emu.plant.vehicle import DrivelineParameters


def driveline_structure(
    parameters: DrivelineParameters, model: str, reduction: str = "load-weighted"
) -> Structure:
    """Return the structure of ``4dof`` or ``16dof``; raises ValueError for another model."""
    if model == "16dof":
        return full_order(parameters)
    if model == "4dof":
        return reduced(parameters, reduction)
    raise ValueError(f"model: expected 4dof or 16dof, got {model!r}")


def build_plant(parameters: DrivelineParameters, machines: Machines, structure: Structure) -> Plant:
    """Prepare all propagators (about 50 ms for the full model) and pack the machines' parameters."""
    bank: Bank = build_bank(structure, powertrain.PERIOD)
    radius = parameters.tyre_radius
    mass = parameters.inertias["Jv"] / radius**2
    shorted1, shorted2 = machines.em1.short_circuit, machines.em2.short_circuit
    car = np.array(
        [
            radius,
            shorted1.peak_torque,
            shorted1.speed,
            shorted2.peak_torque,
            shorted2.speed,
        ]
    )
    return Plant(
        bank=bank,
        engine=machines.engine.pack(),
        em1=machines.em1.motor.pack(),
        em2=machines.em2.motor.pack(),
        control1=machines.em1.speed_control.pack(),
        control2=machines.em2.speed_control.pack(),
        battery=machines.battery.pack(),
        contactors=machines.contactors.pack(),
        thermal1=machines.em1.thermal.pack(),
        thermal2=machines.em2.thermal.pack(),
        brakes=machines.brakes.pack(),
        road=machines.road.pack(mass, radius),
        synchronizer=machines.synchronizer.pack(),
        clutch=machines.clutch.pack(),
        coolant=machines.engine_coolant.pack(),
        car=car,
    )


def start_state(
    plant: Plant, start: Start
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the float64 state, the int64 state and the truth at the start."""
    x = aligned(powertrain.state_size(plant.bank))
    n = np.zeros(driveline.N_INTEGERS, dtype=np.int64)
    n[driveline.SIGN : driveline.SIGN + N_LOCKS] = 1
    x[powertrain.X_BATTERY + battery.X_SOC] = start.state_of_charge
    x[powertrain.X_BATTERY + battery.X_TEMPERATURE] = start.temperature
    for offset in (powertrain.X_THERMAL1, powertrain.X_THERMAL2):
        x[offset + thermal.X_WINDING] = x[offset + thermal.X_INVERTER] = start.temperature
    x[powertrain.X_COOLANT] = start.temperature
    limits = np.zeros(battery.N_LIM)
    battery.battery_limits(
        plant.battery, x[powertrain.X_BATTERY : powertrain.X_BATTERY + battery.N_STATE], limits
    )
    voltage = float(limits[battery.LIM_OCV])
    if start.closed:
        x[powertrain.X_CONTACTORS + contactors.X_PHASE] = contactors.CLOSED
        x[powertrain.X_CONTACTORS + contactors.X_LINK_VOLTAGE] = voltage
    y = np.zeros(len(powertrain.TRUTH))
    y[powertrain.Y_BATTERY_VOLTAGE] = voltage
    y[powertrain.Y_LINK_VOLTAGE] = x[powertrain.X_CONTACTORS + contactors.X_LINK_VOLTAGE]
    y[powertrain.Y_CONTACTOR_PHASE] = x[powertrain.X_CONTACTORS + contactors.X_PHASE]
    y[powertrain.Y_AMBIENT] = start.temperature
    powertrain.observe(
        plant, x, n, np.zeros(len(plant.bank.speed_at)), y, np.zeros(driveline.N_SEEN)
    )
    return x, n, y
