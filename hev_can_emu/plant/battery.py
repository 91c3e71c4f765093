"""The traction battery: open-circuit voltage behind a resistance, solved for the power of its loads.

With discharge current I, ``U = OCV(soc) - R(soc, T)*I`` and the loads' power ``P = U*I``; the root of
smaller current is the stable one: ``I = 2*P / (OCV + sqrt(OCV^2 - 4*R*P))``.  It exists up to
``OCV^2/(4*R)``.  Published limits are the smallest of the pulse maps, the power at the least or
greatest terminal voltage and, when discharging, that maximum.  More than the limits is refused: the
battery carries the granted power only and says so.
State of charge is the integral of the terminal current.  The cells are one thermal node.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from hev_can_emu.errors import InputError
from hev_can_emu.jit import small_kernel
from hev_can_emu.plant import checks
from hev_can_emu.plant import torque_source as source
from hev_can_emu.plant.tables import between, blend, bracket

# Layout of the packed parameters; the tables come last, in this order: soc axis, OCV, temperature
# axis, resistance, discharge power, charge power (rows: soc, columns: temperature).
P_DT, P_CAPACITY, P_VOLTAGE_MIN, P_VOLTAGE_MAX = 0, 1, 2, 3
P_HEAT_KEEP, P_HEAT_RESISTANCE, P_AUXILIARY = 4, 5, 6
P_N_SOC, P_N_TEMPERATURE, P_TABLES = 7, 8, 9

# Layout of the state.
X_SOC, X_TEMPERATURE = 0, 1
N_STATE = 2

# Layout of the limits.
LIM_DISCHARGE, LIM_CHARGE, LIM_REASON_DISCHARGE, LIM_REASON_CHARGE = 0, 1, 2, 3
LIM_OCV, LIM_RESISTANCE = 4, 5
N_LIM = 6

# Layout of the output.
OUT_VOLTAGE, OUT_CURRENT, OUT_POWER, OUT_REFUSED, OUT_REASON, OUT_HEAT = 0, 1, 2, 3, 4, 5
N_OUT = 6

_TOLERANCE = 1e-6  # W; more than this beyond a limit counts as refused


class BatteryParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A traction battery; SI units.

    Attributes:
        capacity: charge from empty to full, A s.
        soc: axis of the tables, 0 to 1, rising.
        open_circuit_voltage: at each soc, V.
        temperature: second axis of the tables, K, rising.
        resistance: one row per soc, one column per temperature, ohm.
        discharge_power: greatest power out, same shape, W.
        charge_power: greatest power in, same shape, W, positive.
        voltage_min, voltage_max: allowed terminal voltage, V.
        heat_capacity: of the cells, J/K.
        heat_resistance: from cells to coolant, K/W.
        auxiliary_power: of the low-voltage supply and pumps, taken while the contactors are closed, W.
    """

    capacity: float
    soc: tuple[float, ...]
    open_circuit_voltage: tuple[float, ...]
    temperature: tuple[float, ...]
    resistance: tuple[tuple[float, ...], ...]
    discharge_power: tuple[tuple[float, ...], ...]
    charge_power: tuple[tuple[float, ...], ...]
    voltage_min: float
    voltage_max: float
    heat_capacity: float
    heat_resistance: float
    auxiliary_power: float

    def validate(self, where: str) -> None:
        """Raise :class:`InputError` naming the first value that makes no sense."""
        checks.positive(where, self, "capacity", "voltage_min", "heat_capacity", "heat_resistance")
        checks.ordered(where, self, "voltage_min", "voltage_max")
        checks.not_negative(where, self, "auxiliary_power")
        checks.axis(f"{where}.soc", self.soc)
        if self.soc[0] != 0.0 or self.soc[-1] != 1.0:
            raise InputError(
                f"{where}.soc", "an axis from 0 to 1", f"{self.soc[0]!r} to {self.soc[-1]!r}"
            )
        checks.axis(f"{where}.temperature", self.temperature)
        rows, columns = len(self.soc), len(self.temperature)
        checks.column(f"{where}.open_circuit_voltage", self.open_circuit_voltage, rows, 1.0)
        checks.grid(f"{where}.resistance", self.resistance, rows, columns, 1e-6)
        checks.grid(f"{where}.discharge_power", self.discharge_power, rows, columns, 0.0)
        checks.grid(f"{where}.charge_power", self.charge_power, rows, columns, 0.0)
        lowest, highest = min(self.open_circuit_voltage), max(self.open_circuit_voltage)
        if self.voltage_min >= highest or self.voltage_max <= lowest:
            raise InputError(
                f"{where}.voltage_min, voltage_max",
                f"a window that meets the open-circuit voltage ({lowest:g} to {highest:g} V)",
                f"{self.voltage_min:g} to {self.voltage_max:g} V",
            )

    def pack(self, dt: float = 1e-3) -> NDArray[np.float64]:
        """Return the kernels' parameters for a period of ``dt`` s; shape depends on the tables."""
        own = [
            dt,
            self.capacity,
            self.voltage_min,
            self.voltage_max,
            math.exp(-dt / (self.heat_capacity * self.heat_resistance)),
            self.heat_resistance,
            self.auxiliary_power,
            float(len(self.soc)),
            float(len(self.temperature)),
        ]
        parts = [np.array(own), np.array(self.soc), np.array(self.open_circuit_voltage)]
        parts.append(np.array(self.temperature))
        tables = (self.resistance, self.discharge_power, self.charge_power)
        parts.extend(np.array(rows).ravel() for rows in tables)
        return np.concatenate(parts)


