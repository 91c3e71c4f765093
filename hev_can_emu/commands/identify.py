"""``hev-can-emu identify``: driveline parameters from measured natural frequencies."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from hev_can_emu.commands._model import check_output, writing
from hev_can_emu.errors import InputError

if TYPE_CHECKING:
    from hev_can_emu.plant.identification import Determinacy, Fit
    from hev_can_emu.plant.problem import Problem
    from hev_can_emu.plant.targets import TargetsFile

NOT_UNIQUE = "identified, not measured or published, and not unique"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("targets", metavar="TARGETS", help="targets file or name of a shipped one")
    parser.add_argument("--out", metavar="FILE", help="write the parameters as a vehicle file")
    parser.add_argument(
        "--starts", type=int, default=64, metavar="N", help="most starts (default: %(default)s)"
    )
    parser.add_argument(
        "--matches",
        type=int,
        default=1,
        metavar="N",
        help="stop after N starts that meet everything (default: %(default)s)",
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="of the random starts (default: 1)"
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="processes (default: one per available core)"
    )


def execute(args: argparse.Namespace) -> int:
    """Identify; return 0 where every measured number is met, 1 where not.

    Raises:
        InputError: unusable options or targets.
    """
    from hev_can_emu import config
    from hev_can_emu.plant.identification import determinacy
    from hev_can_emu.plant.problem import problem
    from hev_can_emu.plant.targets import TargetsFile
    from hev_can_emu.resources import folder, shipped_or_path

    for name, least in (("starts", 1), ("matches", 1), ("jobs", 1), ("seed", 0)):
        value = getattr(args, name)
        if value is not None and value < least:
            raise InputError(f"--{name}", f"a whole number >= {least}", str(value))
    out = check_output("--out", args.out) if args.out else None
    place = folder("vehicles") / "targets"
    path = shipped_or_path(args.targets, place, "TARGETS")
    file = config.load(path, TargetsFile)
    posed = problem(file, str(path))
    jobs = min(args.jobs or _cores(), args.starts)
    began = time.monotonic()
    fits = _run(posed, args.seed, args.starts, args.matches, jobs)
    best = min(fits, key=lambda fit: (not fit.matched, fit.worst))
    worst = _print_fit(posed, best)
    _print_determinacy(posed, determinacy(posed, best.sought))
    matched = sum(fit.matched for fit in fits)
    print(
        f"{matched} of {len(fits)} starts met every measured number; best start {best.start},"
        f" worst deviation {worst:.3g} tolerances; {time.monotonic() - began:.0f} s"
        f" on {jobs} {'process' if jobs == 1 else 'processes'}"
    )
    if out is not None:
        with writing("--out", out):
            out.write_text(_vehicle(file, posed, best), encoding="utf-8")
        print(f"{out}: vehicle file; its parameters are {NOT_UNIQUE}")
    if not best.matched:
        print(
            "Not every measured number is met: more --starts, wider ranges or tolerances may help"
        )
        return 1
    return 0


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS
        return os.cpu_count() or 1


def _run(posed: Problem, seed: int, starts: int, matches: int, jobs: int) -> list[Fit]:
    """Return the fits of the starts gone through, in order: the same for any number of processes."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    fits: list[Fit] = []
    found = 0
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total} starts, {task.fields[found]} met everything"),
        TimeElapsedColumn(),
        console=console,
        disable=not console.is_terminal,
    ) as progress:
        task = progress.add_task("identifying", total=starts, found=0)
        with _fits(posed, seed, starts, jobs) as results:
            for fit in results:
                fits.append(fit)
                found += fit.matched
                progress.update(task, advance=1, found=found)
                if not console.is_terminal:
                    state = "met everything" if fit.matched else f"left at stage '{fit.stage}'"
                    print(f"start {fit.start}: {state}", file=sys.stderr)
                if found >= matches:
                    break
    return fits


