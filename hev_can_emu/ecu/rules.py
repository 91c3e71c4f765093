"""What the bindings declare of supervision, as tables that its kernels read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from hev_can_emu.ecu import ports, reasons
from hev_can_emu.ecu.bindings_file import Bindings
from hev_can_emu.ecu.supervision_file import Limited, Plausible, Supervision
from hev_can_emu.ecu.ties import OWNER_EXTERNAL, ROLE_CONTROLLER, ResolvedBindings
from hev_can_emu.ecu.trouble_codes import code_number
from hev_can_emu.errors import InputError, did_you_mean
from hev_can_emu.messages.database import Database
from hev_can_emu.units import parse_quantity, unit

Steps = tuple[str | int, ...]
Locate = Callable[[Steps], str]

LIMP_PORTS = (ports.ENGINE_TORQUE_REQUEST, ports.EM1_TORQUE_REQUEST, ports.EM2_TORQUE_REQUEST)

_REQUESTS = {port.name: index for index, port in enumerate(ports.REQUESTS)}
_STATUSES = {port.name: index for index, port in enumerate(ports.STATUSES)}


class Rules(NamedTuple):
    """Tables beside :class:`~hev_can_emu.ecu.ties.ResolvedBindings`; M messages, R reasons.

    The limits of message ``m`` are ``limit_start[m]`` to ``limit_start[m + 1] - 1``, slew rates and
    claims on the plant alike.  ``..._tie`` is the tie that carries the value, ``..._refuse`` 1 where a
    frame beyond is refused, 0 where the request is limited.  Values are SI.
    """

    watched: np.ndarray  #: int64, the messages that are watched at all
    ignored: np.ndarray  #: uint8 (M, R)
    failed: np.ndarray  #: int64 (M,), bad frames in a row, 0 none
    healed: np.ndarray  #: int64 (M,), good frames in a row
    number: np.ndarray  #: int64 (M,), trouble code without failure type, 0 none
    confirm: np.ndarray  #: int64 (M,), cycles
    substitute: np.ndarray  #: float64 (request ports,), NaN for none
    limp_torque: np.ndarray  #: float64 (M,), N m
    limp_speed: np.ndarray  #: float64 (M,), m/s
    limit_start: np.ndarray
    limit_tie: np.ndarray
    limit_low: np.ndarray
    limit_high: np.ndarray
    limit_refuse: np.ndarray
    slew_start: np.ndarray
    slew_tie: np.ndarray
    slew_rate: np.ndarray  #: per second
    slew_slack: np.ndarray  #: one step of the signal
    slew_refuse: np.ndarray
    claim_start: np.ndarray
    claim_tie: np.ndarray
    claim_status: np.ndarray  #: status port
    claim_when: np.ndarray  #: code of the request, NaN: the status port lies near the request
    claim_low: np.ndarray
    claim_high: np.ndarray


def resolve_rules(
    bindings: Bindings, database: Database, ties: ResolvedBindings, locate: Locate
) -> Rules:
    """Check the supervision that bindings declare and return its tables.

    Raises:
        InputError: a port that the message does not set, or a quantity that does not fit.
    """
    return _Resolver(database, ties, locate).run(bindings)


class _Resolver:
    def __init__(self, database: Database, ties: ResolvedBindings, locate: Locate) -> None:
        self._database, self._ties, self._locate = database, ties, locate
        count = len(database.messages)
        self._ignored = np.zeros((count, reasons.N_REASONS), dtype=np.uint8)
        self._failed = np.zeros(count, dtype=np.int64)
        self._healed = np.ones(count, dtype=np.int64)
        self._number = np.zeros(count, dtype=np.int64)
        self._confirm = np.ones(count, dtype=np.int64)
        self._substitute = np.full(len(ports.REQUESTS), np.nan)
        self._limp = np.zeros((2, count))
        self._limits: list[list[tuple[float, ...]]] = [[] for _ in range(count)]
        self._slews: list[list[tuple[float, ...]]] = [[] for _ in range(count)]
        self._claims: list[list[tuple[float, ...]]] = [[] for _ in range(count)]

    def _watched(self) -> list[int]:
        """Return the requests and what external units report."""
        ties = self._ties
        found = []
        for message, node in enumerate(ties.message_node):
            reports = (
                ties.rx_start[message] < ties.rx_start[message + 1]
                and ties.node_ownership[node] == OWNER_EXTERNAL
                and ties.node_role[node] != ROLE_CONTROLLER
            )
            if ties.supervised[message] == 1 or reports:
                found.append(message)
        return found

    def run(self, bindings: Bindings) -> Rules:
        for name, binding in bindings.messages.items():
            if binding.supervision is not None:
                steps = ("messages", name, "supervision")
                self._message(steps, self._database.message(name).index, binding.supervision)
        limits, slews, claims = (
            np.array([row for rows in table for row in rows], dtype=np.float64).reshape(-1, width)
            for table, width in ((self._limits, 4), (self._slews, 4), (self._claims, 5))
        )
        return Rules(
            np.array(self._watched(), dtype=np.int64),
            self._ignored, self._failed, self._healed, self._number, self._confirm,
            self._substitute, self._limp[0].copy(), self._limp[1].copy(),
            _starts(self._limits), _whole(limits[:, 0]), limits[:, 1].copy(), limits[:, 2].copy(),
            _whole(limits[:, 3]),
            _starts(self._slews), _whole(slews[:, 0]), slews[:, 1].copy(), slews[:, 2].copy(),
            _whole(slews[:, 3]),
            _starts(self._claims), _whole(claims[:, 0]), _whole(claims[:, 1]), claims[:, 2].copy(),
            claims[:, 3].copy(), claims[:, 4].copy(),
        )  # fmt: skip

    def _message(self, steps: Steps, m: int, asked: Supervision) -> None:
        self._failed[m], self._healed[m] = asked.debounce.failed, asked.debounce.healed
        self._confirm[m] = asked.confirm_cycles
        if asked.code:
            self._number[m] = code_number(asked.code, self._locate((*steps, "code")))
        for choice, known in (
            (asked.crc, (reasons.R_CRC,)),
            (asked.counter_frozen, (reasons.R_FROZEN,)),
            (asked.counter_jump, (reasons.R_JUMP,)),
            (asked.range, (reasons.R_LOW, reasons.R_HIGH)),
        ):
            self._ignored[m, list(known)] = choice != "refuse"
        ties = range(self._ties.rx_start[m], self._ties.rx_start[m + 1])
        if asked.range == "limit":
            self._limits[m] += [row for tie in ties if (row := self._declared(tie)) is not None]
        for port, limits in asked.limits.items():
            place: Steps = (*steps, "limits", port)
            tie = self._tie(place, m, port)
            low, high = (
                self._si((*place, key), text, ports.REQUESTS[_REQUESTS[port]])
                for key, text in (("low", limits.low), ("high", limits.high))
            )
            if low > high:
                raise InputError(self._locate(place), "low below high", f"{limits.low} as low")
            self._limits[m].append((tie, low, high, _refuses(limits.action)))
        for port, slew in asked.slew.items():
            place = (*steps, "slew", port)
            tie = self._tie(place, m, port)
            rate = self._rate((*place, "rate"), slew.rate, ports.REQUESTS[_REQUESTS[port]])
            signal = self._database.signals[self._ties.rx_signal[tie]]
            slack = abs(signal.scale * self._ties.rx_gain[tie])
            self._slews[m].append((tie, rate, slack, _refuses(slew.action)))
        for number, claim in enumerate(asked.plausible):
            self._claim((*steps, "plausible", number), m, claim)
        self._reaction(steps, m, asked)

    def _claim(self, steps: Steps, m: int, claim: Plausible) -> None:
        tie = self._tie((*steps, "port"), m, claim.port)
        if claim.of not in _STATUSES:
            raise self._refuse((*steps, "of"), "a status port", claim.of, _STATUSES)
        port = ports.STATUSES[_STATUSES[claim.of]]
        if (claim.when is None) == (not claim.within):
            got = "both" if claim.within else "neither"
            raise InputError(self._locate(steps), "either 'within' or 'when'", got)
        if claim.when is None:
            asked = ports.REQUESTS[_REQUESTS[claim.port]]
            if unit(asked.unit).dimension != unit(port.unit).dimension:
                got = f"'{claim.of}' in {port.unit}"
                raise InputError(
                    self._locate((*steps, "of")), f"a status port in {asked.unit}", got
                )
            where = (*steps, "within")
            size = self._si(where, claim.within, port) - unit(_unit_of(claim.within)).offset
            if size < 0.0:
                raise InputError(self._locate(where), "0 or more", f"'{claim.within}'")
            self._claims[m].append((tie, _STATUSES[claim.of], math.nan, -size, size))
            return
        low = self._si((*steps, "low"), claim.low, port) if claim.low else -math.inf
        high = self._si((*steps, "high"), claim.high, port) if claim.high else math.inf
        self._claims[m].append((tie, _STATUSES[claim.of], float(claim.when), low, high))

    def _reaction(self, steps: Steps, m: int, asked: Supervision) -> None:
        wrong = [
            key
            for key, given, reaction in (
                ("substitute", asked.substitute, "substitute"),
                ("limp_home", asked.limp_home, "limp_home"),
            )
            if bool(given) != (asked.reaction == reaction)
        ]
        if wrong:
            got = f"reaction {asked.reaction} with{'' if getattr(asked, wrong[0]) else 'out'} it"
            raise InputError(
                self._locate((*steps, wrong[0])), f"it with the reaction {wrong[0]}", got
            )
        for name, value in asked.substitute.items():
            place = (*steps, "substitute", name)
            self._tie(place, m, name)
            port = ports.REQUESTS[_REQUESTS[name]]
            si = self._si(place, value, port) if isinstance(value, str) else float(value)
            if not math.isfinite(si):
                raise InputError(self._locate(place), "a finite number", f"{value}")
            self._substitute[_REQUESTS[name]] = si
        if asked.limp_home is not None:
            covered = self._ties.cover_port[
                self._ties.cover_start[m] : self._ties.cover_start[m + 1]
            ]
            if not np.isin(covered, LIMP_PORTS).any():
                raise InputError(
                    self._locate((*steps, "limp_home")), "a message that asks for torque",
                    f"{self._database.messages[m].name}",
                )  # fmt: skip
            torque = ports.REQUESTS[ports.EM2_TORQUE_REQUEST]
            speed = ports.STATUSES[ports.S_VEHICLE_SPEED]
            self._limp[0, m] = self._si(
                (*steps, "limp_home", "torque"), asked.limp_home.torque, torque
            )
            self._limp[1, m] = self._si(
                (*steps, "limp_home", "speed"), asked.limp_home.speed, speed
            )

    def _declared(self, tie: int) -> tuple[float, ...] | None:
        """Return the database's range of a tie as a limit, None for codes and where there is none."""
        ties = self._ties
        ends = np.array([ties.rx_low[tie], ties.rx_high[tie]])
        if ties.rx_map_start[tie] != ties.rx_map_stop[tie] or not np.isfinite(ends).all():
            return None
        if ports.REQUESTS[ties.rx_port[tie]].unit == "1":
            return None
        low, high = sorted((ends * ties.rx_gain[tie] + ties.rx_offset[tie]).tolist())
        return tie, low, high, 0.0

    def _tie(self, steps: Steps, m: int, name: str) -> int:
        first, last = self._ties.rx_start[m], self._ties.rx_start[m + 1]
        bound = [ports.REQUESTS[port].name for port in self._ties.rx_port[first:last]]
        if name not in bound:
            expected = f"a request port of {self._database.messages[m].name}"
            raise self._refuse(steps, expected, name, bound)
        return int(first) + bound.index(name)

    def _si(self, steps: Steps, text: str, port: ports.Port) -> float:
        where = self._locate(steps)
        found = parse_quantity(text, where, port.unit if port.unit != "1" else "")
        if found.dimension != unit(port.unit).dimension:
            raise InputError(where, "a pure number", f"'{text}'", f"{port.name} has no unit")
        return found.si_value

    def _rate(self, steps: Steps, text: str, port: ports.Port) -> float:
        where = self._locate(steps)
        wanted = f"({port.unit})/s" if port.unit != "1" else "1/s"
        found = parse_quantity(text, where)
        if found.dimension != unit(wanted).dimension or found.si_value <= 0.0:
            raise InputError(where, f"a positive rate in {wanted}", f"'{text}'")
        return found.si_value

    def _refuse(self, steps: Steps, expected: str, got: str, known: Iterable[str]) -> InputError:
        return InputError(self._locate(steps), expected, f"'{got}'", did_you_mean(got, known))


def _refuses(action: Limited) -> float:
    return 1.0 if action == "refuse" else 0.0


def _unit_of(text: str) -> str:
    return parse_quantity(text).unit


def _starts(table: list[list[tuple[float, ...]]]) -> np.ndarray:
    return np.cumsum([0, *(len(rows) for rows in table)]).astype(np.int64)


def _whole(column: np.ndarray) -> np.ndarray:
    return column.astype(np.int64)
