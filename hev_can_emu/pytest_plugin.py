"""The pytest plug-in: scenario files are tests, and tests of one's own get a car.

``pytest scenarios/`` collects every scenario file, a test for each run of its matrix.  docs/testbench.md
tells of fixtures and options.  Nothing of this package is imported before a test needs it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from hev_can_emu.report.run_report import RunReport
    from hev_can_emu.runtime.emulator import Emulator
    from hev_can_emu.runtime.scenario_runs import Run
    from hev_can_emu.runtime.setup import Setup
    from hev_can_emu.runtime.testbench import SyncTestbench
    from hev_can_emu.scenario.verdict import Verdict

_MARKS = (re.compile(r"^version:\s*1\s*(#.*)?$", re.M), re.compile(r"^duration:", re.M))
_HEAD = 65_536  # characters of a file that are looked at

_reports = pytest.StashKey[list[tuple["RunReport", str]]]()
_cars = pytest.StashKey[list[tuple["Setup", "Emulator", bytes]]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the plug-in's options."""
    group = parser.getgroup("hev-can-emu", "a hybrid car on a CAN bus")
    group.addoption(
        "--hev-out",
        metavar="DIR",
        help="leave a report of each scenario, and a recording of each test bench, in DIR",
    )
    parser.addini(
        "hev_scenarios",
        "collect scenario files (*.yaml, *.yml) as tests",
        type="bool",
        default=True,
    )


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker; begin with no report and no car."""
    config.addinivalue_line(
        "markers", "testbench(model=..., ...): what the fixture `testbench` is made with"
    )
    config.stash[_reports] = []
    config.stash[_cars] = []


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collect a scenario file."""
    if file_path.suffix not in (".yaml", ".yml") or not parent.config.getini("hev_scenarios"):
        return None
    try:
        with file_path.open(encoding="utf-8") as file:
            head = file.read(_HEAD)
    except (OSError, UnicodeDecodeError):
        return None
    if not all(mark.search(head) for mark in _MARKS):
        return None
    found: pytest.Collector = ScenarioFile.from_parent(parent, path=file_path)
    return found


class ScenarioFile(pytest.File):
    """A scenario file; its runs are its tests."""

    def collect(self) -> Iterator[pytest.Item]:
        """Yield a test for each run."""
        from hev_can_emu.errors import InputError
        from hev_can_emu.runtime.scenario_runs import read_runs

        try:
            runs = read_runs(self.path)
        except InputError as error:
            raise self.CollectError(str(error)) from error
        for run in runs:
            yield ScenarioItem.from_parent(self, name=run.label or self.path.stem, run=run)


class ScenarioFailed(Exception):
    """A scenario that is no pass: its verdicts that are none, and where the report is."""

    def __init__(self, outcome: str, verdicts: list[Verdict], page: Path | None) -> None:
        super().__init__(outcome)
        self.outcome = outcome
        self.verdicts = verdicts
        self.page = page


