"""``hev-can-emu dbc check``: what a DBC file, and bindings beside it, make of the car."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.messages.database import Database, MessageDef

_MS = 1_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    actions.add_parser("ports", help="list what bindings can tie signals to")
    check = actions.add_parser(
        "check", help="list what is wrong or missing, and what would be sent"
    )
    check.add_argument("file", metavar="FILE", help="DBC file")
    check.add_argument(
        "--bindings",
        metavar="FILE",
        help="what its signals mean (default: NAME.bindings.yaml beside NAME.dbc, where there is one)",
    )


def execute(arguments: argparse.Namespace) -> int:
    """List everything; raises InputError where the network cannot be used."""
    if arguments.action == "ports":
        return _list_ports()
    from hev_can_emu import config
    from hev_can_emu.ecu.bindings_file import Bindings
    from hev_can_emu.ecu.network import complete
    from hev_can_emu.messages.inspection import inspect
    from hev_can_emu.runtime.setup import bindings_beside

    path = Path(arguments.file)
    beside = Path(arguments.bindings) if arguments.bindings else bindings_beside(path)
    bindings = document = None
    if beside is not None:
        document = config.read(beside)
        bindings = document.convert(Bindings)
    found = inspect(path, bindings.leave_out if bindings else ())
    database = found.database
    print(
        f"{path}: {len(database.messages)} messages, {len(database.signals)} signals, "
        f"{len(database.nodes)} nodes"
    )
    _section("cannot be used", (str(defect) for defect in found.defects))
    _section("cannot be encoded", (f"{one.where}: {one.text}" for one in found.unencodable))
    if found.defects:
        # What follows would be told of another network than the file's.
        sys.stdout.flush()
        count = f"{len(found.defects)} message{'s' * (len(found.defects) > 1)} that cannot be used"
        hint = "mend them, or name them under 'leave_out' in the bindings"
        raise InputError(str(path), "a network without defects", count, hint)
    if bindings is None or document is None:
        _without_cycle_time(database, ())
        print("\nsent by the DBC's own words (no bindings file: nothing would be sent)")
        _table([_schedule(message) for message in database.messages])
        return 0
    database = complete(bindings, database, document.where)
    told = [
        name
        for name, binding in bindings.messages.items()
        if binding.supervision is not None and binding.supervision.period
    ]
    _without_cycle_time(database, told)
    _print_trial(path, beside)
    return 0


def _list_ports() -> int:
    from hev_can_emu.ecu.ports import REQUESTS, STATUSES

    for title, known in (
        ("request: and external: (what a unit receives)", REQUESTS),
        ("status: (what a unit sends)", STATUSES),
    ):
        print(f"{title}")
        _table(
            [
                (port.name, "" if port.unit == "1" else port.unit, port.meaning)
                for port in sorted(known)
            ]
        )
        print()
    return 0


def _without_cycle_time(database: Database, told: Collection[str]) -> None:
    """List messages that nothing tells when to send, but those whose period the bindings tell."""
    from hev_can_emu.messages.inspection import without_cycle_time

    silent = [message.name for message in without_cycle_time(database)]
    _section(
        "without cycle time, and with no event that sends them",
        (name for name in silent if name not in told),
    )


def _section(title: str, lines: Iterable[str]) -> None:
    listed = list(lines)
    if listed:
        print(f"\n{title} ({len(listed)})")
        for line in listed:
            print(f"  {line}")


def _print_trial(path: Path, beside: Path | None) -> None:
    from hev_can_emu.commands._compiling import compiling
    from hev_can_emu.runtime.trial import Trial

    with compiling():
        trial = Trial(path, beside)
    _section("messages that no binding names", trial.unnamed_messages)
    _section("signals without a port, and what is sent for them", trial.unbound_signals)
    _section("requests that no signal carries", trial.unbound_requests)
    _section("requests without supervision", trial.unsupervised)
    if trial.unbound_statuses:
        print(f"\nstatuses that no signal carries ({len(trial.unbound_statuses)})")
        names = ", ".join(trial.unbound_statuses)
        print(textwrap.fill(names, 100, initial_indent="  ", subsequent_indent="  "))
    print(f"\nsent in the first second, ignition on: {trial.frames} frames")
    _table(
        [(*_schedule(sent.message), f"{sent.frames}/s", sent.last.hex(" ")) for sent in trial.sent]
    )
    if trial.received:
        print(f"\nreceived from the controller ({len(trial.received)})")
        _table([_schedule(message) for message in trial.received])


def _schedule(message: MessageDef) -> tuple[str, ...]:
    """Return what there is to say of a message's sending."""
    width = 8 if message.extended else 3
    kind = "FD" if message.fd else "classic"
    when = message.send_type.value
    if message.cycle_time_ns:
        when += f" {message.cycle_time_ns / _MS:g} ms"
    if message.fast_cycle_time_ns:
        when += f" (fast {message.fast_cycle_time_ns / _MS:g} ms)"
    if message.repetitions:
        when += f", {message.repetitions} repetitions"
    guard = message.protection.profile if message.protection else "unprotected"
    return (
        f"0x{message.can_id:0{width}X}",
        message.name,
        message.sender or "nobody",
        f"{message.length} bytes {kind}",
        when,
        guard,
    )


def _table(rows: list[tuple[str, ...]]) -> None:
    if not rows:
        return
    widths = [max(len(row[n]) for row in rows) for n in range(len(rows[0]))]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print(f"  {'  '.join(cells)}".rstrip())
