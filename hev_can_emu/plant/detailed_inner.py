"""One inner step of the detailed plant: every machine once, then driveline, DC link and oil.

Machines take speeds, pressures and voltage from the step's beginning and give what holds over it, C1 by
what is foreseen for its middle; the driveline moves exactly under that; then each machine's energy is
taken over the angle really travelled, and the DC link gives what the drives took.  The coupling is of
first order in the step, each part of the order its own page tells.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import inlined_kernel, kernel
from hev_can_emu.plant import (
    combustion,
    dc_link,
    hydraulics,
    ledger,
    pmsm,
    road,
    shifting,
    teeth,
    tyre,
    wet_clutch,
)
from hev_can_emu.plant import detailed_layout as lay
from hev_can_emu.plant import electric_drive as drive
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.driveline import lock_torque
from hev_can_emu.plant.holding import HELD
from hev_can_emu.plant.structure import (
    BODY,
    C1,
    EM1,
    EM2,
    ENGINE,
    G1,
    G2,
    LEFT,
    N_PORTS,
    REAR,
    RIGHT,
    ROAD,
)
from hev_can_emu.plant.teeth import TRAVEL
from hev_can_emu.plant.tyre import TyreSlip

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


@inlined_kernel
def machine_torque(
    p: Array,
    x: Array,
    request: float,
    gates: float,
    external: float,
    speed: float,
    link_voltage: float,
    x_thermal: Array,
    out: Array,
) -> float:
    """Return the torque that EM1 or EM2 gives over this step, N m; ``external`` is NaN, or what it gives."""
    if math.isnan(external):
        drive.drive_step(p, x, request, gates, speed, link_voltage, x_thermal[0], x_thermal[1], out)
        return float(out[pmsm.OUT_TORQUE])
    for i in range(drive.N_OUT):
        out[i] = 0.0
    x[pmsm.X_ID] = 0.0
    x[pmsm.X_IQ] = 0.0
    out[pmsm.OUT_TORQUE] = out[pmsm.OUT_AIR_GAP] = external
    out[drive.OUT_DC] = external * speed * p[pmsm.P_DT]
    return external


@inlined_kernel
def machine_energy(
    out: Array,
    gates: float,
    speed: float,
    step: float,
    travel: float,
    tick: Array,
    heat: int,
    shaft: int,
    dc: int,
) -> float:
    """Book a drive's step over the angle travelled; return what it took from the DC link, J.

    The machine saw a constant speed; what its shaft really turned more or less goes to shaft, losses
    and DC link (shorted: winding) alike, so that nothing is made or lost.
    """
    further = travel - speed * step
    taken = out[drive.OUT_DC]
    if gates == drive.SHORT:
        tick[heat] -= out[pmsm.OUT_AIR_GAP] * further
    else:
        taken += out[pmsm.OUT_AIR_GAP] * further
    tick[heat] += out[pmsm.OUT_COPPER]
    tick[heat + 1] += out[pmsm.OUT_IRON]
    tick[heat + 1] += (out[pmsm.OUT_AIR_GAP] - out[pmsm.OUT_TORQUE]) * further
    tick[heat + 2] += out[pmsm.OUT_DRAG]
    tick[heat + 3] += out[drive.OUT_INVERTER]
    tick[shaft] += out[pmsm.OUT_TORQUE] * travel
    tick[dc] += taken
    return float(taken)


@inlined_kernel
def engine_torque(
    p: Array, x: Array, hold: Array, external: float, speed: float, angle: float, out: Array
) -> float:
    """Return the combustion engine's torque over this step, N m, pistons' inertia apart."""
    if math.isnan(external):
        combustion.combustion_step(
            p, x, hold[lay.H_ENGINE], hold[lay.H_RUN], 1.0, speed, angle, out
        )
        return float(out[source.OUT_TORQUE])
    for i in range(combustion.N_OUT):
        out[i] = 0.0
    out[source.OUT_TORQUE] = external
    return external


@inlined_kernel
def engine_energy(
    p: Array,
    out: Array,
    external: float,
    travel: float,
    energy: Array,
    tick: Array,
    x: Array,
) -> None:
    """Book the engine's step over the angle travelled; ``x`` is the plant's state (fuel, ripple)."""
    if not math.isnan(external):
        tick[ledger.L_EXTERNAL] += external * travel
        tick[ledger.L_ENGINE_SHAFT] += external * travel
        return
    combustion.combustion_energy(p, out, travel, energy)
    tick[ledger.L_FUEL] += energy[combustion.J_FUEL]
    tick[ledger.L_WALL] += energy[combustion.J_WALL]
    tick[ledger.L_EXHAUST] += energy[combustion.J_EXHAUST]
    tick[ledger.L_ENGINE_DRAG] += energy[combustion.J_DRAG]
    tick[ledger.L_ENGINE_SHAFT] += energy[combustion.J_SHAFT]
    x[lay.X_GAS] -= energy[combustion.J_RIPPLE]
    x[lay.X_FUEL] += energy[combustion.M_FUEL]


@inlined_kernel
def shift(
    held: Array,
    speeds: Array,
    p: Array,
    x: Array,
    oil: Array,
    drive_x: Array,
    n: Integers,
    forces: Array,
    books: Array,
    kinetic: Array,
    static: Array,
    play: bool,
    out: Array,
) -> None:
    """Move the sleeve under the cylinder's force of the step before; its locks follow."""
    torque1 = torque2 = 0.0
    if n[HELD + G1] == 1:
        torque1 = lock_torque(held, drive_x, n, forces, G1)
    if n[HELD + G2] == 1:
        torque2 = lock_torque(held, drive_x, n, forces, G2)
    shifting.move_sleeve(
        p, x, oil[hydraulics.OUT_SHIFT_FORCE], oil[hydraulics.OUT_SHIFT_STIFFNESS],
        speeds[N_PORTS + G1], speeds[N_PORTS + G2],
        torque1, torque2, play, n, books, kinetic, static, out,
    )  # fmt: skip


