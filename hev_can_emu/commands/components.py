"""``hev-can-emu components``: every component of the detailed model beside its known answers, drawn."""

from __future__ import annotations

import argparse
import importlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.commands._components.card import Car, Card

# name, module, line of help
COMPONENTS = {
    "engine": "engine",
    "clutch": "clutch",
    "synchronizer": "synchronizer",
    "machine": "machine",
    "current-control": "current_control",
    "hydraulics": "hydraulics",
    "battery": "battery",
    "road": "road",
    "tyre": "tyre",
    "mesh": "mesh",
    "ripple": "ripple",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"some of {', '.join(COMPONENTS)} (default: all)"
    )
    parser.add_argument(
        "--vehicle", default="dai2024", metavar="FILE", help="vehicle file or shipped name"
    )
    parser.add_argument("--out", metavar="DIR", help="draw a picture of each into this folder")
    parser.add_argument(
        "--format", default="png", metavar="F", help="of the pictures: png, svg or pdf"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def execute(args: argparse.Namespace) -> int:
    """Compute the components' known answers; 1 where one is missed, InputError for unusable input."""
    names = args.names or list(COMPONENTS)
    for name in names:
        if name not in COMPONENTS:
            raise InputError("components", f"one of {', '.join(COMPONENTS)}", f"'{name}'")
    if args.format not in ("png", "svg", "pdf"):
        raise InputError("--format", "png, svg or pdf", f"'{args.format}'")
    car = _car(args.vehicle)
    held = True
    told = {}
    for name in names:
        card = compute(name, car)
        held = held and all(fact.holds for fact in card.facts)
        if args.out:
            from hev_can_emu.report.component_plot import plot_component

            path = Path(args.out) / f"{name}.{args.format}"
            plot_component(path, card.title, card.panels, card.facts, card.note)
        if args.json:
            told[name] = [
                {**fact._asdict(), "apart": fact.off, "holds": fact.holds} for fact in card.facts
            ]
        else:
            _print(name, card)
    if args.json:
        print(json.dumps(told))
    return 0 if held else 1


def compute(name: str, car: Car) -> Card:
    """Return a component's card; ``name`` is one of :data:`COMPONENTS`."""
    module = importlib.import_module(f"hev_can_emu.commands._components.{COMPONENTS[name]}")
    card: Card = module.show(car)
    return card


def _car(vehicle: str) -> Car:
    from hev_can_emu.commands._components.load import load_car

    return load_car(vehicle)


def _print(name: str, card: Card) -> None:
    print(f"{name}: {card.title}")
    for fact in card.facts:
        apart = f"{100.0 * fact.off:.2g} %" if fact.known else f"{fact.off:.2g} {fact.unit}"
        print(
            f"  {fact.what:<66} known {fact.known:<12.7g} computed {fact.computed:<12.7g}"
            f" {fact.unit:<8} apart {apart}{'' if fact.holds else '   TOO FAR'}"
        )
    print()