class ScenarioItem(pytest.Item):
    """One run of a scenario, in virtual time."""

    def __init__(self, *, run: Run, **more: Any) -> None:
        super().__init__(**more)
        self.run = run

    def runtest(self) -> None:
        """Play it; raises ScenarioFailed unless it passes."""
        from hev_can_emu.runtime.playing import Playing
        from hev_can_emu.runtime.reporting import RunLog, make_report
        from hev_can_emu.runtime.virtual import play_virtual
        from hev_can_emu.scenario.verdict import Outcome

        emulator, start = self._car()
        run = self.run
        playing = Playing(emulator, run.document, run.scenario, run.locate, start)
        log = RunLog(playing)
        started = time.monotonic()
        try:
            trace = play_virtual(playing, [log.add])
        finally:
            log.close()
        result = playing.result(trace)
        self.user_properties += [("outcome", result.outcome.value), ("trace", trace)]
        page = None
        if self._folder() is not None or result.outcome is not Outcome.PASS:
            report = make_report(
                playing,
                result,
                log,
                wall_s=time.monotonic() - started,
                clock="virtual",
                command=f"pytest {self.nodeid!r}",
            )
            page = self._write(report)
            self.user_properties.append(("report", str(page)))
        if result.outcome is not Outcome.PASS:
            bad = [each for each in result.verdicts if each.outcome is not Outcome.PASS]
            raise ScenarioFailed(result.outcome.value, bad, page)

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Tell what failed as a scenario does, not as Python does."""
        from hev_can_emu.errors import HevError

        error = excinfo.value
        if isinstance(error, HevError):
            return str(error)
        if not isinstance(error, ScenarioFailed):
            return super().repr_failure(excinfo, style)
        lines = [f"{self.run.scenario.name}: {error.outcome}"]
        for verdict in error.verdicts:
            at = "" if verdict.instant_ns is None else f" at {verdict.instant_ns * 1e-9:.3f} s"
            lines += [
                "",
                f"{verdict.where}",
                f"  {verdict.outcome.value}: {verdict.name}{at}",
                f"  expected {verdict.expected}",
                f"  observed {verdict.observed or 'nothing'}",
            ]
            if verdict.margin is not None:
                lines.append(f"  margin   {verdict.margin:.4g} {verdict.margin_unit}".rstrip())
        if error.page is not None:
            lines += ["", f"report: {error.page}"]
        return "\n".join(lines)

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return file and name."""
        return self.path, 0, f"{self.path.name}: {self.run.scenario.name}"

    def _car(self) -> tuple[Emulator, bytes]:
        """Return the run's car with its state at the start; alike ones are made once a session."""
        from hev_can_emu.runtime.emulator import Emulator
        from hev_can_emu.runtime.scenario_runs import setup_of

        setup = setup_of(self.run.scenario)
        cars = self.config.stash[_cars]
        for known, emulator, start in cars:
            if known == setup:
                return emulator, start
        emulator = Emulator(setup)
        cars.append((setup, emulator, emulator.snapshot()))
        return emulator, cars[-1][2]

    def _folder(self) -> Path | None:
        told = self.config.getoption("--hev-out")
        return None if told is None else Path(told)

    def _write(self, report: RunReport) -> Path:
        """Write the report, where none is asked for into pytest's cache; return the page."""
        from hev_can_emu.commands._reports import write_run

        folder = self._folder() or _cache(self.config)
        folder.mkdir(parents=True, exist_ok=True)
        stem = re.sub(r"[^A-Za-z0-9_.=-]+", "_", f"{self.path.stem} {self.run.label}".strip())
        write_run(folder, stem, report)
        self.config.stash[_reports].append((report, stem))
        page = folder / f"{stem}.html"
        return page if page.exists() else page.with_suffix(".json")


def _cache(config: pytest.Config) -> Path:
    cache = config.cache
    return Path("hev-can-emu-reports") if cache is None else cache.mkdir("hev-can-emu")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Leave an index where several reports were asked for."""
    reports = session.config.stash.get(_reports, [])
    folder = session.config.getoption("--hev-out")
    if folder is not None and len(reports) > 1 and not hasattr(session.config, "workerinput"):
        from hev_can_emu.report.page import write_index

        pages = [(report, f"{stem}.html") for report, stem in reports]
        if (Path(folder) / pages[0][1]).exists():
            write_index(Path(folder) / "index.html", "pytest", pages)


@pytest.fixture
def make_testbench(
    request: pytest.FixtureRequest, record_property: Callable[[str, object], None]
) -> Iterator[Callable[..., SyncTestbench]]:
    """Make test benches, open until the test is over: ``make_testbench(model="4dof")``."""
    from contextlib import ExitStack

    from hev_can_emu.runtime.testbench import SyncTestbench

    folder = request.config.getoption("--hev-out")
    with ExitStack() as opened:
        count = 0

        def make(*arguments: Any, **choices: Any) -> SyncTestbench:
            nonlocal count
            if folder is not None and "record" not in choices:
                count += 1
                Path(folder).mkdir(parents=True, exist_ok=True)
                name = re.sub(r"[^A-Za-z0-9_.=-]+", "_", request.node.name)
                path = Path(folder) / (f"{name}.log" if count == 1 else f"{name}.{count}.log")
                choices["record"] = [path]
                record_property("recording", str(path))
            return opened.enter_context(SyncTestbench(*arguments, **choices))

        yield make


@pytest.fixture
def testbench(
    request: pytest.FixtureRequest, make_testbench: Callable[..., SyncTestbench]
) -> SyncTestbench:
    """A test bench, open; ``@pytest.mark.testbench(model="4dof")`` says of which car."""
    marker = request.node.get_closest_marker("testbench")
    return make_testbench(*marker.args, **marker.kwargs) if marker else make_testbench()
