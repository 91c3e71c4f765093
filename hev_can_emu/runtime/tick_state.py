"""All that a run changes, laid out in one buffer: a snapshot is a copy of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import (
    control,
    fault_table,
    plant_faults,
    ports,
    reasons,
    supervision,
)
from hev_can_emu.ecu.fault_table import FaultTable
from hev_can_emu.ecu.frame_faults import HELD_FRAMES
from hev_can_emu.ecu.ties import (
    OWNER_EMULATED,
    OWNER_EXTERNAL,
    ROLE_CONTROLLER,
    ResolvedBindings,
)
from hev_can_emu.ecu.trouble_codes import COLUMNS as CODE_COLUMNS
from hev_can_emu.jit import uncompiled
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.frame import FRAME, make_frames
from hev_can_emu.messages.restbus import new_wake, restbus_state_size
from hev_can_emu.messages.transfer import receive_state_size
from hev_can_emu.plant import driveline, powertrain
from hev_can_emu.plant.columns import CACHE_LINE, aligned, filled_up
from hev_can_emu.plant.events import EVENT
from hev_can_emu.runtime import tick
from hev_can_emu.runtime.tick import Constants, State

FRAMES_OUT = 8192
EVENTS = 4096
LOOKS = 512  #: samples of the plant's truth that a call can give


def allocate(
    constants: Constants, origin: npt.NDArray[np.uint8], plant_size: int, work: int
) -> tuple[npt.NDArray[np.uint8], State]:
    """Lay the whole state out in one buffer; return it and the views."""
    messages = len(origin)
    with uncompiled():
        room = tick.faulty_room(messages)
    signals = constants.codec.signals.shape[0]
    nodes = len(constants.follows_ignition)
    tcu_state = 0
    if constants.unit is not None:
        from hev_can_emu.ecu.transmission_unit import N_STATE as tcu_state
    i8, f8, u1 = np.dtype(np.int64), np.dtype(np.float64), np.dtype(np.uint8)
    layout: dict[str, tuple[np.dtype[np.generic], tuple[int, ...]]] = {
        "scalars": (i8, (tick.N_SCALARS,)),
        "plant_n": (i8, (driveline.N_INTEGERS,)),
        "transmit": (i8, (restbus_state_size(constants.restbus),)),
        "wake": (i8, new_wake(messages).shape),
        "receive": (i8, (receive_state_size(constants.codec),)),
        "supervision": (i8, (messages, supervision.COLUMNS)),
        "seen_ns": (i8, (signals,)),
        "power": (i8, (nodes,)),
        "power_since_ns": (i8, (nodes,)),
        "plant_x": (f8, (plant_size,)),
        "truth": (f8, (len(powertrain.TRUTH),)),
        "command": (f8, (len(powertrain.COMMANDS),)),
        "requests": (f8, (len(ports.REQUESTS),)),
        "kept": (f8, (len(ports.REQUESTS),)),
        "effective": (f8, (len(ports.REQUESTS),)),
        "share": (f8, (len(ports.REQUESTS),)),
        "limited": (f8, (len(ports.REQUESTS),)),
        "slewed": (f8, (len(constants.rules.slew_tie),)),
        "codes": (i8, (messages, len(reasons.FAILURES), CODE_COLUMNS)),
        "statuses": (f8, (len(ports.STATUSES),)),
        "sensed": (f8, (len(constants.sensors.port),)),
        "health": (f8, (plant_faults.N_HEALTH,)),
        "unit_state": (f8, (control.N_STATE,)),
        "transmission": (f8, (tcu_state,)),
        "values": (f8, (signals,)),
        "encoded": (f8, (signals,)),
        "on_bus": (f8, (signals,)),
        "work": (f8, (work,)),
        "origin": (u1, (messages,)),
        "muted": (u1, (messages,)),
        "enabled": (u1, (messages,)),
        "accept": (u1, (messages,)),
        "told": (u1, (messages,)),
        "pending": (FRAME, (room,)),
        "fault_whole": (i8, (fault_table.SLOTS, fault_table.WHOLE_COLUMNS)),
        "fault_real": (f8, (fault_table.SLOTS, fault_table.REAL_COLUMNS)),
        "fault_counts": (i8, (fault_table.N_COUNTS,)),
        "held": (FRAME, (HELD_FRAMES,)),
        "held_row": (i8, (HELD_FRAMES, 2)),
    }
    # Each begins where a cache line does.
    sizes = {
        name: filled_up(int(np.prod(shape)) * kind.itemsize, CACHE_LINE)
        for name, (kind, shape) in layout.items()
    }
    buffer = aligned(sum(sizes.values()) // 8).view(np.uint8)
    views, at = {}, 0
    for name, (kind, shape) in layout.items():
        length = int(np.prod(shape)) * kind.itemsize
        views[name] = buffer[at : at + length].view(kind).reshape(shape)
        at += sizes[name]
    faults = FaultTable(*(views.pop(f"fault_{name}") for name in FaultTable._fields))
    state = State(
        **views,
        faults=faults,
        frames_out=make_frames(max(FRAMES_OUT, room)),
        scratch=make_frames(messages + HELD_FRAMES),
        events=np.zeros(EVENTS, dtype=EVENT),
        result=np.zeros(5, dtype=np.int64),
        due=np.zeros(messages, dtype=np.int64),
        looks=np.zeros((LOOKS, len(powertrain.TRUTH))),
        looks_ns=np.zeros(LOOKS, dtype=np.int64),
        looking=np.zeros(1, dtype=np.int64),
    )
    state.origin[:] = origin
    state.accept[:] = origin == tick.ORIGIN_BUS
    return buffer, state


def origins(
    database: Database, ties: ResolvedBindings, owners: list[int], driver_nodes: set[int]
) -> npt.NDArray[np.uint8]:
    """Say for each message who sends it: a unit, a played node, somebody on the bus, nobody."""
    origin = np.zeros(len(database.messages), dtype=np.uint8)
    for message, node in enumerate(ties.message_node):
        if node < 0:
            continue
        if owners[node] == OWNER_EXTERNAL:
            origin[message] = tick.ORIGIN_BUS
        elif owners[node] == OWNER_EMULATED:
            plays = ties.node_role[node] == ROLE_CONTROLLER or int(node) in driver_nodes
            origin[message] = tick.ORIGIN_PLAYED if plays else tick.ORIGIN_UNIT
    return origin
