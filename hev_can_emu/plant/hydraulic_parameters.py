"""What the hydraulic circuit is made of: valves, pump, supply, clutch cylinder, shift cylinder."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.plant import checks

# Layout of the packed parameters.
P_DT, P_LAMINAR_SQUARE = 0, 1
P_PUMP_DISPLACEMENT, P_PUMP_SPEED, P_PUMP_KEEP, P_PUMP_LEAK, P_PUMP_FRICTION = 2, 3, 4, 5, 6
P_RELIEF_OPEN, P_RELIEF_SLOPE, P_LINE, P_PRECHARGE, P_ACCUMULATOR = 7, 8, 9, 10, 11
P_CLUTCH_COMPLIANCE, P_CLUTCH_AREA, P_PRELOAD, P_SPRING, P_KISS, P_PACK, P_SEAL_RATE = range(12, 19)
P_SHIFT_COMPLIANCE, P_SHIFT_AREA, P_MAKE_UP = 19, 21, 23
# Three valves: flow factor per stroke, underlap, leak, full current, then the spool's propagator by rows.
P_VALVES = 24
V_FLOW, V_UNDERLAP, V_LEAK, V_CURRENT, V_SPOOL = 0, 1, 2, 3, 4
N_VALVE = 8
N_PARAMETERS = P_VALVES + 3 * N_VALVE


class OilParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Oil and orifices; SI units.

    Attributes:
        density: kg/m^3.
        bulk_modulus: effective, with the air in it at working pressure, Pa.
        discharge_coefficient: of all orifices, 1.
        laminar_pressure: pressure drop below which orifice flow turns laminar, Pa.
    """

    density: float
    bulk_modulus: float
    discharge_coefficient: float
    laminar_pressure: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.positive(where, self, *self.__struct_fields__)

    def flow_factor(self, area: float) -> float:
        """Return ``Cd*a*sqrt(2/rho)``: flow is that times the root of the pressure drop."""
        return self.discharge_coefficient * area * math.sqrt(2.0 / self.density)


class ValveParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A proportional three-way valve; SI units.  Without current its chamber is open to the tank.

    Attributes:
        area: fully open, m^2.
        underlap: share of the stroke around the centre in which both edges are open, 1.
        leak: past each closed edge, m^3/(s Pa).
        full_current: that moves the spool from the tank's end to the supply's, A.
        natural_frequency, damping: of the spool, rad/s and 1.
    """

    area: float
    underlap: float
    leak: float
    full_current: float
    natural_frequency: float
    damping: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "area", "full_current", "natural_frequency", "damping")
        checks.not_negative(where, self, "leak")
        if not 0.0 < self.underlap < 1.0:
            raise InputError(
                f"{where}.underlap", "more than 0 and less than 1", repr(self.underlap)
            )

    def pack(self, dt: float, oil: OilParameters) -> NDArray[np.float64]:
        """Return shape ``(N_VALVE,)``."""
        from scipy.linalg import expm  # a tenth of a second that other models need not spend

        w = self.natural_frequency
        rate = np.array([[0.0, 1.0], [-w * w, -2.0 * self.damping * w]])
        keep = np.asarray(expm(rate * dt)).ravel()
        per_stroke = oil.flow_factor(self.area) / (1.0 + self.underlap)
        return np.array([per_stroke, self.underlap, self.leak, self.full_current, *keep])


class SupplyParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Electric pump behind a check valve, spring accumulator, relief valve; SI units.

    Attributes:
        displacement: of the pump, m^3/rad.
        speed: of the running pump, rad/s.
        time_constant: with which its speed follows on and off, s.
        leak: inside the pump, m^3/(s Pa).
        friction: of the pump, N m s/rad.
        relief_pressure: at which the relief valve begins to open, Pa.
        relief_slope: its flow per pressure above, m^3/(s Pa).
        line_volume: oil in pump outlet and lines, m^3.
        precharge: at which the accumulator's piston leaves its stop, Pa.
        accumulator_compliance: its volume per pressure above, m^3/Pa.
    """

    displacement: float
    speed: float
    time_constant: float
    leak: float
    friction: float
    relief_pressure: float
    relief_slope: float
    line_volume: float
    precharge: float
    accumulator_compliance: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "displacement", "speed", "relief_slope", "line_volume")
        checks.positive(where, self, "accumulator_compliance", "precharge")
        checks.not_negative(where, self, "time_constant", "leak", "friction")
        checks.ordered(where, self, "precharge", "relief_pressure")


class ClutchCylinderParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Cylinder, return spring and pack of C1; SI units.

    Attributes:
        area: of the piston, m^2.
        volume: of chamber and channel, m^3.
        preload: of the return spring at the stop, N.
        spring: stiffness of the return spring, N/m.
        kiss_travel: from the stop to where the plates touch, m.
        pack: stiffness of the plates pressed together, N/m.
        seal_damping: N s/m.
    """

    area: float
    volume: float
    preload: float
    spring: float
    kiss_travel: float
    pack: float
    seal_damping: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.positive(where, self, *self.__struct_fields__)

    @property
    def kiss_force(self) -> float:
        """Force of the return spring where the plates touch, N."""
        return self.preload + self.spring * self.kiss_travel

    @property
    def kiss_pressure(self) -> float:
        """Pressure that just makes the plates touch, Pa."""
        return self.kiss_force / self.area


class ShiftCylinderParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Two-sided cylinder of the synchronizer; SI units.

    Attributes:
        area1, area2: of the sides that push towards G1 and G2, m^2.
        volume1, volume2: of the chambers with their channels, sleeve in the middle, m^3.
        make_up_area: of the check valve that lets oil in from the tank at suction, m^2.
    """

    area1: float
    area2: float
    volume1: float
    volume2: float
    make_up_area: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "area1", "area2", "volume1", "volume2")
        checks.not_negative(where, self, "make_up_area")


class HydraulicsParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole circuit.

    Attributes:
        oil: and orifices.
        supply: pump, accumulator, relief valve.
        clutch_valve: fills and empties the clutch cylinder.
        shift_valve: each of the two of the synchronizer cylinder.
        clutch: cylinder of C1.
        shift: cylinder of the synchronizer.
    """

    oil: OilParameters
    supply: SupplyParameters
    clutch_valve: ValveParameters
    shift_valve: ValveParameters
    clutch: ClutchCylinderParameters
    shift: ShiftCylinderParameters

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        for name in self.__struct_fields__:
            getattr(self, name).validate(f"{where}.{name}")

    def pack(self, dt: float = 5e-5) -> NDArray[np.float64]:
        """Return the kernels' parameters, shape ``(N_PARAMETERS,)``, for a step of ``dt`` s."""
        oil, supply, clutch, shift = self.oil, self.supply, self.clutch, self.shift
        tau = supply.time_constant
        own = [
            dt,
            oil.laminar_pressure**2,
            supply.displacement,
            supply.speed,
            math.exp(-dt / tau) if tau > 0.0 else 0.0,
            supply.leak,
            supply.friction,
            supply.relief_pressure,
            supply.relief_slope,
            supply.line_volume / oil.bulk_modulus,
            supply.precharge,
            supply.accumulator_compliance,
            clutch.volume / oil.bulk_modulus,
            clutch.area,
            clutch.preload,
            clutch.spring,
            clutch.kiss_travel,
            clutch.pack,
            clutch.seal_damping / dt,
            shift.volume1 / oil.bulk_modulus,
            shift.volume2 / oil.bulk_modulus,
            shift.area1,
            shift.area2,
            oil.flow_factor(shift.make_up_area),
        ]
        valves = [self.clutch_valve, self.shift_valve, self.shift_valve]
        return np.concatenate([own, *(valve.pack(dt, oil) for valve in valves)])
