"""docs/buses.md tells the truth: its recipes for continuous integration run as written."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from bus_peers import free_port

from hev_can_emu.ecu.faults import BUS_FAULTS, CATALOGUE, COMMON, tag

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "buses.md").read_text()
PORT = "29536"


def recipes() -> dict[str, dict]:
    """Return the page's YAML blocks by their only job's name and image."""
    found = {}
    for text in re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL):
        loaded = yaml.safe_load(text)
        found["GitHub" if "jobs" in loaded else f"GitLab {next(iter(loaded))}"] = loaded
    return found


def script(recipe: dict) -> str:
    """Return what a job runs, as one shell script."""
    if "jobs" in recipe:
        (job,) = recipe["jobs"].values()
        return "\n".join(step["run"] for step in job["steps"] if "run" in step)
    (job,) = recipe.values()
    return "\n".join(job["script"])


def test_there_are_recipes_for_both() -> None:
    assert set(recipes()) == {"GitHub", "GitLab controller", "GitLab vcan"}


def test_a_recipe_runs_a_test_on_the_embedded_bus(tmp_path: Path) -> None:
    (test,) = re.findall(r"```python\n(import can\n\ndef test_.*?)```", PAGE, re.DOTALL)
    port = str(free_port())  # other tests may be on the default port
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_car.py").write_text(test.replace(PORT, port))
    lines = script(recipes()["GitHub"])
    other = script(recipes()["GitLab controller"])
    same = other.replace(" emulator=$!", "").replace("$emulator", "$!")
    assert [line for line in lines.split("\n") if line and line != "cat emulator.log"] == (
        same.split("\n")
    )
    assert "hev-can-emu run >" in lines
    assert "pip install" in lines
    lines = re.sub("^pip install.*$", "", lines, flags=re.MULTILINE)  # it is installed
    lines = lines.replace("run >", f"run --bus socketcand:127.0.0.1:{port} >")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-e", "-c", lines],
        cwd=tmp_path,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        timeout=400,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout
    assert "Traceback" not in (tmp_path / "emulator.log").read_text()


def test_the_recipe_for_vcan_installs_what_its_runner_needs() -> None:
    lines = script(recipes()["GitLab vcan"])
    makefile = (ROOT / "Makefile").read_text()
    (packages,) = re.findall(r"^SYSTEM_PACKAGES := (.*)$", makefile, re.MULTILINE)
    runner = re.search(r"hev-can-emu/(\S+with_vcan0\.py)", lines)
    assert runner
    assert (ROOT / runner[1]).exists()
    for package in ("can-utils", "iproute2", "kmod", "user-mode-linux"):
        assert package in packages.split()
        assert package in lines.split()


def test_the_example_with_bit_times_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(from hev_can_emu\.bus\.wire_parts.*?)```", PAGE, re.DOTALL)
    exec(compile(code, "docs/buses.md", "exec"), {})
    printed = capsys.readouterr().out
    states = re.findall(r"MCU2 is (\w+ \w+)", printed)
    assert states == ["error passive", "bus off", "error active"]
    assert "32 error frames" in printed.splitlines()[-1]


def test_the_faults_of_the_bus_are_all_there() -> None:
    rows = re.findall(r"\| `(bus_\w+)` \| .*? \| (.*) \|", PAGE)
    assert [name for name, _ in rows] == [tag(kind.__name__) for kind in BUS_FAULTS]
    for name, parameters in rows:
        told = set(re.findall(r"`(\w+)`", parameters))
        assert told == {p.name for p in CATALOGUE[name].parameters} - set(COMMON)
