"""Sensors between the plant's truth and what a unit takes for measured: filter, dead zone, resolution.

Declared per status port in the bindings file; a port without a sensor is measured perfectly.  In this
order: a first-order filter, exact for a truth held over the tick; a dead zone, inside which zero is
measured; rounding to whole steps of the resolution.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports
from hev_can_emu.ecu.sensors_file import Sensor
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.jit import kernel
from hev_can_emu.units import parse_quantity, unit

Array = npt.NDArray[np.float64]

_TICK_S = 1e-3


class Sensors(NamedTuple):
    """One row per sensor: its status port, and what of the old value the filter keeps per tick."""

    port: npt.NDArray[np.int64]
    keep: Array
    dead_zone: Array
    resolution: Array


def resolve_sensors(
    declared: dict[str, Sensor], locate: Callable[[tuple[str | int, ...]], str]
) -> Sensors:
    """Return the tables that :func:`measure` reads.

    Raises:
        InputError: an unknown port, or a quantity that does not fit it.
    """
    names = [port.name for port in ports.STATUSES]
    rows = []
    for name, sensor in declared.items():
        steps = ("sensors", name)
        if name not in names:
            hint = did_you_mean(name, names)
            raise InputError(locate(steps), "a status port", f"'{name}'", hint)
        port = ports.STATUSES[names.index(name)]
        keep = 0.0
        if sensor.filter:
            where = locate((*steps, "filter"))
            time = parse_quantity(sensor.filter, where, "s").si_value
            if not 0.0 <= time <= 60.0:
                raise InputError(where, "0 s to 60 s", f"'{sensor.filter}'")
            keep = math.exp(-_TICK_S / time) if time > 0.0 else 0.0
        sizes = []
        for key, text in (("dead_zone", sensor.dead_zone), ("resolution", sensor.resolution)):
            where = locate((*steps, key))
            size = 0.0
            if text:
                found = parse_quantity(text, where, port.unit if port.unit != "1" else "")
                if found.dimension != unit(port.unit).dimension:
                    raise InputError(where, "a pure number", f"'{text}'")
                size = found.si_value - unit(found.unit).offset
                if size < 0.0:
                    raise InputError(where, "0 or more", f"'{text}'")
            sizes.append(size)
        rows.append((names.index(name), keep, *sizes))
    return Sensors(
        np.array([row[0] for row in rows], dtype=np.int64),
        *(np.array([row[n] for row in rows], dtype=np.float64) for n in (1, 2, 3)),
    )


@kernel
def measure(sensors: Sensors, memory: Array, statuses: Array) -> None:
    """Replace the true values in ``statuses`` by measured ones.

    Args:
        sensors: S rows.
        memory: (S,), the filters' state, NaN before the first value; changed in place.
        statuses: status ports.
    """
    for row in range(sensors.port.shape[0]):
        value = statuses[sensors.port[row]]
        if math.isnan(value):
            continue
        if not math.isnan(memory[row]):
            value += (memory[row] - value) * sensors.keep[row]
        memory[row] = value
        if abs(value) < sensors.dead_zone[row]:
            value = 0.0
        step = sensors.resolution[row]
        if step > 0.0:
            value = np.rint(value / step) * step
        statuses[sensors.port[row]] = value
