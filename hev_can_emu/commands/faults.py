"""``hev-can-emu faults``: what can be injected, and what a client on the bus sees of it."""

from __future__ import annotations

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "kind", nargs="?", metavar="KIND", help="tell all about one kind (default: list them)"
    )
    parser.add_argument(
        "--seen",
        metavar="FILE",
        nargs="?",
        const="",
        help="play each fault of a file (default: the shipped one) and tell, as a Markdown table, what a"
        " client on the bus sees",
    )


def execute(arguments: argparse.Namespace) -> int:
    """Print; returns the exit code."""
    from hev_can_emu.errors import InputError, did_you_mean

    if arguments.seen is not None:
        from hev_can_emu.commands._compiling import compiling
        from hev_can_emu.runtime.fault_show import as_markdown, show
        from hev_can_emu.runtime.setup import Setup, prepared_faults

        faults, _ = prepared_faults(Setup(faults=arguments.seen or None))
        with compiling(quiet=True):
            rows = show(faults)
        print(as_markdown(rows), end="")
        return 0
    from hev_can_emu.ecu.faults import CATALOGUE, COMMON

    if arguments.kind is None:
        width = max(map(len, CATALOGUE))
        for kind in CATALOGUE.values():
            print(f"{kind.name:<{width}}  {kind.does}")
        return 0
    if arguments.kind not in CATALOGUE:
        hint = did_you_mean(arguments.kind, CATALOGUE)
        raise InputError("faults", "a kind of fault", f"'{arguments.kind}'", hint)
    kind = CATALOGUE[arguments.kind]
    print(f"{kind.name}: {kind.does}")
    for parameter in sorted(kind.parameters, key=lambda p: (p.name in COMMON, not p.required)):
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        default = " (required)" if parameter.required else ""
        if not parameter.required and parameter.default not in ("", "None"):
            default = f" (default: {parameter.default})"
        print(f"  {parameter.name}{unit}: {parameter.meaning}{default}")
    return 0
