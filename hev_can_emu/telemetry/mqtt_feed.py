"""What goes out when: rate limit per topic, on change, all of it anew now and then.  Time is passed in."""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.telemetry.vss import Leaf

_UTC = datetime.UTC


def rfc3339(unix_ns: int) -> str:
    """Return a Unix time in ns as a date, UTC, with milliseconds."""
    whole, rest = divmod(unix_ns, 1_000_000_000)
    date = datetime.datetime.fromtimestamp(whole, _UTC).replace(tzinfo=None)
    return f"{date.isoformat()}.{rest // 1_000_000:03d}Z"


class Reading(msgspec.Struct, frozen=True, omit_defaults=True):
    """One signal's value: null while it is not available; ``unit`` where it has one.

    ``time`` is the car's, s since its start; ``timestamp`` the date.
    """

    value: float | int | bool | str | None
    time: float
    timestamp: str
    unit: str = ""


class Feed:
    """Decides which signals are told of a snapshot of the statuses.

    A signal is told when its value has changed and ``period_s`` has passed since it was last told, and
    in any case after ``refresh_s``, so that a newcomer knows all within that time.

    Args:
        leaves: what to tell.
        names: of the statuses, in the order of the snapshots; leaves of others are never told.
        period_s: least time between two tellings of a signal, s; 0 tells every change.
        refresh_s: s.
    """

    def __init__(
        self,
        leaves: Sequence[Leaf],
        names: Sequence[str],
        period_s: float,
        refresh_s: float,
    ) -> None:
        known = {name: index for index, name in enumerate(names)}
        self._leaves = [(leaf, known[leaf.source]) for leaf in leaves if leaf.source in known]
        self._period_s = period_s
        self._refresh_s = refresh_s
        self._encode = msgspec.json.Encoder().encode
        self._told: list[object] = [math.nan] * len(self._leaves)
        self._told_s = [-math.inf] * len(self._leaves)

    def forget(self) -> None:
        """Tell everything with the next snapshot: whoever listened may be gone."""
        self._told_s = [-math.inf] * len(self._leaves)

    def due(
        self, statuses: npt.NDArray[np.float64], t_ns: int, unix_ns: int, now_s: float
    ) -> list[tuple[str, bytes]]:
        """Return topic (below the car's own) and payload of each signal to tell now.

        Args:
            statuses: SI, in the order of the names.
            t_ns, unix_ns: the car's time they belong to, and the date.
            now_s: of any steady clock, by which rates are kept, s.
        """
        out: list[tuple[str, bytes]] = []
        date = ""
        for index, (leaf, source) in enumerate(self._leaves):
            since_s = now_s - self._told_s[index]
            if since_s < self._period_s:
                continue
            value = leaf.value(float(statuses[source]))
            if value == self._told[index] and since_s < self._refresh_s:
                continue
            date = date or rfc3339(unix_ns)
            reading = Reading(value, round(t_ns * 1e-9, 6), date, leaf.unit)
            out.append((leaf.topic, self._encode(reading)))
            self._told[index] = value
            self._told_s[index] = now_s
        return out
