"""Which signal of a network carries which port: the bindings file, checked and turned into tables.

:class:`~hev_can_emu.ecu.bindings_file.Bindings` is the file's shape.  :func:`resolve` checks it against a
database and gives :class:`~hev_can_emu.ecu.ties.ResolvedBindings`, which kernels read.  Nothing here
knows a name of the shipped network: any DBC with a bindings file of its own takes the same way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from hev_can_emu.ecu import ports
from hev_can_emu.ecu.bindings_file import (
    Bindings,
    MessageBinding,
    NodeBinding,
    Tie,
)
from hev_can_emu.ecu.supervision_file import Supervision
from hev_can_emu.ecu.ties import (
    OWNERSHIPS,
    REACTIONS,
    ROLE_CONTROLLER,
    ROLE_EMULATED,
    ResolvedBindings,
    message_from_statuses,
    requests_from_signals,
    signals_from_statuses,
    with_ownership,
)
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.messages.database import Database, MessageDef, SignalDef
from hev_can_emu.units import Unit, parse_quantity, unit

__all__ = [
    "Bindings",
    "MessageBinding",
    "NodeBinding",
    "ResolvedBindings",
    "Supervision",
    "Tie",
    "message_from_statuses",
    "requests_from_signals",
    "resolve",
    "signals_from_statuses",
    "with_ownership",
]

SILENCE_PERIODS = 3
"""An external unit whose message is missing for longer than so many periods is gone."""

Steps = tuple[str | int, ...]
Locate = Callable[[Steps], str]


def resolve(
    bindings: Bindings, database: Database, locate: Locate | None = None
) -> ResolvedBindings:
    """Check ``bindings`` against ``database`` and return the tables that kernels read.

    Args:
        bindings: the file's content.
        database: the network.
        locate: gives a place in the file from the keys that lead to it.

    Raises:
        InputError: an unknown message, signal, node, port or label; a port bound in the wrong
            direction or twice; units that do not fit; supervision of a message without period.
    """
    return _Resolver(bindings, database, locate or _spell).run()


def _spell(steps: Steps) -> str:
    return "bindings: $." + ".".join(str(step) for step in steps)


_REQUESTS = {port.name: index for index, port in enumerate(ports.REQUESTS)}
_STATUSES = {port.name: index for index, port in enumerate(ports.STATUSES)}


class _Row(NamedTuple):
    signal: int
    port: int
    gain: float
    offset: float
    map_start: int
    map_stop: int
    optional: int
    low: float
    high: float


class _Resolver:
    """Walks the bindings once; collects rows per message."""

    def __init__(self, bindings: Bindings, database: Database, locate: Locate) -> None:
        self._bindings = bindings
        self._database = database
        self._locate = locate
        self._file = database.path.name
        self._node_index = {name: index for index, name in enumerate(bindings.nodes)}
        self._bound: dict[str, str] = {}
        self._map_value: list[float] = []
        self._map_code: list[float] = []
        count = len(database.messages)
        self._rx: list[list[_Row]] = [[] for _ in range(count)]
        self._tx: list[list[_Row]] = [[] for _ in range(count)]
        self._covers: list[list[int]] = [[] for _ in range(count)]
        self._node = np.full(count, -1, dtype=np.int64)
        self._supervised = np.zeros(count, dtype=np.uint8)
        self._timeout_ns = np.zeros(count, dtype=np.int64)
        self._ramp_ns = np.zeros(count, dtype=np.int64)
        self._reaction = np.zeros(count, dtype=np.int64)
        self._silence_ns = np.zeros(count, dtype=np.int64)
        self._status_port = np.full(count, -1, dtype=np.int64)

    def run(self) -> ResolvedBindings:
        nodes = self._bindings.nodes
        senders = {binding.node for binding in self._bindings.messages.values()}
        for name in nodes:
            if name not in self._database.nodes and name not in senders:
                known = self._database.nodes
                raise self._refuse(("nodes", name), f"a node of {self._file}", name, known)
        for name, binding in self._bindings.messages.items():
            self._message(name, binding)
        return self._tables()

    def _message(self, name: str, binding: MessageBinding) -> None:
        steps: Steps = ("messages", name)
        by_name = {message.name: message for message in self._database.messages}
        if name not in by_name:
            raise self._refuse(steps, f"a message of {self._file}", name, by_name)
        message = by_name[name]
        sender = binding.node or message.sender
        if sender not in self._node_index:
            hint = "add it to 'nodes', or name another with 'node'"
            raise InputError(
                self._locate(steps), "a message of one of the nodes", f"'{sender}'", hint
            )
        self._node[message.index] = self._node_index[sender]
        is_controller = self._bindings.nodes[sender].role == "controller"
        wrong = ("status", "external") if is_controller else ("request", "supervision")
        for section in wrong:
            if getattr(binding, section):
                kind = "an emulated unit" if is_controller else "a controller"
                raise InputError(
                    self._locate((*steps, section)),
                    f"a message that {kind} sends",
                    f"one of {sender}",
                )
        signals = {signal.name: signal for signal in message.signals}
        for number, signal in enumerate(binding.optional):
            if signal not in binding.request and signal not in binding.external:
                known = (*binding.request, *binding.external)
                raise self._refuse((*steps, "optional", number), "a bound signal", signal, known)
        for section, ties in (("request", binding.request), ("external", binding.external)):
            rows = self._rx[message.index]
            for key, tie in ties.items():
                place = (*steps, section, key)
                self._claim(place, tie, f"{name}.{key}")
                rows.append(self._tie(place, key, tie, signals, message, True, binding.optional))
        for key, tie in binding.status.items():
            place = (*steps, "status", key)
            self._tx[message.index].append(self._tie(place, key, tie, signals, message, False, ()))
        if binding.external:
            self._silence_ns[message.index] = SILENCE_PERIODS * message.cycle_time_ns
        if binding.supervision is not None:
            self._supervise((*steps, "supervision"), message, binding, binding.supervision)

    def _claim(self, steps: Steps, tie: str | Tie, owner: str) -> None:
        port = tie if isinstance(tie, str) else tie.port
        first = self._bound.setdefault(port, owner)
        if first != owner:
            raise InputError(
                self._locate(steps),
                "each request port once",
                f"'{port}' again",
                f"first at {first}",
            )

    def _tie(
        self,
        steps: Steps,
        key: str,
        tie: str | Tie,
        signals: Mapping[str, SignalDef],
        message: MessageDef,
        receive: bool,
        optional: tuple[str, ...],
    ) -> _Row:
        if key not in signals:
            raise self._refuse(steps, f"a signal of {message.name}", key, signals)
        signal = signals[key]
        if message.protection and not message.protection.bits().isdisjoint(signal.bits()):
            got = f"'{key}', which the protection of {message.name} writes"
            raise InputError(self._locate(steps), "a signal that carries a value", got)
        full = Tie(port=tie) if isinstance(tie, str) else tie
        index = self._port(steps, full.port, receive)
        measured = self._unit(
            steps, signal, full, ports.REQUESTS if receive else ports.STATUSES, index
        )
        start, stop = self._map(steps, signal, full)
        if receive:
            gain, offset = full.factor * measured.gain, full.factor * measured.offset
        else:
            gain, offset = 1.0 / (full.factor * measured.gain), -measured.offset / measured.gain
        low, high = _range(signal)
        return _Row(signal.index, index, gain, offset, start, stop, int(key in optional), low, high)

    def _port(self, steps: Steps, name: str, receive: bool) -> int:
        known, other = (_REQUESTS, _STATUSES) if receive else (_STATUSES, _REQUESTS)
        if name in known:
            return known[name]
        kinds = ("request", "status") if receive else ("status", "request")
        if name in other:
            hint = f"that is a {kinds[1]} port"
            raise InputError(self._locate(steps), f"a {kinds[0]} port", f"'{name}'", hint)
        raise self._refuse(steps, f"a {kinds[0]} port", name, known)

    def _unit(
        self,
        steps: Steps,
        signal: SignalDef,
        tie: Tie,
        known: tuple[ports.Port, ...],
        index: int,
    ) -> Unit:
        where = self._locate(steps)
        if not math.isfinite(tie.factor) or tie.factor == 0.0:
            raise InputError(where, "a finite factor other than 0", f"{tie.factor:g}")
        text = signal.unit if tie.unit is None else tie.unit
        port = known[index]
        try:
            measured = unit(text, where)
        except InputError as error:
            name = "1" if port.unit == "1" else port.unit
            hint = (
                error.hint
                or f"say what it is in with 'unit', such as {{port: {tie.port}, unit: {name}}}"
            )
            raise InputError(where, error.expected, error.got, hint) from error
        if measured.dimension != unit(port.unit).dimension:
            expected = (
                f"a unit that converts to {port.unit}" if port.unit != "1" else "a pure number"
            )
            hint = f"{tie.port} is {port.meaning}" if port.meaning else ""
            raise InputError(where, expected, f"'{text}' of {signal.qualified_name}", hint)
        return measured

    def _map(self, steps: Steps, signal: SignalDef, tie: Tie) -> tuple[int, int]:
        start = len(self._map_value)
        for label, code in tie.values.items():
            raws = [raw for raw, known in signal.labels.items() if known == label]
            if not raws:
                place = (*steps, "values", label)
                raise self._refuse(
                    place, f"a label of {signal.name}", label, signal.labels.values()
                )
            for raw in raws:
                self._map_value.append(float(raw * signal.scale + signal.offset))
                self._map_code.append(float(code))
        return start, len(self._map_value)

    def _supervise(
        self, steps: Steps, message: MessageDef, binding: MessageBinding, asked: Supervision
    ) -> None:
        m = message.index
        if asked.status:
            self._status_port[m] = self._port((*steps, "status"), asked.status, False)
        period_ns = message.cycle_time_ns
        if asked.period:
            period_ns = self._time_ns((*steps, "period"), asked.period)
        if period_ns <= 0:
            raise InputError(
                self._locate(steps), "a cyclic message", f"'{message.name}' without cycle time",
                "name its 'period'",
            )  # fmt: skip
        bound = [tie if isinstance(tie, str) else tie.port for tie in binding.request.values()]
        for number, port in enumerate(asked.covers):
            if port not in bound:
                expected = f"a request port of {message.name}"
                raise self._refuse((*steps, "covers", number), expected, port, bound)
        self._supervised[m] = 1
        self._timeout_ns[m] = asked.timeout_periods * period_ns
        self._ramp_ns[m] = self._time_ns((*steps, "ramp_down"), asked.ramp_down)
        self._reaction[m] = REACTIONS[asked.reaction]
        self._covers[m] = [_REQUESTS[port] for port in asked.covers or bound]

    def _time_ns(self, steps: Steps, text: str) -> int:
        where = self._locate(steps)
        seconds = parse_quantity(text, where, "s").si_value
        if not 0.0 <= seconds <= 3600.0:
            raise InputError(where, "0 s to 3600 s", f"'{text}'")
        return round(seconds * 1e9)

    def _refuse(self, steps: Steps, expected: str, got: str, known: Iterable[str]) -> InputError:
        return InputError(self._locate(steps), expected, f"'{got}'", did_you_mean(got, known))

    def _tables(self) -> ResolvedBindings:
        nodes = self._bindings.nodes.values()
        roles = [ROLE_CONTROLLER if n.role == "controller" else ROLE_EMULATED for n in nodes]
        owners = [
            OWNERSHIPS[n.ownership or ("external" if n.role == "controller" else "emulated")]
            for n in nodes
        ]
        rx = [row for rows in self._rx for row in rows]
        tx = [row for rows in self._tx for row in rows]
        return ResolvedBindings(
            rx_start=_starts(self._rx),
            rx_signal=_integers(row.signal for row in rx),
            rx_port=_integers(row.port for row in rx),
            rx_gain=_floats(row.gain for row in rx),
            rx_offset=_floats(row.offset for row in rx),
            rx_map_start=_integers(row.map_start for row in rx),
            rx_map_stop=_integers(row.map_stop for row in rx),
            rx_optional=_integers(row.optional for row in rx).astype(np.uint8),
            rx_low=_floats(row.low for row in rx),
            rx_high=_floats(row.high for row in rx),
            tx_start=_starts(self._tx),
            tx_signal=_integers(row.signal for row in tx),
            tx_port=_integers(row.port for row in tx),
            tx_gain=_floats(row.gain for row in tx),
            tx_offset=_floats(row.offset for row in tx),
            tx_map_start=_integers(row.map_start for row in tx),
            tx_map_stop=_integers(row.map_stop for row in tx),
            map_value=_floats(self._map_value),
            map_code=_floats(self._map_code),
            message_node=self._node,
            node_role=_integers(roles),
            node_ownership=_integers(owners),
            supervised=self._supervised,
            timeout_ns=self._timeout_ns,
            ramp_ns=self._ramp_ns,
            reaction=self._reaction,
            status_port=self._status_port,
            silence_ns=self._silence_ns,
            cover_start=_starts(self._covers),
            cover_port=_integers(port for covers in self._covers for port in covers),
        )


def _range(signal: SignalDef) -> tuple[float, float]:
    """Return the physical values between which a signal means something, labels included."""
    labels = [raw for raw in signal.labels if raw != signal.not_available]
    labelled = [raw * signal.scale + signal.offset for raw in labels]
    low = -math.inf if signal.minimum is None else min([signal.minimum, *labelled])
    high = math.inf if signal.maximum is None else max([signal.maximum, *labelled])
    slack = 0.0 if signal.is_float else 1e-6 * abs(signal.scale)
    return low - slack, high + slack


def _starts(groups: Iterable[list[_Row]] | Iterable[list[int]]) -> np.ndarray:
    return np.cumsum([0, *(len(group) for group in groups)]).astype(np.int64)


def _integers(values: Iterable[int]) -> np.ndarray:
    return np.array(list(values), dtype=np.int64)


def _floats(values: Iterable[float]) -> np.ndarray:
    return np.array(list(values), dtype=np.float64)
