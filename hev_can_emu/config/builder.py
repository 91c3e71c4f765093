"""Builds plain data with places from YAML events, by the rules of YAML 1.2's core schema."""

from __future__ import annotations

import math
import re
from typing import Any

import yaml

from hev_can_emu.config.node import Node
from hev_can_emu.errors import InputError, did_you_mean

MAX_DEPTH = 50
MAX_VALUES = 500_000  #: after expansion of aliases

_PARSER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_NULL = {"", "~", "null", "Null", "NULL"}
_TRUE = {"true", "True", "TRUE"}
_FALSE = {"false", "False", "FALSE"}
_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "seq", "map")
}


_EXPLICIT: dict[str, type] = {"int": int, "float": float, "bool": bool, "null": type(None)}


class _Open:
    """A mapping or list that is not closed yet."""

    def __init__(self, event: Any, anchor: str | None) -> None:
        self.mark = event.start_mark
        self.anchor = anchor
        self.value: Any = {} if isinstance(event, yaml.MappingStartEvent) else []
        self.children: dict[str | int, Node] = {}
        self.key: tuple[str, Any] | None = None
        self.size = 1


class Builder:
    """Builds nodes from the parser's events with a stack of its own: no depth can exhaust it."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._stack: list[_Open] = []
        self._anchors: dict[str, Node | None] = {}
        self._root: Node | None = None

    def build(self, text: str) -> Node | None:
        """Return the document's root, None where it is empty; may raise ``yaml.YAMLError``."""
        documents = 0
        for event in yaml.parse(text, Loader=_PARSER):
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise self._refuse(event.start_mark, "one YAML document", "a second one")
            elif isinstance(event, yaml.AliasEvent):
                self._put(self._alias(event), event.start_mark)
            elif isinstance(event, yaml.ScalarEvent):
                self._scalar(event)
            elif isinstance(event, yaml.CollectionStartEvent):
                self._begin(event)
            elif isinstance(event, yaml.CollectionEndEvent):
                self._end()
        return self._root

    def _scalar(self, event: Any) -> None:
        self._check_tag(event)
        top = self._stack[-1] if self._stack else None
        if top is not None and isinstance(top.value, dict) and top.key is None:
            self._key(top, event)
            return
        mark = event.start_mark
        if event.tag is None and event.value == "" and event.implicit[0] and top is None:
            return  # nothing but comments
        node = Node(self._resolve(event), mark.line + 1, mark.column + 1, {}, 1)
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        self._put(node, mark)

    def _key(self, top: _Open, event: Any) -> None:
        key, mark = event.value, event.start_mark
        if key == "<<" and event.implicit[0]:
            raise self._refuse(mark, "a key", "'<<'", "merge keys are not part of YAML 1.2")
        if key in top.children:
            first = top.children[key].line
            raise self._refuse(mark, "each key once", f"'{key}' again", f"first in line {first}")
        top.key = (key, mark)

    def _begin(self, event: Any) -> None:
        self._check_tag(event)
        if self._stack:
            top = self._stack[-1]
            if isinstance(top.value, dict) and top.key is None:
                raise self._refuse(event.start_mark, "text as key", "a mapping or list")
        if len(self._stack) >= MAX_DEPTH:
            raise self._refuse(event.start_mark, f"at most {MAX_DEPTH} levels", "a deeper nesting")
        if event.anchor is not None:
            self._anchors[event.anchor] = None
        self._stack.append(_Open(event, event.anchor))

    def _end(self) -> None:
        done = self._stack.pop()
        node = Node(done.value, done.mark.line + 1, done.mark.column + 1, done.children, done.size)
        if done.anchor is not None:
            self._anchors[done.anchor] = node
        self._put(node, done.mark)

    def _alias(self, event: Any) -> Node:
        name, mark = event.anchor, event.start_mark
        if name not in self._anchors:
            hint = did_you_mean(name, self._anchors)
            raise self._refuse(mark, "an anchor defined above", f"'*{name}'", hint)
        node = self._anchors[name]
        if node is None:
            raise self._refuse(mark, "an anchor defined above", f"'*{name}' inside itself")
        return node

    def _put(self, node: Node, mark: Any) -> None:
        if not self._stack:
            self._root = node
            return
        top = self._stack[-1]
        top.size += node.size
        if top.size > MAX_VALUES:
            raise self._refuse(mark, f"at most {MAX_VALUES} values", "more")
        if isinstance(top.value, list):
            top.children[len(top.value)] = node
            top.value.append(node.value)
        elif top.key is None:
            raise self._refuse(mark, "text as key", "an alias")
        else:
            key, key_mark = top.key
            top.key = None
            top.value[key] = node.value
            top.children[key] = node._replace(line=key_mark.line + 1, column=key_mark.column + 1)

    def _check_tag(self, event: Any) -> None:
        tag = event.tag
        if tag is not None and tag != "!" and tag not in _TAGS:
            raise self._refuse(event.start_mark, "plain data", f"the tag '{tag}'")

    def _resolve(self, event: Any) -> str | int | float | bool | None:
        text: str = event.value
        mark = event.start_mark
        tag = event.tag.rpartition(":")[2] if event.tag else ""
        if tag == "str" or (not tag and not event.implicit[0]) or event.tag == "!":
            return text
        value = self._plain(text, mark)
        wanted = _EXPLICIT.get(tag)
        if wanted is None:
            return value
        if tag == "float" and type(value) is int:
            return float(value)
        if type(value) is not wanted:
            raise self._refuse(mark, f"a value of !!{tag}", f"'{text}'")
        return value

    def _plain(self, text: str, mark: Any) -> str | int | float | bool | None:
        if text in _NULL:
            return None
        if text in _TRUE or text in _FALSE:
            return text in _TRUE
        if _INTEGER.fullmatch(text):
            value = int(text, 0 if text[:2] in ("0o", "0x") else 10) if len(text) < 40 else 1 << 64
            if abs(value) >= 1 << 63:
                raise self._refuse(mark, "a whole number of at most 63 bits", _short(text))
            return value
        if _NOT_FINITE.fullmatch(text):
            raise self._refuse(mark, "a finite number", text)
        if _FLOAT.fullmatch(text):
            number = float(text)
            if not math.isfinite(number):
                raise self._refuse(mark, "a finite number", _short(text))
            return number
        return text

    def _refuse(self, mark: Any, expected: str, got: str, hint: str = "") -> InputError:
        return InputError(f"{self._name}:{mark.line + 1}:{mark.column + 1}", expected, got, hint)


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."
