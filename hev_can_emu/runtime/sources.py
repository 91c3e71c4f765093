"""What a scenario can look at in an emulator: its network, the plant's truth, its events."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hev_can_emu.ecu import fault_table, faults, supervision
from hev_can_emu.plant import driveline, powertrain
from hev_can_emu.plant.truth_units import truth_unit
from hev_can_emu.runtime import tick
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.event_texts import LOCKS, MODE_NAMES, PHASES
from hev_can_emu.scenario.place import Place
from hev_can_emu.scenario.signals import Signals
from hev_can_emu.scenario.sources import EventKind, Sources, Truth, no_profile
from hev_can_emu.units import unit


def sources_of(emulator: Emulator, profile: Callable[[str, Place], str] = no_profile) -> Sources:
    """Return what there is; ``profile`` reads the CSV files that a scenario names."""

    def fault(mapping: Mapping[str, object], place: Place) -> tuple[str, object]:
        found = faults.parse(mapping, str(place))
        emulator.check_fault(found, str(place))
        return found.label, found

    messages = {message.name: message.index for message in emulator.database.messages}
    return Sources(
        signals=Signals(emulator.database.messages),
        truths={
            name: Truth(index, unit(written) if (written := truth_unit(name)) else None)
            for index, name in enumerate(powertrain.TRUTH)
        },
        events={
            "lock": EventKind(driveline.LOCKED, _numbered(LOCKS)),
            "release": EventKind(driveline.RELEASED, _numbered(LOCKS)),
            "reverse": EventKind(driveline.REVERSED, _numbered(LOCKS)),
            "lost": EventKind(supervision.LOST, messages),
            "healed": EventKind(supervision.HEALED, messages),
            "conflict": EventKind(tick.CONFLICT, messages),
            "mode": EventKind(tick.MODE_CHANGED, _numbered(MODE_NAMES)),
            "synchronizer": EventKind(tick.SYNC_CHANGED, _numbered(PHASES), by_value=True),
            "fault": EventKind(fault_table.BEGAN, {}),
            "fault_over": EventKind(fault_table.OVER, {}),
        },
        profile=profile,
        fault=fault,
    )


def _numbered(names: tuple[str, ...]) -> dict[str, int]:
    return {name: number for number, name in enumerate(names)}