@inlined_kernel
def capacities(
    clutch_p: Array,
    x_clutch: Array,
    force: float,
    piston: float,
    slip: float,
    oil_temperature: float,
    hold: Array,
    road_out: Array,
    n: Integers,
    clutch_out: Array,
    kinetic: Array,
    static: Array,
) -> None:
    """Write what C1, brakes and rolling resistance can carry; the gears' locks are the sleeve's.

    ``force`` presses C1's plates, ``piston`` is its travel.
    """
    external = hold[lay.H_CAPACITY]
    if math.isnan(external):
        wet_clutch.capacity_step(
            clutch_p, x_clutch, force, piston,
            wet_clutch.foreseen_slip(x_clutch, 0.0 if n[HELD + C1] == 1 else slip),
            oil_temperature, clutch_out,
        )  # fmt: skip
        kinetic[C1] = clutch_out[wet_clutch.OUT_KINETIC] + clutch_out[wet_clutch.OUT_DRAG]
        static[C1] = clutch_out[wet_clutch.OUT_STATIC]
    else:
        clutch_out[wet_clutch.OUT_KINETIC] = kinetic[C1] = external
        static[C1] = external
    kinetic[LEFT] = static[LEFT] = hold[lay.H_FRONT]
    kinetic[RIGHT] = static[RIGHT] = hold[lay.H_FRONT]
    rolling = road_out[road.OUT_ROLLING_CAPACITY]
    if kinetic.shape[0] > REAR:
        kinetic[BODY] = static[BODY] = rolling
        kinetic[REAR] = static[REAR] = 2.0 * hold[lay.H_REAR]
    else:
        kinetic[BODY] = static[BODY] = rolling + 2.0 * hold[lay.H_REAR]


@inlined_kernel
def link_and_battery(
    p: Array, x: Array, hold: Array, step: float, taken: float, out: Array, tick: Array, mean: Array
) -> None:
    """Let the DC link give what the loads took, J, and book it."""
    if not math.isnan(hold[lay.H_VOLTAGE]) and hold[lay.H_RESISTANCE] <= 0.0:
        # An external battery: its voltage is given.
        x[0] = hold[lay.H_VOLTAGE]
        tick[ledger.L_EXTERNAL] += taken
        mean[lay.M_CURRENT] += taken / max(hold[lay.H_VOLTAGE], 1.0)
        return
    auxiliary = hold[lay.H_AUXILIARY] * step
    dc_link.link_step(
        p, x, hold[lay.H_PHASE], hold[lay.H_VOLTAGE], hold[lay.H_RESISTANCE],
        taken + auxiliary, out,
    )  # fmt: skip
    tick[ledger.L_AUXILIARY] += auxiliary
    tick[ledger.L_BATTERY] += out[dc_link.OUT_SOURCE]
    tick[ledger.L_BATTERY_RESISTANCE] += out[dc_link.OUT_RESISTANCE]
    tick[ledger.L_LINK_DISCHARGE] += out[dc_link.OUT_DISCHARGE]
    tick[ledger.L_REFUSED] += out[dc_link.OUT_REFUSED]
    mean[lay.M_CURRENT] += out[dc_link.OUT_CURRENT] * step


@inlined_kernel
def book_oil(out: Array, tick: Array) -> None:
    """Book the hydraulics' step."""
    tick[ledger.L_PUMP] += out[hydraulics.OUT_PUMP_WORK]
    for i in range(hydraulics.OUT_STEP_LOSS - hydraulics.OUT_PUMP_LOSS + 1):
        tick[ledger.L_OIL + i] += out[hydraulics.OUT_PUMP_LOSS + i]


@inlined_kernel
def book_road(road_out: Array, travel: float, tick: Array, x: Array) -> None:
    """Book air drag and height over the body's travel, rad at the wheel."""
    tick[ledger.L_AIR] -= road_out[road.OUT_AIR_TORQUE] * travel
    tick[ledger.L_ROAD_SHAFT] += road_out[road.OUT_BODY_TORQUE] * travel
    x[lay.X_HEIGHT] -= road_out[road.OUT_GRADE_TORQUE] * travel


@inlined_kernel
def turned(books: Array, port: int) -> float:
    """Return what a port turned in the step just over, rad."""
    return float(books[TRAVEL + port])


ENGINE_PORT, EM1_PORT, EM2_PORT, ROAD_PORT = ENGINE, EM1, EM2, ROAD


@kernel
def slip_tyres(tyres: TyreSlip | None, middle: int, x: Array, n: Integers, work: Array) -> None:
    """Let the tyres creep after the driveline's step, and book it; ``middle`` of the extras."""
    if tyres is not None:
        first = lay.X_BOOKS + teeth.DAMPERS
        work[lay.W_TICK + ledger.L_TYRES] += tyre.slip_tyres(
            tyres, x[lay.X_DRIVELINE :], n, x[first : lay.X_TYRES if middle > 0 else first],
            x[lay.X_TYRES : lay.X_DRIVELINE], work[lay.W_TYRES : lay.WORK],
        )  # fmt: skip


@kernel
def creep_acceleration(tyres: TyreSlip | None, radius: float, x: Array, n: Integers) -> float:
    """Return by how much the body gains less than its state says, m/s^2: what its tyres let slip."""
    gain = 0.0
    if tyres is not None and n[HELD + BODY] == 0:
        torque = tyre.creep_torque(tyres, x[lay.X_TYRES : lay.X_DRIVELINE])
        gain = radius * torque / tyres.parameters[0, tyre.P_BODY_INERTIA]
    return gain
