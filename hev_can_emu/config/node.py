"""One value of a YAML file with its place, and what is kept of a file that was read before.

Importing and running a YAML parser takes a twentieth of a short run, for files that rarely change.  So what
was read is kept in the user's cache folder, under a hash of the text beside one of the code that reads it.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import re
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from hev_can_emu.kept_file import keep, read_kept

_KEPT = 200  #: files kept per version of the code
_MOST_VALUES = 20_000  #: of a file that is kept
_PLAIN_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")

Steps = tuple[str | int, ...]  #: the way to a value: keys and list positions


class Node(NamedTuple):
    """One value with its place: ``value`` is plain data, ``children`` the nodes inside by key.

    ``line`` and ``column`` count from 1; for a mapping's entry they are those of its key.  ``file``: where
    it stands; empty where its parent does.
    """

    value: Any
    line: int
    column: int
    children: dict[str | int, Node]
    size: int
    file: str = ""


class KeptFile:
    """The place of what was read from a text."""

    def __init__(self, text: str) -> None:
        from hev_can_emu.jit import cache_folder

        key = hashlib.sha256(_parser_version() + text.encode()).hexdigest()[:32]
        self._path = cache_folder("config") / f"{key}.yaml.json"

    def read(self) -> Node | None:
        """Return the root that was kept; None where there is none, or it cannot be read."""
        content = read_kept(self._path)
        return None if content is None else _grown(msgspec.json.decode(content))

    def keep(self, root: Node) -> None:
        """Keep a root, unless it is large."""
        if root.size <= _MOST_VALUES:
            with contextlib.suppress(UnicodeEncodeError):  # half a pair of surrogates
                keep(self._path, msgspec.json.encode(_packed(root)), "*.yaml.json", _KEPT)


def spell(steps: Steps) -> str:
    """Return a path as text: ``$.steps[3].set['MCU1_Status.EM1Speed']``."""
    parts = ["$"]
    for step in steps:
        if isinstance(step, int):
            parts.append(f"[{step}]")
        elif _PLAIN_KEY.fullmatch(step):
            parts.append(f".{step}")
        else:
            parts.append(f"['{' '.join(step.split())}']")
    return "".join(parts)


def _parser_version() -> bytes:
    """Return what tells versions of PyYAML apart, without importing it."""
    found = importlib.util.find_spec("yaml")
    if found is None or found.origin is None:
        return b""
    return Path(found.origin).read_bytes()


def _packed(node: Node) -> Any:
    inside: Any = node.value
    if isinstance(node.value, dict):
        inside = {key: _packed(child) for key, child in node.children.items()}
    elif isinstance(node.value, list):
        inside = [_packed(child) for child in node.children.values()]
    return node.line, node.column, inside


def _grown(packed: Any) -> Node:
    line, column, inside = packed
    children: dict[str | int, Node] = {}
    value = inside
    if isinstance(inside, dict):
        children = {key: _grown(child) for key, child in inside.items()}
        value = {key: child.value for key, child in children.items()}
    elif isinstance(inside, list):
        children = {number: _grown(child) for number, child in enumerate(inside)}
        value = [child.value for child in children.values()]
    size = 1 + sum(child.size for child in children.values())
    return Node(value, line, column, children, size)
