"""``pytest scenarios/`` runs scenarios as tests; a test of one's own gets a bench."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree as Tree

import pytest

from hev_can_emu.jit import cache_home

# Found before pytester moves HOME: kernels are not compiled anew in its runs.
CACHE = cache_home().parent

pytest_plugins = ["pytester"]

GOOD = """\
version: 1
name: pulls
duration: 400 ms
model: 4dof
parameters: {torque: 50 Nm}
matrix: {torque: [50 Nm, 100 Nm]}
steps:
- at: 100 ms
  set: {ContactorRequest: Closed, EM2ControlMode: Torque, EM2TorqueRequest: torque}
expectations:
- {name: the torque comes, becomes: EM2Torque > 0.9 * torque, within: 400 ms}
"""
BAD = GOOD.replace("matrix: {torque: [50 Nm, 100 Nm]}\n", "").replace("> 0.9", "> 1.1")


@pytest.fixture
def project(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    monkeypatch.setenv("HEV_CAN_EMU_CACHE", str(CACHE))
    folder = pytester.mkdir("scenarios")
    (folder / "good.yaml").write_text(GOOD)
    (folder / "settings.yaml").write_text("version: 1\nduration_of_lunch: 1 h\n")
    return pytester


def test_scenario_files_are_tests_a_run_each(project: pytest.Pytester) -> None:
    (project.path / "scenarios" / "bad.yaml").write_text(BAD)
    (project.path / "scenarios" / "broken.yaml").write_text(GOOD.replace("at: 100 ms", "at: 1 V"))
    done = project.runpytest_subprocess(
        "scenarios", "-v", "--hev-out", "out", "--junitxml", "junit.xml"
    )
    done.assert_outcomes(passed=2, failed=3)
    done.stdout.fnmatch_lines(
        [
            "*good.yaml::torque=50 Nm PASSED*",
            "*good.yaml::torque=100 Nm PASSED*",
            "pulls: fail",
            "*bad.yaml:10: $.expectations?0?",
            "  fail: the torque comes at 0.400 s",
            "  expected becomes: EM2Torque > 1.1 ? torque*",
            "  observed EM2Torque = *",
            "  margin   -*",
            "report: *bad.html",
        ]
    )
    done.stdout.no_fnmatch_line("*Traceback*")
    assert "scenarios/broken.yaml:8: $.steps[0].at: expected" in done.stdout.str()
    out = project.path / "out"
    made = {path.name for path in out.iterdir()}
    assert {"bad.html", "bad.json", "good_torque=50_Nm.html", "index.html"} <= made
    told = json.loads((out / "bad.json").read_text())
    assert told["command"] == "pytest 'scenarios/bad.yaml::bad'"
    case = Tree.parse(project.path / "junit.xml").find(".//testcase[@name='bad']")
    assert case is not None
    properties = {each.get("name"): each.get("value", "") for each in case.iter("property")}
    assert properties["outcome"] == "fail"
    assert Path(properties["report"]).name == "bad.html"
    assert len(properties["trace"]) == 64


def test_a_failure_leaves_its_report_in_the_cache(project: pytest.Pytester) -> None:
    """And a file that cannot be read is told in one line."""
    (project.path / "scenarios" / "bad.yaml").write_text(BAD)
    path = project.path / "scenarios" / "odd.yaml"
    path.write_text(GOOD.replace("steps:", "stepps:"))
    chosen = ["scenarios/bad.yaml", "scenarios/odd.yaml", "--continue-on-collection-errors"]
    done = project.runpytest_subprocess(*chosen)
    done.assert_outcomes(failed=1, errors=1)
    done.stdout.fnmatch_lines(["*odd.yaml*stepps*"])
    done.stdout.fnmatch_lines(["report: *pytest_cache*hev-can-emu*bad.html"])
    done.stdout.no_fnmatch_line("*Traceback*")


def test_they_can_be_left_alone(project: pytest.Pytester) -> None:
    project.makeini("[pytest]\nhev_scenarios = false\n")
    project.runpytest_subprocess("scenarios").assert_outcomes()


def test_fixtures_give_a_bench(project: pytest.Pytester) -> None:
    path = project.makepyfile(
        """
        import pytest

        PULL = {"ContactorRequest": "Closed", "EM2ControlMode": "Torque", "EM2TorqueRequest": "80 Nm"}

        @pytest.mark.testbench(model="4dof")
        def test_pull(testbench):
            testbench.set(PULL)
            testbench.until("EM2Torque > 79 Nm", within="300 ms")
            assert testbench.emulator.setup.model == "4dof"

        def test_two(make_testbench):
            first, second = make_testbench(model="4dof"), make_testbench(model="4dof")
            first.set(PULL)
            for bench in first, second:
                bench.advance("300 ms")
            assert first["EM2Torque"] > 79 > abs(second["EM2Torque"])

        @pytest.mark.testbench(model="4dof")
        def test_fails(testbench):
            testbench.until("VehicleSpeed > 1 km/h", within="20 ms")
        """
    )
    done = project.runpytest_subprocess(path, "--hev-out", "out", "--strict-markers")
    done.assert_outcomes(passed=2, failed=1)
    done.stdout.fnmatch_lines(["*NotMet: VehicleSpeed > 1 km/h within 20 ms: VehicleSpeed = *"])
    made = {path.name for path in (project.path / "out").iterdir()}
    assert made == {"test_pull.log", "test_two.log", "test_two.2.log", "test_fails.log"}
