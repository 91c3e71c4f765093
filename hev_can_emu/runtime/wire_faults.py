"""Faults of a bus with bit times: injected, cleared and told like any other."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hev_can_emu.bus.bits import INTERMISSION, bits_of
from hev_can_emu.bus.disturbance import Disturbance, Flood
from hev_can_emu.bus.medium import Medium
from hev_can_emu.bus.wire import FOREVER
from hev_can_emu.ecu.faults import BusErrors, BusFlood, BusOff, Fault, seconds
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.messages.frame import EXTENDED, frame
from hev_can_emu.runtime.fault_book import InjectedFault


class _Entry(NamedTuple):
    record: InjectedFault
    end: Callable[[], None]
    hits: Callable[[], int]


class WireFaults:
    """Puts faults on a medium's wire.

    Args:
        medium: the bus; its clock may have begun at another time than the car's.
        nodes: names of the control units on it.
    """

    def __init__(self, medium: Medium, nodes: Sequence[str]) -> None:
        self._medium = medium
        self._nodes = nodes
        self._entries: list[_Entry] = []

    def inject(self, fault: Fault, now_ns: int) -> str:
        """Begin a fault, or have it begin ``after`` now; raises InputError for an unknown node."""
        name = self._name(fault, now_ns)
        after_ns = round(seconds(fault.after, "after") * 1e9)
        start = self._medium.now_ns() + after_ns
        stop = start_ns = now_ns + after_ns
        until: int | None = None
        if fault.duration is not None:
            length_ns = round(seconds(fault.duration, "duration") * 1e9)
            until, stop = start + length_ns, start_ns + length_ns
        if isinstance(fault, BusErrors):
            end, hits = self._destroy(fault, name, start, until)
        elif isinstance(fault, BusOff):
            end, hits = self._turn_off(fault, start, until)
        else:
            assert isinstance(fault, BusFlood)
            end, hits = self._flood(fault, name, start, until)
        record = InjectedFault(
            name, fault, now_ns, start_ns, None if until is None else stop, "waiting", 0
        )
        self._entries.append(_Entry(record, end, hits))
        return name

    def clear(self, name: str, now_ns: int) -> bool:
        """End the live fault of that name; return whether there is one."""
        for i, entry in enumerate(self._entries):
            if entry.record.name == name and self._told(entry, now_ns).state != "ended":
                entry.end()
                ended = entry.record._replace(until_ns=now_ns)
                self._entries[i] = entry._replace(record=ended)
                return True
        return False

    def records(self, now_ns: int) -> tuple[InjectedFault, ...]:
        """Return all that were injected, as they are now."""
        return tuple(self._told(entry, now_ns) for entry in self._entries)

    def _told(self, entry: _Entry, now_ns: int) -> InjectedFault:
        record, hits = entry.record, entry.hits()
        limit = getattr(record.fault, "frames", 0)
        if (record.until_ns is not None and now_ns >= record.until_ns) or 0 < limit <= hits:
            return record._replace(state="ended", hits=hits)
        return record._replace(
            state="active" if now_ns >= record.start_ns else "waiting", hits=hits
        )

    def _name(self, fault: Fault, now_ns: int) -> str:
        live = {
            entry.record.name
            for entry in self._entries
            if self._told(entry, now_ns).state != "ended"
        }
        if fault.label not in live:
            return fault.label
        if fault.name:
            raise InputError("fault.name", "a name that is not in use", f"'{fault.name}'")
        number = 2
        while f"{fault.label} {number}" in live:
            number += 1
        return f"{fault.label} {number}"

    def _check(self, key: str, node: str) -> None:
        if node and node not in self._nodes:
            hint = did_you_mean(node, self._nodes)
            raise InputError(f"fault.{key}", f"one of {', '.join(self._nodes)}", f"'{node}'", hint)

    def _destroy(
        self, fault: BusErrors, name: str, start_ns: int, end_ns: int | None
    ) -> tuple[Callable[[], None], Callable[[], int]]:
        self._check("node", fault.node)
        self._check("receiver", fault.receiver)
        wire = self._medium.wire
        active = wire.disturb(
            Disturbance(
                sender=fault.node,
                receiver=fault.receiver,
                identifier=fault.id,
                extended=fault.extended,
                frames=fault.frames,
                chance=fault.chance,
                start_ns=start_ns,
                end_ns=end_ns,
                seed=zlib.crc32(name.encode()) if fault.seed is None else fault.seed,
            )
        )
        return lambda: wire.calm(active), lambda: active.hits

    def _turn_off(
        self, fault: BusOff, start_ns: int, end_ns: int | None
    ) -> tuple[Callable[[], None], Callable[[], int]]:
        self._check("node", fault.node)
        wire = self._medium.wire
        wire.hold_off(fault.node, start_ns, FOREVER if end_ns is None else end_ns)
        return lambda: wire.release(fault.node, self._medium.now_ns()), lambda: 1

    def _flood(
        self, fault: BusFlood, name: str, start_ns: int, end_ns: int | None
    ) -> tuple[Callable[[], None], Callable[[], int]]:
        wire = self._medium.wire
        record = frame(fault.id, b"\xff" * fault.length, flags=EXTENDED if fault.extended else 0)
        nominal = bits_of(record)[0, 0]
        busy_ns = wire.timing.bits_ns(int(nominal) + INTERMISSION)
        period_ns = 0 if fault.load >= 1.0 else round(busy_ns / fault.load)
        flooding = wire.flood(name, Flood(record.tobytes(), period_ns, start_ns, end_ns))
        return lambda: wire.end_flood(flooding), lambda: flooding.node.sent
