"""One decorator for compiled kernels, with a cache that cannot run stale code.

Numba's own cache looks at a kernel's own source file only: after a change in a *callee's* module it
runs the old code.  Here the cache folder's name holds a hash of all kernel sources of the
package, so any change starts a fresh folder; the oldest ones are removed.  Where no user cache folder can
be written, a temporary one serves.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numba.core.config

F = TypeVar("F", bound=Callable[..., Any])

# Its attributes are made at run time, out of a type checker's sight.
numba_config: Any = numba.core.config

JIT_DISABLED = bool(numba_config.DISABLE_JIT)

_PACKAGE = Path(__file__).resolve().parent
_KEPT = 6  # cache folders of other versions that are left alone


@functools.cache
def cache_folder() -> Path:
    """Return the folder for compiled kernels, made where needed."""
    digest = hashlib.sha256()
    for source in sorted(_PACKAGE.rglob("*.py")):
        text = source.read_bytes()
        if b"kernel\n" in text:
            digest.update(source.relative_to(_PACKAGE).as_posix().encode())
            digest.update(text)
    flags = f"{numba.__version__} {numba_config.BOUNDSCHECK} {numba_config.DISABLE_JIT}"
    digest.update(flags.encode())
    home = os.environ.get("HEV_CAN_EMU_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache"),
        "hev-can-emu",
    )
    folder = Path(home) / f"kernels-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        os.utime(folder)
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="hev-can-emu-kernels-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        return folder
    _remove_old(folder)
    return folder


def _remove_old(folder: Path) -> None:
    """Remove the cache folders of versions not used for longest, beyond a few."""
    with contextlib.suppress(OSError):  # another process may be at it, too
        others = [each for each in folder.parent.glob("kernels-*") if each != folder]
        others.sort(key=lambda each: each.stat().st_mtime, reverse=True)
        for each in others[_KEPT:]:
            shutil.rmtree(each, ignore_errors=True)


def kernel(function: F) -> F:
    """Compile ``function`` with Numba on first call: no Python objects, strict floating point.

    Never ``fastmath`` and never parallel: the same inputs give the same bits.
    """
    return _compile(function, no_cpython_wrapper=False)


def inner_kernel(function: F) -> F:
    """Compile as :func:`kernel` does, for a kernel that only kernels call.

    It has no entry from Python, which saves seconds of compilation where arguments are large tuples.
    """
    return _compile(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _compile(function: F, **options: Any) -> F:
    previous = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = str(cache_folder())
    try:
        njit: Any = numba.njit
        compiled = njit(cache=True, error_model="numpy", **options)(function)
    finally:
        numba_config.CACHE_DIR = previous
    return cast(F, compiled)
