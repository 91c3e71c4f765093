"""The plant of whichever fidelity behind one name: which kernel runs is decided by the constants' type.

Decided when the tick is compiled, so that a run carries the code of its own plant only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import before_compiling, small_kernel
from hev_can_emu.plant.powertrain import Plant, plant_step

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Events = npt.NDArray[np.void]


@small_kernel
def advance_simple(
    plant: Plant, unit: None, transmission: Array, x: Array, n: Integers, command: Array,
    truth: Array, work: Array, t_ns: int, events: Events, n_events: int,
) -> int:  # fmt: skip
    """Advance the 4-DOF or 16-DOF plant by one tick."""
    return plant_step(plant, x, n, command, truth, work, t_ns, events, n_events)


def advance_plant(
    plant: Any, unit: Any, transmission: Array, x: Array, n: Integers, command: Array,
    truth: Array, work: Array, t_ns: int, events: Events, n_events: int,
) -> int:  # fmt: skip
    """Advance the plant by one tick; return the number of event records taken.

    Args:
        plant: constants, of either kind.
        unit: TCU of the detailed plant, or None; ``transmission`` is its state.
        x, n, command, truth, work, t_ns, events, n_events: as :func:`.powertrain.plant_step`.
    """
    chosen: Any = advance_simple if isinstance(plant, Plant) else _advance_detailed()
    advanced: int = chosen(
        plant, unit, transmission, x, n, command, truth, work, t_ns, events, n_events
    )
    return advanced


def _advance_detailed() -> Any:
    # Imported where it is asked for: most runs have a simpler plant.
    from hev_can_emu.runtime.detailed_fidelity import advance_detailed

    return advance_detailed


def _advance_compiled(
    plant: Any, unit: Any, transmission: Any, x: Any, n: Any, command: Any,
    truth: Any, work: Any, t_ns: Any, events: Any, n_events: Any,
) -> Any:  # fmt: skip
    # The same, when the tick is compiled.
    kernel_of: Any = advance_simple if plant.instance_class is Plant else _advance_detailed()

    def advance(
        plant: Any, unit: Any, transmission: Any, x: Any, n: Any, command: Any,
        truth: Any, work: Any, t_ns: Any, events: Any, n_events: Any,
    ) -> Any:  # fmt: skip
        return kernel_of(
            plant, unit, transmission, x, n, command, truth, work, t_ns, events, n_events
        )

    return advance


def _choose_at_compilation() -> None:
    from numba.extending import overload

    overload(advance_plant, inline="always")(_advance_compiled)


before_compiling(_choose_at_compilation)
