"""Runs a command where there is a vcan0: ``python tests/socketcan/with_vcan0.py COMMAND...``

On the host's own kernel where that has vcan, else inside Debian's user-mode Linux: a kernel that runs as an
ordinary process, on this machine's own files, which are read-only there.  The command may write into the
folder ``$SCRATCH`` (``--scratch FOLDER`` here) and into ``$TMPDIR``.  Where neither works this fails.
"""

from __future__ import annotations

import argparse
import contextlib
import mmap
import os
import platform
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
DEVICE = "vcan0"
MEMORY_MIB = 1024
LIMIT_S = 400.0


class NoVcanError(Exception):
    """There is no vcan0 here, and none can be made."""


def main() -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(description="Run a command where there is a vcan0.")
    parser.add_argument("--scratch", type=Path, help="where the command may write: $SCRATCH")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    arguments = parser.parse_args()
    with contextlib.ExitStack() as undo:
        scratch = arguments.scratch
        if scratch is None:
            scratch = Path(undo.enter_context(tempfile.TemporaryDirectory(prefix="vcan0-")))
        try:
            return run_with_vcan0(arguments.command, scratch)
        except NoVcanError as error:
            print(f"no {DEVICE}: {error}", file=sys.stderr)
            return 1


def run_with_vcan0(command: Sequence[str], scratch: Path) -> int:
    """Run ``command`` in this folder, printing where and what it prints; returns its exit code."""
    scratch.mkdir(parents=True, exist_ok=True)
    with host_device() as obstacle:
        if not obstacle:
            say(f"{DEVICE} on this machine's kernel, {platform.release()}")
            environment = os.environ | {"SCRATCH": str(scratch.resolve())}
            return subprocess.run(command, env=environment, timeout=LIMIT_S, check=False).returncode
    for folder in (Path.cwd(), Path(sys.prefix)):
        if folder.is_relative_to("/run") or folder.is_relative_to("/dev"):
            raise NoVcanError(
                f"{folder} would be hidden inside user-mode Linux; use another folder"
            )
    kernel = find("linux.uml")
    if not kernel:
        hint = "nor is there user-mode Linux (Debian: user-mode-linux, kmod)"
        raise NoVcanError(f"this machine's kernel says: {obstacle}; {hint}")
    say(f"{DEVICE} on user-mode Linux ({obstacle} on this kernel): wait")
    # A folder of its own for what goes in and out; no blank may be in its path.
    with tempfile.TemporaryDirectory(prefix="vcan0-") as folder:
        inside = Path(folder)
        prepare(inside, command, scratch)
        boot(kernel, inside)
        code = verdict(inside)
        for left in ("command", "init.sh", "code", "output", "console"):
            (inside / left).unlink(missing_ok=True)
        shutil.rmtree(inside / "cache", ignore_errors=True)
        shutil.copytree(inside, scratch, dirs_exist_ok=True)
    return code


def say(text: str) -> None:
    print(text)
    sys.stdout.flush()


def find(tool: str) -> str | None:
    """Return where a program is; an ordinary user's PATH lacks the sbin folders."""
    return shutil.which(tool) or shutil.which(tool, path="/usr/sbin:/sbin")


# -- this machine's kernel --------------------------------------------------------------------------


@contextlib.contextmanager
def host_device() -> Iterator[str]:
    """Yield '' while there is a vcan0 that works, or why there is none."""
    made = False
    obstacle = ""
    if not Path("/sys/class/net", DEVICE).exists():
        run("modprobe", "vcan")  # it may be there without
        obstacle = run("ip", "link", "add", "dev", DEVICE, "type", "vcan")
        made = not obstacle
        obstacle = obstacle or run("ip", "link", "set", DEVICE, "mtu", "72", "up")
    obstacle = obstacle or unusable()
    try:
        yield obstacle
    finally:
        if made:
            run("ip", "link", "delete", DEVICE)


def run(*command: str) -> str:
    """Run a command; return '' or its complaint."""
    program = find(command[0])
    if not program:
        return f"no {command[0]}"
    done = subprocess.run([program, *command[1:]], capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else (done.stderr.strip() or "failed").splitlines()[-1]


def unusable() -> str:
    """Return why no raw CAN socket can be bound to vcan0, or ''."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as probe:
            probe.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            probe.bind((DEVICE,))
    except OSError as error:
        return str(error)
    return ""


# -- user-mode Linux --------------------------------------------------------------------------------


def prepare(inside: Path, command: Sequence[str], scratch: Path) -> None:
    """Fill the folder that is $SCRATCH inside: what is in ``scratch``, and what init.sh runs."""
    from hev_can_emu.jit import cache_home

    shutil.copytree(scratch, inside, dirs_exist_ok=True)
    # What is compiled is taken along: compiling inside would take minutes.
    with contextlib.suppress(shutil.Error):  # another process may be removing what is old
        shutil.copytree(cache_home(), inside / "cache" / "kernels")
    shutil.copy(HERE / "init.sh", inside)
    (inside / "command").write_text(
        f"cd {shlex.quote(str(Path.cwd()))} || exit 1\n"
        f"export PATH={shlex.quote(os.environ['PATH'])}:$PATH\n"
        "export HEV_CAN_EMU_CACHE=$SCRATCH/cache PYTHONDONTWRITEBYTECODE=1\n"
        f"exec {shlex.join(command)}\n"
    )


def boot(kernel: str, inside: Path) -> None:
    """Run user-mode Linux until it halts."""
    arguments = (
        f"root=/dev/root rootfstype=hostfs rootflags=/ ro mem={MEMORY_MIB}M init={inside}/init.sh "
        f"scratch={inside} con0=null,fd:1 con=null quiet"
    )
    with (inside / "console").open("wb") as console:
        process = subprocess.Popen(
            [kernel, *arguments.split()],
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=subprocess.STDOUT,
            env=os.environ | {"TMPDIR": str(memory_folder(inside))},
            start_new_session=True,
        )
        try:
            process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # its session: the kernel and what runs on it
            process.wait()


def verdict(inside: Path) -> int:
    """Print what the command printed; returns its exit code."""
    output, code = inside / "output", inside / "code"
    if output.exists():
        say(output.read_text(errors="replace").rstrip())
    if not code.exists():
        said = (inside / "console").read_text(errors="replace").strip().splitlines()[-12:]
        raise NoVcanError("\n".join(["user-mode Linux ended without a verdict:", *said]))
    return int(code.read_text())


def memory_folder(otherwise: Path) -> Path:
    """Return a folder for the file that is the memory inside: in memory where that may be."""
    shared = Path("/dev/shm")
    roomy = shared.is_dir() and shutil.disk_usage(shared).free > 1.2 * (MEMORY_MIB << 20)
    return shared if roomy and may_execute(shared) else otherwise


def may_execute(folder: Path) -> bool:
    """Return whether files there may be mapped for execution, which containers often forbid."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(mmap.PAGESIZE))
            file.flush()
            mapped = mmap.mmap(file.fileno(), mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_EXEC)
            mapped.close()
    except OSError:
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
