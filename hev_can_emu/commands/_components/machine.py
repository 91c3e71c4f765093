"""EM1 and EM2: where their currents go, and the textbook machine with its known corner values."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.plant import operating_points as points
from hev_can_emu.plant import torque_map
from hev_can_emu.plant.electric_drive import DriveParameters
from hev_can_emu.plant.pmsm import PmsmParameters
from hev_can_emu.report import style
from hev_can_emu.report.component_plot import Curve, Fact, Panel

# A machine with round values, and what its equations give for 400 A and 200 V RMS.
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
CURRENT, VOLTAGE = 400.0 * math.sqrt(2.0), 200.0 * math.sqrt(2.0)
MTPA_D, MTPA_Q, MTPA_TORQUE = -305.309, 476.221, 339.5916
CORNER_IDEAL, CORNER = 2057.75, 2033.66
MTPV_ENTRY, MTPV_D, MTPV_Q, MTPV_TORQUE = 6556.9, -547.17, 143.55, 118.468

_RPM = 30.0 / math.pi


def _changed(flux: float, resistance: float) -> PmsmParameters:
    values = {name: getattr(BOOK, name) for name in BOOK.__struct_fields__}
    return PmsmParameters(**{**values, "flux": flux, "resistance": resistance})


IDEAL = _changed(0.07, 0.0)
WEAK = _changed(0.05, 0.0)


def locus(machine: PmsmParameters, speeds: np.ndarray) -> np.ndarray:
    """Return i_d, i_q, torque of the most torque at electrical speeds, shape (len(speeds), 3)."""
    return np.array([points.most_torque(machine, CURRENT, VOLTAGE / speed) for speed in speeds])


def _plane() -> Panel:
    corner = points.corner_speed(WEAK, CURRENT, VOLTAGE)
    entry = points.voltage_limit_entry(WEAK, CURRENT, VOLTAGE)
    mtpa = np.array([points.most_torque_per_ampere(WEAK, c) for c in np.linspace(0.0, CURRENT, 60)])
    weak = locus(WEAK, np.linspace(corner, entry, 120))
    beyond = locus(WEAK, np.geomspace(entry, 8.0 * entry, 120))
    circle = np.linspace(0.5 * math.pi, math.pi, 90)
    curves = [
        Curve("MTPA", mtpa[:, 0], mtpa[:, 1]),
        Curve("field weakening", weak[:, 0], weak[:, 1]),
        Curve("MTPV", beyond[:, 0], beyond[:, 1]),
        Curve("known: MTPV entry", np.array([MTPV_D]), np.array([MTPV_Q]), marker="o"),
        Curve("", CURRENT * np.cos(circle), CURRENT * np.sin(circle), True, color=style.FAINT),
    ]
    for speed in (corner, 1.6 * corner, entry):
        angle = np.linspace(0.0, math.pi, 400)
        flux = VOLTAGE / speed
        i_d = (flux * np.cos(angle) - WEAK.flux) / WEAK.inductance_d
        i_q = flux * np.sin(angle) / WEAK.inductance_q
        inside = (i_d > -1.15 * CURRENT) & (i_d < 60.0) & (i_q < 1.05 * CURRENT)
        curves.append(Curve("", i_d[inside], i_q[inside], True, color=style.GRID))
    return Panel(
        "Most torque within 400 A and 200 V (RMS), magnets of 0.05 Wb",
        "i_d (A, peak)", "i_q (A, peak)", curves, equal=True,
    )  # fmt: skip


def _torque() -> Panel:
    speeds = np.linspace(200.0, 16000.0, 300)
    strong, weak = locus(IDEAL, speeds)[:, 2], locus(WEAK, speeds)[:, 2]
    return Panel(
        "Torque over electrical speed",
        "electrical speed (rad/s)",
        "torque (N m)",
        [
            Curve("0.07 Wb", speeds, strong),
            Curve("0.05 Wb: MTPV in the end", speeds, weak),
            Curve(
                "known",
                np.array([CORNER_IDEAL, MTPV_ENTRY]),
                np.array([MTPA_TORQUE, MTPV_TORQUE]),
                marker="o",
            ),
        ],
    )


def _envelope(name: str, drive: DriveParameters) -> Panel:
    packed = drive.limits.pack(drive.machine)
    voltage = min(math.sqrt(2.0) * drive.inverter.voltage_rms, 350.0 / math.sqrt(3.0))
    speeds = np.linspace(0.0, drive.limits.max_speed, 200)
    out = np.zeros(torque_map.N_LIM)
    rows = []
    for speed in speeds:
        torque_map.torque_limits(packed, speed, voltage, 350.0, 300.0, 300.0, out)
        rows.append((out[torque_map.LIM_TORQUE_MAX], out[torque_map.LIM_TORQUE_MIN]))
    found = np.array(rows)
    checked = np.linspace(50.0, 0.93 * drive.limits.fade_speed, 12)
    current = math.sqrt(2.0) * drive.limits.current_rms
    usable = drive.limits.voltage_margin * voltage
    solved = [
        points.most_torque_at(drive.machine, current, usable, drive.machine.pole_pairs * w, 1.0)[2]
        for w in checked
    ]
    return Panel(
        f"{name}: air-gap torque at 350 V",
        "speed (1/min)",
        "torque (N m)",
        [
            Curve("driving, from the table", speeds * _RPM, found[:, 0]),
            Curve("braking", speeds * _RPM, found[:, 1]),
            Curve("known: the solver's", checked * _RPM, np.array(solved), marker="."),
        ],
    )


def show(car: Car) -> Card:
    """Compute the card."""
    mtpa = points.most_torque_per_ampere(BOOK, CURRENT)
    entry = points.voltage_limit_entry(WEAK, CURRENT, VOLTAGE)
    mtpv = points.most_torque(WEAK, CURRENT, VOLTAGE / entry)
    facts = [
        Fact("MTPA at 400 A: i_d", "A", MTPA_D, mtpa.i_d, 2e-6),
        Fact("MTPA at 400 A: i_q", "A", MTPA_Q, mtpa.i_q, 2e-6),
        Fact("MTPA at 400 A: torque", "N m", MTPA_TORQUE, mtpa.torque, 2e-7),
        Fact(
            "corner without resistance", "rad/s", CORNER_IDEAL,
            points.corner_speed(IDEAL, CURRENT, VOLTAGE), 3e-6,
        ),
        Fact(
            "corner with 8 mOhm", "rad/s", CORNER, points.corner_speed(BOOK, CURRENT, VOLTAGE), 3e-6
        ),
        Fact("MTPV begins (0.05 Wb)", "rad/s", MTPV_ENTRY, entry, 1e-5),
        Fact("there: i_d", "A", MTPV_D, mtpv.i_d, 1e-5),
        Fact("there: i_q", "A", MTPV_Q, mtpv.i_q, 3e-5),
        Fact("there: torque", "N m", MTPV_TORQUE, mtpv.torque, 5e-6),
    ]  # fmt: skip
    panels = [
        _plane(), _torque(), _envelope("EM1", car.detailed.em1), _envelope("EM2", car.detailed.em2)
    ]  # fmt: skip
    return Card("EM1 and EM2: currents and torque", panels, facts)
