"""Files made of files: what one file includes is put in place, every value still knows where it stands.

The key ``include`` at the top of a file names other files (one, or a list), relative to it: their
lists come before the file's own, and where both give a value under one key of a mapping, the including
file's counts.  An entry ``include: FILE`` of a list is replaced by that file's list under the same key.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from hev_can_emu import config
from hev_can_emu.config import Document
from hev_can_emu.config.node import Node
from hev_can_emu.errors import InputError, did_you_mean

KEY = "include"
MAX_DEPTH = 20


class Parts(NamedTuple):
    """Which keys of an included file count: mappings, lists, and keys that are let pass."""

    mappings: Sequence[str]
    lists: Sequence[str]
    ignored: Sequence[str]


def read_with_includes(path: Path, parts: Parts) -> Document:
    """Read a YAML file and all that it includes.

    Raises:
        InputError: a file that cannot be read, a loop, a key that does not belong into an included file.
    """
    document = config.read(path)
    root = _Composer(parts).compose(document, (path,))
    return Document(document.name, root)


class _Composer:
    def __init__(self, parts: Parts) -> None:
        self._parts = parts

    def compose(self, document: Document, trail: tuple[Path, ...]) -> Node:
        """Return the root with everything included; ``trail``: the files on the way here."""
        root = document.root
        if not isinstance(root.value, dict):
            return root
        mappings: dict[str, dict[str | int, Node]] = {key: {} for key in self._parts.mappings}
        lists: dict[str, list[Node]] = {key: [] for key in self._parts.lists}

        def take(node: Node, steps: tuple[str | int, ...], only: str = "") -> None:
            included = self._load(document, node, steps, trail)
            for key in mappings:
                mappings[key] |= _entries(included, key)
            for key in lists:
                if not only or key == only:
                    lists[key] += _entries(included, key).values()

        if KEY in root.children:
            for node, steps in _named(root.children[KEY]):
                take(node, steps)
        for key in self._parts.lists:
            for number, node in enumerate(_entries(root, key).values()):
                if isinstance(node.value, dict) and list(node.value) == [KEY]:
                    take(node.children[KEY], (key, number, KEY), key)
                else:
                    lists[key].append(_stamped(node, document.name))
        for key in self._parts.mappings:
            own = _entries(root, key)
            mappings[key] |= {name: _stamped(node, document.name) for name, node in own.items()}
        return _rebuilt(root, mappings, lists)

    def _load(
        self,
        document: Document,
        node: Node,
        steps: tuple[str | int, ...],
        trail: tuple[Path, ...],
    ) -> Node:
        where = document.where(steps)
        if not isinstance(node.value, str) or not node.value:
            raise InputError(where, "a file's name", f"{node.value!r}")
        path = trail[-1].parent / node.value
        if any(path.resolve() == other.resolve() for other in trail):
            names = " includes ".join(f"'{each.name}'" for each in (*trail, path))
            raise InputError(where, "files that do not include one another", names)
        if len(trail) > MAX_DEPTH:
            raise InputError(where, f"at most {MAX_DEPTH} files deep", "a deeper nesting")
        try:
            included = config.read(path)
        except InputError as error:
            if error.where != str(path):
                raise
            raise InputError(where, error.expected, f"'{path}': {error.got}", error.hint) from error
        self._check(included)
        return self.compose(included, (*trail, path))

    def _check(self, included: Document) -> None:
        """Refuse what cannot be included."""
        if not isinstance(included.root.value, dict):
            raise InputError(included.where(), "a mapping", "something else")
        known = (KEY, *self._parts.mappings, *self._parts.lists, *self._parts.ignored)
        for key in included.root.value:
            if key not in known:
                hint = did_you_mean(key, known) or f"known: {', '.join(known)}"
                raise InputError(
                    included.where((key,)), "a key that an included file can have", f"'{key}'", hint
                )


def _named(node: Node) -> Iterable[tuple[Node, tuple[str | int, ...]]]:
    """Yield the names in an ``include`` at the top of a file, with their places."""
    if isinstance(node.value, list):
        yield from ((child, (KEY, number)) for number, child in node.children.items())
    else:
        yield node, (KEY,)


def _entries(root: Node, key: str) -> dict[str | int, Node]:
    node = root.children.get(key)
    return {} if node is None else node.children


def _stamped(node: Node, name: str) -> Node:
    """Return the node with the name of its file, unless it has one."""
    return node if node.file else node._replace(file=name)


def _rebuilt(
    root: Node, mappings: dict[str, dict[str | int, Node]], lists: dict[str, list[Node]]
) -> Node:
    """Return the root with these entries in place of its own, and without ``include``."""
    children = {key: node for key, node in root.children.items() if key != KEY}
    for key, entries in mappings.items():
        if entries and isinstance(_value(children, key, {}), dict):
            value = {name: node.value for name, node in entries.items()}
            children[key] = _like(children.get(key), root, value, entries)
    for key, items in lists.items():
        if items and isinstance(_value(children, key, []), list):
            numbered: dict[str | int, Node] = dict(enumerate(items))
            children[key] = _like(children.get(key), root, [node.value for node in items], numbered)
    value = {key: node.value for key, node in children.items()}
    return root._replace(value=value, children=children)


def _value(children: dict[str | int, Node], key: str, default: object) -> object:
    return children[key].value if key in children else default


def _like(own: Node | None, root: Node, value: object, children: dict[str | int, Node]) -> Node:
    at = root if own is None else own
    return Node(value, at.line, at.column, children, at.size, at.file)
