"""The only YAML reader: files into frozen records, every complaint with its place in the file.

YAML is read as its 1.2 core schema reads it, so that what looks like a number is one and what
looks like a word is one: ``1e-3`` is a number; ``on``, ``off``, ``yes``, ``no``, ``1_000``
and ``1:30`` and dates are text.  Keys are always text.  Anchors and aliases work.  Refused are
merge keys (``<<``), tags other than the core ones, duplicate keys, ``.nan``, ``.inf`` and a second
document.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import msgspec

from hev_can_emu.config.node import KeptFile, Node, spell
from hev_can_emu.config.node import Steps as Steps
from hev_can_emu.errors import InputError, did_you_mean

if TYPE_CHECKING:
    import yaml

T = TypeVar("T")
Locate = Callable[[Steps], str]  #: what :meth:`Document.where` is: a path's place as text

MAX_BYTES = 5_000_000

_UNPRINTABLE = "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ufffe\uffff]"


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
        file = self.name
        for step in steps:
            if step not in node.children:
                break
            node = node.children[step]
            file = node.file or file
        return f"{file}:{node.line}: {spell(steps)}"

    def text_beside(self, file: str, steps: Steps) -> str:
        """Return the text of a file named at ``steps``, relative to the file that names it.

        Raises:
            InputError: it cannot be read; told at ``steps``.
        """
        where = self.where(steps)
        path = Path(where.rpartition(": ")[0].rpartition(":")[0]).parent / file
        try:
            return _text(path, str(path))
        except InputError as error:
            if error.where != str(path):
                raise
            expected = error.expected.replace("a YAML file", "a file")
            raise InputError(where, expected, f"'{path}': {error.got}", error.hint) from error

    def convert(self, type_: type[T]) -> T:
        """Return the file as ``type_`` (a msgspec Struct).

        Raises:
            InputError: the data does not fit; told with line and path.
        """
        try:
            return msgspec.convert(self.data, type_, strict=True, str_keys=True)
        except msgspec.ValidationError as error:
            from hev_can_emu.config import complaint

            told = complaint.translate(error, self.data, type_)
            raise InputError(self.where(told.steps), told.expected, told.got, told.hint) from error


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
    text = _text(Path(path), name)
    kept = KeptFile(text)
    root = kept.read()
    if root is not None:
        return Document(name, root)
    document = parse(text, name)
    kept.keep(document.root)
    return document


def parse(text: str, name: str = "<text>") -> Document:
    """Read YAML from ``text``; ``name`` stands for the file in complaints.

    Raises:
        InputError: ``text`` is not YAML as told above.
    """
    # Importing these takes long; most files were read before.
    import yaml

    from hev_can_emu.config.builder import Builder

    bad = re.search(_UNPRINTABLE, text)
    if bad:
        line = text.count("\n", 0, bad.start()) + 1
        column = bad.start() - text.rfind("\n", 0, bad.start())
        got = f"the control character U+{ord(bad.group()):04X}"
        raise InputError(f"{name}:{line}:{column}", "YAML text", got, "is this a binary file?")
    try:
        root = Builder(name).build(text)
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
