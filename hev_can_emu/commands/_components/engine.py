"""The engine: what its pistons do to the crank, and what its gas gives."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from hev_can_emu.commands._components.card import Car, Card
from hev_can_emu.plant import combustion_map as maps
from hev_can_emu.plant import crank, gas_pulses
from hev_can_emu.report.component_plot import Curve, Fact, Panel

SPEED = 300.0  # rad/s
_RPM = 30.0 / math.pi


def rod_torque(parameters: crank.CrankParameters, angle: np.ndarray, speed: float) -> np.ndarray:
    """Return the inertial torque of four pistons on an exact rod by its definition, N m.

    ``-m*x''*dx/da`` summed over the cylinders, with the piston's travel differentiated by its Fourier
    series: shares nothing with the kernels.
    """
    radius, rod = parameters.radius, parameters.rod_length
    total = np.zeros_like(angle)
    for offset in (0.0, math.pi, math.pi, 0.0):
        a = angle + offset
        travel = radius + rod - radius * np.cos(a) - np.sqrt(rod**2 - (radius * np.sin(a)) ** 2)
        order = 1j * np.fft.fftfreq(len(a), 1.0 / len(a))
        series = np.fft.fft(travel)
        rate = np.fft.ifft(order * series).real
        total -= (
            parameters.reciprocating_mass
            * speed**2
            * np.fft.ifft(order**2 * series).real
            * rate
        )  # fmt: skip
    return total


def _order(torque: np.ndarray, order: int) -> float:
    """Return the sine amplitude of an order."""
    return float(-2.0 * np.fft.rfft(torque)[order].imag / len(torque))


def show(car: Car) -> Card:
    """Compute the card."""
    engine = car.detailed.engine
    geometry = engine.crank
    angle = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)
    exact_p = msgspec.structs.replace(geometry, exact_rod=True).pack()
    short_p = msgspec.structs.replace(geometry, exact_rod=False).pack()
    exact = np.array([crank.inertial_torque(exact_p, a, SPEED, 0.0) for a in angle])
    short = np.array([crank.inertial_torque(short_p, a, SPEED, 0.0) for a in angle])
    defined = rod_torque(geometry, angle, SPEED)
    size = geometry.reciprocating_mass * geometry.radius**2 * SPEED**2
    k = geometry.radius / geometry.rod_length
    closed = -size * (2.0 * np.sin(2.0 * angle) + k**2 * np.sin(4.0 * angle))
    degrees = np.degrees(angle)

    p = msgspec.structs.replace(engine, pulses=None).pack()
    speeds = np.linspace(55.0, engine.speed[-1], 200)
    loads = []
    for load in (1.0, 0.7, 0.4, 0.15, 0.0):
        net = [maps.load_torque(p, w, load) - maps.drag_torque(p, w) for w in speeds]
        loads.append(Curve(f"load {load:g}", speeds * _RPM, np.array(net)))
    row = len(engine.speed) // 2 + 1
    full = engine.torque[row][-1] - engine.drag[row]
    at_point = maps.load_torque(p, engine.speed[row], 1.0) - maps.drag_torque(p, engine.speed[row])
    back = maps.torque_load(p, 200.0, maps.load_torque(p, 200.0, 0.55))
    facts = [
        Fact(
            "exact rod against its definition, furthest apart (share of the peak)", "1", 0.0,
            float(np.max(np.abs(exact - defined)) / np.max(np.abs(defined))), 1e-9,
        ),
        Fact(
            "truncated rod against -m R^2 w^2 (2 sin 2a + k^2 sin 4a), alike", "1", 0.0,
            float(np.max(np.abs(short - closed)) / np.max(np.abs(closed))), 1e-12,
        ),
        Fact("truncated rod: order 2", "N m", -2.0 * size, _order(short, 2), 1e-12),
        Fact("truncated rod: order 4", "N m", -size * k**2, _order(short, 4), 1e-9),
        Fact("mean over a turn", "N m", 0.0, float(np.mean(exact)), 1e-10),
        Fact("full load at a point of the map, after friction", "N m", full, at_point, 1e-12),
        Fact("load 0.55 to torque and back", "1", 0.55, back, 1e-9),
    ]  # fmt: skip
    pistons = Panel(
        f"Inertial torque on the crank at {SPEED * _RPM:.0f} 1/min",
        "crank angle (deg)",
        "torque (N m)",
        [
            Curve("exact rod", degrees, exact),
            Curve("truncated rod", degrees, short),
            Curve("known: exact, by definition", degrees, defined, True, color="#22272e"),
        ],
    )
    difference = Panel(
        "Exact less truncated rod: orders 6, 8, ... of size k^4",
        "crank angle (deg)",
        "torque (N m)",
        [
            Curve("computed", degrees, exact - short),
            Curve("known", degrees, defined - closed, True, color="#22272e"),
        ],
    )
    gas = Panel("Torque after friction", "speed (1/min)", "torque (N m)", loads)
    panels = [pistons, difference, gas]
    if engine.pulses is not None:
        panel, more = _pulses(engine)
        panels.append(panel)
        facts.extend(more)
    return Card("Engine: pistons and gas", panels, facts)


def _pulses(engine: maps.CombustionParameters) -> tuple[Panel, list[Fact]]:
    """Return the firing ripple over half a turn, and that its mean is none."""
    p = engine.pack()
    angle = np.linspace(0.0, 2.0 * math.pi, 721)
    speed, curves, work = 200.0, [], 0.0
    for load in (1.0, 0.5, 0.0):
        torque = maps.load_torque(p, speed, load)
        closed = p[maps.P_CLOSED_PRESSURE]
        pressure = closed + (gas_pulses.ATMOSPHERE - closed) * load
        values = np.array(
            [gas_pulses.ripple(p, maps.P_RIPPLE, a, 0.0, 1.0, pressure, torque) for a in angle]
        )
        curves.append(Curve(f"load {load:g}", np.degrees(angle), torque + values))
        work = max(work, abs(float(np.mean(values[:-1]))))
    panel = Panel(
        f"Gas torque with its firing ripple at {speed * _RPM:.0f} 1/min (option)",
        "crank angle (deg)", "torque (N m)", curves,
    )  # fmt: skip
    return panel, [Fact("mean of the firing ripple", "N m", 0.0, work, 1e-9)]