@contextmanager
def _fits(posed: Problem, seed: int, starts: int, jobs: int) -> Iterator[Iterator[Fit]]:
    import functools
    import multiprocessing

    from hev_can_emu.plant.identification import fit_start

    work = functools.partial(fit_start, posed, seed)
    if jobs == 1:
        yield map(work, range(starts))
        return
    # The matrices are small: a process each for the starts, no threads inside.
    previous = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        with multiprocessing.get_context("spawn").Pool(jobs, initializer=_leave_interrupts) as pool:
            yield pool.imap(work, range(starts))
    finally:
        for name, value in previous.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _leave_interrupts() -> None:
    """In a worker: leave Ctrl-C to the parent, which then ends the pool."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def _print_fit(posed: Problem, best: Fit) -> float:
    """Print measured and found numbers and the parameters; return the worst deviation."""
    import numpy as np

    from hev_can_emu.plant.identification import table
    from hev_can_emu.plant.problem import UNITS

    print(f"{'measured number':<40} {'measured':>11} {'found':>13}      deviation in tolerances")
    rows = table(posed, best.sought)
    for row in rows:
        print(
            f"{row.what:<40} {row.measured:>11.9g} {row.found:>13.9g} {row.unit:<4}"
            f" {row.error:>+8.2f}{'' if abs(row.error) <= 1.0 else '  MISSED'}"
        )
    print()
    print(f"Parameters ({NOT_UNIQUE}):")
    for name, value in zip(posed.sought, np.exp(best.sought), strict=True):
        print(f"  {name:<24} {value:>13.6g} {UNITS[name]}")
    print()
    return max(abs(row.error) for row in rows)


def _print_determinacy(posed: Problem, known: Determinacy) -> None:
    count = len(posed.sought)
    print(
        f"The data determine {known.determined} of {count} combinations of parameters to better than"
        f" {100 * known.limit:g} %; the other {count - known.determined} are chosen by ranges and"
        " priors, not by the data."
    )
    print("Relative uncertainty of each combination (one tolerance), best first:")
    shown = [f"{one:.1e}" if one < 1e6 else "none" for one in known.uncertainties]
    for first in range(0, count, 10):
        print("  " + " ".join(f"{one:>8}" for one in shown[first : first + 10]))
    print("Best determined combinations, as products of powers (largest exponents):")
    for row, uncertainty in list(zip(known.combinations, known.uncertainties, strict=True))[:5]:
        if not uncertainty < known.limit:
            break
        print(f"  {_powers(posed.sought, row)}  to {uncertainty:.1e}")
    print("How much of each parameter the data determine (1 all, 0 nothing):")
    ranked = sorted(zip(posed.sought, known.shares.tolist(), strict=True), key=lambda one: -one[1])
    for first in range(0, count, 4):
        some = ranked[first : first + 4]
        print("  " + " ".join(f"{name:>22} {share:.2f}" for name, share in some))
    print()


def _powers(names: tuple[str, ...], row: object) -> str:
    import numpy as np

    exponents = np.asarray(row)
    exponents = exponents * np.sign(exponents[np.argmax(np.abs(exponents))])
    largest = np.argsort(-np.abs(exponents), kind="stable")[:4]
    parts = [f"{_short(names[i])}^{exponents[i]:+.2f}" for i in largest if abs(exponents[i]) > 0.05]
    return " * ".join(parts)


def _short(name: str) -> str:
    section, _, last = name.rpartition(".")
    return f"rounding({last})" if section == "ratio_rounding" else last


def _vehicle(file: TargetsFile, posed: Problem, best: Fit) -> str:
    from hev_can_emu.plant.identification import table
    from hev_can_emu.plant.residuals import parameters_at
    from hev_can_emu.plant.vehicle_text import vehicle_text

    rows = table(posed, best.sought)
    met = sum(abs(row.error) <= 1.0 for row in rows)
    provenance = (
        f"Identified from the targets '{file.name}', of which {met} of {len(rows)} numbers are met within"
        " their tolerances. The values are plausible, not unique: other parameter sets meet the same"
        " numbers. Values given in the targets file are marked 'given'. About the targets: "
        + file.provenance
    )
    sources = {
        name: "identified" if posed.spread[index].any() else "given"
        for index, name in enumerate(posed.names)
    }
    for name in sources:
        if name.startswith("ratio_rounding.") and sources[name] == "given":
            sources[name] = "from the base radii"
    return vehicle_text(parameters_at(posed, best.sought), file.name, provenance, sources)
