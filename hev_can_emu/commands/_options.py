"""Options that several commands share, and how they become a Setup."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import msgspec

from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.runtime.setup import Setup

_FIELDS = ("vehicle", "model", "reduction", "dbc", "bindings", "faults", "protection", "start")


def add_setup_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what decides how the car behaves."""
    group = parser.add_argument_group("the car and its network")
    group.add_argument(
        "--vehicle", metavar="FILE", help="vehicle file or shipped name (default: dai2024)"
    )
    group.add_argument(
        "--model", metavar="MODEL", help="plant: 4dof, 16dof or detailed (default: 16dof)"
    )
    group.add_argument(
        "--reduction",
        metavar="RULE",
        help="of 4dof: load-weighted or paper (default: load-weighted)",
    )
    group.add_argument("--dbc", metavar="FILE", help="network file (default: the shipped hev.dbc)")
    group.add_argument(
        "--bindings", metavar="FILE", help="what its signals mean (default: the shipped bindings)"
    )
    group.add_argument(
        "--faults",
        metavar="FILE",
        help="faults that a message of the network injects by number (default: the shipped ones)",
    )
    group.add_argument(
        "--protection",
        metavar="MODE",
        help="received counters and CRCs: off, observe or enforce (default: enforce)",
    )
    group.add_argument("--start", metavar="STATE", help="ready or off (default: ready)")
    group.add_argument(
        "--node",
        metavar="NAME=OWNER",
        action="append",
        default=[],
        help="who sends a node's messages: emulated, external or silent; may be repeated",
    )


def make_setup(arguments: argparse.Namespace, base: Setup | None = None) -> Setup:
    """Return the setup: command line over ``base`` (a scenario's), over defaults.

    Raises:
        InputError: ``--node`` is not NAME=OWNER.
    """
    from hev_can_emu.runtime.setup import Setup

    base = base or Setup()
    nodes = dict(base.nodes)
    for text in arguments.node:
        name, equals, owner = text.partition("=")
        if not equals or not name or not owner:
            raise InputError("--node", "NAME=OWNER", f"'{text}'", "e.g. --node MCU2=external")
        nodes[name] = owner
    told = {key: value for key in _FIELDS if (value := getattr(arguments, key)) is not None}
    return msgspec.structs.replace(base, nodes=nodes, **told)


def seconds(text: str) -> float:
    """Read a time in seconds for argparse: a number, or a number with a unit of time."""
    from hev_can_emu.units import parse_quantity

    wrong = argparse.ArgumentTypeError(f"expected a time such as 10 or '10 s', got '{text}'")
    try:
        value = float(text)
    except ValueError:
        try:
            value = parse_quantity(text, "--duration", "s").si_value
        except InputError as error:
            raise wrong from error
    if not 0.0 < value < 1e7:
        raise argparse.ArgumentTypeError(f"expected a time above 0 s, got '{text}'")
    return value
