"""What a fault's names and quantities mean in a network: from records to rows of the fault table."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from hev_can_emu.ecu import fault_table as table
from hev_can_emu.ecu import faults, ports
from hev_can_emu.ecu.fault_table import FaultTable
from hev_can_emu.ecu.faults import Fault, Value
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.messages.database import Database
from hev_can_emu.messages.definitions import MessageDef, SignalDef
from hev_can_emu.units import parse_quantity, unit

# Codes of the kinds, in the order in which they act on one frame.
KINDS = tuple(faults.CATALOGUE)
CODES = {name: code for code, name in enumerate(KINDS)}

MACHINES = ("engine", "em1", "em2")
ACTUATORS = ("engine", "em1", "em2", "clutch", "shift", "brake", "contactors")
VALVES = ("clutch", "g1", "g2")

_ACTUATOR_UNITS = {"shift": "N", "contactors": ""}
_TICK_S = 1e-3


class Network(NamedTuple):
    """What rows are made from: the database, the bindings' nodes, and who sends each message."""

    database: Database
    nodes: Sequence[str]
    senders: Sequence[int]  #: index into ``nodes`` per message, -1 for none
    seed: int  #: of the run


def fill_row(fault: Fault, network: Network, into: FaultTable, slot: int, where: str) -> None:
    """Write a fault into a free row, which then still has to be started.

    Raises:
        InputError: a name that the network does not have, or a value that does not fit.
    """
    whole = np.zeros(table.WHOLE_COLUMNS, dtype=np.int64)
    real = np.zeros(table.REAL_COLUMNS)
    whole[table.KIND] = CODES[fault.kind]
    whole[[table.MESSAGE, table.NODE, table.TARGET]] = -1
    whole[table.AFTER_NS] = _ns(fault.after)
    if fault.duration is not None:
        whole[table.DURATION_NS] = max(_ns(fault.duration), 1)
    whole[[table.SEED1, table.SEED2]] = table.random_state(_seed(fault, network.seed))
    real[table.CHANCE] = 1.0
    _Filler(network, where).fill(fault, whole, real)
    into.whole[slot] = whole
    into.real[slot] = real


def _ns(time: Value) -> int:
    return round(faults.seconds(time, "time") * 1e9)


def _seed(fault: Fault, run: int) -> int:
    if fault.seed is not None:
        return fault.seed
    digest = hashlib.sha256(f"{run} {fault.label}".encode()).digest()
    return int.from_bytes(digest[:7], "little")


