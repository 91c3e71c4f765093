"""docs/testbench.md runs as it stands, from top to bottom; docs/lockstep.md names what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hev_can_emu.cli import build_parser


def test_the_page_s_programs_run(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (repository / "docs" / "testbench.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert len(blocks) == 3
    space: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/testbench.md", "exec"), space)
    assert (tmp_path / "pull.log").stat().st_size > 10_000


def test_the_commands_of_the_lockstep_page_are_commands(repository: Path) -> None:
    page = (repository / "docs" / "lockstep.md").read_text(encoding="utf-8")
    commands = re.findall(r"^hev-can-emu (.*?)(?: *[#&].*)?$", page, re.MULTILINE)
    assert len(commands) == 3
    for command in commands:
        words = command.split()
        assert build_parser(words).parse_args(words).clock == "lockstep"
