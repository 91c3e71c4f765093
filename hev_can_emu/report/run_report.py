"""What a report shows of one run, gathered before any of its forms is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.report.ribbons import Ribbon
from hev_can_emu.scenario.verdict import Outcome, Verdict


class Curve(NamedTuple):
    """A signal or a quantity of the plant over the run.

    Attributes:
        name: ``Message.Signal`` or ``truth.name``.
        unit: empty for a pure number.
        t_s, values: float64 (n,), NaN not available.
        labels: text of each value, where the signal has a value table.
    """

    name: str
    unit: str
    t_s: npt.NDArray[np.float64]
    values: npt.NDArray[np.float64]
    labels: Mapping[float, str]


class Happening(NamedTuple):
    """Something that happened at an instant: supervision, a fault, a lock, a mode."""

    t_s: float
    kind: str
    text: str


class Span(NamedTuple):
    """Something that lasted: a fault, the loss of a request.  ``kind`` is ``fault`` or ``lost``."""

    kind: str
    name: str
    start_s: float
    end_s: float


class Period(NamedTuple):
    """How a message kept its period: number of frames and distances between them, ms."""

    message: str
    sender: str
    frames: int
    nominal_ms: float
    mean_ms: float
    least_ms: float
    most_ms: float


class Panel(NamedTuple):
    """Curves of one unit that are drawn together."""

    title: str
    unit: str
    curves: Sequence[Curve]


class RunReport(NamedTuple):
    """One run.

    Attributes:
        name, file, description: the scenario's.
        parameters: as written, by name.
        car: vehicle, model, start, protection and owners, in words, by name.
        seed: of everything random.
        verdicts: of steps, then of expectations.
        outcome: the worst of them.
        car_s: how long the car ran.
        wall_s: how long that took.
        started: date and time; empty where the run has none, as in virtual time.
        clock: ``virtual``, ``wall`` or ``lockstep``; with the bus, where there is one.
        trace: hash over all frames; empty where the clock was the wall's.
        happenings, spans: in order of time.
        faults: what was injected, a line each.
        timing: figures about the run's own time-keeping, in words, by name.
        periods: of each message seen.
        curves: what expectations look at, by name.
        ribbons, panels: the overview.
        versions: of this program and what it stands on, by name.
        command: repeats the run.
        files: recordings beside the report, by name.
        ledger: where the energy went, where the plant tells: ``unit``, ``moved``, ``residue``, ``fuel_kg``,
            and ``terms`` of ``kind``, ``text`` and ``energy``.
    """

    name: str
    file: str
    description: str
    parameters: Mapping[str, str]
    car: Mapping[str, str]
    seed: int
    verdicts: Sequence[Verdict]
    outcome: Outcome
    car_s: float
    wall_s: float
    started: str
    clock: str
    trace: str
    happenings: Sequence[Happening]
    spans: Sequence[Span]
    faults: Sequence[str]
    timing: Mapping[str, str]
    periods: Sequence[Period]
    curves: Mapping[str, Curve]
    ribbons: Sequence[Ribbon]
    panels: Sequence[Panel]
    versions: Mapping[str, str]
    command: str
    files: Sequence[str] = ()
    ledger: Mapping[str, Any] | None = None

    @property
    def steps(self) -> list[Verdict]:
        """The steps' verdicts."""
        return [verdict for verdict in self.verdicts if verdict.kind == "step"]

    @property
    def expectations(self) -> list[Verdict]:
        """The expectations' verdicts."""
        return [verdict for verdict in self.verdicts if verdict.kind != "step"]
