"""A second of a network on trial: what its bindings leave open, and what the car would send."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hev_can_emu.ecu import ports
from hev_can_emu.ecu.ties import ROLE_CONTROLLER, ResolvedBindings
from hev_can_emu.messages.definitions import MessageDef, SignalDef
from hev_can_emu.runtime.emulator import Emulator
from hev_can_emu.runtime.setup import Setup

_SECOND_NS = 1_000_000_000


class SentMessage(NamedTuple):
    """A message's frames in the first second: how many, and the last one's bytes."""

    message: MessageDef
    frames: int
    last: bytes


class Trial:
    """A network with its bindings, tried for a second with ignition on and no controller.

    Attributes:
        unnamed_messages: messages without bindings: neither sent nor received.
        unbound_signals: signals of bound messages that carry no port, with what is sent for them.
        unbound_requests: request ports that no signal carries, with their meanings; those of external
            units and of testers are left out.
        unbound_statuses: names of the status ports that no signal carries.
        unsupervised: request messages whose loss nobody would notice.
        received: messages that are taken from the bus.
        sent: what was sent, by identifier.
        frames: how many in all.

    Raises:
        InputError: DBC or bindings cannot be used.
    """

    def __init__(self, dbc: Path, bindings: Path | None) -> None:
        setup = Setup(
            model="4dof", dbc=str(dbc), bindings=None if bindings is None else str(bindings)
        )
        emulator = Emulator(setup)
        ties = emulator.constants.ties
        messages = emulator.database.messages
        bound = {int(n) for n in (*ties.rx_signal, *ties.tx_signal)}
        self.unnamed_messages = [m.name for m in messages if ties.message_node[m.index] < 0]
        self.unbound_signals = [
            f"{signal.qualified_name}: {_instead(signal)}"
            for message in messages
            if ties.message_node[message.index] >= 0 and not _asks(ties, message.index)
            for signal in message.signals
            if signal.index not in bound and not _is_protection(message, signal)
        ]
        optional = {ports.REQUESTS[port].name for port in ports.TESTER_REQUESTS}
        self.unbound_requests = [
            f"{port.name}: {port.meaning}"
            for port in _unbound(ports.REQUESTS, ties.rx_port)
            if not port.name.startswith("external_") and port.name not in optional
        ]
        self.unbound_statuses = [port.name for port in _unbound(ports.STATUSES, ties.tx_port)]
        self.received = [m for m in messages if _asks(ties, m.index)]
        self.unsupervised = [m.name for m in self.received if ties.supervised[m.index] == 0]
        frames = emulator.advance(_SECOND_NS)
        self.sent: list[SentMessage] = []
        self.frames = len(frames)
        for message in sorted(messages, key=lambda m: m.can_id):
            own = frames[frames["id"] == message.can_id]
            if len(own):
                last = own[-1]["data"][: own[-1]["length"]].tobytes()
                self.sent.append(SentMessage(message, len(own), last))


def _asks(ties: ResolvedBindings, message: int) -> bool:
    node = ties.message_node[message]
    return bool(node >= 0 and ties.node_role[node] == ROLE_CONTROLLER)


def _is_protection(message: MessageDef, signal: SignalDef) -> bool:
    return message.protection is not None and not message.protection.bits().isdisjoint(
        signal.bits()
    )


def _instead(signal: SignalDef) -> str:
    if signal.not_available is not None:
        return "not available"
    raw = signal.initial or 0
    value = raw * signal.scale + signal.offset
    label = "" if math.isnan(raw) else signal.labels.get(int(raw), "")
    if signal.is_float and not signal.constant:
        return "NaN"
    kind = "constant" if signal.constant else "start value"
    return f"{kind} {value:g}{' ' + signal.unit if signal.unit else ''}" + (
        f" ({label})" if label else ""
    )


def _unbound(known: tuple[ports.Port, ...], used: np.ndarray) -> list[ports.Port]:
    taken = {int(n) for n in used}
    return [port for n, port in enumerate(known) if n not in taken]
