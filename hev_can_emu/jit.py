"""One decorator for compiled kernels, with a cache that cannot run stale code.

Numba's own cache looks at a kernel's own source file only: after a change in a *callee's* module it
runs the old code.  Here the cache folder's name holds a hash of all kernel sources of the
package, so any change starts a fresh folder.  Where no user cache folder can be written, a
temporary one serves.
"""

from __future__ import annotations

import functools
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numba.core.config

F = TypeVar("F", bound=Callable[..., Any])

# Its attributes are made at run time, out of a type checker's sight.
numba_config: Any = numba.core.config

_PACKAGE = Path(__file__).resolve().parent


@functools.cache
def cache_folder() -> Path:
    """Return the folder for compiled kernels, made where needed."""
    digest = hashlib.sha256()
    for source in sorted(_PACKAGE.rglob("*.py")):
        text = source.read_bytes()
        if b"@kernel" in text:
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
        probe = tempfile.TemporaryFile(dir=folder)
        probe.close()
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="hev-can-emu-kernels-"))
    return folder


def kernel(function: F) -> F:
    """Compile ``function`` with Numba on first call: no Python objects, strict floating point.

    Never ``fastmath`` and never parallel: the same inputs give the same bits.
    """
    previous = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = str(cache_folder())
    try:
        compiled: Any = numba.njit(cache=True, error_model="numpy")(function)
    finally:
        numba_config.CACHE_DIR = previous
    return cast(F, compiled)
