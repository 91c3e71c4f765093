"""A tick of the detailed plant with its TCU, as :mod:`.fidelity` chooses it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu.transmission_unit import TransmissionUnit, tell_shift, transmission_step
from hev_can_emu.jit import small_kernel
from hev_can_emu.plant.detailed import detailed_step
from hev_can_emu.plant.detailed_layout import DetailedPlant

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Events = npt.NDArray[np.void]


@small_kernel
def advance_detailed(
    plant: DetailedPlant, unit: TransmissionUnit, transmission: Array, x: Array, n: Integers,
    command: Array, truth: Array, work: Array, t_ns: int, events: Events, n_events: int,
) -> int:  # fmt: skip
    """Let the TCU work its valves, then advance the detailed plant by one tick."""
    transmission_step(unit, transmission, truth, command)
    n_events = detailed_step(plant, x, n, command, truth, work, t_ns, events, n_events)
    tell_shift(transmission, truth)
    return n_events
