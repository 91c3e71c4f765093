"""The detailed engine's parameters and maps: combustion torque over speed and load, drag, efficiency.

Load is the air charge from 0 to 1.  The map ``torque(speed, load)`` is linear between its points
and rises along the load, so that its inverse at a given speed is exact.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.jit import kernel
from hev_can_emu.plant import checks, gas_pulses
from hev_can_emu.plant.crank import CrankParameters
from hev_can_emu.plant.engine_control import check_speeds
from hev_can_emu.plant.gas_pulses import ATMOSPHERE, GasPulseParameters
from hev_can_emu.plant.tables import bracket

# Layout of the packed parameters; the pulses and the tables come last.
P_STEP, P_DRAG_FADE, P_CRANK_SPEED, P_STALL_SPEED = 0, 1, 2, 3
P_IDLE_SPEED, P_IDLE_GAIN, P_IDLE_INTEGRAL_STEP, P_IDLE_KEEP, P_IDLE_MAX = 4, 5, 6, 7, 8
P_FADE_SPEED, P_MAX_SPEED, P_CUT_SPEED, P_RESUME_SPEED = 9, 10, 11, 12
P_INTAKE_ANGLE, P_INTAKE_TIME, P_HEATING_VALUE, P_WALL_SHARE = 13, 14, 15, 16
P_PULSES, P_CLOSED_PRESSURE, P_LEAK_SPEED = 17, 18, 19
P_SPEEDS, P_LOADS, P_IDLE_DRAG = 20, 21, 22
P_BREAKAWAY = 23
P_RIPPLE = 24
P_TABLES = P_RIPPLE + gas_pulses.N_PARAMETERS  # speed, drag, efficiency, load, torque by speed

_IDLE_FORGET = 0.5  # s: the governor forgets an idle load so fast once off idle


class CombustionParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A four-cylinder four-stroke engine with its control unit, at the crankshaft; SI units.

    Attributes:
        crank: geometry and masses; pack it for :mod:`hev_can_emu.plant.crank` as well.
        speed: axis of the tables, rad/s, rising.
        load: axis of the torque map, air charge from 0 to 1, rising.
        torque: mean combustion torque, N m, one row per speed, one column per load; each row rises
            from 0.  At load 1 it is full load after friction plus drag.
        drag: torque that turns the unfuelled engine at each speed, N m, positive.
        efficiency: combustion work per fuel energy at each speed, 1: the Willans line's slope.
        drag_fade_speed: below it drag falls in proportion to speed, rad/s.
        breakaway: torque that a crank at rest withstands, N m.
        crank_speed: the engine fires from here on, rad/s.
        stall_speed: and stalls below this, rad/s.
        idle_speed: rad/s.
        idle_gain: of the idle governor, N m s/rad.
        idle_integral_gain: N m/rad.
        idle_torque_max: most combustion torque the governor asks for, N m.
        fade_speed, max_speed: full load fades from the first to zero at the second, rad/s.
        cut_speed, resume_speed: fuel is cut above the first until below the second, rad/s.
        intake_angle: the charge's lag, rad of crank angle.
        intake_time_max: and the most it takes when the engine turns slowly, s.
        heating_value: of the fuel, lower, J/kg.
        wall_share: of the heat not turned into work, the share that enters the coolant, 1.
        pulses: cycle of the firing ripple; None for none.
    """

    crank: CrankParameters
    speed: tuple[float, ...]
    load: tuple[float, ...]
    torque: tuple[tuple[float, ...], ...]
    drag: tuple[float, ...]
    efficiency: tuple[float, ...]
    drag_fade_speed: float
    breakaway: float
    crank_speed: float
    stall_speed: float
    idle_speed: float
    idle_gain: float
    idle_integral_gain: float
    idle_torque_max: float
    fade_speed: float
    max_speed: float
    cut_speed: float
    resume_speed: float
    intake_angle: float
    intake_time_max: float
    heating_value: float
    wall_share: float
    pulses: GasPulseParameters | None = None

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        self.crank.validate(f"{where}.crank")
        checks.axis(f"{where}.speed", self.speed)
        checks.axis(f"{where}.load", self.load)
        if self.load[0] != 0.0 or self.load[-1] != 1.0:
            raise InputError(f"{where}.load", "values from 0 to 1", repr(self.load))
        checks.grid(f"{where}.torque", self.torque, len(self.speed), len(self.load), 0.0)
        for index, row in enumerate(self.torque):
            checks.axis(f"{where}.torque[{index}]", row)
            if row[0] != 0.0:
                raise InputError(f"{where}.torque[{index}][0]", "0 at load 0", repr(row[0]))
        checks.column(f"{where}.drag", self.drag, len(self.speed), 0.0)
        checks.column(f"{where}.efficiency", self.efficiency, len(self.speed), 0.01)
        if max(self.efficiency) > 1.0:
            raise InputError(f"{where}.efficiency", "at most 1", repr(max(self.efficiency)))
        check_speeds(where, self)
        checks.not_negative(where, self, "breakaway")
        checks.positive(where, self, "intake_angle", "intake_time_max", "heating_value")
        checks.fraction(where, self, "wall_share")
        if self.pulses is not None:
            self.pulses.validate(f"{where}.pulses")

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernels' parameters for a step of ``dt`` s; shape depends on the tables."""
        pulses = np.zeros(gas_pulses.N_PARAMETERS)
        closed, leak = ATMOSPHERE, 1.0
        if self.pulses is not None:
            pulses = self.pulses.pack(self.crank)
            closed, leak = self.pulses.closed_pressure, self.pulses.leak_speed
        own = [
            dt,
            self.drag_fade_speed,
            self.crank_speed,
            self.stall_speed,
            self.idle_speed,
            self.idle_gain,
            self.idle_integral_gain * dt,
            math.exp(-dt / _IDLE_FORGET),
            self.idle_torque_max,
            self.fade_speed,
            self.max_speed,
            self.cut_speed,
            self.resume_speed,
            self.intake_angle,
            self.intake_time_max,
            self.heating_value,
            self.wall_share,
            0.0 if self.pulses is None else 1.0,
            closed,
            leak,
            float(len(self.speed)),
            float(len(self.load)),
            float(np.interp(self.idle_speed, self.speed, self.drag))
            * min(self.idle_speed / self.drag_fade_speed, 1.0),
            self.breakaway,
        ]
        torque = [value for row in self.torque for value in row]
        tables = [*self.speed, *self.drag, *self.efficiency, *self.load, *torque]
        return np.concatenate([np.array(own), pulses, np.array(tables)])


