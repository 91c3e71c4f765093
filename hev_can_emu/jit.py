"""One decorator for compiled kernels, with a cache that cannot run stale code.

Numba's own cache looks at a kernel's own source file only: after a change in a *callee's* module it
runs the old code, and it forgets what it has when the package moves.  Here the cache folder of a module
is named by a hash of its source and of all that it imports from this package, so a change compiles
anew what hangs on it and nothing else, and two checkouts of the same code share what is compiled.  The
oldest folders are removed.  Where no user cache folder can be written, a temporary one serves.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numba.core.config
import numba.core.options

F = TypeVar("F", bound=Callable[..., Any])

# Its attributes are made at run time, out of a type checker's sight.
numba_config: Any = numba.core.config
locators: Any = numba.core.caching

JIT_DISABLED = bool(numba_config.DISABLE_JIT)

# Without Numba's own run time references to arrays are not counted, which would cost several times the
# work where tuples of arrays are handed on.  Not a public option: a Numba without it is slower, no more.
_UNCOUNTED = {"_nrt": False} if hasattr(numba.core.options.DefaultOptions, "_nrt") else {}

_PACKAGE = Path(__file__).resolve().parent
_NAME = _PACKAGE.name
_KEPT = 6  # folders of other versions of a module that are left alone
_IMPORT = re.compile(
    rf"^\s*(?:from {_NAME}([\w.]*) import (\([^)]*\)|[^\n]*)|import {_NAME}\.([\w.]+))",
    re.MULTILINE,
)


@functools.cache
def cache_home() -> Path:
    """Return the folder that holds all compiled kernels, made where needed."""
    home = os.environ.get("HEV_CAN_EMU_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache"),
        "hev-can-emu",
    )
    folder = Path(home) / "kernels"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="hev-can-emu-kernels-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@functools.cache
def _source(module: str) -> tuple[bytes, tuple[str, ...]]:
    """Return a module's source and the modules of this package that it imports; empty for no module."""
    path = _PACKAGE.joinpath(*module.split("."))
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    if not path.is_file():
        return b"", ()
    text = path.read_bytes()
    found = set()
    for parent, names, whole in _IMPORT.findall(text.decode()):
        start = parent.lstrip(".") or whole
        if start:
            found.add(start)
        for name in re.findall(r"\w+", re.sub(r"#.*|\bas \w+", "", names)):
            found.add(f"{start}.{name}" if start else name)
    return text, tuple(found)


def _digest(module: str) -> str:
    """Return a hash of all that the compiled code of a module depends on."""
    reached, waiting = {module}, [module]
    while waiting:
        for other in _source(waiting.pop())[1]:
            if other not in reached and _source(other)[0]:
                reached.add(other)
                waiting.append(other)
    digest = hashlib.sha256()
    for each in sorted(reached):
        text = _source(each)[0]
        digest.update(f"{each} {len(text)}\n".encode())
        digest.update(text)
    digest.update(f"{numba.__version__} {numba_config.BOUNDSCHECK}".encode())
    return digest.hexdigest()[:16]


@functools.cache
def cache_folder(module: str) -> Path:
    """Return the folder for the compiled kernels of one module, named without the package."""
    folder = cache_home() / module / _digest(module)
    with contextlib.suppress(OSError):  # Numba says so where it cannot write
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    _remove_old(folder)
    return folder


def _remove_old(folder: Path) -> None:
    """Remove the cache folders of versions not used for longest, beyond a few."""
    with contextlib.suppress(OSError):  # another process may be at it, too
        others = [each for each in folder.parent.iterdir() if each != folder]
        others.sort(key=lambda each: each.stat().st_mtime, reverse=True)
        for each in others[_KEPT:]:
            shutil.rmtree(each, ignore_errors=True)


class KernelLocator(locators.UserProvidedCacheLocator):  # type: ignore[misc]
    """Places what is compiled in the folder set, wherever the package itself lies."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Return the path inside the folder; ``py_file`` is in the folder's name already."""
        return "compiled"


def kernel(function: F) -> F:
    """Compile ``function`` with Numba on first call: no Python objects, strict floating point.

    Never ``fastmath`` and never parallel: the same inputs give the same bits.  No references are
    counted, so it cannot allocate.
    """
    return _compile(function)


def counting_kernel(function: F) -> F:
    """Compile as :func:`kernel` does, for one that allocates or opens a structure; off the hot path."""
    return _compile(function, **dict.fromkeys(_UNCOUNTED, True))


def inlined_kernel(function: F) -> F:
    """Compile as :func:`kernel` does, and put the code where kernels call it.

    For a large kernel with many arrays and one caller on the hot path: handing those over costs.
    """
    return _compile(function, inline="always")


def inner_kernel(function: F) -> F:
    """Compile as :func:`kernel` does, for a kernel that only kernels call.

    It has no entry from Python, which saves seconds of compilation where arguments are large tuples.
    """
    return _compile(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _compile(function: F, **options: Any) -> F:
    if JIT_DISABLED:
        return function
    module = function.__module__.partition(".")[2]
    settings = {
        "CACHE_DIR": str(cache_folder(module)),
        "CACHE_LOCATOR_CLASSES": f"{__name__}.{KernelLocator.__name__}",
    }
    previous = {name: getattr(numba_config, name, "") for name in settings}
    for name, value in settings.items():
        setattr(numba_config, name, value)
    try:
        njit: Any = numba.njit
        compiled = njit(cache=True, error_model="numpy", **{**_UNCOUNTED, **options})(function)
    finally:
        for name, value in previous.items():
            setattr(numba_config, name, value)
    return cast(F, compiled)
