"""Which faults were injected, when, until when, and how often they acted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from hev_can_emu.ecu import fault_table as table
from hev_can_emu.ecu.fault_rows import Network, fill_row
from hev_can_emu.ecu.fault_table import MOST_PREPARED, SLOTS, FaultTable, clear_row, start_row
from hev_can_emu.ecu.faults import BUS_FAULTS, Fault
from hev_can_emu.errors import InputError, StateError, did_you_mean

State = Literal["prepared", "waiting", "active", "ended"]
_STATES: tuple[State, ...] = ("ended", "prepared", "waiting", "active", "ended")


class InjectedFault(NamedTuple):
    """One fault that was injected: what, under which name, and what became of it.

    ``injected_ns``, ``start_ns``: when it was injected and when it began or will begin; ``until_ns``: when
    it ended or will end, None while that is open; ``hits``: frames, or ticks, on which it acted.
    """

    name: str
    fault: Fault
    injected_ns: int
    start_ns: int
    until_ns: int | None
    state: State
    hits: int


class _Page(msgspec.Struct):
    """What a snapshot needs beside the table: names and records per row, and rows given up."""

    rows: dict[int, tuple[str, Fault]] = {}
    past: list[InjectedFault] = []


class FaultBook:
    """Puts faults into the table and reads back what they did.

    Args:
        faults: the table, a view of the emulator's state.
        network: what names mean.
        now_ns: gives the time of the next tick.
    """

    def __init__(self, faults: FaultTable, network: Network, now_ns: Callable[[], int]) -> None:
        self._table = faults
        self._network = network
        self._now_ns = now_ns
        self._page = _Page()
        self._prepared = 0

    @property
    def prepared(self) -> tuple[str, ...]:
        """The names of the prepared faults, by number."""
        return tuple(self._page.rows[number][0] for number in range(self._prepared))

    def reseed(self, seed: int) -> None:
        """Let the random numbers of faults injected from now on follow from ``seed``."""
        self._network = self._network._replace(seed=seed)

    def check(self, fault: Fault, where: str) -> None:
        """Raise InputError where the fault's names and values do not fit the network."""
        own = self._table
        scratch = FaultTable(
            np.zeros_like(own.whole), np.zeros_like(own.real), np.zeros_like(own.counts)
        )
        fill_row(fault, self._network, scratch, 0, where)

    def inject(self, fault: Fault, where: str = "fault") -> str:
        """Start a fault at the next tick (or ``after`` it); see :meth:`Emulator.inject`."""
        name = self._new_name(fault, where)
        slot = self._free_slot()
        fill_row(fault, self._network, self._table, slot, where)
        self._page.rows[slot] = (name, fault)
        start_row(self._table.whole, slot, self._now_ns())
        self._table.counts[table.LIVE] += 1
        return name

    def prepare(self, faults: Sequence[Fault], locate: Callable[[int], str]) -> None:
        """Fill the first rows with faults that a control message injects by their number.

        Raises:
            InputError: too many, two of one name, or one that does not fit the network.
        """
        if len(faults) > MOST_PREPARED:
            got = f"{len(faults)} of them"
            raise InputError(locate(MOST_PREPARED), f"at most {MOST_PREPARED} faults", got)
        names: set[str] = set()
        for number, fault in enumerate(faults):
            if isinstance(fault, BUS_FAULTS):
                got = f"{fault.kind}, which is of the wire"
                raise InputError(locate(number), "a fault of frames, signals or the car", got)
            if fault.label in names:
                got = f"'{fault.label}' again"
                raise InputError(locate(number), "each name once", got, "give it a 'name'")
            names.add(fault.label)
            fill_row(fault, self._network, self._table, number, locate(number))
            self._table.whole[number, table.STATE] = table.PREPARED
            self._page.rows[number] = (fault.label, fault)
        self._prepared = len(faults)

    def clear(self, name: str) -> None:
        """End a fault at the next tick; see :meth:`Emulator.clear`."""
        live = {self._page.rows[slot][0]: slot for slot in self._live()}
        if name not in live:
            hint = did_you_mean(name, live) or ("none is live" if not live else "")
            raise InputError("clear", "the name of a live fault", f"'{name}'", hint)
        clear_row(self._table.whole, live[name], self._now_ns())

    def records(self) -> tuple[InjectedFault, ...]:
        """Return everything injected so far, in order of injection."""
        states = self._table.whole[:, table.STATE]
        used = (slot for slot in self._page.rows if states[slot] != table.PREPARED)
        found = [*self._page.past, *(self._record(slot) for slot in used)]
        return tuple(sorted(found, key=lambda record: record.injected_ns))

    def name(self, slot: int) -> str:
        """Return the name of the fault in a row."""
        return self._page.rows[slot][0] if slot in self._page.rows else f"fault {slot}"

    def pack(self) -> bytes:
        """Return the book as part of a snapshot."""
        # What faults may hold takes long to be made ready for this; most cars have none.
        return msgspec.json.encode(self._page) if self._page.rows or self._page.past else b""

    def unpack(self, packed: bytes) -> None:
        """Take the book from a snapshot."""
        self._page = msgspec.json.decode(packed, type=_Page) if packed else _Page()

    def _live(self) -> list[int]:
        states = self._table.whole[:, table.STATE]
        return [s for s in self._page.rows if states[s] in (table.WAITING, table.ACTIVE)]

    def _new_name(self, fault: Fault, where: str) -> str:
        taken = {self._page.rows[slot][0] for slot in self._live()}
        if fault.label not in taken:
            return fault.label
        if fault.name:
            got = f"'{fault.name}', which is live"
            raise InputError(f"{where}.name", "a name that is not in use", got, "clear it first")
        number = 2
        while f"{fault.label} {number}" in taken:
            number += 1
        return f"{fault.label} {number}"

    def _free_slot(self) -> int:
        states = self._table.whole[:, table.STATE]
        for slot in range(self._prepared, SLOTS):
            if states[slot] == table.FREE:
                return slot
        # The one that ended first makes room; what it did is written down.
        ended = [slot for slot in range(self._prepared, SLOTS) if states[slot] == table.ENDED]
        if not ended:
            places = SLOTS - self._prepared
            raise StateError(f"all {places} places for faults are taken; clear some first")
        slot = min(ended, key=lambda s: int(self._table.whole[s, table.END_NS]))
        self._page.past.append(self._record(slot))
        del self._page.rows[slot]
        return slot

    def _record(self, slot: int) -> InjectedFault:
        name, fault = self._page.rows[slot]
        row = self._table.whole[slot]
        end = int(row[table.END_NS])
        return InjectedFault(
            name,
            fault,
            int(row[table.INJECTED_NS]),
            int(row[table.START_NS]),
            end if end > 0 else None,
            _STATES[int(row[table.STATE])],
            int(row[table.HITS]),
        )