@small_kernel
def battery_limits(
    p: NDArray[np.float64], x: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Write what the battery can give and take now.

    Args:
        p: parameters of :meth:`BatteryParameters.pack`.
        x: state, ``(N_STATE,)``: state of charge 1, temperature K.
        out: ``(N_LIM,)``: discharge and charge power W (magnitudes), their LIMIT_* codes
            (battery power, voltage), open-circuit voltage V, resistance ohm.
    """
    rows, columns = int(p[P_N_SOC]), int(p[P_N_TEMPERATURE])
    ocv_at = P_TABLES + rows
    temperature_at = ocv_at + rows
    table_at = temperature_at + columns
    size = rows * columns
    row, row_share = bracket(p, P_TABLES, rows, x[X_SOC])
    column, column_share = bracket(p, temperature_at, columns, x[X_TEMPERATURE])
    ocv = between(p, ocv_at, row, row_share)
    r = blend(p, table_at, columns, row, row_share, column, column_share)
    pulse_out = blend(p, table_at + size, columns, row, row_share, column, column_share)
    pulse_in = blend(p, table_at + 2 * size, columns, row, row_share, column, column_share)

    # The most a source of resistance r can give is at half its voltage.
    at_least = max(p[P_VOLTAGE_MIN], 0.5 * ocv)
    voltage_out = max(ocv - at_least, 0.0) / r * at_least
    voltage_in = max(p[P_VOLTAGE_MAX] - ocv, 0.0) / r * p[P_VOLTAGE_MAX]
    if x[X_SOC] <= 0.0:
        pulse_out = 0.0
    if x[X_SOC] >= 1.0:
        pulse_in = 0.0
    out[LIM_DISCHARGE] = min(pulse_out, voltage_out)
    out[LIM_CHARGE] = min(pulse_in, voltage_in)
    by_voltage, by_power = float(source.LIMIT_VOLTAGE), float(source.LIMIT_BATTERY_POWER)
    out[LIM_REASON_DISCHARGE] = by_voltage if voltage_out < pulse_out else by_power
    out[LIM_REASON_CHARGE] = by_voltage if voltage_in < pulse_in else by_power
    out[LIM_OCV] = ocv
    out[LIM_RESISTANCE] = r


@small_kernel
def discharge_current(ocv: float, resistance: float, power: float) -> float:
    """Return the current, A, at which the terminals give ``power`` (negative: take it), W.

    Beyond the maximum transferable power: the current at that maximum.
    """
    root = math.sqrt(max(ocv * ocv - 4.0 * resistance * power, 0.0))
    if root == 0.0:
        return ocv / (2.0 * resistance)
    return 2.0 * power / (ocv + root)


@small_kernel
def battery_step(
    p: NDArray[np.float64],
    x: NDArray[np.float64],
    power: float,
    connected: float,
    coolant_temperature: float,
    limits: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Advance one period under the loads' power; call after :func:`battery_limits`.

    Args:
        p: parameters of :meth:`BatteryParameters.pack`.
        x: state, ``(N_STATE,)``, changed in place.
        power: of all loads together, W, positive discharges.
        connected: 1 while the contactors are closed; 0 refuses all power.
        coolant_temperature: K.
        limits: what :func:`battery_limits` wrote for this period.
        out: ``(N_OUT,)``: terminal voltage V, current A (positive charges), granted power W (positive
            discharges), refused power W (of the sign of ``power``), LIMIT_* code, heat W.
    """
    granted = power
    reason = float(source.LIMIT_NONE)
    if connected < 0.5:
        granted = 0.0
        if power != 0.0:
            reason = source.LIMIT_DISABLED
    elif power > limits[LIM_DISCHARGE]:
        granted = limits[LIM_DISCHARGE]
        if power > granted + _TOLERANCE:
            reason = limits[LIM_REASON_DISCHARGE]
    elif power < -limits[LIM_CHARGE]:
        granted = -limits[LIM_CHARGE]
        if power < granted - _TOLERANCE:
            reason = limits[LIM_REASON_CHARGE]
    ocv, r = limits[LIM_OCV], limits[LIM_RESISTANCE]
    current = discharge_current(ocv, r, granted)
    x[X_SOC] -= current * p[P_DT] / p[P_CAPACITY]
    heat = r * current * current
    settled = coolant_temperature + heat * p[P_HEAT_RESISTANCE]
    x[X_TEMPERATURE] = settled + (x[X_TEMPERATURE] - settled) * p[P_HEAT_KEEP]
    out[OUT_VOLTAGE] = ocv - r * current
    out[OUT_CURRENT] = -current
    out[OUT_POWER] = granted
    out[OUT_REFUSED] = power - granted if reason != source.LIMIT_NONE else 0.0
    out[OUT_REASON] = reason
    out[OUT_HEAT] = heat