class _Filler:
    """Looks names up and converts values."""

    def __init__(self, network: Network, where: str) -> None:
        self._network = network
        self._where = where

    def fill(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        if hasattr(fault, "message"):
            message = self._message(fault.message)
            whole[table.MESSAGE] = message.index
            self._check_protection(fault.kind, message)
        if hasattr(fault, "signal"):
            signal = self._signal(fault.signal)
            whole[table.MESSAGE], whole[table.TARGET] = signal.message_index, signal.index
            real[table.VALUE] = self._signal_value(fault, signal)
        if hasattr(fault, "node"):
            whole[table.NODE] = self._node(fault.node)
        if hasattr(fault, "frames"):
            whole[table.FRAMES], real[table.CHANCE] = fault.frames, fault.chance
        if hasattr(fault, "resume"):
            stopped = fault.resume == "stopped"
            whole[table.RESUME] = table.RESUME_STOPPED if stopped else table.RESUME_RUNNING
        own: Callable[[Any, np.ndarray, np.ndarray], None] | None = getattr(
            self, f"_{fault.kind}", None
        )
        if own is not None:
            own(fault, whole, real)

    def _message(self, name: str) -> MessageDef:
        known = {message.name: message for message in self._network.database.messages}
        if name not in known:
            raise self._refuse("message", "a message of the network", name, known)
        return known[name]

    def _check_protection(self, kind: str, message: MessageDef) -> None:
        spec = message.protection
        for what, there in (
            ("counter", spec is not None and spec.counter_bits > 0),
            ("CRC", spec is not None and spec.effective_crc.width > 0),
        ):
            if kind.startswith(f"{what.lower()}_") and not there:
                got = f"'{message.name}', which has none"
                raise InputError(f"{self._where}.message", f"a message with a {what}", got)

    def _node(self, name: str) -> int:
        nodes = list(self._network.nodes)
        if name not in nodes:
            raise self._refuse("node", f"one of {', '.join(nodes)}", name, nodes)
        index = nodes.index(name)
        if index not in self._network.senders:
            raise InputError(f"{self._where}.node", "a node that sends", f"'{name}'")
        return index

    def _signal(self, name: str) -> SignalDef:
        try:
            found = self._network.database.signal(name)
        except InputError as error:
            where = f"{self._where}.signal"
            raise InputError(where, error.expected, error.got, error.hint) from None
        protection = self._network.database.messages[found.message_index].protection
        if protection and not protection.bits().isdisjoint(found.bits()):
            raise InputError(
                f"{self._where}.signal", "a signal that carries a value", f"'{name}'",
                "counter and CRC have faults of their own",
            )  # fmt: skip
        if found.length > 52 and not found.is_float:
            got = f"'{name}' of {found.length} bits"
            raise InputError(f"{self._where}.signal", "a signal of at most 52 bits", got)
        return found

    def _signal_value(self, fault: Any, signal: SignalDef) -> float:
        for key, difference in (
            ("value", False), ("offset", True), ("deviation", True), ("rate", True),
        ):  # fmt: skip
            given: Value | None = getattr(fault, key, None)
            if given is not None:
                return self._value(key, given, signal, difference)
        return math.nan

    def _value(self, key: str, given: Value, signal: SignalDef, difference: bool) -> float:
        """Return a value in the signal's unit; a difference of temperatures has no offset."""
        where = f"{self._where}.{key}"
        if not isinstance(given, str):
            if not math.isfinite(given):
                raise InputError(where, "a finite number", f"{given}")
            return float(given)
        for raw, label in signal.labels.items():
            if label == given and not difference:
                if raw == signal.not_available:
                    raise InputError(where, "a value", f"'{given}'", "use signal_not_available")
                return float(raw * signal.scale + signal.offset)
        own = unit(signal.unit, where)
        expect = own.dimension if own.dimension != "1" else ""
        text = given[: -len("/s")] if key == "rate" and given.endswith("/s") else given
        try:
            found = parse_quantity(text, where, expect)
        except InputError as error:
            hint = error.hint or did_you_mean(given, signal.labels.values())
            raise InputError(where, error.expected, error.got, hint) from None
        if expect == "" and found.dimension != own.dimension:
            raise InputError(where, "a pure number", f"'{given}'", f"{signal.name} has no unit")
        if difference:
            return (found.si_value - unit(found.unit).offset) / own.gain
        return own.from_si(found.si_value)

    def _refuse(self, key: str, expected: str, got: str, known: Any) -> InputError:
        return InputError(f"{self._where}.{key}", expected, f"'{got}'", did_you_mean(got, known))

    # What single kinds need beside.

    def _counter_offset(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        whole[table.NUMBER] = fault.offset

    _crc_offset = _counter_offset

    def _wrong_length(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        message = self._network.database.messages[whole[table.MESSAGE]]
        most = 64 if message.fd else 8
        if fault.length > most or fault.length == message.wire_length:
            got = str(fault.length)
            expected = f"0 to {most} bytes, other than its own {message.wire_length}"
            raise InputError(f"{self._where}.length", expected, got)
        whole[table.NUMBER] = fault.length

    def _delay(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        whole[table.TIME_NS] = _ns(fault.delay)

    def _jitter(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        whole[table.TIME_NS] = _ns(fault.jitter)

    def _duplicate(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        whole[table.NUMBER] = fault.copies

    def _babbling_node(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        rate = fault.rate
        number = parse_quantity(rate, "rate", "Hz").si_value if isinstance(rate, str) else rate
        whole[table.NUMBER] = fault.id
        whole[table.TARGET] = fault.length
        whole[table.MARK] = int(fault.extended)
        whole[table.TIME_NS] = round(number / 1000.0)

    def _actuator_stuck(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        whole[table.TARGET] = ACTUATORS.index(fault.actuator)
        real[table.VALUE] = math.nan
        if fault.value is None:
            return
        where = f"{self._where}.value"
        expect = _ACTUATOR_UNITS.get(fault.actuator, "Nm")
        number = fault.value
        if isinstance(number, str):
            number = parse_quantity(number, where, expect).si_value
        if not math.isfinite(number):
            raise InputError(where, "a finite number", f"{number}")
        if fault.actuator == "contactors" and number not in (0, 1):
            raise InputError(where, "0 (open) or 1 (closed)", f"{number:g}")
        if fault.actuator in ("clutch", "shift", "brake") and number < 0.0:
            raise InputError(where, "0 or more", f"{number:g}")
        real[table.VALUE] = number

    def _actuator_slow(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        whole[table.TARGET] = ACTUATORS.index(fault.actuator)
        real[table.VALUE] = math.exp(
            -_TICK_S / faults.seconds(fault.time_constant, "time_constant")
        )

    def _sensor_failure(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        known = [port.name for port in ports.STATUSES]
        if fault.sensor not in known:
            raise self._refuse("sensor", "a status port", fault.sensor, known)
        whole[table.TARGET] = known.index(fault.sensor)
        whole[table.NUMBER] = int(fault.mode == "lost")

    def _machine_derated(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        whole[table.TARGET] = MACHINES.index(fault.machine)
        real[table.VALUE] = fault.share

    def _machine_tripped(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        whole[table.TARGET] = MACHINES.index(fault.machine)

    _machine_short_circuit = _machine_tripped

    def _clutch_leak(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        real[table.VALUE] = fault.share

    def _valve_stuck(self, fault: Any, whole: np.ndarray, real: np.ndarray) -> None:
        whole[table.TARGET] = VALVES.index(fault.valve)
        real[table.VALUE] = fault.opening
