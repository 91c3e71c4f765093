"""``hev-can-emu step-response``: full-order against reduced model after a torque step."""

from __future__ import annotations

import argparse
import json
import math
from typing import TYPE_CHECKING

from hev_can_emu.commands._model import (
    add_configuration_argument,
    add_reduction_argument,
    add_vehicle_argument,
    check_plot,
    configuration_named,
    reduction_named,
)
from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.plant.step_response import StepResponse

MAX_POINTS = 1_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options; their defaults are the experiment of Figure 12."""
    add_configuration_argument(parser)
    add_reduction_argument(parser)
    add_vehicle_argument(parser)
    for name, default, unit, what in (
        ("engine-torque", 150.0, "NM", "engine torque after the step"),
        ("em1-torque", 0.0, "NM", "EM1 torque after the step"),
        ("em2-torque", 200.0, "NM", "EM2 torque after the step"),
        ("step-time", 4.0, "S", "time of the step"),
        ("end-time", 10.0, "S", "when the speeds are read"),
        ("grid", 0.01, "S", "spacing of the results"),
    ):
        parser.add_argument(
            f"--{name}",
            type=float,
            default=default,
            metavar=unit,
            help=f"{what} (default: %(default)g)",
        )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--plot", metavar="FILE", help="draw the response (.png, .svg, .pdf)")


def execute(args: argparse.Namespace) -> int:
    """Run both models and print how far they are apart; raises InputError for unusable input."""
    from hev_can_emu.commands._vehicle import load_vehicle
    from hev_can_emu.plant.step_response import Step, step_response

    plot = check_plot(args.plot) if args.plot else None
    configuration = configuration_named(args.configuration)
    rule = reduction_named(args.reduction)
    _check_numbers(args)
    vehicle = load_vehicle(args.vehicle)
    step = Step(
        args.step_time,
        args.end_time,
        args.engine_torque,
        args.em1_torque,
        args.em2_torque,
        args.grid,
    )
    result = step_response(vehicle.driveline, configuration, step, rule)
    if plot is not None:
        from hev_can_emu.report.step_plot import Response, plot_step_response

        plot_step_response(
            plot,
            result.times,
            Response("16-DOF", result.velocity_16, result.acceleration_16),
            Response(f"4-DOF ({rule})", result.velocity_4, result.acceleration_4),
            f"{vehicle.name}, {args.configuration}: torque step from rest",
            (
                f"{result.velocity_difference_percent:.4f} % apart at the end",
                f"furthest apart, {result.acceleration_difference_percent:.3f} %,"
                f" at {result.acceleration_difference_time:.2f} s",
            ),
        )
    if args.json:
        print(json.dumps(_as_json(result, args.configuration, rule, vehicle[:2])))
    else:
        _print(result, args.configuration, rule, vehicle[:2])
    return 0


def _check_numbers(args: argparse.Namespace) -> None:
    for name in ("engine_torque", "em1_torque", "em2_torque", "step_time", "end_time", "grid"):
        value = getattr(args, name)
        if not math.isfinite(value):
            raise InputError(f"--{name.replace('_', '-')}", "a finite number", str(value))
    if not args.grid > 0.0:
        raise InputError("--grid", "a spacing > 0 s", f"{args.grid:g} s")
    if args.step_time < 0.0:
        raise InputError("--step-time", "a time >= 0 s", f"{args.step_time:g} s")
    if args.end_time <= args.step_time:
        raise InputError(
            "--end-time", f"a time after the step at {args.step_time:g} s", f"{args.end_time:g} s"
        )
    if args.end_time / args.grid > MAX_POINTS:
        count = args.end_time / args.grid
        raise InputError("--grid", f"at most {MAX_POINTS} points", f"{count:.3g}", "widen the grid")
    for name in ("step_time", "end_time"):
        value = getattr(args, name)
        if abs(round(value / args.grid) * args.grid - value) > 1e-9 * max(1.0, value):
            raise InputError(
                f"--{name.replace('_', '-')}", f"a multiple of {args.grid:g} s", f"{value:g} s"
            )


def _as_json(
    result: StepResponse, configuration: str, rule: str, vehicle: tuple[str, str]
) -> dict[str, object]:
    at = result.largest
    return {
        "configuration": configuration,
        "reduction": rule,
        "vehicle": vehicle[0],
        "provenance": vehicle[1],
        "dof16": {
            "velocity": float(result.velocity_16[-1]),
            "acceleration": float(result.acceleration_16[at]),
        },
        "dof4": {
            "velocity": float(result.velocity_4[-1]),
            "acceleration": float(result.acceleration_4[at]),
        },
        "velocity_difference_percent": result.velocity_difference_percent,
        "acceleration_difference_percent": result.acceleration_difference_percent,
        "acceleration_difference_time": round(result.acceleration_difference_time, 9),
    }


def _print(result: StepResponse, configuration: str, rule: str, vehicle: tuple[str, str]) -> None:
    from hev_can_emu.commands._vehicle import print_provenance

    at = result.largest
    print(f"{vehicle[0]}: {configuration}, reduction {rule}, from rest, no road load")
    print_provenance(vehicle[1])
    print()
    print(
        f"speed at {result.times[-1]:g} s      16-DOF {result.velocity_16[-1]:.4f} m/s"
        f"   4-DOF {result.velocity_4[-1]:.4f} m/s"
        f"   apart {result.velocity_difference_percent:.4f} %"
    )
    print(
        f"acceleration furthest apart at {result.times[at]:.2f} s: 16-DOF"
        f" {result.acceleration_16[at]:.5f} m/s^2   4-DOF {result.acceleration_4[at]:.5f} m/s^2"
        f"   apart {result.acceleration_difference_percent:.3f} %"
    )
