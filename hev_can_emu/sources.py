"""One hash per module of all the sources that its compiled code follows from: its own, and what it imports.

Reading and searching them takes a tenth of a short run.  So the hashes of a whole package are kept in a
table, for as long as none of its files looks changed: names, sizes, times and numbers on the disk, which is
more than Python asks before it runs a module's bytecode.  A file changed within the last seconds may change
again without looking so; then no table is used.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from hev_can_emu.kept_file import keep, read_kept

_KEPT = 20  #: tables of other packages and versions that are left alone
_SETTLED_NS = 2_000_000_000  #: more than the coarsest clock of a file system's


class Sources:
    """The sources of one package.

    Args:
        package: its folder.
        more: what all hashes follow from as well.
    """

    def __init__(self, package: Path, more: bytes) -> None:
        self._package = package
        self._more = more
        self._read: dict[str, tuple[bytes, tuple[str, ...]]] = {}

    def digest(self, module: str) -> str:
        """Return the hash for a module, named without the package."""
        reached, waiting = {module}, [module]
        while waiting:
            for other in self._source(waiting.pop())[1]:
                if other not in reached and self._source(other)[0]:
                    reached.add(other)
                    waiting.append(other)
        digest = hashlib.sha256()
        for each in sorted(reached):
            text = self._source(each)[0]
            digest.update(f"{each} {len(text)}\n".encode())
            digest.update(text)
        digest.update(self._more)
        return digest.hexdigest()[:16]

    def digests(self, folder: Path) -> dict[str, str]:
        """Return the hashes for all modules, from a table in the folder where it is there."""
        files = sorted(_files(str(self._package)))
        looks = repr([(path, *_look(status)) for path, status in files]).encode()
        changed = max((max(each.st_mtime_ns, each.st_ctime_ns) for _, each in files), default=0)
        settled = changed < time.time_ns() - _SETTLED_NS
        name = hashlib.sha256(looks + self._more).hexdigest()[:32]
        table = folder / f"sources-{name}.json"
        if settled:
            content = read_kept(table)
            if content is not None:
                known: dict[str, str] = msgspec.json.decode(content)
                return known
        start = len(str(self._package)) + 1
        modules = [path[start:].removesuffix(".py") for path, _ in files if path.endswith(".py")]
        modules = [each.removesuffix("/__init__").replace(os.sep, ".") for each in modules]
        found = {each: self.digest(each) for each in modules}
        if settled:
            keep(table, msgspec.json.encode(found), "sources-*.json", _KEPT)
        return found

    def _source(self, module: str) -> tuple[bytes, tuple[str, ...]]:
        """Return a module's source and the modules of this package that it imports; empty for no module."""
        if module in self._read:
            return self._read[module]
        path = self._package.joinpath(*module.split("."))
        path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        text, found = b"", set()
        if path.is_file():
            text = path.read_bytes()
            name = self._package.name
            pattern = (
                rf"^\s*(?:from {name}([\w.]*) import (\([^)]*\)|[^\n]*)|import {name}\.([\w.]+))"
            )
            for parent, names, whole in re.findall(pattern, text.decode(), re.MULTILINE):
                start = parent.lstrip(".") or whole
                if start:
                    found.add(start)
                for name in re.findall(r"\w+", re.sub(r"#.*|\bas \w+", "", names)):
                    found.add(f"{start}.{name}" if start else name)
        self._read[module] = text, tuple(found)
        return self._read[module]


def _files(folder: str) -> Iterator[tuple[str, os.stat_result]]:
    """Yield all Python files inside, with how they look."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(".py"):
                yield entry.path, entry.stat()
            elif "." not in entry.name and entry.name != "__pycache__" and entry.is_dir():
                yield from _files(entry.path)


def _look(status: os.stat_result) -> tuple[int, ...]:
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino
