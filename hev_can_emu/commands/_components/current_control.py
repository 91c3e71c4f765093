"""The current controllers of EM1: a torque step, and a current step with its known pole."""

from __future__ import annotations

import math

import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.plant import current_control, electric_drive, inverter, pmsm
from hev_can_emu.plant.electric_drive import DriveParameters
from hev_can_emu.report.component_plot import Curve, Fact, Panel

LINK = 350.0  # V
STEPS = 60


def current_step(drive: DriveParameters, speed: float, d: float, q: float) -> np.ndarray:
    """Return the currents at the control instants after a step of the references, A.

    The machine steps a tenth of a control period at a time: only the controller's own law is left to see.
    """
    period = drive.control.period
    machine = drive.machine.pack(period / 10)
    control = drive.control.pack(drive.machine)
    legs = drive.inverter.pack(period)
    x, i, out = np.zeros(current_control.N_STATE), np.zeros(pmsm.N_STATE), np.zeros(pmsm.N_OUT)
    electrical = drive.machine.pole_pairs * speed
    angle, seen = 0.0, [(0.0, 0.0)]
    # First settle at no current, so that the back-EMF is held already.
    for step in range(STEPS):
        on = step >= STEPS // 2
        current_control.current_control_step(
            control, legs, x, d if on else 0.0, q if on else 0.0, i[0], i[1], electrical, angle, LINK
        )  # fmt: skip
        v_d, v_q = x[current_control.X_VD], x[current_control.X_VQ]
        for _ in range(10):
            pmsm.pmsm_step(machine, i, v_d, v_q, speed, drive.machine.resistance, 0.0, out)
        angle = (angle + electrical * period) % (2.0 * math.pi)
        seen.append((i[0], i[1]))
    return np.array(seen[STEPS // 2 :])


def torque_step(drive: DriveParameters, speed: float, torque: float) -> tuple[np.ndarray, ...]:
    """Return times s, shaft torque N m, i_d and i_q A after a torque step."""
    dt = 5e-5
    p = drive.pack(dt)
    x, out = np.zeros(electric_drive.N_STATE), np.zeros(electric_drive.N_OUT)
    rows = []
    for step in range(480):
        request = torque if step >= 80 else 0.0
        electric_drive.drive_step(p, x, request, inverter.ACTIVE, speed, LINK, 333.0, 320.0, out)
        rows.append(((step - 80) * dt, out[pmsm.OUT_TORQUE], x[pmsm.X_ID], x[pmsm.X_IQ]))
    return tuple(np.array(rows).T)


def show(car: Car) -> Card:
    """Compute the card."""
    drive = car.detailed.em1
    period, bandwidth = drive.control.period, drive.control.bandwidth
    pole = math.exp(-bandwidth * period)
    panels, facts = [], []
    for speed in (100.0, 600.0):
        seen = current_step(drive, speed, -40.0, 60.0)
        time = period * np.arange(len(seen))
        known = 1.0 - pole ** np.arange(len(seen))
        panels.append(
            Panel(
                f"Current step at {speed:g} rad/s",
                "time (ms)", "current (A)",
                [
                    Curve("i_d", 1e3 * time, seen[:, 0], marker="o"),
                    Curve("i_q", 1e3 * time, seen[:, 1], marker="o"),
                    Curve("known: first order", 1e3 * time, -40.0 * known, True, color="#22272e"),
                    Curve("", 1e3 * time, 60.0 * known, True, color="#22272e"),
                ],
            )
        )  # fmt: skip
        for name, column, size in (("i_d", 0, -40.0), ("i_q", 1, 60.0)):
            apart = float(np.max(np.abs(seen[:, column] / size - known)))
            facts.append(
                Fact(f"{name} at {speed:g} rad/s: share furthest from 1 - a^n", "1", 0.0, apart, 0.02)
            )  # fmt: skip
    speed, torque = 200.0, 0.6 * _peak(drive)
    time, shaft, i_d, i_q = torque_step(drive, speed, torque)
    ramp = np.clip(time, 0.0, None) * drive.slew_rate
    panels.append(
        Panel(
            f"Torque step at {speed:g} rad/s",
            "time (ms)", "torque (N m)",
            [
                Curve("at the shaft", 1e3 * time, shaft),
                Curve("known: the slew limit", 1e3 * time, np.minimum(ramp, torque), True, color="#22272e"),
            ],
        )
    )  # fmt: skip
    panels.append(
        Panel("Its currents", "time (ms)", "current (A)",
              [Curve("i_d", 1e3 * time, i_d), Curve("i_q", 1e3 * time, i_q)])
    )  # fmt: skip
    facts.append(Fact("shaft torque at the end of the step", "N m", torque, float(shaft[-1]), 5e-3))
    rising = (shaft > 0.3 * torque) & (shaft < 0.9 * torque)
    slope = float(np.polyfit(time[rising], shaft[rising], 1)[0])
    facts.append(Fact("its rise", "N m/s", drive.slew_rate, slope, 0.05))
    return Card("EM1: current control", panels, facts)


def _peak(drive: DriveParameters) -> float:
    from hev_can_emu.plant.operating_points import most_torque_per_ampere

    return most_torque_per_ampere(drive.machine, math.sqrt(2.0) * drive.limits.current_rms).torque
