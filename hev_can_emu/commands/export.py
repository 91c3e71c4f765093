"""``hev-can-emu export``: the linear driveline as named state-space matrices."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from hev_can_emu.commands._model import (
    add_model_arguments,
    add_vehicle_argument,
    check_output,
    choose,
    configuration_named,
    reduction_named,
    structure_for,
    writing,
)

if TYPE_CHECKING:
    from hev_can_emu.plant.state_space import Named

FORMATS = ("npz", "mat")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--format", default="npz", metavar="FORMAT", help="npz (default) or mat")
    add_model_arguments(parser)
    add_vehicle_argument(parser)
    parser.add_argument(
        "--out", metavar="FILE", help="file to write (default: MODEL_CONFIGURATION.FORMAT)"
    )


def execute(args: argparse.Namespace) -> int:
    """Write the matrices; raises InputError for unusable options or files."""
    from hev_can_emu.commands._vehicle import load_vehicle, print_provenance
    from hev_can_emu.plant.state_space import state_space

    kind = choose("--format", args.format, FORMATS)
    configuration = configuration_named(args.configuration)
    path = check_output("--out", args.out or f"{args.model}_{args.configuration}.{kind}")
    vehicle = load_vehicle(args.vehicle)
    structure = structure_for(vehicle.driveline, args.model, args.reduction)
    system = state_space(structure, configuration, vehicle.driveline.tyre_radius)
    content: dict[str, Any] = {"A": system.a, "B": system.b, "C": system.c, "D": system.d}
    texts = {
        "model": args.model,
        "configuration": args.configuration,
        "reduction": reduction_named(args.reduction) if args.model == "4dof" else "",
        "vehicle": vehicle.name,
        "provenance": vehicle.provenance,
    }
    names = {"state": system.states, "input": system.inputs, "output": system.outputs}
    with writing("--out", path):
        if kind == "npz":
            _write_npz(path, content, names, texts)
        else:
            _write_mat(path, content, names, texts)
    nx, nu, ny = len(system.states), len(system.inputs), len(system.outputs)
    print(f"{path}: {nx} states, {nu} inputs, {ny} outputs; A, B, C, D with names and units")
    print_provenance(vehicle.provenance)
    return 0


def _write_npz(
    path: Any, matrices: dict[str, Any], names: dict[str, tuple[Named, ...]], texts: dict[str, str]
) -> None:
    import numpy as np

    for kind, named in names.items():
        matrices[f"{kind}_names"] = np.array([one.name for one in named])
        matrices[f"{kind}_units"] = np.array([one.unit for one in named])
    matrices |= {key: np.array(text) for key, text in texts.items()}
    # Through an open file: given a name, NumPy would add .npz to it.
    with open(path, "wb") as stream:
        np.savez(stream, **matrices)


def _write_mat(
    path: Any, matrices: dict[str, Any], names: dict[str, tuple[Named, ...]], texts: dict[str, str]
) -> None:
    import numpy as np
    from scipy.io import savemat

    for kind, named in names.items():  # cell arrays of text
        matrices[f"{kind}_names"] = np.array([[one.name] for one in named], dtype=object)
        matrices[f"{kind}_units"] = np.array([[one.unit] for one in named], dtype=object)
    with open(path, "wb") as stream:
        savemat(stream, matrices | texts)
