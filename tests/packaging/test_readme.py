"""Every command that the README shows is run, as shown.

A comment before each block of shell or Python says how::

    <!-- test: run -->          to its end, which must be a success
    <!-- test: run 3s -->       for three seconds, then interrupted: until then it must not have ended
    <!-- test: background -->   alive while the blocks after it run; then interrupted, it must end well
    <!-- test: setup -->        lines of `make TARGET` for a fresh clone: only checked to be targets

Blocks run in order in a scratch folder that shows the repository's own folders.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

pytestmark = pytest.mark.realtime

LIMIT_S = 120.0
SHOWN = (".venv", "dbc", "docs", "scenarios", "vehicles")
BLOCK = re.compile(
    r"(?:^<!-- test: ([^>]*?) -->\n)?^```(sh|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL
)


class Block(NamedTuple):
    """One block of the README: how to run it, in which language, and its text."""

    how: str
    language: str
    text: str

    def command(self) -> list[str]:
        if self.language == "python":
            return [sys.executable, "-c", self.text]
        # What will be interrupted takes the shell's place, so that the exit code is its own.
        return ["sh", "-e", "-c", self.text if self.how == "run" else f"exec {self.text.strip()}"]


def blocks_of(page: str) -> list[Block]:
    return [Block(*match.groups(default="")) for match in BLOCK.finditer(page)]


@pytest.fixture
def scratch(repository: Path, tmp_path: Path) -> Path:
    for name in SHOWN:
        (tmp_path / name).symlink_to(repository / name)
    return tmp_path


class Session:
    """Runs blocks one after the other, and what was put in the background beside them."""

    def __init__(self, scratch: Path) -> None:
        self._scratch = scratch
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        self._environment = os.environ | {"PATH": path, "COLUMNS": "120", "PYTHONUNBUFFERED": "1"}
        self._background: list[tuple[Block, subprocess.Popen[str], Path]] = []
        self._started: list[subprocess.Popen[str]] = []

    def play(self, block: Block) -> None:
        if block.how == "background":
            self._play_behind(block)
        elif bounded := re.fullmatch(r"run (\d+)s", block.how):
            self._play_for(block, float(bounded[1]))
        else:
            assert block.how == "run", f"how to run this? {block}"
            process, log = self._start(block)
            code = process.wait(LIMIT_S)
            assert code == 0, f"{block.text}ended with {code}:\n{log.read_text()}"

    def _play_behind(self, block: Block) -> None:
        process, log = self._start(block)
        self._background.append((block, process, log))
        # Up once it says how to join; pipes would fill, so it writes to a file that grows.
        for _ in range(int(LIMIT_S * 10)):
            if "29536" in log.read_text() and accepts(29536):
                return
            if ended(process, 0.1):
                break
        pytest.fail(f"{block.text}is not up:\n{log.read_text()}")

    def _play_for(self, block: Block, seconds: float) -> None:
        process, log = self._start(block)
        assert not ended(process, seconds), f"{block.text}ended early:\n{log.read_text()}"
        os.killpg(process.pid, signal.SIGINT)
        process.wait(LIMIT_S)
        assert "Traceback" not in log.read_text(), log.read_text()
        assert log.read_text().strip(), f"{block.text}printed nothing"

    def _start(self, block: Block) -> tuple[subprocess.Popen[str], Path]:
        log = self._scratch / f"log{len(list(self._scratch.glob('log*')))}"
        with log.open("w") as out:
            process = subprocess.Popen(
                block.command(),
                cwd=self._scratch,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
        self._started.append(process)
        return process, log

    def end(self) -> None:
        """Interrupt what runs in the background and see it end well."""
        while self._background:
            block, process, log = self._background.pop()
            assert process.poll() is None, f"{block.text}ended by itself:\n{log.read_text()}"
            os.killpg(process.pid, signal.SIGINT)
            assert process.wait(20.0) == 0, f"{block.text}:\n{log.read_text()}"
            assert "Traceback" not in log.read_text(), log.read_text()

    def kill(self) -> None:
        """Leave nothing behind when a test has failed."""
        for process in self._started:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def ended(process: subprocess.Popen[str], seconds: float) -> bool:
    """Return whether the process ends within that time, and wait no longer than that."""
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        return False
    return True


def accepts(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
    except OSError:
        return False
    return True


@pytest.fixture
def session(scratch: Path) -> Iterator[Session]:
    started = Session(scratch)
    yield started
    started.kill()


def test_every_block_says_how_it_is_tested(repository: Path) -> None:
    blocks = blocks_of((repository / "README.md").read_text())
    assert len(blocks) >= 5
    unclear = [b for b in blocks if not re.fullmatch(r"setup|background|run( \d+s)?", b.how)]
    assert unclear == []


def test_set_up_lines_are_targets(repository: Path) -> None:
    blocks = blocks_of((repository / "README.md").read_text())
    lines = [line for b in blocks if b.how == "setup" for line in b.text.splitlines()]
    assert "make demo" in lines
    assert "make test" in lines
    # As from a terminal of its own, not as part of the make that may be running this test.
    environment = {key: value for key, value in os.environ.items() if not key.startswith("MAKE")}
    listed = subprocess.run(
        ["make", "help"],
        cwd=repository,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    targets = {line.split()[1] for line in listed.stdout.splitlines()}
    for line in lines:
        assert line.split()[0] == "make"
        assert set(line.split()[1:]) <= targets


def test_commands_do_what_the_readme_says(repository: Path, session: Session) -> None:
    for block in blocks_of((repository / "README.md").read_text()):
        if block.how != "setup":
            session.play(block)
    session.end()


@pytest.mark.parametrize(
    ("block", "complaint"),
    [
        (Block("run", "sh", "false\ntrue\n"), "ended with 1"),
        (Block("run", "python", "raise SystemExit(3)"), "ended with 3"),
        (Block("run 1s", "sh", "echo done\n"), "ended early"),
        (Block("", "sh", "true\n"), "how to run this"),
        (Block("background", "sh", "echo port 29536\n"), "is not up"),
    ],
    ids=lambda value: value if isinstance(value, str) else value.how,
)
def test_harness_notices_what_goes_wrong(session: Session, block: Block, complaint: str) -> None:
    with pytest.raises((AssertionError, pytest.fail.Exception), match=complaint):
        session.play(block)
