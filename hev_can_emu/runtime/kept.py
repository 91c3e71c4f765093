"""Results kept from run to run: named tuples of arrays and numbers, in the user's cache folder.

An entry is written in one piece, under a hash of what the result follows from, in the folder of the code
that makes it; one that cannot be read, or is damaged, is made anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from hev_can_emu.jit import JIT_DISABLED, cache_folder
from hev_can_emu.kept_file import CHECK, keep
from hev_can_emu.plant.columns import CACHE_LINE, aligned, filled_up

T = TypeVar("T")

_KEPT = 20  #: entries of each kind, per version of the code
_PAGE = 512  #: words
_PACKAGE = __name__.partition(".")[0]


def kept(module: str, name: str, key: bytes, make: Callable[[], T]) -> T:
    """Return what ``make`` returns, from the cache where it is there.

    Args:
        module: whose code makes it, as :func:`hev_can_emu.jit.cache_folder` takes it.
        name: of the kind of result.
        key: what it follows from, besides the code.
        make: makes it: named and plain tuples, arrays of numbers, floats, whole numbers and None.
    """
    if JIT_DISABLED:  # its numbers may differ in the last bits
        return make()
    path = cache_folder(module) / f"{name}-{hashlib.sha256(key).hexdigest()[:32]}.kept"
    with contextlib.suppress(OSError, ValueError, TypeError, LookupError, AttributeError):
        found: T = _read(path)
        return found
    made = make()
    content = _written(made)
    check = _check(np.frombuffer(content, dtype=np.uint64))
    keep(path, content, f"{name}-*.kept", _KEPT, check)
    return made


def _read(path: Path) -> Any:
    size = path.stat().st_size
    if size % 8 != 0 or size < CHECK:
        raise ValueError("cut short")
    content = aligned(size // 8).view(np.uint8)  # whose arrays are aligned in the file
    with path.open("rb") as file:
        if file.readinto(content.data) != size:
            raise ValueError("cut short")
    told, rest = content[:CHECK].tobytes(), content[CHECK:]
    if _check(rest.view(np.uint64)) != told:
        raise ValueError("damaged")
    size = int(rest[:8].view(np.int64)[0])
    form = msgspec.json.decode(rest[8 : 8 + size].data)
    return _grown(form, content[_start(size) :])


def _check(words: npt.NDArray[np.uint64]) -> bytes:
    """Return a hash of the sums over each page and over each place in a page.

    It tells every damage to one page, and all pages in a wrong place, in a tenth of the time that a hash of
    all megabytes takes.
    """
    whole = len(words) // _PAGE * _PAGE
    pages = words[:whole].reshape(-1, _PAGE)
    digest = hashlib.sha256(words[whole:].tobytes())
    for axis in (0, 1):
        digest.update(np.add.reduce(pages, axis=axis).tobytes())
    return digest.digest()


def _start(size: int) -> int:
    """Return where the arrays start in the file, after a description of ``size`` bytes."""
    return filled_up(CHECK + 8 + size, CACHE_LINE)


def _written(value: Any) -> bytes:
    parts: list[bytes] = []
    form = msgspec.json.encode(_described(value, parts, [0]))
    rest = len(form).to_bytes(8, "little") + form
    rest += bytes(_start(len(form)) - CHECK - len(rest)) + b"".join(parts)
    return rest


def _described(value: Any, parts: list[bytes], at: list[int]) -> Any:
    if isinstance(value, np.ndarray):
        raw = np.ascontiguousarray(value).tobytes()
        place = at[0]
        parts.append(raw + bytes(-len(raw) % CACHE_LINE))
        at[0] += len(parts[-1])
        return {"dtype": value.dtype.str, "shape": value.shape, "at": place}
    if isinstance(value, tuple):
        kind = type(value)
        inner = [_described(each, parts, at) for each in value]
        name = "" if kind is tuple else f"{kind.__module__}:{kind.__qualname__}"
        return {"kind": name, "inner": inner}
    if isinstance(value, np.generic):
        return _described(value.item(), parts, at)
    if isinstance(value, float):
        return {"float": value.hex()}  # JSON has no infinity
    return value


def _grown(form: Any, content: Any) -> Any:
    if not isinstance(form, dict):
        return form
    if "float" in form:
        return float.fromhex(form["float"])
    if "dtype" in form:
        dtype, shape, at = np.dtype(form["dtype"]), form["shape"], form["at"]
        length = dtype.itemsize * int(np.prod(shape))
        return content[at : at + length].view(dtype).reshape(shape)
    inner = [_grown(each, content) for each in form["inner"]]
    if not form["kind"]:
        return tuple(inner)
    module, _, name = form["kind"].partition(":")
    if module.partition(".")[0] != _PACKAGE:
        raise ValueError(f"no kind of result: {module}")
    return getattr(importlib.import_module(module), name)(*inner)
