"""The page's Python runs as written."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "runtime.md"


def test_the_example_drives_the_car(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {})
    on_bus, truth = (float(word) for word in capsys.readouterr().out.split())
    assert 3.0 < on_bus < 10.0  # km/h
    assert on_bus == pytest.approx(truth * 3.6, abs=0.1)
