"""Events: what happened when, as records that kernels append to."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import kernel

EVENT = np.dtype(
    [("t_ns", np.int64), ("kind", np.int32), ("index", np.int32), ("value", np.float64)]
)
"""One event: time, kind, what it concerns, a number that goes with it."""


@kernel
def note(
    events: npt.NDArray[np.void], n_events: int, t_ns: int, kind: int, index: int, value: float
) -> int:
    """Append an event while there is room; return the number of records taken."""
    if n_events < events.shape[0]:
        events[n_events]["t_ns"] = t_ns
        events[n_events]["kind"] = kind
        events[n_events]["index"] = index
        events[n_events]["value"] = value
        return n_events + 1
    return n_events
