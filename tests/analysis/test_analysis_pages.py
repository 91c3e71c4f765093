"""What the pages on analysis and identification show is run as shown."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from hev_can_emu.cli import main

BLOCK = re.compile(r"^<!-- test: run -->\n```(sh|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", ["analysis", "identification", "components", "vehicles"])
def test_page(page: str, repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = BLOCK.findall((repository / "docs" / f"{page}.md").read_text(encoding="utf-8"))
    assert blocks
    for language, text in blocks:
        if language == "python":
            exec(compile(text, page, "exec"), {})
            continue
        for line in text.splitlines():
            words = shlex.split(line)
            if ">" in words:  # the shell's part is not what is tested
                words = words[: words.index(">")]
            assert words[0] == "hev-can-emu"
            assert main(words[1:]) == 0, line
