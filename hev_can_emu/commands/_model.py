"""The options that choose model, configuration and reduction, and what they stand for.

Light to import: what the options stand for is looked up when a command runs.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from hev_can_emu.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from hev_can_emu.plant.structure import Configuration, Structure
    from hev_can_emu.plant.vehicle import DrivelineParameters

MODELS = ("16dof", "4dof")
REDUCTIONS = ("paper", "load-weighted")


def add_vehicle_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--vehicle``."""
    parser.add_argument(
        "--vehicle",
        default="dai2024",
        metavar="FILE",
        help="vehicle file or name of a shipped one (default: %(default)s)",
    )


def add_configuration_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--configuration``."""
    parser.add_argument(
        "--configuration",
        default="parallel_g1",
        metavar="NAME",
        help="series, parallel_g1, parallel_g2, electric_neutral, electric_g1 or electric_g2 "
        "(default: %(default)s)",
    )


def add_model_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--model``, ``--configuration`` and ``--reduction``."""
    parser.add_argument(
        "--model", default="16dof", metavar="MODEL", help="16dof or 4dof (default: %(default)s)"
    )
    add_configuration_argument(parser)
    add_reduction_argument(parser)


def add_reduction_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--reduction``."""
    parser.add_argument(
        "--reduction",
        metavar="RULE",
        help="of the 4dof model: paper (its literal rule, the default) or load-weighted (a closer one)",
    )


def choose(option: str, given: str, known: tuple[str, ...]) -> str:
    """Return ``given`` if it is one of ``known``; raises InputError otherwise."""
    if given not in known:
        raise InputError(
            option, f"one of {', '.join(known)}", f"'{given}'", did_you_mean(given, known)
        )
    return given


def configuration_named(name: str) -> Configuration:
    """Return the driving configuration ``name``; raises InputError for another name."""
    from hev_can_emu.plant.structure import CONFIGURATIONS

    return CONFIGURATIONS[choose("--configuration", name, tuple(CONFIGURATIONS))]


def reduction_named(given: str | None, model: str = "4dof") -> str:
    """Return the reduction's rule, the paper's where none is given.

    Raises:
        InputError: an unknown rule, or a rule for the full-order model.
    """
    if given is not None and model != "4dof":
        raise InputError("--reduction", "--model 4dof beside it", f"--model {model}")
    return choose("--reduction", given or "paper", REDUCTIONS)


def structure_for(parameters: DrivelineParameters, model: str, reduction: str | None) -> Structure:
    """Return the full-order or reduced structure; raises InputError for unknown names."""
    from hev_can_emu.plant.reduction import reduced
    from hev_can_emu.plant.structure import full_order

    choose("--model", model, MODELS)
    rule = reduction_named(reduction, model)
    return full_order(parameters) if model == "16dof" else reduced(parameters, rule)


def check_output(option: str, path: str) -> Path:
    """Return ``path`` if a file can be written there; raises InputError otherwise."""
    target = Path(path)
    if target.is_dir():
        raise InputError(option, "a file", f"the directory '{path}'")
    if not target.parent.is_dir():
        raise InputError(option, "a file in an existing folder", f"'{path}'")
    existed = target.exists()
    # Tried, not asked: permissions say little to root, on a full disk or in a special file system.
    with writing(option, target), target.open("ab"):
        pass
    if not existed:
        target.unlink()
    return target


@contextlib.contextmanager
def writing(option: str, path: Path) -> Iterator[None]:
    """Turn a failure to write ``path`` into an InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{option} {path}", "a file that can be written", f"{error.strerror}"
        ) from error


def check_plot(path: str) -> Path:
    """Return ``path`` if a plot can be written there; raises InputError otherwise."""
    from hev_can_emu.report.style import check_path

    target = check_output("--plot", path)
    check_path(target)
    return target
