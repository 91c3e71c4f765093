"""A detailed car on the bench: stepped by commands alone, without network and control units.

For comparisons, benchmarks and studies.  Commands and truth are those of
:mod:`hev_can_emu.plant.powertrain`, SI, by name; effects can be left out one by one
(:class:`hev_can_emu.plant.detailed_parameters.Effects`); torques, capacities and gear that the
``external_*`` commands give replace the machine behind them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import transmission_unit
from hev_can_emu.jit import kernel
from hev_can_emu.native import Bound
from hev_can_emu.plant import detailed_layout as lay
from hev_can_emu.plant import powertrain as port
from hev_can_emu.plant.columns import aligned
from hev_can_emu.plant.detailed_parameters import Effects
from hev_can_emu.plant.events import EVENT
from hev_can_emu.plant.ledger import Ledger
from hev_can_emu.plant.start import Start
from hev_can_emu.runtime.car import Car
from hev_can_emu.runtime.fidelity import advance_plant
from hev_can_emu.runtime.setup import Setup

Array = npt.NDArray[np.float64]

EVENTS = 65536  #: records of one call; more are dropped


class BenchEvent(NamedTuple):
    """An event of the driveline: ``kind`` and ``which`` as :mod:`hev_can_emu.plant.holding` has them."""

    t_ns: int
    kind: int
    which: int
    value: float


class Parts(NamedTuple):
    """What a bench hands to its kernel; all arrays but the constants' change."""

    plant: Any
    unit: Any
    transmission: Array
    x: Array
    n: npt.NDArray[np.int64]
    command: Array
    truth: Array
    work: Array
    events: npt.NDArray[np.void]


@kernel
def run_bench(
    parts: Parts, t_ns: int, ticks: int, watched: npt.NDArray[np.int64], trace: Array
) -> Any:
    """Advance ``ticks`` ticks; ``trace[k]`` gets the watched truths after tick k.

    Returns:
        The number of event records taken.
    """
    n_events: Any = np.int64(0)
    for k in range(ticks):
        n_events = advance_plant(
            parts.plant, parts.unit, parts.transmission, parts.x, parts.n, parts.command,
            parts.truth, parts.work, t_ns + k * port.PERIOD_NS, parts.events, n_events,
        )  # fmt: skip
        for i in range(watched.shape[0]):
            trace[k, i] = parts.truth[watched[i]]
    return n_events


class Bench:
    """A car with its plant, stepped by whole milliseconds.

    Args:
        setup: vehicle and model; the detailed one by default.
        effects: of the detailed plant.
        start: where it starts.

    Attributes:
        plant: its constants; ``plant.bank.period`` is the inner step of the detailed plant, s.
        x, n: its state: from ``detailed_layout.X_DRIVELINE`` on the driveline's speeds and twists.
        t_ns: time, ns.
        events: since the start.

    Raises:
        InputError: as :class:`hev_can_emu.runtime.car.Car`.
    """

    def __init__(
        self,
        setup: Setup | None = None,
        effects: Effects | None = None,
        start: Start | None = None,
    ) -> None:
        self._car = Car(setup or Setup(model="detailed"), effects)
        self.plant = self._car.plant
        self.x, self.n, self._truth = self._car.start(start or Start())
        self._command = np.full(len(port.COMMANDS), np.nan)
        self._command[: port.U_GRADE] = 0.0
        for bound in ("em1_torque_min", "em1_torque_max", "em2_torque_min", "em2_torque_max"):
            self._command[port.COMMANDS.index(bound)] = np.nan  # none
        self._command[port.U_CONTACTOR] = 1.0 if (start or Start()).closed else 0.0
        transmission = np.zeros(transmission_unit.N_STATE)
        transmission_unit.start_unit(transmission)
        self._events = np.zeros(EVENTS, dtype=EVENT)
        parts = Parts(
            self.plant, self._car.unit, transmission, self.x, self.n, self._command,
            self._truth, aligned(self._car.work), self._events,
        )  # fmt: skip
        self._nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
        self._advance = Bound(run_bench, (parts,), (0, 0, *self._nothing))
        self.t_ns = 0
        self.events: list[BenchEvent] = []

    def command(self, **values: float) -> None:
        """Set commands by name (``powertrain.COMMANDS``); they hold until set anew."""
        for name, value in values.items():
            self._command[port.COMMANDS.index(name)] = value

    def truth(self, name: str) -> float:
        """Return a quantity (``powertrain.TRUTH``) at the present time."""
        return float(self._truth[port.TRUTH.index(name)])

    def run(self, ticks: int) -> None:
        """Advance by milliseconds."""
        self._take(self._advance(self.t_ns, ticks, *self._nothing), ticks)

    def advance(self, ticks: int, watch: tuple[str, ...] = ()) -> Array:
        """As :meth:`run`; return the watched truths after each millisecond, shape (ticks, watched)."""
        watched = np.array([port.TRUTH.index(name) for name in watch], dtype=np.int64)
        trace = np.zeros((ticks, len(watch)))
        self._take(self._advance(self.t_ns, ticks, watched, trace), ticks)
        return trace

    def _take(self, count: int, ticks: int) -> None:
        if count:
            self.events.extend(BenchEvent(*record.tolist()) for record in self._events[:count])
        self.t_ns += ticks * port.PERIOD_NS

    @property
    def driveline(self) -> Array:
        """Speeds, then twists of the detailed driveline (a live view); may be set at the start."""
        return self.x[lay.X_DRIVELINE :]

    def ledger(self) -> Ledger | None:
        """Return the energy ledger since the start; None for a model without one."""
        return self._car.ledger(self.x, self.n)
