"""The emulator: frames in, time, frames out.  Synchronous, no I/O, no clock."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from hev_can_emu.ecu import (
    control,
    ports,
    reporting,
    supervision,
)
from hev_can_emu.ecu.fault_rows import Network
from hev_can_emu.ecu.faults import BUS_FAULTS, Fault
from hev_can_emu.ecu.network import complete
from hev_can_emu.ecu.rules import resolve_rules
from hev_can_emu.ecu.sensors import resolve_sensors
from hev_can_emu.ecu.ties import (
    OWNER_EMULATED,
    OWNER_EXTERNAL,
    ROLE_CONTROLLER,
    ResolvedBindings,
    with_ownership,
)
from hev_can_emu.ecu.trouble_codes import (
    TroubleCode,
    read_codes,
    reset_codes,
    write_codes,
)
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.jit import uncompiled
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.definitions import SignalDef
from hev_can_emu.messages.frame import make_frames
from hev_can_emu.messages.frame_copy import copy_frames
from hev_can_emu.messages.restbus import (
    T_COLUMNS,
    T_SATURATED,
    new_wake,
    reset_restbus,
)
from hev_can_emu.messages.transfer import reset_receive
from hev_can_emu.native import Bound
from hev_can_emu.plant import powertrain
from hev_can_emu.plant.holding import MESH_EVENT
from hev_can_emu.plant.start import Start
from hev_can_emu.runtime import tick
from hev_can_emu.runtime.car import Car
from hev_can_emu.runtime.event_texts import TEETH, Event, EventTexts
from hev_can_emu.runtime.fault_book import FaultBook, InjectedFault
from hev_can_emu.runtime.network_cache import cached_database
from hev_can_emu.runtime.network_tables import network_tables, network_ties
from hev_can_emu.runtime.setup import (
    MODELS,
    PROTECTION_MODES,
    Setup,
    network_files,
    prepared_faults,
)
from hev_can_emu.runtime.tick import TICK_NS, Constants, make_world, run_world
from hev_can_emu.runtime.tick_state import allocate, origins
from hev_can_emu.scenario.script import GO_ON, STOPPED, Script, no_script

if TYPE_CHECKING:
    from hev_can_emu.plant.ledger import Ledger

BOOT_NS = control.BOOT_TICKS * TICK_NS
AFTERRUN_NS = control.AFTERRUN_TICKS * TICK_NS
TRUTH_NS = 10_000_000  #: from one to the next

_DRIVER_PORTS = (
    ports.ACCELERATOR,
    ports.BRAKE_PEDAL,
    ports.SELECTOR,
    ports.IGNITION,
    ports.ROAD_GRADE,
    ports.AMBIENT_TEMPERATURE,
)
#: Takes samples of the plant's truth, both its own: int64 (n,) and float64 (n, len(TRUTH)).
TruthSink = Callable[[npt.NDArray[np.int64], npt.NDArray[np.float64]], None]


class BusFaults(Protocol):
    """What a bus with bit times does with the faults that are its own."""

    def inject(self, fault: Fault, now_ns: int) -> str:
        """Begin a fault; return its name."""

    def clear(self, name: str, now_ns: int) -> bool:
        """End the fault of that name; return whether there is one."""

    def records(self, now_ns: int) -> tuple[InjectedFault, ...]:
        """Return all that were injected."""


class Emulator:
    """A car with its control units on a network.

    Args:
        setup: what to build.

    Raises:
        InputError: a file or choice cannot be used.

    Attributes:
        database: the network.
        on_bus: signals as last seen on the bus, physical values in the DBC's units, NaN not available.
        seen_ns: time of each signal's last frame, -1 never.
    """

    def __init__(self, setup: Setup | None = None) -> None:
        self.setup = setup or Setup()
        self.setup.check()
        self._car = Car(self.setup)
        self.vehicle_name, self.provenance = self._car.name, self._car.provenance
        dbc, document, bindings = network_files(self.setup)
        self.database: Database = complete(
            bindings, cached_database(dbc, bindings.leave_out), document.where
        )
        ties = network_ties(bindings, self.database, document.where)
        self.node_names = tuple(bindings.nodes)
        driver_nodes = self._nodes_with(ties, _DRIVER_PORTS)
        owners = self._owners(ties)
        self.origin = origins(self.database, ties, owners, driver_nodes)
        # A played node's frames are received like anybody's, so its ties must count.
        played = {node: OWNER_EXTERNAL for node in driver_nodes if owners[node] == OWNER_EMULATED}
        ties = with_ownership(ties, {**dict(enumerate(owners)), **played})
        awake_always = driver_nodes | self._nodes_sending(ties, ports.S_DRIVING_MODE)
        controlled = ports.FAULT_COMMAND in ties.rx_port
        if self.setup.faults is not None and not controlled:
            hint = "bind one to the port 'fault_command'"
            raise InputError(
                "--faults", "a message that injects faults", "none in the network", hint
            )
        faults, locate_fault = prepared_faults(self.setup) if controlled else ((), str)
        codec, protection, restbus = network_tables(self.database)
        sensors = resolve_sensors(bindings.sensors, document.where)
        self.constants = Constants(
            codec=codec,
            protection=protection,
            restbus=restbus,
            ties=ties,
            rules=resolve_rules(bindings, self.database, ties, document.where),
            plant=self._car.plant,
            unit=self._car.unit,
            follows_ignition=np.array(
                [node not in awake_always for node in range(len(self.node_names))], dtype=np.uint8
            ),
            boot_ns=BOOT_NS,
            afterrun_ns=AFTERRUN_NS,
            protection_mode=PROTECTION_MODES.index(self.setup.protection),
            model=MODELS.index(self.setup.model),
            tyre_radius=self._car.tyre_radius,
            brake_max=self._car.brake_max,
            clutch_max=self._car.clutch_max,
            force_max=self._car.force_max,
            prepared=len(faults),
            sensors=sensors,
            restless=int(np.isin(sensors.port, [*ties.status_port, *reporting.ECHOES[:, 0]]).any()),
        )
        begin = Start(
            state_of_charge=self.setup.state_of_charge, closed=self.setup.start == "ready"
        )
        x, n, truth = self._car.start(begin)
        self._buffer, self.state = allocate(self.constants, self.origin, len(x), self._car.work)
        self.state.plant_x[:], self.state.plant_n[:], self.state.truth[:] = x, n, truth
        network = Network(self.database, self.node_names, ties.message_node.tolist(), 0)
        self._book = FaultBook(self.state.faults, network, lambda: self.now_ns)
        self._book.prepare(faults, locate_fault)
        self._texts = EventTexts(
            self.database.messages, self.constants.rules.number, self._book.name
        )
        self._start(begin)
        self._script = no_script()
        self._world: Bound | None = None  #: made with the first call, or for a scenario's script
        self._noted: list[Event] = []
        self._truth_sinks: list[TruthSink] = []
        self.bus_faults: BusFaults | None = None  #: takes faults of a bus with bit times
        self._none = make_frames(1)

    # Building

    def _owners(self, ties: ResolvedBindings) -> list[int]:
        owners = [int(owner) for owner in ties.node_ownership]
        known = ("emulated", "external", "silent")
        for name, owner in self.setup.nodes.items():
            if name not in self.node_names:
                hint = did_you_mean(name, self.node_names)
                raise InputError(
                    "--node", f"one of {', '.join(self.node_names)}", f"'{name}'", hint
                )
            owners[self.node_names.index(name)] = known.index(owner)
        return owners

    @staticmethod
    def _nodes_with(ties: ResolvedBindings, wanted: Iterable[int]) -> set[int]:
        """Nodes of emulated role whose frames set one of the driver's and road's ports."""
        found = set()
        for message, node in enumerate(ties.message_node):
            if node < 0 or ties.node_role[node] == ROLE_CONTROLLER:
                continue
            received = ties.rx_port[ties.rx_start[message] : ties.rx_start[message + 1]]
            if np.isin(received, list(wanted)).any():
                found.add(int(node))
        return found

    @staticmethod
    def _nodes_sending(ties: ResolvedBindings, port: int) -> set[int]:
        return {
            int(node)
            for message, node in enumerate(ties.message_node)
            if node >= 0
            and port in ties.tx_port[ties.tx_start[message] : ties.tx_start[message + 1]]
        }

    def _start(self, begin: Start) -> None:
        """Bring the state but the plant's to the start: everything at rest, nothing received."""
        state, constants = self.state, self.constants
        ready = begin.closed
        state.command[:] = np.nan
        for vector in (
            state.requests, state.kept, state.effective, state.values, state.encoded, state.on_bus,
            state.sensed, state.slewed,
        ):  # fmt: skip
            vector[:] = np.nan
        state.share[:] = 1.0
        state.seen_ns[:] = -1
        state.power[:] = tick.AWAKE if ready else tick.ASLEEP
        state.power[constants.follows_ignition == 0] = tick.AWAKE
        state.scalars[tick.LAST_MODE] = ports.MODE_ELECTRIC_NEUTRAL
        state.scalars[tick.RECHECK] = 1
        state.scalars[tick.CALM_NS] = -1
        with uncompiled():
            control.start_units(state.unit_state, ready)
            reset_restbus(constants.restbus, state.transmit, 0)
            state.wake[:] = new_wake(len(self.database.messages))
            reset_receive(constants.codec, state.receive)
            supervision.reset_supervision(state.supervision)
            reset_codes(state.codes)
        if constants.unit is not None:
            from hev_can_emu.ecu.transmission_unit import start_unit

            with uncompiled():
                start_unit(state.transmission)
        state.scalars[tick.OPERATING] = 1 if ready else 0
        inputs = {
            ports.ACCELERATOR: 0.0,
            ports.BRAKE_PEDAL: 0.0,
            ports.SELECTOR: 3.0 if ready else 0.0,
            ports.IGNITION: 2.0 if ready else 0.0,
            ports.ROAD_GRADE: 0.0,
            ports.AMBIENT_TEMPERATURE: begin.temperature,
        }
        for message in self.database.messages:
            if self.origin[message.index] == tick.ORIGIN_PLAYED:
                for signal in message.signals:
                    state.values[signal.index] = _initial(signal)
                self._play_inputs(message.index, inputs)
        for port, value in inputs.items():
            state.requests[port] = state.effective[port] = value

    def _play_inputs(self, message: int, inputs: dict[int, float]) -> None:
        """Let the signals of a played message carry the driver's and road's starting values."""
        ties = self.constants.ties
        for tie in range(ties.rx_start[message], ties.rx_start[message + 1]):
            port = int(ties.rx_port[tie])
            if port not in inputs:
                continue
            value = (inputs[port] - ties.rx_offset[tie]) / ties.rx_gain[tie]
            for i in range(ties.rx_map_start[tie], ties.rx_map_stop[tie]):
                if ties.map_code[i] == inputs[port]:
                    value = ties.map_value[i]
            self.state.values[ties.rx_signal[tie]] = value

    # Running

    @property
    def now_ns(self) -> int:
        """Time of the next tick, ns since the start."""
        return int(self.state.scalars[tick.TICKS]) * TICK_NS

    @property
    def on_bus(self) -> npt.NDArray[np.float64]:
        """Signals as last seen on the bus (a live view)."""
        return self.state.on_bus

    @property
    def seen_ns(self) -> npt.NDArray[np.int64]:
        """Time of each signal's last frame, -1 never (a live view)."""
        return self.state.seen_ns

    def advance(
        self, until_ns: int, frames: npt.NDArray[np.void] | None = None, count: int = 0
    ) -> npt.NDArray[np.void]:
        """Run every tick before ``until_ns`` and return the frames sent.

        Args:
            until_ns: time to stop at; ticks lie on whole milliseconds.
            frames: received frames in order of time (FRAME records).
            count: how many of them.

        Returns:
            FRAME records, valid until the next call where one buffer held them all.

        Raises:
            ValueError: frames later than the last tick; they belong to the next call.
        """
        given = self._none if frames is None else frames
        parts: list[npt.NDArray[np.void]] = []
        taken = 0
        while True:
            sent, used = self.run(until_ns, given[taken:], count - taken)
            taken += used
            if self.now_ns >= until_ns or self._script.control[STOPPED] != GO_ON:
                break
            parts.append(copy_frames(sent))
        if taken < count:
            raise ValueError(f"{count - taken} frames later than the last tick")
        return np.concatenate([*parts, sent]) if parts else sent

    def run(
        self, until_ns: int, frames: npt.NDArray[np.void], count: int
    ) -> tuple[npt.NDArray[np.void], int]:
        """Run ticks before ``until_ns`` as one call, as far as its buffers last and the script lets it.

        Args:
            until_ns: see :meth:`advance`.
            frames, count: see :meth:`advance`.

        Returns:
            The frames sent, valid until the next call, and how many of the given ones were taken.
        """
        ticks = -(-(until_ns - self.now_ns) // TICK_NS)
        if self._world is None:
            self._world = make_world(self.constants, self.state, self._script)
        run_world(self._world, max(ticks, 0), frames if count > 0 else self._none, count)
        sent, used, noted, _, looks = self.state.result.tolist()
        if looks:
            times, values = self.state.looks_ns[:looks].copy(), self.state.looks[:looks].copy()
            for sink in self._truth_sinks:
                sink(times, values)
        if noted:
            told = self.state.events[:noted]
            # A mesh that rattles does so a thousand times a second: that is for the bench.
            mesh = np.isin(told["kind"], TEETH) & (told["index"] >= MESH_EVENT)
            self._noted.extend(self._texts.event(record) for record in told[~mesh])
        return self.state.frames_out[:sent], used

    def watch_truth(self, sink: TruthSink) -> Callable[[], None]:
        """Give a sink the plant's truth before each tick at a multiple of TRUTH_NS, at the end of each call.

        It gets them before the call's frames are known.  Where a call begins and ends changes nothing.

        Returns:
            What ends that, with the truth at that time.
        """
        self._truth_sinks.append(sink)
        self.state.looking[0] = TRUTH_NS // TICK_NS

        def end() -> None:
            if sink in self._truth_sinks:
                self._truth_sinks.remove(sink)
                sink(np.array([self.now_ns], dtype=np.int64), self.state.truth[np.newaxis].copy())
            if not self._truth_sinks:
                self.state.looking[0] = 0

        return end

    @property
    def wired(self) -> bool:
        """Whether what it sends acts, and is seen, only when it is handed back, marked SENT.

        So it is on a bus with bit times, where a frame may be late or lost; elsewhere it is there at once.
        """
        return bool(self.state.scalars[tick.WIRED])

    @wired.setter
    def wired(self, wired: bool) -> None:
        self.state.scalars[tick.WIRED] = wired

    def attach(self, script: Script) -> None:
        """Let a scenario's script act at every tick from now on; it replaces the one before.

        What plays it is compiled then, where that has not been done.
        """
        if script is not self._script or self._world is None:
            self._script = script
            self._world = make_world(self.constants, self.state, script)

    def set_value(self, signal: int, value: float) -> None:
        """Set what a played node sends: physical value in the DBC's unit, NaN for not available."""
        self.state.values[signal] = value

    def send_message(self, message: int, enabled: bool) -> None:
        """Stop or resume the sending of one message."""
        self.state.muted[message] = 0 if enabled else 1
        self.state.scalars[tick.RECHECK] = 1

    @property
    def saturations(self) -> int:
        """How many values sent so far lay beyond their signal's range, and went out as its end."""
        return int(self.state.transmit.reshape(-1, T_COLUMNS)[:, T_SATURATED].sum())

    def signal(self, name: str) -> float:
        """Return a signal as last seen on the bus; raises InputError for an unknown name."""
        return float(self.state.on_bus[self.database.signal(name).index])

    def truth(self, name: str) -> float:
        """Return a quantity of the plant, SI; ``name`` is one of powertrain.TRUTH."""
        if name not in powertrain.TRUTH:
            hint = did_you_mean(name, powertrain.TRUTH)
            raise InputError("truth", "a name of the plant's truth", f"'{name}'", hint)
        return float(self.state.truth[powertrain.TRUTH.index(name)])

    @property
    def keeps_ledger(self) -> bool:
        """Whether the model keeps an energy ledger."""
        return self._car.unit is not None

    def ledger(self) -> Ledger:
        """Return the energy ledger since the start; raises InputError for a model without one."""
        found = self._car.ledger(self.state.plant_x, self.state.plant_n)
        if found is None:
            raise InputError("--ledger", "--model detailed, which keeps one", f"{self.setup.model}")
        return found

    def inject(self, fault: Fault) -> str:
        """Inject a fault; it begins at the next tick, or ``after`` it.

        Returns:
            The name by which it is cleared and told.

        Raises:
            InputError: a name that the network does not have, a value that does not fit, or a name in use.
            StateError: too many faults at once.
        """
        if not isinstance(fault, BUS_FAULTS):
            return self._book.inject(fault)
        if self.bus_faults is None:
            hint = "e.g. --bus loopback?bitrate=500000 or --bus socketcand?bitrate=500000"
            raise InputError("fault", "a bus with bit times", f"{fault.kind} on one without", hint)
        return self.bus_faults.inject(fault, self.now_ns)

    def check_fault(self, fault: Fault, where: str = "fault") -> None:
        """Raise InputError, told at ``where``, for a fault that :meth:`inject` would refuse."""
        self._book.check(fault, where)

    def reseed(self, seed: int) -> None:
        """Let the random numbers of faults injected from now on follow from ``seed`` (0 at first)."""
        self._book.reseed(seed)

    def clear(self, name: str) -> None:
        """End a fault at the next tick; raises InputError where none of this name is live."""
        if self.bus_faults is None or not self.bus_faults.clear(name, self.now_ns):
            self._book.clear(name)

    @property
    def faults(self) -> tuple[InjectedFault, ...]:
        """Every fault injected so far: what, when, until when, and how often it acted."""
        records = self._book.records()
        if self.bus_faults is not None:
            records += self.bus_faults.records(self.now_ns)
        return tuple(sorted(records, key=lambda record: record.injected_ns))

    def measured(self, name: str) -> float:
        """Return what a unit takes for measured, SI; ``name`` is a status port; raises InputError."""
        names = [port.name for port in ports.STATUSES]
        if name not in names:
            hint = did_you_mean(name, names)
            raise InputError("measured", "a status port", f"'{name}'", hint)
        return float(self.state.statuses[names.index(name)])

    def note(self, event: Event) -> None:
        """Let an event from outside, such as the bus's, be told among the car's own."""
        self._noted.append(event)

    @property
    def trouble_codes(self) -> list[TroubleCode]:
        """Every trouble code that has failed since it was cleared, or is still known from before."""
        names = tuple(message.name for message in self.database.messages)
        return read_codes(self.state.codes, self.constants.rules.number, names)

    def load_trouble_codes(self, stored: list[TroubleCode]) -> list[str]:
        """Put back what an earlier run stored, and begin an operation cycle.

        Returns:
            The codes that no message of this network has.
        """
        strangers = write_codes(stored, self.state.codes, self.constants.rules.number)
        supervision.begin_cycle(self.state.supervision, self.state.codes, self.now_ns)
        self.state.scalars[tick.CALM_NS] = -1
        tick.count_into(self.state.codes, self.state.scalars)
        return strangers

    def clear_trouble_codes(self) -> None:
        """Clear all of them (ISO 14229-1, ClearDiagnosticInformation); what still fails, fails anew."""
        reset_codes(self.state.codes)
        self.state.supervision[:, supervision.TOLD] = 0
        self.state.supervision[:, supervision.CALM_NS] = supervision.NEVER_NS
        self.state.scalars[tick.CALM_NS] = -1
        tick.count_into(self.state.codes, self.state.scalars)

    def take_events(self) -> list[Event]:
        """Return what happened since the last call."""
        events, self._noted = self._noted, []
        return events

    def snapshot(self) -> bytes:
        """Return the whole state."""
        return self._fingerprint() + self._buffer.tobytes() + self._book.pack()

    def _fingerprint(self) -> bytes:
        """Return 16 bytes that tell emulators apart whose states do not mean the same."""
        setup = self.setup
        files = (setup.vehicle, setup.model, setup.reduction, setup.dbc, setup.bindings)
        kind = (*files, setup.protection, sorted(setup.nodes.items()))
        return hashlib.sha256(repr(kind).encode()).digest()[:16]

    def restore(self, snapshot: bytes) -> None:
        """Go back to a snapshot of this emulator; raises ValueError for another's."""
        mark = self._fingerprint()
        end = len(mark) + self._buffer.size
        if snapshot[: len(mark)] != mark or len(snapshot) < end:
            raise ValueError("snapshot of another emulator: car, network or owners differ")
        self._buffer[:] = np.frombuffer(snapshot[len(mark) : end], dtype=np.uint8)
        self._book.unpack(snapshot[end:])


def _initial(signal: SignalDef) -> float:
    """Return a signal's physical start value, NaN for none or not available."""
    raw = signal.initial
    if raw is None or raw == signal.not_available:
        return float("nan")
    return raw * signal.scale + signal.offset
