"""A network of two messages for the units' kernels, without a DBC file's size."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from hev_can_emu import config
from hev_can_emu.ecu import ports, supervision, trouble_codes
from hev_can_emu.ecu.bindings import Bindings, ResolvedBindings, resolve
from hev_can_emu.ecu.reasons import FAILURES
from hev_can_emu.ecu.rules import Rules, resolve_rules
from hev_can_emu.messages.database import Database, load_database

MS = 1_000_000

DBC = """VERSION ""
BU_: CTRL DRIVE
BO_ 256 Cmd: 8 CTRL
 SG_ Trq : 0|16@1+ (0.1,-800) [-800|800] "Nm" DRIVE
 SG_ Gang : 16|4@1+ (1,0) [0|2] "" DRIVE
 SG_ Top : 24|16@1+ (0.1,-800) [-800|800] "Nm" DRIVE
BO_ 257 Cap: 8 CTRL
 SG_ Clutch : 0|16@1+ (0.1,0) [0|1000] "Nm" DRIVE
BO_ 258 State: 8 DRIVE
 SG_ Real : 0|16@1+ (0.1,-800) [-800|800] "Nm" CTRL
 SG_ Slope : 16|16@1+ (0.01,-100) [-100|100] "%" CTRL
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
VAL_ 256 Gang 0 "Neutral" 1 "Erster" 2 "Zweiter" ;
"""

BINDINGS = """
version: 1
nodes:
  CTRL: {role: controller}
  DRIVE: {role: emulated, ownership: external}
messages:
  Cmd:
    request: {Trq: em2_torque_request, Gang: gear_request, Top: em2_torque_max}
    optional: [Top]
    supervision: {status: em2_request_status, reaction: ramp_to_zero, ramp_down: 100 ms,
                  covers: [em2_torque_request]}
  Cap:
    request: {Clutch: clutch_capacity_request}
    supervision: {status: clutch_request_status, reaction: hold}
  State:
    external: {Real: external_em2_torque, Slope: road_grade}
"""

CMD, CAP, STATE = 0, 1, 2
TRQ, GANG, TOP, CLUTCH, REAL, SLOPE = range(6)


class Network(NamedTuple):
    database: Database
    ties: ResolvedBindings
    rules: Rules


def network(folder: Path, bindings: str = BINDINGS) -> Network:
    """Return the network above, or with other bindings."""
    (folder / "small.dbc").write_text(DBC)
    database = load_database(folder / "small.dbc")
    document = config.parse(bindings, "small.yaml")
    declared = document.convert(Bindings)
    ties = resolve(declared, database, document.where)
    return Network(database, ties, resolve_rules(declared, database, ties, document.where))


class Watch:
    """The arrays that supervision works on, and time."""

    def __init__(self, given: Network, ties: ResolvedBindings | None = None) -> None:
        self.ties = given.ties if ties is None else ties
        self.rules = given.rules
        self.codes = np.zeros((3, len(FAILURES), trouble_codes.COLUMNS), dtype=np.int64)
        trouble_codes.reset_codes(self.codes)
        self.limited = np.zeros(len(ports.REQUESTS))
        self.slewed = np.full(len(self.rules.slew_tie), np.nan)
        self.operating = True
        self.changed = False
        self.state = np.zeros((3, supervision.COLUMNS), dtype=np.int64)
        supervision.reset_supervision(self.state)
        count = len(ports.REQUESTS)
        self.requests = np.full(count, np.nan)
        self.held = np.full(count, np.nan)
        self.effective = np.zeros(count)
        self.share = np.zeros(count)
        self.statuses = np.zeros(len(ports.STATUSES))
        self.events = np.zeros(
            4, dtype=[("t_ns", "i8"), ("kind", "i8"), ("index", "i8"), ("value", "f8")]
        )
        self.told: list[tuple[int, int]] = []
        self.failed = -1

    def take(
        self, t_ms: float, message: int, code: int = 0, mode: int = 2, **values: float
    ) -> None:
        """Receive a message at a time with these signals (others 0)."""
        vector = np.zeros(6)
        for name, value in values.items():
            vector[globals()[name.upper()]] = value
        supervision.take_message(
            self.ties, self.rules, self.state, message, code, mode, vector, self.requests,
            self.statuses, round(t_ms * MS),
        )  # fmt: skip

    def look(self, t_ms: float) -> Watch:
        """Look for time-outs."""
        self.failed, noted, self.changed, _ = supervision.watch(
            self.ties, self.rules, self.state, self.requests, self.held, self.effective, self.share,
            self.limited, self.slewed, self.statuses, self.codes, self.operating,
            round(t_ms * MS), self.events, 0,
        )  # fmt: skip
        self.told += [(int(e["kind"]), int(e["index"])) for e in self.events[:noted]]
        return self
