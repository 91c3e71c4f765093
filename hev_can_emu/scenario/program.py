"""A scenario ready to play: what the compilers make of a file, and the player plays.

Structs, whose classes are made in a tenth of the time that those of named tuples take: at each start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.scenario.columns import Columns
from hev_can_emu.scenario.evaluation import Code
from hev_can_emu.scenario.expression import Expression
from hev_can_emu.scenario.monitor import Monitor
from hev_can_emu.scenario.signals import Signal


class Instant(msgspec.Struct, frozen=True):
    """A time in the scenario: ``offset_ns`` after its start, or after the step with that number."""

    step: int | None
    offset_ns: int


class Span(msgspec.Struct, frozen=True):
    """Where in the tables a program or samples stand."""

    first: int
    length: int


class Set(msgspec.Struct, frozen=True):
    """A constant; NaN sends "not available"."""

    value: float


class Hold(msgspec.Struct, frozen=True):
    """The present value from now on."""


class Release(msgspec.Struct, frozen=True):
    """The initial value."""


class Shape(msgspec.Struct, frozen=True):
    """A running stimulus, as :mod:`.script` reads it.

    Attributes:
        kind: LINE, WAVE, CHIRP, TRAIN, TABLE or FOLLOW.
        numbers: up to four; a first one of NaN stands for the present value.
        length_ns: of a line or chirp; of one step of a train.
        span: code or samples.
        mode: chirp: 1 logarithmic; train: rounds; table: 1 straight lines.
    """

    kind: int
    numbers: tuple[float, ...]
    length_ns: int = 0
    span: Span = Span(0, 0)
    mode: int = 0


Action = Set | Shape | Hold | Release


class SendMessage(msgspec.Struct, frozen=True):
    """From now on ``message`` is sent (``enabled``) or not."""

    message: str
    enabled: bool


class SendFrame(msgspec.Struct, frozen=True):
    """A raw frame, sent once."""

    identifier: int
    data: bytes
    extended: bool
    fd: bool


class Inject(msgspec.Struct, frozen=True):
    """Start a fault; ``fault`` is what the caller's reader of faults made of it."""

    label: str
    fault: object
    where: str


class Clear(msgspec.Struct, frozen=True):
    """End the fault of that name, if it is live."""

    label: str


Command = SendMessage | SendFrame | Inject | Clear


class Step(msgspec.Struct, frozen=True):
    """One step, ready to play; exactly one of ``at_ns``, ``after_ns`` and ``when`` is given."""

    name: str
    at_ns: int | None
    after_ns: int | None
    when: Expression | None
    when_span: Span
    timeout_ns: int
    held_ns: int
    stop_on_timeout: bool
    actions: tuple[tuple[Signal, Action], ...]
    commands: tuple[Command, ...]
    where: str


class Watch(msgspec.Struct, frozen=True):
    """One expectation: ``make`` gives a fresh monitor for the window; ``hears``: it needs the frames."""

    opens: Instant
    closes: Instant
    make: Callable[[], Monitor]
    hears: bool


class Tables:
    """Collects all programs' code and all samples."""

    def __init__(self) -> None:
        self._code: list[Code] = []
        self._samples: list[npt.NDArray[np.float64]] = []
        self._codes = self._sampled = 0

    def add_code(self, code: Code) -> Span:
        """Return where ``code`` stands now."""
        span = Span(self._codes, len(code))
        self._code.append(code)
        self._codes += len(code)
        return span

    def add_rows(self, rows: Sequence[tuple[float, float]]) -> Span:
        """Return where samples, time in s and value, stand now."""
        samples = np.array(rows, dtype=np.float64)
        span = Span(self._sampled, len(samples))
        self._samples.append(samples)
        self._sampled += len(samples)
        return span

    def arrays(self) -> tuple[Code, npt.NDArray[np.float64]]:
        """Return all code and all samples, shape (n, 2) each."""
        empty = np.empty((0, 2))
        return np.concatenate([empty, *self._code]), np.concatenate([empty, *self._samples])


class Program(msgspec.Struct, frozen=True):
    """A scenario, ready to play."""

    name: str
    duration_ns: int
    setup: tuple[Step, ...]
    steps: tuple[Step, ...]
    teardown: tuple[Step, ...]
    watches: tuple[Watch, ...]
    columns: Columns
    tables: Tables
