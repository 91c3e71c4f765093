"""The energy ledger of the detailed plant: every term integrated for itself, none as the remainder.

What comes in (sources), less what goes out as heat or into the air (sinks), less what is stored more
than at the start, is zero up to the quadrature of the dampers and rounding.  The kernels add to an
array of terms in each inner step; what is stored follows from the state.  Transfers between the
machines are told, too, but are no part of the sum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.plant.geared import REAR_BRANCH
from hev_can_emu.plant.structure import ALL_LOCKS, BRANCHES

Array = npt.NDArray[np.float64]

SOURCE, SINK, STORED, TRANSFER = "source", "sink", "stored", "transfer"

DAMPED = (*(f"k{name}" for name, *_ in BRANCHES), REAR_BRANCH)

_LOCK_HEAT = {
    "c1": "C1, plates and oil film",
    "g1": "cone and dogs of G1",
    "g2": "cone and dogs of G2",
    "brake_left": "brake, front left",
    "brake_right": "brake, front right",
    "body": "rolling resistance",
    "brake_rear": "brakes, rear",
}

# Order: sources, sinks, transfers; stored terms are a table of their own.
_TERMS: tuple[tuple[str, str, str], ...] = (
    ("fuel", SOURCE, "heating value of the fuel burnt"),
    ("battery", SOURCE, "open-circuit voltage times current"),
    ("pump", SOURCE, "shaft of the oil pump"),
    ("external", SOURCE, "torques and voltage that external units report"),
    ("refused", SOURCE, "taken from an empty DC link"),
    ("wall", SINK, "engine: combustion heat into the coolant"),
    ("exhaust", SINK, "engine: heat in the exhaust"),
    ("engine_drag", SINK, "engine: friction and pumping"),
    ("battery_resistance", SINK, "battery and precharge resistance"),
    ("link_discharge", SINK, "discharge and bleed resistors"),
    ("auxiliary", SINK, "low-voltage supply"),
    ("em1_copper", SINK, "EM1: winding"),
    ("em1_iron", SINK, "EM1: iron"),
    ("em1_drag", SINK, "EM1: bearings and air"),
    ("em1_inverter", SINK, "EM1: inverter"),
    ("em2_copper", SINK, "EM2: winding"),
    ("em2_iron", SINK, "EM2: iron"),
    ("em2_drag", SINK, "EM2: bearings and air"),
    ("em2_inverter", SINK, "EM2: inverter"),
    *((f"friction_{name}", SINK, f"friction: {_LOCK_HEAT[name]}") for name in ALL_LOCKS),
    *((f"damper_{name[1:]}", SINK, f"damper beside {name}") for name in DAMPED),
    ("locks", SINK, "dropped where locks catch"),
    ("dogs", SINK, "blows of the dogs"),
    ("meshes", SINK, "parting teeth of meshes with play"),
    ("air", SINK, "air drag"),
    ("pump_loss", SINK, "pump: leakage and friction"),
    ("relief", SINK, "relief valve"),
    ("clutch_valve", SINK, "valve of C1"),
    ("shift_valve1", SINK, "shift valve towards G1"),
    ("shift_valve2", SINK, "shift valve towards G2"),
    ("seal", SINK, "seals of the clutch piston"),
    ("piston_stop", SINK, "stop of the clutch piston"),
    ("oil_step", SINK, "taken by implicit Euler from oil and springs within a step"),
    ("sleeve_damping", SINK, "sleeve: guide, seals, oil"),
    ("sleeve_friction", SINK, "sleeve: dry friction"),
    ("sleeve_stops", SINK, "sleeve: blows"),
    ("sleeve_chamfers", SINK, "sleeve: chamfers' torque held while they turn"),
    ("sleeve_lag", SINK, "sleeve: shift force foreseen, less what the oil gave"),
    ("tyres", SINK, "tyres: slip on the road"),
    ("engine_shaft", TRANSFER, "combustion engine to crank, pistons' inertia apart"),
    ("em1_shaft", TRANSFER, "EM1 to its shaft"),
    ("em2_shaft", TRANSFER, "EM2 to its shaft"),
    ("em1_dc", TRANSFER, "DC link to EM1's inverter"),
    ("em2_dc", TRANSFER, "DC link to EM2's inverter"),
    ("road_shaft", TRANSFER, "air and grade to the body"),
)
TERMS = tuple(name for name, *_ in _TERMS)
N_TERMS = len(TERMS)
PLACE = {name: index for index, name in enumerate(TERMS)}

L_FUEL, L_BATTERY, L_PUMP = PLACE["fuel"], PLACE["battery"], PLACE["pump"]
L_EXTERNAL, L_REFUSED = PLACE["external"], PLACE["refused"]
L_WALL, L_EXHAUST, L_ENGINE_DRAG = PLACE["wall"], PLACE["exhaust"], PLACE["engine_drag"]
L_BATTERY_RESISTANCE = PLACE["battery_resistance"]
L_LINK_DISCHARGE, L_AUXILIARY = PLACE["link_discharge"], PLACE["auxiliary"]
L_EM1, L_EM2 = PLACE["em1_copper"], PLACE["em2_copper"]  # copper, iron, drag, inverter
L_FRICTION, L_DAMPER = PLACE["friction_c1"], PLACE["damper_1"]
L_LOCKS, L_DOGS, L_MESHES = PLACE["locks"], PLACE["dogs"], PLACE["meshes"]
L_AIR, L_OIL = PLACE["air"], PLACE["pump_loss"]  # oil: in the order of the hydraulics' outputs
L_SLEEVE = PLACE["sleeve_damping"]  # in the order of shifting.N_LOSS
L_TYRES = PLACE["tyres"]
L_ENGINE_SHAFT, L_EM1_SHAFT, L_EM2_SHAFT = range(PLACE["engine_shaft"], PLACE["em1_dc"])
L_EM1_DC, L_EM2_DC, L_ROAD_SHAFT = PLACE["em1_dc"], PLACE["em2_dc"], PLACE["road_shaft"]

_STORED: tuple[tuple[str, str], ...] = (
    ("kinetic", "rotation of all inertias, the body's motion among them"),
    ("elastic", "shafts, meshes, tyres"),
    ("pistons", "reciprocating parts beyond their mean"),
    ("gas", "gas pressed in the cylinders (ripple)"),
    ("height", "the car on the slope"),
    ("em1_magnetic", "field of EM1"),
    ("em2_magnetic", "field of EM2"),
    ("link", "DC link"),
    ("oil", "accumulator, chambers, springs of C1"),
    ("sleeve", "sleeve: motion and detents"),
)
STORED_TERMS = tuple(name for name, _ in _STORED)
N_STORED = len(STORED_TERMS)
(
    S_KINETIC, S_ELASTIC, S_PISTONS, S_GAS, S_HEIGHT, S_EM1, S_EM2, S_LINK, S_OIL, S_SLEEVE,
) = range(N_STORED)  # fmt: skip


class Term(NamedTuple):
    """One line: ``kind`` is source, sink, stored (more than at the start) or transfer; J."""

    name: str
    kind: str
    energy: float
    text: str


class Ledger(NamedTuple):
    """All terms since the start.

    Attributes:
        terms: sources, sinks, transfers, stored.
        fuel: burnt, kg.
    """

    terms: tuple[Term, ...]
    fuel: float

    def total(self, kind: str) -> float:
        """Return the sum of one kind, J."""
        return sum(term.energy for term in self.terms if term.kind == kind)

    @property
    def residue(self) -> float:
        """Sources less sinks less what is stored, J: what does not close."""
        return self.total(SOURCE) - self.total(SINK) - self.total(STORED)

    @property
    def moved(self) -> float:
        """Energy moved, J: half the sum of the sizes of all terms of the balance."""
        return 0.5 * sum(abs(term.energy) for term in self.terms if term.kind != TRANSFER)

    def __getitem__(self, name: str) -> float:  # type: ignore[override]
        """Return a term's energy by its name, J; KeyError for none such."""
        for term in self.terms:
            if term.name == name:
                return term.energy
        raise KeyError(name)


def make_ledger(terms: Array, stored: Array, fuel: float) -> Ledger:
    """Return the ledger from the kernels' arrays, shapes (N_TERMS,) and (N_STORED,) (changes)."""
    lines = [
        Term(name, kind, float(terms[index]), text)
        for index, (name, kind, text) in enumerate(_TERMS)
    ]
    lines += [
        Term(name, STORED, float(stored[index]), text) for index, (name, text) in enumerate(_STORED)
    ]
    return Ledger(tuple(lines), fuel)
