"""JUnit as other parsers read it, JSON, and pages that need nothing and escape everything."""

from __future__ import annotations

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as Tree

import numpy as np
import pytest
from junitparser import Error, Failure, JUnitXml
from one_run import NASTY, one_run, verdict
from xunit2 import complaints

from hev_can_emu.errors import InputError
from hev_can_emu.report import figures, svg
from hev_can_emu.report.json_report import write_json
from hev_can_emu.report.junit import write_junit
from hev_can_emu.report.page import write_index, write_page
from hev_can_emu.scenario.verdict import Outcome


def test_junit_is_what_the_schema_allows_and_junitparser_reads(tmp_path: Path) -> None:
    path = tmp_path / "junit.xml"
    write_junit(path, [one_run(), one_run("second", Outcome.PASS)])
    assert complaints(Tree.parse(path).getroot()) == []
    first, second = JUnitXml.fromfile(str(path))
    assert (first.name, first.tests, first.failures, first.errors) == (NASTY, 7, 2, 2)
    assert (second.tests, second.failures, second.errors) == (7, 1, 2)
    cases = {case.name: case for case in first}
    assert cases["good"].result == []
    failure = cases[NASTY].result[0]
    assert isinstance(failure, Failure)
    assert "observed EM2Torque = 45 Nm at 1.000 s" in failure.message
    assert "a.yaml:7: $.expectations[0]" in failure.text
    unsure = cases["unsure"].result[0]
    assert isinstance(unsure, Error)  # an inconclusive run must not look green
    assert unsure.type == "inconclusive"
    assert "�control� characters" in cases["broken"].result[0].message
    told = {each.name: each.value for each in first.properties()}
    assert told["seed"] == "7"
    assert told["car.model"] == "4dof"
    assert told["parameter.mass"] == "1500 kg"


@pytest.mark.parametrize(
    ("document", "complaint"),
    [
        ("<report/>", "no report: report"),
        ("<testsuites><testcase name='a'/></testsuites>", "testcase in testsuites"),
        ("<testsuite name='a' tests='1' failures='0'/>", "testsuite without errors"),
        ("<testsuites time='1.2.3'/>", "testsuites with time 1.2.3"),
        ("<testsuites time='-1'/>", "testsuites with time -1"),
        ("<testsuites>words</testsuites>", "testsuites with text"),
        ("<testcase name='a' status='run'/>", "testcase with status"),
        ("<testcase name='a'><failure><b/></failure></testcase>", "b in failure"),
        ("<testcase name='a'><properties/></testcase>", "properties in testcase"),
    ],
)
def test_the_schema_refuses(document: str, complaint: str) -> None:
    assert complaints(Tree.fromstring(document)) == [complaint]


def test_json_has_what_the_page_has(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    write_json(path, one_run())
    content = json.loads(path.read_text())
    assert content["version"] == 1
    assert content["outcome"] == "error"
    assert content["verdicts"][2]["window_s"] == [0.5, 2.0]
    assert content["events"][0] == {"t_s": 0.5, "kind": "lost", "text": NASTY}
    assert content["periods"][0]["most_ms"] == 11.0
    assert "started" not in content  # virtual time has no date: the same bytes each time


class Tags(HTMLParser):
    """Collects tags, their attributes, and the text outside script and style."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.text = ""
        self._hidden = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        self._hidden = tag in ("script", "style")

    def handle_endtag(self, tag: str) -> None:
        self._hidden = False

    def handle_data(self, data: str) -> None:
        if not self._hidden:
            self.text += data


def pages(folder: Path) -> list[Path]:
    run, index = folder / "run.html", folder / "index.html"
    write_page(run, one_run())
    varied = [one_run(mass=mass) for mass in ("1500 kg", NASTY)]
    write_index(index, NASTY, [(report, f"{n}.html") for n, report in enumerate(varied)])
    return [run, index]


def test_pages_escape_what_they_are_given_and_ask_for_nothing(tmp_path: Path) -> None:
    for path in pages(tmp_path):
        found = Tags(path.read_text(encoding="utf-8"))
        assert found.tags.count("script") == 1
        assert "img" not in found.tags
        assert NASTY in found.text
        assert not [name for name, _ in found.attributes if name.startswith("on")]
        for name, value in found.attributes:
            if name in ("src", "href", "data", "action", "xlink:href"):
                assert value.startswith(("#", "data:")) or re.fullmatch(r"[\w%.]+", value), value
        assert "@import" not in path.read_text()
        assert "url(" not in path.read_text()


def test_an_index_shows_what_varies(tmp_path: Path) -> None:
    text = Tags(pages(tmp_path)[1].read_text(encoding="utf-8")).text
    assert "mass" in text
    assert "1500 kg" in text
    assert "2 runs" in text


def test_without_jinja2_it_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(InputError, match=r"pip install 'hev-can-emu\[report\]'"):
        write_page(tmp_path / "run.html", one_run())


def test_limits_are_read_from_the_words() -> None:
    curves = list(one_run().curves.values())

    def limits(expected: str) -> list[tuple[float, float, str]]:
        judged = verdict("expectation", "", Outcome.PASS, expected)
        return [each[1:] for each in figures.limits_of(judged, curves)]

    assert limits("always: EM2Torque > 50 Nm from 1 s") == [(50.0, np.inf, "allowed")]
    assert limits("never: EM2Torque <= -2.5e1 Nm") == [(-np.inf, -25.0, "forbidden")]
    assert limits("becomes: EM2Torque > 0.1 kNm within 1 s") == [(100.0, np.inf, "allowed")]
    assert limits("always: EM2Torque > 5 rpm") == []
    assert limits("settles: EM2Torque = 40 ± 9 Nm") == [(31.0, 49.0, "allowed")]
    assert limits("settles: EM1Speed - EM2Torque = 40 ± 9 Nm") == []
    both = limits("always: EM2Torque > 1 Nm and EM2Torque < 9 Nm")
    assert both == [(1.0, np.inf, "named"), (-np.inf, 9.0, "named")]
    assert limits("always: Gear == 1") == []


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.2, 7.9), (1e-7, 2e-7), (-5e6, 4e6)])
def test_scales_have_round_numbers_inside(low: float, high: float) -> None:
    found = svg.ticks(low, high, 5)
    assert 3 <= len(found) <= 8
    assert low <= found[0]
    assert found[-1] <= high * (1 + 1e-9)
    steps = np.diff(found)
    assert steps == pytest.approx(steps[0])


def test_a_long_curve_keeps_its_spikes() -> None:
    x = np.linspace(0.0, 800.0, 500_000)
    v = np.zeros(500_000)
    v[123_456], v[400_000] = 9.0, -7.0
    thin_x, thin_v = svg.thinned(x, v)
    assert len(thin_x) < 4000
    assert (thin_v.max(), thin_v.min()) == (9.0, -7.0)
    assert thin_x[np.argmax(thin_v)] == x[123_456]
    gaps = np.where(x > 400.0, np.nan, v)
    assert np.isnan(svg.thinned(x, gaps)[1]).any()
