"""Jenkins' schema of xunit2 reports (junit-10.xsd of its xunit plug-in, which pytest follows), as a check."""

from __future__ import annotations

import re
from typing import NamedTuple
from xml.etree import ElementTree as Tree

_TIME = re.compile(r"(([0-9]{0,3},)*[0-9]{3}|[0-9]{0,3})*(\.[0-9]*)?")  # its SUREFIRE_TIME


class _Element(NamedTuple):
    required: frozenset[str] = frozenset()
    optional: frozenset[str] = frozenset()
    children: frozenset[str] = frozenset()  # in any order, as often as they like
    text: bool = False
    timed: bool = False  # the attribute "time" must be a number of seconds


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_TOLD = _Element(optional=_words("type message"), text=True)
_RERUN = _Element(
    _words("type"), _words("message"), _words("stackTrace system-out system-err"), True
)
_STRING = _Element(text=True)
_RERUNS = ("rerunFailure", "rerunError", "flakyFailure", "flakyError")
_OUTPUT = ("system-out", "system-err")

ELEMENTS = {
    "testsuites": _Element(
        optional=_words("name time tests failures errors"), children=_words("testsuite"), timed=True
    ),
    "testsuite": _Element(
        required=_words("name tests failures errors"),
        optional=_words("group time skipped timestamp hostname id package file log url"),
        children=frozenset({"testsuite", "properties", "testcase", *_OUTPUT}),
        timed=True,
    ),
    "properties": _Element(children=_words("property")),
    "property": _Element(required=_words("name value")),
    "testcase": _Element(
        required=_words("name"),
        optional=_words("time classname group"),
        children=frozenset({"skipped", "error", "failure", *_RERUNS, *_OUTPUT}),
    ),
    **dict.fromkeys(("failure", "error", "skipped"), _TOLD),
    **dict.fromkeys(_RERUNS, _RERUN),
    **dict.fromkeys((*_OUTPUT, "stackTrace"), _STRING),
}


def complaints(element: Tree.Element) -> list[str]:
    """Return what of a document the schema does not allow; nothing where it is valid."""
    if element.tag not in ("testsuites", "testsuite", "testcase"):
        return [f"no report: {element.tag}"]
    return _inside(element)


def _inside(element: Tree.Element) -> list[str]:
    rule, given, tag = ELEMENTS[element.tag], set(element.attrib), element.tag
    found = [f"{tag} without {name}" for name in sorted(rule.required - given)]
    found += [f"{tag} with {name}" for name in sorted(given - rule.required - rule.optional)]
    if rule.timed and not _TIME.fullmatch(element.get("time", "")):
        found.append(f"{tag} with time {element.get('time')}")
    texts = [element.text, *(child.tail for child in element)]
    if not rule.text and any((text or "").strip() for text in texts):
        found.append(f"{tag} with text")
    for child in element:
        if child.tag in rule.children:
            found += _inside(child)
        else:
            found.append(f"{child.tag} in {tag}")
    return found
