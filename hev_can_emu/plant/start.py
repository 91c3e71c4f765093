"""Where a run starts."""

from __future__ import annotations

from typing import NamedTuple


class Start(NamedTuple):
    """The car at rest on a level road.

    Attributes:
        state_of_charge: 0 to 1.
        temperature: of everything, K.
        closed: contactors closed and DC link charged.
    """

    state_of_charge: float = 0.6
    temperature: float = 293.15
    closed: bool = True
