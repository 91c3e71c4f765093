"""From a car's parameters to a detailed plant that steps, the state to start from, and its ledger."""

from __future__ import annotations

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.errors import InputError
from hev_can_emu.plant import battery, contactors, hydraulics, ledger, thermal
from hev_can_emu.plant import detailed_layout as lay
from hev_can_emu.plant import powertrain as port
from hev_can_emu.plant.bank import build_bank
from hev_can_emu.plant.columns import aligned
from hev_can_emu.plant.detailed import observe, stored_energies
from hev_can_emu.plant.detailed_layout import DetailedPlant
from hev_can_emu.plant.detailed_parameters import DetailedParameters, Effects
from hev_can_emu.plant.driveline import N_SEEN
from hev_can_emu.plant.geared import geared
from hev_can_emu.plant.holding import N_INTEGERS, ROW, SIGN, row_of
from hev_can_emu.plant.ledger import Ledger, make_ledger
from hev_can_emu.plant.machines import Machines
from hev_can_emu.plant.start import Start
from hev_can_emu.plant.teeth import N_LOCKS, build_extras, parting
from hev_can_emu.plant.tyre import build_tyre_slip
from hev_can_emu.plant.vehicle import DrivelineParameters

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

LEVELS = 6  #: halvings of the inner step at events: below 1 us from 50 us
SUPPLY_PRESSURE = 5e6  #: of the accumulator at the start, Pa


def build_detailed(
    parameters: DrivelineParameters,
    machines: Machines,
    finer: DetailedParameters,
    effects: Effects | None = None,
) -> DetailedPlant:
    """Prepare all propagators and pack the machines' parameters (about half a second).

    Raises:
        InputError: an effect that cannot be, or parameters that do not fit each other.
    """
    effects = effects or Effects()
    effects.validate("effects")
    step = effects.step_ns * 1e-9
    rear = finer.rear_axle if effects.rear_wheels else None
    finer.rear_axle.check_fits(parameters.inertias["Jv"], "detailed.rear_axle")
    structure = geared(parameters, rear)
    mesh_play = finer.mesh_play if effects.mesh_play is None else effects.mesh_play
    bank = build_bank(
        structure, step, LEVELS, travel=True, dampers=effects.damper_work,
        open_branches=parting(structure, mesh_play),
    )  # fmt: skip
    pistons = finer.engine.crank.pack() if effects.pistons else np.zeros(0)
    ripple = finer.firing_ripple if effects.firing_ripple is None else effects.firing_ripple
    if ripple and finer.engine.pulses is None:
        raise InputError("effects.firing_ripple", "false for an engine without pulses", "true")
    combustion = finer.engine if ripple else msgspec.structs.replace(finer.engine, pulses=None)
    clutch_wear = finer.transmission.clutch_wear if effects.wear is None else effects.wear
    radius = parameters.tyre_radius
    car = np.zeros(lay.N_CAR)
    car[lay.CAR_RADIUS] = radius
    car[lay.CAR_COOLING] = finer.transmission.clutch_cooling
    car[lay.CAR_PLAY] = 1.0 if effects.dog_play else 0.0
    return DetailedPlant(
        bank=bank,
        extras=build_extras(structure, bank, pistons, mesh_play, effects.damper_work),
        engine=combustion.pack(step),
        em1=finer.em1.pack(step),
        em2=finer.em2.pack(step),
        control1=machines.em1.speed_control.pack(),
        control2=machines.em2.speed_control.pack(),
        battery=machines.battery.pack(),
        contactors=machines.contactors.pack(),
        link=finer.dc_link.pack(step),
        thermal1=machines.em1.thermal.pack(),
        thermal2=machines.em2.thermal.pack(),
        brakes=machines.brakes.pack(),
        road=machines.road.pack(parameters.inertias["Jv"] / radius**2, radius),
        hydraulics=finer.hydraulics.pack(step),
        fine_hydraulics=finer.hydraulics.pack(step / hydraulics.PARTS),
        clutch=finer.clutch.pack(step, clutch_wear),
        sleeve=finer.sleeve.pack(step),
        coolant=machines.engine_coolant.pack(),
        car=car,
        tyres=build_tyre_slip(
            structure, finer.tyre_slip if effects.tyre_slip else None, radius, step
        ),
        steps=1_000_000 // effects.step_ns,
        step_ns=effects.step_ns,
    )


def start_detailed(plant: DetailedPlant, start: Start) -> tuple[Array, Integers, Array]:
    """Return the float64 state, the int64 state and the truth at the start."""
    x = aligned(lay.state_size(plant.bank))
    n = np.zeros(N_INTEGERS, dtype=np.int64)
    n[SIGN : SIGN + N_LOCKS] = 1
    n[ROW] = row_of(n, plant.extras)  # teeth of meshes with play stand apart
    x[lay.X_BATTERY + battery.X_SOC] = start.state_of_charge
    x[lay.X_BATTERY + battery.X_TEMPERATURE] = start.temperature
    for offset in (lay.X_THERMAL1, lay.X_THERMAL2):
        x[offset + thermal.X_WINDING] = x[offset + thermal.X_INVERTER] = start.temperature
    x[lay.X_COOLANT] = x[lay.X_CLUTCH] = start.temperature
    limits = np.zeros(battery.N_LIM)
    battery.battery_limits(plant.battery, x[lay.X_BATTERY : lay.X_CONTACTORS], limits)
    voltage = float(limits[battery.LIM_OCV])
    if start.closed:
        x[lay.X_CONTACTORS + contactors.X_PHASE] = contactors.CLOSED
        x[lay.X_LINK] = voltage
    hydraulics.hydraulics_start(plant.hydraulics, x[lay.X_OIL : lay.X_CLUTCH], SUPPLY_PRESSURE)
    y = np.zeros(len(port.TRUTH))
    y[port.Y_BATTERY_VOLTAGE] = voltage
    y[port.Y_CONTACTOR_PHASE] = x[lay.X_CONTACTORS + contactors.X_PHASE]
    y[port.Y_AMBIENT] = start.temperature
    y[port.Y_SUPPLY_PRESSURE] = SUPPLY_PRESSURE
    observe(plant, x, n, np.zeros(len(plant.bank.speed_at)), y, np.zeros(N_SEEN))
    stored_energies(plant, x, n, x[lay.X_START : lay.X_BOOKS])
    return x, n, y


def read_ledger(plant: DetailedPlant, x: Array, n: Integers) -> Ledger:
    """Return the energy ledger since the start."""
    stored = np.zeros(ledger.N_STORED)
    stored_energies(plant, x, n, stored)
    return make_ledger(
        x[lay.X_LEDGER : lay.X_START],
        stored - x[lay.X_START : lay.X_BOOKS],
        float(x[lay.X_FUEL]),
    )
