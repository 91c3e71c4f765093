"""A switch from series to parallel in first gear, and parts of it, by valve currents and torque requests.

In all of them C1 opens and EM1 brings the input shaft near G1's speed.  Then C1 closes and locks, or the
sleeve synchronises G1 and turns the ring out of its way; in the whole switch its dogs then go in, and C1
closes on them.  Every command holds for whole milliseconds, so that any
simulation can be given the very same ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from reference.car import ANGLE, CHARGE, EM1, EM2, GAP, OIL, PLATES, SIZE, Car, V
from reference.hybrid import Stretch
from reference.mechanics import AT, N
from reference.oil import CLUTCH, PISTON, PUMP, SPOOL, SUPPLY

PERIOD = 1e-3
COMMANDS = (
    "clutch_current", "shift_current1", "shift_current2", "pump",
    "engine_torque", "em1_torque", "em2_torque",
)  # fmt: skip
SIGNALS = (
    "engine_speed", "input_speed", "em2_speed", "body_speed", "half_shaft_torque",
    "input_shaft_torque", "clutch_slip", "clutch_capacity", "clutch_pressure", "gear_slip",
    "sleeve_position", "em1_torque", "em2_torque", "clutch_heat", "plate_temperature",
)  # fmt: skip
# What is tested by level at the start of a stretch, not only by crossing.
_LEVELS = ("leaves", "releases", "lets go", "part")


class Manoeuvre(NamedTuple):
    """What is asked for; times in s, torques in N m.

    Attributes:
        end: length.
        shift, close: when the sleeve is pushed to G1, when C1 begins to fill.
        em2: torque of EM2.
        drive, rise: when it begins, and how long it rises.
        fill: how long C1's valve stands wide open.
        top: pressure held for at the end of C1's rise of 0.28 s, Pa.
        press: EM1's torque on the dogs once they are in.
        engine: the engine's, rising while C1 closes.
        gap: angle of the sleeve against G1 at the start, rad.
    """

    end: float
    shift: float
    close: float
    em2: float
    drive: float = 0.0
    rise: float = 0.0
    fill: float = 0.028
    top: float = 6.5e5
    press: float = 0.0
    engine: float = 0.0
    gap: float = 0.0


# In the whole switch the dogs find a gap as they are; their touch is kept, and C1 closes on it.
MANOEUVRES = {
    "close": Manoeuvre(0.75, np.inf, 0.47, 60.0),
    "shift": Manoeuvre(0.26, 0.2, np.inf, 0.0),
    "switch": Manoeuvre(
        0.62, 0.2, 0.32, 30.0, drive=0.31, rise=0.15, fill=0.027, top=2e6, press=8.0, engine=20.0
    ),
}


class Start(NamedTuple):
    """Where the run starts: C1 locked, sleeve in neutral, all shafts free of torque; SI units."""

    engine_speed: float = 172.0
    body_speed: float = 25.0
    crank_angle: float = 0.3
    charge: float = 0.2
    temperature: float = 353.15
    supply_pressure: float = 5e6
    clutch_pressure: float = 8e5


class Run(NamedTuple):
    """What came out.

    Attributes:
        times: shape (n,), s.
        signals: shape (n, len(SIGNALS)).
        events: (time, name) of all that changed.
        final: the state at the end.
    """

    times: np.ndarray
    signals: np.ndarray
    events: list[tuple[float, str]]
    final: np.ndarray


def holding_current(car: Car, valve: int, pressure: float, supply: float) -> float:
    """Return the current at which a valve, as a divider of the supply, rests at ``pressure``."""
    v = car.circuit.valves[valve]
    share = (pressure / (supply - pressure)) ** 0.5
    spool = v.underlap * (share - 1.0) / (share + 1.0)
    return float(0.5 * (1.0 + spool) * v.full_current)


def commands(car: Car, start: Start, asked: Manoeuvre) -> np.ndarray:
    """Return the commands of every millisecond, shape (ms, len(COMMANDS))."""
    count = round(asked.end / PERIOD)
    out = np.zeros((count, len(COMMANDS)))
    t = PERIOD * np.arange(count)
    clutch = car.circuit.valves[0].full_current

    def hold(valve: int, pressure: float) -> float:
        return holding_current(car, valve, pressure, start.supply_pressure)

    since = t + 1e-9 - asked.close
    out[:, 0] = np.select(
        [t < 0.02, since < 0.0, since < asked.fill, since < 0.05],
        [hold(0, start.clutch_pressure), 0.0, clutch, hold(0, 1.9e5)],
        np.interp(since, [0.05, 0.33], [hold(0, 1.9e5), hold(0, asked.top)]),
    )
    out[:, 1] = np.where(t >= asked.shift, hold(1, 11e5), 0.0)
    out[:, 4] = np.interp(t, [0.0, 0.02, 0.05, 0.8, 0.9], [12.0, 12.0, 0.0, 0.0, 30.0])
    out[:, 4] += np.interp(since, [0.02, 0.1], [0.0, asked.engine])
    out[:, 5] = np.interp(t, [0.06, 0.08, 0.155, 0.175], [-9.0, -14.0, -14.0, 0.0])
    out[:, 5] += np.interp(t, [0.285, 0.305], [0.0, asked.press])
    rising = (t - asked.drive) / asked.rise if asked.rise else np.ones(count)
    out[:, 6] = np.where(t >= asked.drive, asked.em2 * np.minimum(rising, 1.0), 0.0)
    return out


def initial(car: Car, start: Start, asked: Manoeuvre) -> np.ndarray:
    """Return the state at the start and set the modes that belong to it."""
    y = np.zeros(SIZE)
    d = car.chain.reach
    # Rigid motion: input side with the engine, output side with the body.
    names = ("Je", "Jc1", "Jc2", "J1", "Jsleeve")
    for name in names:
        y[AT[name]] = start.engine_speed
    row = {name: index for index, name in enumerate(_MESH_NAMES)}
    mesh = d[-len(_MESH_NAMES) :]

    def across(name: str, known: str, sought: str) -> None:
        ratio = -mesh[row[name], AT[known]] / mesh[row[name], AT[sought]]
        y[AT[sought]] = y[AT[known]] * ratio

    across("id", "J1", "Jid")
    across("m1", "Jid", "Jm1")
    for name in ("Jlw", "Jrw", "Jv", "Jrear", "Jfd2"):
        y[AT[name]] = start.body_speed
    across("fd", "Jfd2", "Jfd1")
    for name in ("Jg12", "J2", "Jg22"):
        y[AT[name]] = y[AT["Jfd1"]]
    across("m2", "J2", "Jm2")
    across("g1", "Jg12", "Jg11")
    across("g2", "Jg22", "Jg21")
    y[ANGLE], y[CHARGE], y[PLATES] = start.crank_angle, start.charge, start.temperature
    oil = y[OIL:]
    c = car.circuit.p.clutch
    oil[SUPPLY], oil[CLUTCH], oil[PUMP] = start.supply_pressure, start.clutch_pressure, 0.0
    push = c.area * start.clutch_pressure - c.preload
    oil[PISTON] = (push + c.pack * c.kiss_travel) / (c.spring + c.pack)
    current = holding_current(car, 0, start.clutch_pressure, start.supply_pressure)
    oil[SPOOL] = car.circuit.spool_target(0, current)
    oil[SPOOL + 2] = oil[SPOOL + 4] = -1.0
    y[GAP] = asked.gap
    car.resting = [False, True, True, False]
    car.combustion.burning = car.combustion.caught = start.charge
    return y


_MESH_NAMES = ("m1", "id", "m2", "g1", "g2", "fd")


def observe(car: Car, y: np.ndarray) -> list[float]:
    """Return the values of :data:`SIGNALS`."""
    torque = car.chain.branch_torque(y[:N], y[N:ANGLE])
    gaps = []
    for machine, at, name in ((car.em1, EM1, "Jm1"), (car.em2, EM2, "Jm2")):
        i_d, i_q = y[at], y[at + 1]
        gaps.append(machine.air_gap(i_d, i_q) - machine.braking(i_d, i_q, y[AT[name]]))
    return [
        y[0], y[AT["J1"]], y[AT["Jm2"]], y[AT["Jv"]], torque[_HALF_SHAFT], torque[_INPUT_SHAFT],
        car.slip(y), car.capacity(y), y[OIL + CLUTCH], car.gear_slip(y), y[V - 1], *gaps, y[-1],
        y[PLATES],
    ]  # fmt: skip


_HALF_SHAFT, _INPUT_SHAFT = 6, 1  # left half shaft; the shaft between C1 and EM1's driven gear


def simulate(
    car: Car,
    y: np.ndarray,
    given: np.ndarray,
    sample: float,
    until: float | None = None,
    told: Callable[[float], Any] | None = None,
) -> Run:
    """Run the commands ``given``; signals are taken every ``sample`` s from the dense solution."""
    stretch = Stretch(car.rates, 0.0, y, tolerances())
    end = until or PERIOD * len(given)
    control = car.em1.p.control.period
    ticks = round(end / control)
    samples = round(end / sample)
    times = sample * np.arange(samples + 1)
    signals = np.full((samples + 1, len(SIGNALS)), np.nan)
    signals[0] = observe(car, y)
    filled = 1
    events: list[tuple[float, str]] = []
    for tick in range(ticks):
        now = tick * control
        row = given[min(int((now + 0.5 * control) / PERIOD), len(given) - 1)]
        car.currents, car.pump = list(row[:3]), row[3] > 0.5
        car.engine_request = float(row[4])
        state = stretch.y
        car.em1.control(float(row[5]), state[EM1], state[EM1 + 1], state[AT["Jm1"]])
        car.em2.control(float(row[6]), state[EM2], state[EM2 + 1], state[AT["Jm2"]])
        stop = (tick + 1) * control
        while stop - stretch.t > 1e-15:
            _settle(car, stretch, events)
            for _, at, dense, name in stretch.until(stop, car.crossings()):
                while filled <= samples and times[filled] <= at + 1e-12:
                    signals[filled] = observe(car, dense(min(times[filled], at)))
                    filled += 1
                if name:
                    events.append((at, name))
                    stretch.y = car.change(name, stretch.y)
        stretch.t = stop
        if told is not None:
            told(stop)
    return Run(times[:filled], signals[:filled], events, stretch.y)


def _settle(car: Car, stretch: Stretch, events: list[tuple[float, str]]) -> None:
    """Change what no longer holds as it is, after a command or another change."""
    for _ in range(8):
        for one in car.crossings():
            if one.name.endswith(_LEVELS) and one.value(stretch.t, stretch.y) > 0.0:
                events.append((stretch.t, one.name))
                stretch.y = car.change(one.name, stretch.y)
                break
        else:
            return


def tolerances() -> np.ndarray:
    """Return absolute tolerances: parts in 1e10 of the sizes that occur."""
    out = np.empty(SIZE)
    out[:N] = 1e-8
    out[N:ANGLE] = 1e-13
    out[ANGLE], out[CHARGE], out[PLATES] = 1e-10, 1e-11, 1e-8
    out[OIL:EM1] = 1e-4  # Pa
    out[OIL + PISTON], out[OIL + PUMP] = 1e-13, 1e-8
    out[OIL + SPOOL : OIL + SPOOL + 6] = [1e-10, 1e-8] * 3
    out[EM1 : EM2 + 2] = 1e-8
    out[EM2 + 2 :] = [1e-13, 1e-10, 1e-10, 1e-11, 1e-7]
    return out
