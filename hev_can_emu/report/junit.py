"""JUnit XML in xunit2 style, as Jenkins, GitLab, GitHub actions and others read it.

A scenario is a test suite, each of its expectations and steps a test case.  JUnit knows no inconclusive
test: it is told as an error, lest it pass for a success.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as Tree

from hev_can_emu.report.run_report import RunReport
from hev_can_emu.scenario.verdict import Outcome, Verdict

_FORBIDDEN = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_junit(path: Path, reports: Sequence[RunReport]) -> None:
    """Write all runs as one file; raises OSError."""
    root = Tree.Element("testsuites", {"name": "hev-can-emu"})
    for report in reports:
        root.append(_suite(report))
    Tree.indent(root)
    path.write_bytes(Tree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _suite(report: RunReport) -> Tree.Element:
    outcomes = [verdict.outcome for verdict in report.verdicts]
    suite = Tree.Element("testsuite", {"name": _text(report.name)})
    counts = {
        "tests": len(outcomes),
        "failures": outcomes.count(Outcome.FAIL),
        "errors": outcomes.count(Outcome.ERROR) + outcomes.count(Outcome.INCONCLUSIVE),
        "skipped": 0,
    }
    suite.attrib.update({key: str(count) for key, count in counts.items()})
    suite.set("time", f"{report.wall_s:.3f}")
    if report.started:
        suite.set("timestamp", report.started.partition("+")[0])
    properties = Tree.SubElement(suite, "properties")
    told = {
        "outcome": report.outcome.value,
        "file": report.file,
        "seed": str(report.seed),
        "trace": report.trace,
        "command": report.command,
        **{f"car.{key}": value for key, value in report.car.items()},
        **{f"parameter.{key}": value for key, value in report.parameters.items()},
    }
    for name, value in told.items():
        Tree.SubElement(properties, "property", {"name": _text(name), "value": _text(value)})
    before_s = 0.0
    for verdict in report.verdicts:
        suite.append(_case(report, verdict, before_s))
        if verdict.kind == "step" and verdict.instant_ns is not None:
            before_s = verdict.instant_ns * 1e-9
    return suite


def _case(report: RunReport, verdict: Verdict, before_s: float) -> Tree.Element:
    """Return a test case; a step lasts from the step before it, an expectation its window."""
    opens, closes = verdict.window_ns
    end_ns = verdict.instant_ns if verdict.instant_ns is not None else closes
    begin_s = before_s if verdict.kind == "step" else (opens or 0) * 1e-9
    lasted_s = 0.0 if end_ns is None else max(end_ns * 1e-9 - begin_s, 0.0)
    case = Tree.Element(
        "testcase",
        {
            "classname": _text(f"{report.name}.{verdict.kind}"),
            "name": _text(verdict.name),
            "time": f"{lasted_s:.3f}",
        },
    )
    if verdict.outcome is Outcome.PASS:
        return case
    kind = "failure" if verdict.outcome is Outcome.FAIL else "error"
    at = "" if verdict.instant_ns is None else f" at {verdict.instant_ns * 1e-9:.3f} s"
    message = f"expected {verdict.expected}, observed {verdict.observed or 'nothing'}{at}"
    told = Tree.SubElement(
        case, kind, {"message": _text(message), "type": _text(verdict.outcome.value)}
    )
    lines = [verdict.where, f"expected: {verdict.expected}", f"observed: {verdict.observed}{at}"]
    if verdict.margin is not None:
        lines.append(f"margin: {verdict.margin:.6g} {verdict.margin_unit}".strip())
    told.text = _text("\n".join(lines))
    return case


def _text(text: str) -> str:
    """Return what of a text XML can carry."""
    return _FORBIDDEN.sub("�", text)
