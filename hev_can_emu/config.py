"""The only YAML reader: files into frozen records, every complaint with its place in the file.

YAML is read as its 1.2 core schema reads it, so that what looks like a number is one and what
looks like a word is one: ``1e-3`` is a number; ``on``, ``off``, ``yes``, ``no``, ``1_000``
and ``1:30`` and dates are text.  Keys are always text.  Anchors and aliases work.  Refused are
merge keys (``<<``), tags other than the core ones, duplicate keys, ``.nan``, ``.inf`` and a second
document.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import yaml

from hev_can_emu import _complaint
from hev_can_emu.errors import InputError, did_you_mean

T = TypeVar("T")
Steps = tuple[str | int, ...]  #: the way to a value: keys and list positions

MAX_BYTES = 5_000_000
MAX_DEPTH = 50
MAX_VALUES = 500_000  #: after expansion of aliases

_PARSER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INTEGER = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_NULL = {"", "~", "null", "Null", "NULL"}
_TRUE = {"true", "True", "TRUE"}
_FALSE = {"false", "False", "FALSE"}
_UNPRINTABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ufffe\uffff]")
_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "seq", "map")
}


class Node(NamedTuple):
    """One value with its place: ``value`` is plain data, ``children`` the nodes inside by key.

    ``line`` and ``column`` count from 1; for a mapping's entry they are those of its key.
    """

    value: Any
    line: int
    column: int
    children: dict[str | int, Node]
    size: int


class Document(NamedTuple):
    """One YAML file as plain data that knows where each value stands."""

    name: str
    root: Node

    @property
    def data(self) -> Any:
        """The whole file as dict, list, str, int, float, bool and None."""
        return self.root.value

    def where(self, steps: Steps = ()) -> str:
        """Return ``file:line: $.path`` of the value at ``steps``, or of its nearest ancestor."""
        node = self.root
        for step in steps:
            if step not in node.children:
                break
            node = node.children[step]
        return f"{self.name}:{node.line}: {_complaint.spell(steps)}"

    def convert(self, type_: type[T]) -> T:
        """Return the file as ``type_`` (a msgspec Struct).

        Raises:
            InputError: the data does not fit; told with line and path.
        """
        try:
            return msgspec.convert(self.data, type_, strict=True, str_keys=True)
        except msgspec.ValidationError as error:
            complaint = _complaint.translate(error, self.data, type_)
            raise InputError(
                self.where(complaint.steps), complaint.expected, complaint.got, complaint.hint
            ) from error


def load(path: str | os.PathLike[str], type_: type[T]) -> T:
    """Read the YAML file ``path`` into ``type_``, a msgspec Struct.

    Raises:
        InputError: the file cannot be read, is not YAML, or does not fit ``type_``.
    """
    return read(path).convert(type_)


def read(path: str | os.PathLike[str]) -> Document:
    """Read the YAML file ``path``; keep the document to locate later complaints.

    Raises:
        InputError: the file cannot be read or is not YAML as told above.
    """
    name = os.fspath(path)
    return parse(_text(Path(path), name), name)


def parse(text: str, name: str = "<text>") -> Document:
    """Read YAML from ``text``; ``name`` stands for the file in complaints.

    Raises:
        InputError: ``text`` is not YAML as told above.
    """
    bad = _UNPRINTABLE.search(text)
    if bad:
        line = text.count("\n", 0, bad.start()) + 1
        column = bad.start() - text.rfind("\n", 0, bad.start())
        got = f"the control character U+{ord(bad.group()):04X}"
        raise InputError(f"{name}:{line}:{column}", "YAML text", got, "is this a binary file?")
    try:
        root = _Builder(name).build(text)
    except yaml.MarkedYAMLError as error:
        raise _syntax_error(error, text, name) from error
    except yaml.YAMLError as error:  # the reader's own, without a mark
        raise InputError(name, "YAML", str(error).splitlines()[0]) from error
    if root is None:
        raise InputError(name, "a YAML document", "an empty file")
    return Document(name, root)


def _text(path: Path, name: str) -> str:
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except FileNotFoundError:
        siblings: list[str] = []
        if path.parent.is_dir() and os.access(path.parent, os.R_OK):
            siblings = [entry.name for entry in path.parent.iterdir()]
        hint = did_you_mean(path.name, siblings)
        raise InputError(name, "a YAML file", "no such file", hint) from None
    except IsADirectoryError:
        raise InputError(name, "a YAML file", "a directory", "name a file in it") from None
    except PermissionError:
        raise InputError(name, "a readable file", "permission denied") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(name, "a readable file", str(error)) from error
    if len(raw) > MAX_BYTES:
        raise InputError(name, f"at most {MAX_BYTES // 1_000_000} MB", "a larger file")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        got = f"the byte 0x{raw[error.start]:02x}"
        raise InputError(f"{name}:{line}", "UTF-8 text", got, "is this a binary file?") from error


def _syntax_error(error: yaml.MarkedYAMLError, text: str, name: str) -> InputError:
    mark = error.problem_mark or error.context_mark
    if mark is None:
        return InputError(name, "YAML", str(error.problem))
    lines = text.splitlines()
    line = lines[mark.line] if mark.line < len(lines) else ""
    hint = ""
    if line[: mark.column + 1].lstrip(" ").startswith("\t") or line[mark.column :].startswith("\t"):
        hint = "indent with spaces, not tabs"
    elif "mapping values are not allowed" in str(error.problem):
        hint = "quote a text that holds ': '"
    elif "did not find expected ',' or" in str(error.problem):
        hint = "a bracket or brace is not closed"
    got = str(error.problem)
    if error.context:
        got += f" ({error.context})"
    return InputError(f"{name}:{mark.line + 1}:{mark.column + 1}", "YAML", got, hint)


class _Open:
    """A mapping or list that is not closed yet."""

    def __init__(self, event: Any, anchor: str | None) -> None:
        self.mark = event.start_mark
        self.anchor = anchor
        self.value: Any = {} if isinstance(event, yaml.MappingStartEvent) else []
        self.children: dict[str | int, Node] = {}
        self.key: tuple[str, Any] | None = None
        self.size = 1


class _Builder:
    """Builds nodes from the parser's events with a stack of its own: no depth can exhaust it."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._stack: list[_Open] = []
        self._anchors: dict[str, Node | None] = {}
        self._root: Node | None = None

    def build(self, text: str) -> Node | None:
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


_EXPLICIT: dict[str, type] = {"int": int, "float": float, "bool": bool, "null": type(None)}


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."


Locate = Callable[[Steps], str]  #: what :meth:`Document.where` is: a path's place as text
