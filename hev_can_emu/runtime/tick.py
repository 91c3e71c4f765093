"""The tick: the one compiled call between frames in and frames out.

The order of events at tick k (t = k ms) is this function, top to bottom: faults begin and end; frames
received at or before t (those this program sent itself in the last tick first, then the bus's, in order of
arrival); supervision; the units' control; sampling and sending what is due at t, by identifier; the
plant to t + 1 ms.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import ports
from hev_can_emu.ecu.control import IGNITION_ON, commands_from_requests
from hev_can_emu.ecu.fault_table import HELD, LIVE, FaultTable, advance_rows, control_rows
from hev_can_emu.ecu.frame_faults import (
    BABBLED_FRAMES,
    HELD_FRAMES,
    MOST_COPIES,
    pass_frame,
    pass_sent,
    release_frames,
    resume_counters,
    silence_nodes,
)
from hev_can_emu.ecu.plant_faults import fault_commands, fault_statuses
from hev_can_emu.ecu.reporting import MOTOR_INIT, statuses_from_truth, supervision_limits
from hev_can_emu.ecu.rules import Rules
from hev_can_emu.ecu.sensors import Sensors, measure
from hev_can_emu.ecu.supervision import REFUSED as SUP_REFUSED
from hev_can_emu.ecu.supervision import begin_cycle, is_taken, take_message, watch
from hev_can_emu.ecu.ties import ResolvedBindings, message_from_statuses, sent_value
from hev_can_emu.ecu.trouble_codes import count_codes
from hev_can_emu.jit import inlined_kernel, inner_kernel, kernel
from hev_can_emu.messages.codec import Codec, decode, find_message
from hev_can_emu.messages.columns import M_COUNT, M_FIRST, M_WIRE_LENGTH
from hev_can_emu.messages.frame import ERROR, EXTENDED, REMOTE, SENT, make_frames
from hev_can_emu.messages.protection import LENGTH_WRONG, Protection, is_accepted
from hev_can_emu.messages.quick import show_signals
from hev_can_emu.messages.restbus import Restbus, awake
from hev_can_emu.messages.transfer import receive, transmit_these
from hev_can_emu.moves import fill_integers
from hev_can_emu.native import Bound
from hev_can_emu.plant.events import note
from hev_can_emu.plant.powertrain import Y_SYNC_PHASE, Plant
from hev_can_emu.runtime.fidelity import advance_plant
from hev_can_emu.scenario.script import EVENTS as AWAITED_EVENTS
from hev_can_emu.scenario.script import GO_ON, Script, mark_events, perform

if TYPE_CHECKING:  # slow to import, and most runs have a simpler plant
    from hev_can_emu.ecu.transmission_unit import TransmissionUnit
    from hev_can_emu.plant.detailed_layout import DetailedPlant

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.uint8]
Frames = npt.NDArray[np.void]

TICK_NS = 1_000_000

# Kinds of message origin.
ORIGIN_NONE, ORIGIN_UNIT, ORIGIN_PLAYED, ORIGIN_BUS = 0, 1, 2, 3
# Power of an emulated node.
ASLEEP, BOOTING, AWAKE, AFTERRUN = 0, 1, 2, 3

# Scalars of the int64 state.
TICKS, PENDING, UNKNOWN, CONFLICTS, RECEIVED, SENT_FRAMES, FAILED, REFUSED, LAST_MODE = range(9)
WIRED = (
    9  #: 1: what this program sends acts, and is seen, when it comes back from the bus marked SENT
)
OPERATING, CODES_ACTIVE, CODES_CONFIRMED = 10, 11, 12
RECHECK = 13  #: 1: who sends what is looked at anew in the next tick
SETTLED = 14  #: 1: no node boots or falls asleep with ignition off, 2: with ignition on
CALM_NS = 15  #: until then, supervision has nothing to do unless a frame brings news
NEWS = 16  #: 1: a frame came that supervision must see
STEADY = 17  #: 1: the commands stay as they are unless supervision changes what acts
LIMITS = 18  #: 1: supervision limits a request, or misses one
N_SCALARS = 19

MODE_CHANGED, SYNC_CHANGED, CONFLICT = 20, 21, 22  #: kinds of events


class Constants(NamedTuple):
    """What a run does not change: network tables and plant; ``unit`` is the detailed plant's TCU.

    ``follows_ignition``: uint8 (nodes); ``boot_ns``, ``afterrun_ns``: time from ignition on to valid
    values, and from ignition off to silence; ``restless``: 1 where a sensor measures what supervision
    or a request tells, which is then told anew in each tick.
    """

    codec: Codec
    protection: Protection
    restbus: Restbus
    ties: ResolvedBindings
    rules: Rules
    plant: Plant | DetailedPlant
    unit: TransmissionUnit | None
    follows_ignition: Flags
    boot_ns: int
    afterrun_ns: int
    protection_mode: int
    model: int
    tyre_radius: float
    brake_max: float
    clutch_max: float
    force_max: float
    prepared: int
    sensors: Sensors
    restless: int


class State(NamedTuple):
    """What a run changes; all arrays but the results are views of one buffer.

    ``origin``: uint8 (messages), ORIGIN_*; ``muted``: uint8 (messages), 1 stops a message;
    ``told``: 1 once a second sender of the message was told of;
    ``values``: signals to send; ``encoded``: as last encoded; ``on_bus``: signals as last seen on the bus;
    ``seen_ns``: when; ``held`` and ``held_row``: frames that faults hold back;
    ``sensed``: the sensors' filters; ``health``: what the units know of their machines' faults;
    ``codes``: trouble codes.
    ``frames_out``, ``events`` and ``result`` carry a call's results, ``looks`` and ``looks_ns`` the plant's
    truth at some ticks, every ``looking[0]``-th, none for 0; ``scratch`` is where frames pass
    faults, ``due`` the messages that are sent; they are no part of a snapshot.
    """

    scalars: Integers
    plant_n: Integers
    transmit: Integers
    wake: Integers
    receive: Integers
    supervision: Integers
    seen_ns: Integers
    power: Integers
    power_since_ns: Integers
    plant_x: Array
    truth: Array
    command: Array
    requests: Array
    kept: Array
    effective: Array
    share: Array
    limited: Array
    slewed: Array
    codes: Integers
    statuses: Array
    sensed: Array
    health: Array
    unit_state: Array
    transmission: Array
    values: Array
    encoded: Array
    on_bus: Array
    work: Array
    origin: Flags
    muted: Flags
    enabled: Flags
    accept: Flags
    told: Flags
    pending: Frames
    faults: FaultTable
    held: Frames
    held_row: Integers
    frames_out: Frames
    scratch: Frames
    events: Frames
    result: Integers
    due: Integers
    looks: Array
    looks_ns: Integers
    looking: Integers


@inner_kernel
def _mark_seen(codec: Codec, seen_ns: Integers, message: int, t_ns: int) -> None:
    first = codec.messages[message, M_FIRST]
    fill_integers(seen_ns, first, codec.messages[message, M_COUNT], t_ns)


@inlined_kernel
def _take_frame(
    constants: Constants, state: State, frames: Frames, i: int, accept: Flags, t_ns: int
) -> None:
    """Receive one frame: decode, check, supervise."""
    message, code = receive(
        constants.codec, constants.protection, state.receive, accept,
        constants.protection_mode, frames, i, state.on_bus,
    )  # fmt: skip
    if message < 0:
        return
    mode = constants.protection_mode
    refused = state.supervision[message, SUP_REFUSED]
    if code != LENGTH_WRONG and not is_accepted(code, mode) and (
        is_taken(constants.rules, message, code, mode)
    ):  # fmt: skip
        decode(constants.codec, message, frames[i]["data"], state.on_bus)
    if take_message(
        constants.ties, constants.rules, state.supervision, message, code, mode, state.on_bus,
        state.requests, state.statuses, t_ns,
    ):  # fmt: skip
        state.scalars[NEWS] = 1
    state.scalars[REFUSED] += state.supervision[message, SUP_REFUSED] - refused
    command = state.requests[ports.FAULT_COMMAND]
    if command > 0.0:
        control_rows(
            state.faults, command, state.requests[ports.FAULT_NUMBER], constants.prepared, t_ns
        )
        state.requests[ports.FAULT_COMMAND] = np.nan
    _mark_seen(constants.codec, state.seen_ns, message, t_ns)


@inner_kernel
def _take_rare(
    constants: Constants, state: State, frames: Frames, i: int, accept: Flags, t_ns: int
) -> None:
    """Do the same where the way is not so often taken that its code should stand there."""
    _take_frame(constants, state, frames, i, accept, t_ns)


@kernel
def count_into(codes: Integers, scalars: Integers) -> None:
    """Count the trouble codes that fail now and those that are confirmed."""
    scalars[CODES_ACTIVE], scalars[CODES_CONFIRMED] = count_codes(codes)


@inner_kernel
def _take_faulty(
    constants: Constants,
    state: State,
    frames: Frames,
    i: int,
    message: int,
    t_ns: int,
    n_events: int,
) -> Any:
    """Receive one frame of another node through the injected faults; return the number of events."""
    single = state.scratch[:1]
    single[0] = frames[i]
    copies, n_events = pass_frame(
        constants.codec, constants.protection, state.faults, state.held, state.held_row, single,
        message, constants.ties.message_node[message], t_ns, state.events, n_events,
    )  # fmt: skip
    for _ in range(copies):
        _take_rare(constants, state, single, 0, state.accept, t_ns)
    if copies > 0 and state.faults.counts[HELD] > 0:
        _take_late(constants, state, message, t_ns)
    return n_events


@inner_kernel
def _take_late(constants: Constants, state: State, message: int, t_ns: int) -> None:
    """Receive what faults held back: until now, or (``message`` >= 0) until its next frame."""
    late = release_frames(
        state.faults, state.held, state.held_row, t_ns, message, 0, state.scratch, 0
    )
    for i in range(late):
        _take_rare(constants, state, state.scratch, i, state.accept, t_ns)


@inner_kernel
def _sent_message(codec: Codec, frames: Frames, i: int) -> Any:
    return find_message(codec, frames[i]["id"], np.int64(frames[i]["flags"]) & EXTENDED)


@inner_kernel
def _show_faulty(constants: Constants, state: State, i: int, message: int) -> None:
    """Let ``on_bus`` tell what a frame sent tells; nobody reads one of a wrong length."""
    codec = constants.codec
    if np.int64(state.frames_out[i]["length"]) == codec.messages[message, M_WIRE_LENGTH]:
        decode(codec, message, state.frames_out[i]["data"], state.on_bus)


@inner_kernel
def _take_own(constants: Constants, state: State, frames: Frames, i: int, t_ns: int) -> None:
    """Take a frame that this program sent and that has been on the bus."""
    codec = constants.codec
    flags = np.int64(frames[i]["flags"])
    message = find_message(codec, frames[i]["id"], flags & EXTENDED)
    if message < 0:
        return
    if state.origin[message] == ORIGIN_PLAYED:
        single = state.scratch[:1]
        single[0] = frames[i]
        single[0]["flags"] = flags & ~SENT
        _take_rare(constants, state, single, 0, state.enabled, t_ns)
    elif state.origin[message] == ORIGIN_UNIT:
        _mark_seen(codec, state.seen_ns, message, t_ns)
        if np.int64(frames[i]["length"]) == codec.messages[message, M_WIRE_LENGTH]:
            decode(codec, message, frames[i]["data"], state.on_bus)


@inner_kernel
def _power_nodes(constants: Constants, state: State, t_ns: int) -> None:
    """Nodes boot and fall asleep with the ignition; a message is enabled while its sender is up."""
    on = state.effective[ports.IGNITION] >= IGNITION_ON
    changed = state.scalars[RECHECK] != 0
    if state.scalars[SETTLED] == (2 if on else 1) and not changed:
        return
    settled = True
    for node in range(state.power.shape[0]):
        phase = state.power[node]
        since = t_ns - state.power_since_ns[node]
        new = phase
        if constants.follows_ignition[node] == 0:
            new = AWAKE
        elif on and phase in (ASLEEP, AFTERRUN):
            new = BOOTING if phase == ASLEEP else AWAKE
        elif on and phase == BOOTING and since >= constants.boot_ns:
            new = AWAKE
        elif not on and phase in (BOOTING, AWAKE):
            new = AFTERRUN
        elif not on and phase == AFTERRUN and since >= constants.afterrun_ns:
            new = ASLEEP
        if new != phase:
            state.power[node] = new
            state.power_since_ns[node] = t_ns
            changed = True
        if new in (BOOTING, AFTERRUN):
            settled = False
    state.scalars[SETTLED] = (2 if on else 1) if settled else 0
    if not changed:
        return
    state.scalars[RECHECK] = 0
    for message in range(state.origin.shape[0]):
        enabled = 0
        if state.muted[message] == 0:
            if state.origin[message] == ORIGIN_PLAYED:
                enabled = 1
            elif state.origin[message] == ORIGIN_UNIT:
                enabled = 1 if state.power[constants.ties.message_node[message]] != ASLEEP else 0
        state.enabled[message] = enabled


@inner_kernel
def _fill_values(constants: Constants, state: State, count: int) -> None:
    """Statuses become signals of what may be sent now; a booting node knows only that it boots."""
    for i in range(count):
        message = state.due[i]
        if state.origin[message] != ORIGIN_UNIT or state.enabled[message] == 0:
            continue
        if state.power[constants.ties.message_node[message]] == BOOTING:
            first = constants.codec.messages[message, M_FIRST]
            for signal in range(first, first + constants.codec.messages[message, M_COUNT]):
                state.values[signal] = np.nan
            for tie in range(
                constants.ties.tx_start[message], constants.ties.tx_start[message + 1]
            ):
                if constants.ties.tx_port[tie] in (ports.S_EM1_STATE, ports.S_EM2_STATE):
                    state.values[constants.ties.tx_signal[tie]] = sent_value(
                        constants.ties, tie, float(MOTOR_INIT)
                    )
        else:
            message_from_statuses(constants.ties, message, state.statuses, state.values)


@kernel
def faulty_room(messages: int) -> int:
    """Return how many frames a tick may send while faults copy, release and babble."""
    return messages * (MOST_COPIES + 1) + HELD_FRAMES + BABBLED_FRAMES


@inner_kernel
def run_ticks(
    constants: Constants,
    state: State,
    script: Script,
    ticks: int,
    frames_in: Frames,
    n_in: int,
) -> Any:
    """Advance by up to ``ticks`` ticks.

    Args:
        constants, state: see there; what is sent goes to ``state.frames_out``, what happens to
            ``state.events``, and ``state.result`` tells how many: frames sent, frames taken from
            ``frames_in``, events, ticks done, looks at the truth.
        script: what a scenario does at each tick; it may stop before one.
        ticks: how many.
        frames_in: received frames, in order of time; ``n_in`` of them.

    Returns:
        The number of ticks done: fewer than asked for when the script stops, and when ``frames_out``, the
        events or the looks are nearly full.
    """
    frames_out, events, result = state.frames_out, state.events, state.result
    codec = constants.codec
    messages = state.origin.shape[0]
    plant = constants.plant
    plant_x, plant_n, work = state.plant_x, state.plant_n, state.work
    command, truth = state.command, state.truth
    n_out: Any = np.int64(0)
    taken: Any = np.int64(0)
    n_events: Any = np.int64(0)
    done: Any = np.int64(0)
    n_looks: Any = np.int64(0)
    while done < ticks:
        faulty = state.faults.counts[LIVE] > 0 or state.faults.counts[HELD] > 0
        if n_out + (faulty_room(messages) if faulty else messages) > frames_out.shape[0]:
            break
        if 2 * n_events > events.shape[0] or n_looks == state.looks_ns.shape[0]:
            break
        t_ns = state.scalars[TICKS] * TICK_NS
        if perform(script, t_ns, state.on_bus, state.seen_ns, state.truth, state.values) != GO_ON:
            break
        if state.looking[0] > 0 and state.scalars[TICKS] % state.looking[0] == 0:
            state.looks_ns[n_looks] = t_ns
            for i in range(truth.shape[0]):
                state.looks[n_looks, i] = truth[i]
            n_looks += 1
        n_before = n_events
        if faulty:
            n_events = advance_rows(state.faults, t_ns, events, n_events)
            resume_counters(state.faults, state.transmit)
            _take_late(constants, state, -1, t_ns)

        # Frames of played nodes come back as any receiver sees them.
        for i in range(state.scalars[PENDING]):
            _take_frame(constants, state, state.pending, i, state.enabled, t_ns)
        state.scalars[PENDING] = 0
        while taken < n_in and frames_in[taken]["t_ns"] <= t_ns:
            flags = np.int64(frames_in[taken]["flags"])
            if flags & SENT != 0 and state.scalars[WIRED] != 0:
                _take_own(constants, state, frames_in, taken, t_ns)
            else:
                state.scalars[RECEIVED] += 1
            if flags & (REMOTE | ERROR | SENT) == 0:
                message = find_message(codec, frames_in[taken]["id"], flags & EXTENDED)
                if message < 0:
                    state.scalars[UNKNOWN] += 1
                elif state.origin[message] == ORIGIN_UNIT or (
                    state.origin[message] == ORIGIN_PLAYED and state.muted[message] == 0
                ):
                    # Somebody else sends what is ours: told, never obeyed.
                    if state.told[message] == 0:
                        state.told[message] = 1
                        n_events = note(events, n_events, t_ns, CONFLICT, message, 0.0)
                    state.scalars[CONFLICTS] += 1
                elif faulty and state.accept[message] != 0:
                    n_events = _take_faulty(
                        constants, state, frames_in, taken, message, t_ns, n_events
                    )
                else:
                    # What is silenced here, another may send.
                    silenced = state.origin[message] == ORIGIN_PLAYED
                    accept = state.muted if silenced else state.accept
                    _take_frame(constants, state, frames_in, taken, accept, t_ns)
            taken += 1

        operating = 1 if state.requests[ports.IGNITION] >= IGNITION_ON else 0
        recount = False
        if operating != state.scalars[OPERATING]:
            state.scalars[OPERATING] = operating
            if operating == 1:
                begin_cycle(state.supervision, state.codes, t_ns)
                recount = True
        calm = t_ns <= state.scalars[CALM_NS] and constants.restless == 0
        fresh = state.scalars[NEWS] != 0 or recount or faulty or not calm
        if fresh:
            state.scalars[NEWS] = 0
            failed, n_events, changed, calm_ns = watch(
                constants.ties, constants.rules, state.supervision, state.requests, state.kept,
                state.effective, state.share, state.limited, state.slewed, state.statuses,
                state.codes, operating == 1, t_ns, events, n_events,
            )  # fmt: skip
            if changed or recount:
                count_into(state.codes, state.scalars)
            # Faults write into the statuses, too.
            state.scalars[CALM_NS] = -1 if faulty else calm_ns
            state.scalars[FAILED] = failed
            limits = supervision_limits(state.limited, state.statuses)
            state.scalars[LIMITS] = 1 if limits else 0
        failed = state.scalars[FAILED]
        refused = state.scalars[REFUSED]
        if fresh or state.scalars[STEADY] == 0:
            steady = commands_from_requests(
                state.effective, state.share, state.statuses, state.truth, constants.brake_max,
                state.unit_state, state.command,
            )  # fmt: skip
            state.scalars[STEADY] = 1 if steady else 0
        if faulty:
            fault_commands(
                state.faults, state.command, state.truth, constants.clutch_max,
                constants.force_max, state.health,
            )  # fmt: skip
        statuses_from_truth(
            state.truth, state.command, state.requests, state.limited, constants.tyre_radius,
            constants.model, failed, refused, fresh, state.scalars[LIMITS] != 0, state.statuses,
        )  # fmt: skip
        state.statuses[ports.S_TROUBLE_CODES_ACTIVE] = state.scalars[CODES_ACTIVE]
        state.statuses[ports.S_TROUBLE_CODES_CONFIRMED] = state.scalars[CODES_CONFIRMED]
        measure(constants.sensors, state.sensed, state.statuses)
        if faulty:
            fault_statuses(state.faults, state.health, state.statuses)
        mode = int(state.statuses[ports.S_DRIVING_MODE])
        if mode != state.scalars[LAST_MODE]:
            state.scalars[LAST_MODE] = mode
            n_events = note(events, n_events, t_ns, MODE_CHANGED, mode, 0.0)
        _power_nodes(constants, state, t_ns)
        count = awake(constants.restbus, state.wake, t_ns, state.due)
        _fill_values(constants, state, count)
        if faulty:
            silence_nodes(state.faults, constants.ties.message_node, state.enabled)
            state.scalars[RECHECK] = 1

        first = n_out
        n_out = transmit_these(
            codec, constants.protection, constants.restbus, state.transmit, state.enabled,
            state.values, state.encoded, t_ns, frames_out, n_out, state.due, count, state.wake,
        )  # fmt: skip
        if faulty:
            n_out, n_events = pass_sent(
                codec, constants.protection, constants.ties.message_node, state.faults, state.held,
                state.held_row, state.scratch, frames_out, first, n_out, t_ns, events, n_events,
            )  # fmt: skip
            resume_counters(state.faults, state.transmit)
        state.scalars[SENT_FRAMES] += n_out - first
        for i in range(first, n_out):
            if state.scalars[WIRED] != 0:
                break
            message = state.due[i - first] if not faulty else _sent_message(codec, frames_out, i)
            if message < 0:
                continue
            if faulty:
                _mark_seen(codec, state.seen_ns, message, t_ns)
                _show_faulty(constants, state, i, message)
            else:
                show_signals(
                    state.encoded, state.on_bus, state.seen_ns, codec.messages[message, M_FIRST],
                    codec.messages[message, M_COUNT], t_ns,
                )  # fmt: skip
            if state.origin[message] == ORIGIN_PLAYED and (
                state.scalars[PENDING] < state.pending.shape[0]
            ):
                slot = state.scalars[PENDING]
                state.pending[slot] = frames_out[i]
                state.pending[slot]["flags"] = np.int64(frames_out[i]["flags"]) & ~SENT
                state.scalars[PENDING] = slot + 1

        phase = state.statuses[ports.S_SYNCHRONIZER_STATE]
        n_events = advance_plant(
            plant, constants.unit, state.transmission, plant_x, plant_n, command, truth, work,
            t_ns, events, n_events,
        )  # fmt: skip
        if state.truth[Y_SYNC_PHASE] != phase:
            n_events = note(
                events, n_events, t_ns + TICK_NS, SYNC_CHANGED, 0, state.truth[Y_SYNC_PHASE]
            )
        if script.control[AWAITED_EVENTS] > 0:
            mark_events(script, events, n_before, n_events)
        state.scalars[TICKS] += 1
        done += 1
    result[0], result[1], result[2], result[3], result[4] = n_out, taken, n_events, done, n_looks
    return done


LONG = 200  #: ticks from which on a call lets other threads run


def make_world(constants: Constants, state: State, script: Script) -> Bound:
    """Return all as one argument for :func:`run_world`."""
    # Unpacking a hundred arrays from tuples at each call would cost more than the tick itself.
    return Bound(run_ticks, (constants, state, script), (1, make_frames(1), 1))


def run_world(world: Bound, ticks: int, frames_in: Frames, n_in: int) -> int:
    """Advance as :func:`run_ticks` does, with what :func:`make_world` made."""
    return world(ticks, frames_in, n_in, release=ticks >= LONG)
