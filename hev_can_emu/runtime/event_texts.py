"""What happens in a run, in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import fault_table, reasons, supervision
from hev_can_emu.ecu.ties import REACTIONS
from hev_can_emu.ecu.trouble_codes import code_text
from hev_can_emu.messages.definitions import MessageDef
from hev_can_emu.plant import driveline
from hev_can_emu.runtime import tick

MODE_NAMES = (
    "transition", "series", "parallel_g1", "parallel_g2",
    "electric_neutral", "electric_g1", "electric_g2",
)  # fmt: skip
PHASES = (
    "neutral", "travel", "synchronising", "index", "engaged",
    "disengaging", "aborted", "blocked by torque", "grating", "tooth on tooth",
)  # fmt: skip
TEETH = (driveline.TOUCHED, driveline.PARTED)
LOCKS = ("C1", "G1", "G2", "left brake", "right brake", "body", "rear brakes")


class Event(NamedTuple):
    """Something that happened, at ``t_ns``: ``kind`` and ``text`` for people, the record's numbers beside."""

    t_ns: int
    kind: str
    text: str
    number: int
    value: float


class EventTexts:
    """Puts records of events into words.

    Args:
        messages: of the network.
        code_numbers: (messages,) numbers of their trouble codes, 0 for none.
        fault_name: returns an injected fault's name by its number.
    """

    def __init__(
        self,
        messages: Sequence[MessageDef],
        code_numbers: npt.NDArray[np.int64],
        fault_name: Callable[[int], str],
    ) -> None:
        self._messages = messages
        self._code_numbers = code_numbers
        self._fault_name = fault_name

    def _loss(self, message: int, value: int) -> str:
        """Return reason, reaction and trouble code of a lost message as text."""
        reaction, reason = divmod(value, supervision.REACTION_STEP)
        parts = [reasons.REASONS[reason].text]
        if reaction > 0:
            parts.append(list(REACTIONS)[reaction - 1].replace("_", " "))
        number, failure = int(self._code_numbers[message]), reasons.REASONS[reason].failure
        if number and failure:
            parts.append(code_text(number | failure))
        return ", ".join(parts)

    def event(self, record: np.void) -> Event:
        """Return a record (EVENT) of a run as an event."""
        kind, index, value = int(record["kind"]), int(record["index"]), float(record["value"])
        messages = self._messages
        if kind == driveline.LOCKED:
            name, text = "lock", f"{LOCKS[index]} holds"
        elif kind == driveline.RELEASED:
            name, text = "release", f"{LOCKS[index]} slips at {value:.1f} Nm"
        elif kind == driveline.REVERSED:
            name, text = "reverse", f"{LOCKS[index]} slips the other way"
        elif kind in TEETH:
            touch = kind == driveline.TOUCHED
            name, text = "teeth", f"dogs of {LOCKS[index]} {'touch' if touch else 'part'}"
        elif kind == supervision.LOST:
            name, text = "lost", f"{messages[index].name}: {self._loss(index, int(value))}"
        elif kind == supervision.HEALED:
            name, text = "healed", f"{messages[index].name} is back"
        elif kind == tick.MODE_CHANGED:
            name, text = "mode", MODE_NAMES[index]
        elif kind == tick.SYNC_CHANGED:
            name, text = "synchronizer", PHASES[int(value)]
        elif kind == fault_table.BEGAN:
            name, text = "fault", f"{self._fault_name(index)} begins"
        elif kind == fault_table.OVER:
            name, text = "fault", f"{self._fault_name(index)} ends, {int(value)} hits"
        else:
            name, text = "conflict", f"{messages[index].name} is also sent by another node"
        return Event(int(record["t_ns"]), name, text, index, value)