@kernel
def drag_torque(p: NDArray[np.float64], speed: float) -> float:
    """Return the drag, N m, of the sign of ``speed`` and in proportion to it near zero."""
    count = int(p[P_SPEEDS])
    row, share = bracket(p, P_TABLES, count, abs(speed))
    return row_drag(p, row, share, speed)


@kernel
def row_value(p: NDArray[np.float64], table: int, row: int, share: float) -> float:
    """Return the value of table 1 (drag) or 2 (efficiency) between speed rows."""
    at = P_TABLES + table * int(p[P_SPEEDS]) + row
    value: float = p[at] + (p[at + 1] - p[at]) * share
    return value


@kernel
def row_drag(p: NDArray[np.float64], row: int, share: float, speed: float) -> float:
    """As :func:`drag_torque`, for a bracket of the speed axis found before."""
    fading: float = speed / p[P_DRAG_FADE]
    return row_value(p, 1, row, share) * min(max(fading, -1.0), 1.0)


@kernel
def row_torque(p: NDArray[np.float64], row: int, share: float, column: int) -> float:
    """Return the map's torque at load column ``column``, between speed rows."""
    speeds, loads = int(p[P_SPEEDS]), int(p[P_LOADS])
    at = P_TABLES + 3 * speeds + loads + row * loads + column
    value: float = p[at] + (p[at + loads] - p[at]) * share
    return value


@kernel
def load_torque(p: NDArray[np.float64], speed: float, load: float) -> float:
    """Return the mean combustion torque, N m, of a charge ``load`` (0 to 1)."""
    row, share = bracket(p, P_TABLES, int(p[P_SPEEDS]), speed)
    return row_load_torque(p, row, share, load)


@kernel
def row_load_torque(p: NDArray[np.float64], row: int, share: float, load: float) -> float:
    """As :func:`load_torque`, for a bracket of the speed axis found before."""
    axis = P_TABLES + 3 * int(p[P_SPEEDS])
    column, column_share = bracket(p, axis, int(p[P_LOADS]), load)
    lower = row_torque(p, row, share, column)
    return lower + (row_torque(p, row, share, column + 1) - lower) * column_share


@kernel
def torque_load(p: NDArray[np.float64], speed: float, torque: float) -> float:
    """Return the load, 0 to 1, that gives this combustion torque: the inverse of the map."""
    row, share = bracket(p, P_TABLES, int(p[P_SPEEDS]), speed)
    return row_torque_load(p, row, share, torque)


@kernel
def row_torque_load(p: NDArray[np.float64], row: int, share: float, torque: float) -> float:
    """As :func:`torque_load`, for a bracket of the speed axis found before."""
    axis = P_TABLES + 3 * int(p[P_SPEEDS])
    lower = 0.0
    for column in range(int(p[P_LOADS]) - 1):
        upper = row_torque(p, row, share, column + 1)
        if torque < upper:
            part = max((torque - lower) / (upper - lower), 0.0)
            load: float = p[axis + column] + (p[axis + column + 1] - p[axis + column]) * part
            return load
        lower = upper
    return 1.0
