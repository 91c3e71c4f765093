"""``hev-can-emu modes``: natural frequencies, damping ratios and mode shapes."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from hev_can_emu.commands._model import (
    add_model_arguments,
    add_vehicle_argument,
    check_plot,
    configuration_named,
    reduction_named,
    structure_for,
)

if TYPE_CHECKING:
    from hev_can_emu.plant.linear import Modes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_model_arguments(parser)
    add_vehicle_argument(parser)
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    parser.add_argument("--plot", metavar="FILE", help="draw the mode shapes (.png, .svg, .pdf)")


def execute(args: argparse.Namespace) -> int:
    """Print the modes; raises InputError for unusable options or files."""
    from hev_can_emu.commands._vehicle import load_vehicle
    from hev_can_emu.plant.linear import modes

    plot = check_plot(args.plot) if args.plot else None
    configuration = configuration_named(args.configuration)
    vehicle = load_vehicle(args.vehicle)
    structure = structure_for(vehicle.driveline, args.model, args.reduction)
    result = modes(structure, configuration)
    reduction = reduction_named(args.reduction) if args.model == "4dof" else None
    if plot is not None:
        from hev_can_emu.report.modes_plot import plot_modes

        rule = f", {reduction} reduction" if reduction else ""
        title = f"{vehicle.name}, {args.model}{rule}, {args.configuration}"
        plot_modes(plot, result.names, result.undamped_hz.tolist(), result.shapes, title)
    if args.json:
        print(json.dumps(_as_json(result, args.model, args.configuration, reduction, vehicle[:2])))
    else:
        _print(result, args.model, args.configuration, reduction, vehicle[:2])
    return 0


def _as_json(
    result: Modes,
    model: str,
    configuration: str,
    reduction: str | None,
    vehicle: tuple[str, str],
) -> dict[str, object]:
    return {
        "model": model,
        "configuration": configuration,
        "reduction": reduction,
        "vehicle": vehicle[0],
        "provenance": vehicle[1],
        "rigid_modes": result.rigid,
        "undamped_hz": result.undamped_hz.tolist(),
        "damped_hz": result.damped_hz.tolist(),
        "oscillation_hz": result.oscillation_hz.tolist(),
        "damping_ratio": result.damping_ratio.tolist(),
        "mode_shapes": {
            name: row.tolist() for name, row in zip(result.names, result.shapes, strict=True)
        },
    }


def _print(
    result: Modes,
    model: str,
    configuration: str,
    reduction: str | None,
    vehicle: tuple[str, str],
) -> None:
    from hev_can_emu.commands._vehicle import print_provenance

    rule = f", reduction {reduction}" if reduction else ""
    print(f"{vehicle[0]}: {model}, {configuration}{rule}; rigid-body modes: {result.rigid}")
    print_provenance(vehicle[1])
    print()
    print(f"{'mode':>4} {'undamped Hz':>12} {'|l|/2pi Hz':>12} {'Im(l)/2pi Hz':>13} {'ratio':>9}")
    columns = (result.undamped_hz, result.damped_hz, result.oscillation_hz, result.damping_ratio)
    for order, (undamped, damped, oscillation, ratio) in enumerate(zip(*columns, strict=True), 1):
        print(f"{order:4d} {undamped:12.2f} {damped:12.2f} {oscillation:13.2f} {ratio:9.5f}")
    print()
    print("Mode shapes, largest entry one, each part turning at its own speed:")
    width = max(len(name) for name in result.names)
    count = len(result.undamped_hz)
    for first in range(0, count, 8):
        some = range(first, min(first + 8, count))
        print(" " * width + "".join(f"{mode + 1:9d}" for mode in some))
        for name, row in zip(result.names, result.shapes, strict=True):
            print(f"{name:<{width}}" + "".join(f"{row[mode]:9.4f}" for mode in some))
        print()
