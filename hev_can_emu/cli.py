"""The command ``hev-can-emu``: a thin face that imports only what the chosen command needs."""

from __future__ import annotations

import argparse
import atexit
import contextlib
import gc
import importlib
import os
import sys
import threading
from collections.abc import Sequence
from typing import Any, NoReturn

from hev_can_emu.errors import HevError

EXIT_PASS, EXIT_FAIL, EXIT_UNUSABLE, EXIT_INCONCLUSIVE = 0, 1, 2, 3

# name, module under hev_can_emu.commands, one line of help
COMMANDS: tuple[tuple[str, str, str], ...] = (
    ("run", "run", "put the car on a CAN bus, in real time"),
    ("scenario", "scenario", "run scenarios and judge what they show"),
    ("replay", "replay", "play a recording to a bus, or its requests to the car"),
    ("compare", "compare", "one scenario with each fidelity of the plant, over each other"),
    ("dbc", "dbc", "check a network file and its bindings"),
    ("faults", "faults", "list the faults that can be injected, and what a client sees of them"),
    ("modes", "modes", "natural frequencies, damping and mode shapes"),
    ("step-response", "step_response", "full-order against reduced model after a torque step"),
    ("identify", "identify", "find driveline parameters from measured frequencies"),
    ("components", "components", "the detailed model's components beside their known answers"),
    ("export", "export", "state-space matrices for controller design"),
    ("warm", "warm", "compile the kernels into the cache"),
)


def build_parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser; only the command named in ``argv`` is imported and given its arguments."""
    parser = _Parser(
        prog="hev-can-emu",
        description="A series-parallel hybrid car on a CAN bus.",
        epilog="Exit codes: 0 pass, 1 fail, 2 unusable input, 3 inconclusive.",
    )
    parser.add_argument("--version", nargs=0, action=_ShowVersion, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    chosen = next((word for word in argv if not word.startswith("-")), None)
    # Nobody sees the others where the first word is a command; to make them takes a millisecond.
    alone = [each for each in COMMANDS if each[0] == argv[0]] if argv else []
    for name, module, summary in alone or COMMANDS:
        sub = commands.add_parser(name, help=summary, description=summary)
        if name == chosen:
            implementation = importlib.import_module(f"hev_can_emu.commands.{module}")
            implementation.add_arguments(sub)
            sub.set_defaults(execute=implementation.execute)
    return parser


class _Parser(argparse.ArgumentParser):
    """Tells what is wrong in one line, as all other errors are told."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(formatter_class=_formatter, **keywords)

    def error(self, message: str) -> NoReturn:
        """Print the line and end with the exit code for unusable input."""
        text = message.removeprefix("argument ")
        self.exit(EXIT_UNUSABLE, f"hev-can-emu: {text}; see {self.prog} --help\n")


def _formatter(prog: str) -> argparse.HelpFormatter:
    """Return what lays help out, as wide as the terminal.

    Left to find that out, argparse imports what packs and unpacks archives, for each option anew.
    """
    columns = os.environ.get("COLUMNS", "")
    width = int(columns) if columns.isdecimal() else 0
    if width == 0:
        width = 80
        with contextlib.suppress(ValueError, OSError):  # no terminal
            if sys.__stdout__ is not None:
                width = os.get_terminal_size(sys.__stdout__.fileno()).columns or width
    return argparse.HelpFormatter(prog, width=width - 2)


class _ShowVersion(argparse.Action):
    """Looks the version up only when it is asked for: importlib.metadata is slow to import."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"hev-can-emu {version('hev-can-emu')}")
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code; errors become one line on stderr."""
    if argv is None:
        # A process of its own: importing the compiler makes half a million objects that stay, and
        # the collector's default would walk them again and again.
        gc.set_threshold(400_000, 50, 100)
        # Its matrices are small: threads that stand ready for large ones would cost more than they save.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        atexit.register(gc.freeze)  # the last collection, at the end, would find nothing of use
        if len(sys.argv) > 1 and not sys.argv[1].startswith("-"):
            _import_msgspec()
    arguments = list(sys.argv[1:] if argv is None else argv)
    parser = build_parser(arguments)
    try:
        parsed = parser.parse_args(arguments)
        code: int = parsed.execute(parsed)
        if sys.stdout is not None:  # it was not closed from the start
            sys.stdout.flush()
    except HevError as error:
        print(f"hev-can-emu: {error}", file=sys.stderr)
        return EXIT_UNUSABLE
    except BrokenPipeError:
        # The reader (head, less) has gone; what it wanted to see, it saw.
        sys.stderr.close()
        return EXIT_PASS
    except OSError as error:
        # What no command expected of the system, such as a full disk behind standard output.
        print(f"hev-can-emu: {error.filename or 'output'}: {error.strerror}", file=sys.stderr)
        return EXIT_UNUSABLE
    except KeyboardInterrupt:
        return 130
    return code


def _import_msgspec() -> None:
    """Import msgspec as if typing_extensions were not installed.

    It takes two names from there that are the same in Python's own typing, and that takes a twentieth of a
    short run.
    """
    if "typing_extensions" in sys.modules:
        return
    sys.modules["typing_extensions"] = None  # type: ignore[assignment]  # its import fails
    try:
        import msgspec  # noqa: F401
    finally:
        del sys.modules["typing_extensions"]


def command() -> NoReturn:
    """Run the command as a process of its own, and end that at once.

    Python would free every object first, for a twentieth of a short run's time.
    """
    code = main()
    if threading.active_count() == 1:
        with contextlib.suppress(Exception):  # told by Python at the regular end
            atexit._run_exitfuncs()
            for stream in (sys.stdout, sys.stderr):
                if stream is not None:
                    stream.flush()
            os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    command()
