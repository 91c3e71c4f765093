"""The Makefile's set-up, driven with a stand-in for Python that only writes down what it is asked."""

import shutil
import subprocess
from pathlib import Path

import pytest

TOOLS = (
    "sh",
    "make",
    "cat",
    "cksum",
    "cut",
    "find",
    "grep",
    "mkdir",
    "rm",
    "touch",
    "cp",
    "chmod",
    "awk",
)

# Plays python, pip and the command: notes its arguments; `-m venv` copies it to where make looks.
STAND_IN = r"""#!{sh}
case "$*" in -c*) exit 0;; "--version") echo Python 3.99; exit 0;; esac
echo "$(basename "$0") $*" | sed "s|$PWD|HERE|g" >> "{log}"
if test "$2" = venv; then
    mkdir -p "$3/bin"
    for name in python hev-can-emu; do cp "$0" "$3/bin/$name"; done
    echo "#!$PWD/$3/bin/python" > "$3/bin/pip"
fi
"""


class Checkout:
    """A checkout's set-up files in a folder of their own, with a PATH that has nothing else."""

    def __init__(self, repository: Path, folder: Path) -> None:
        self.root = folder / "checkout"
        self.path = folder / "bin"
        self.log = folder / "log"
        (self.root / "hev_can_emu").mkdir(parents=True)
        (self.root / "hev_can_emu" / "tick.py").write_text("one = 1\n")
        for name in ("Makefile", "requirements.lock", "pyproject.toml", "hatch_build.py"):
            shutil.copy(repository / name, self.root)
        self.path.mkdir()
        for tool in (*TOOLS, "test", "basename", "sed", "id"):
            found = shutil.which(tool)
            assert found, f"tests need {tool}"
            (self.path / tool).symlink_to(found)
        self.environment = {"PATH": str(self.path), "HOME": str(folder), "LC_ALL": "C"}

    def add_python(self) -> None:
        python = self.path / "python3"
        sh = shutil.which("sh")
        assert sh
        python.write_text(STAND_IN.replace("{sh}", sh).replace("{log}", str(self.log)))
        python.chmod(0o755)

    def make(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["make", *arguments],
            cwd=self.root,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    def calls(self, *arguments: str) -> list[str]:
        """Run make and return what it asked of Python and of the command."""
        self.log.write_text("")
        done = self.make(*arguments)
        assert done.returncode == 0, done.stdout + done.stderr
        return self.log.read_text().splitlines()


@pytest.fixture
def checkout(repository: Path, tmp_path: Path) -> Checkout:
    return Checkout(repository, tmp_path)


def kinds(calls: list[str]) -> list[str]:
    """Return what kind of work each call is."""
    words = {
        "venv": "venv",
        "--require-hashes": "dependencies",
        "--editable": "package",
        "check": "check",
    }
    return [
        next((kind for word, kind in words.items() if word in call.split()), call.split()[1])
        for call in calls
    ]


def test_without_python_one_line_says_what_to_do(checkout: Checkout) -> None:
    done = checkout.make("demo")
    assert done.returncode == 2
    lines = [line for line in done.stderr.splitlines() if not line.startswith("make")]
    assert len(lines) == 1
    assert lines[0].startswith("no Python 3.11 or newer with venv found")
    assert done.stdout == ""


def test_an_old_python_is_passed_over(checkout: Checkout) -> None:
    old = checkout.path / "python3.13"
    old.write_text("#!/bin/sh\nexit 1\n")
    old.chmod(0o755)
    checkout.add_python()
    assert "python3 -m venv .venv" in checkout.calls("install")


def test_demo_alone_sets_up_what_it_needs_and_only_once(checkout: Checkout) -> None:
    checkout.add_python()
    first = checkout.calls("demo")
    assert kinds(first) == ["venv", "dependencies", "package", "check", "warm", "scenario"]
    assert "--only-binary" in first[1]
    assert "--no-build-isolation" in first[2]
    (Path(checkout.environment["HOME"]) / ".cache" / "hev-can-emu").mkdir(parents=True)
    assert kinds(checkout.calls("demo")) == ["scenario"]


def test_changes_redo_what_hangs_on_them(checkout: Checkout) -> None:
    checkout.add_python()
    (Path(checkout.environment["HOME"]) / ".cache" / "hev-can-emu").mkdir(parents=True)
    checkout.calls("demo")
    (checkout.root / "hev_can_emu" / "tick.py").write_text("two = 2\n")
    assert kinds(checkout.calls("demo")) == ["warm", "scenario"]
    with (checkout.root / "requirements.lock").open("a") as lock:
        lock.write("# changed\n")
    assert kinds(checkout.calls("demo")) == ["dependencies", "package", "check", "warm", "scenario"]
    checkout.root = checkout.root.rename(checkout.root.with_name("moved"))
    assert kinds(checkout.calls("demo")) == [
        "venv",
        "dependencies",
        "package",
        "check",
        "warm",
        "scenario",
    ]


def test_a_lost_kernel_cache_is_warmed_again(checkout: Checkout) -> None:
    checkout.add_python()
    cache = Path(checkout.environment["HOME"]) / ".cache" / "hev-can-emu"
    cache.mkdir(parents=True)
    checkout.calls("demo")
    cache.rmdir()
    assert kinds(checkout.calls("demo")) == ["warm", "scenario"]


def test_help_lists_the_targets(checkout: Checkout) -> None:
    done = checkout.make()
    listed = {line.split()[1] for line in done.stdout.splitlines()}
    named = "help install demo test lint format types imports unit wheel-smoke lock clean bench"
    assert listed >= set(named.split())
