"""One decorator for compiled kernels, with a cache that cannot run stale code.

Numba's own cache looks at a kernel's own source file only: after a change in a *callee's* module it
runs the old code, and it forgets what it has when the package moves.  Here the cache folder of a module
is named by a hash of its source and of all that it imports from this package, so a change compiles
anew what hangs on it and nothing else, and two checkouts of the same code share what is compiled.  The
oldest folders are removed.  Where no user cache folder can be written, a temporary one serves.

Numba is imported when the first kernel is called, not before: until then a kernel is a :class:`Kernel`, which
then makes room for Numba's dispatcher wherever a module holds it.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib.util
import os
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

from hev_can_emu.sources import Sources

F = TypeVar("F", bound=Callable[..., Any])

#: Whether Numba's settings are the usual ones; others are Numba's affair from the start.
USUAL = not os.path.exists(".numba_config.yaml") and not any(
    name.startswith("NUMBA_") for name in os.environ
)
if USUAL:
    JIT_DISABLED = BOUNDS_CHECKED = False
else:
    from hev_can_emu.numba_side import BOUNDS_CHECKED, JIT_DISABLED

_PACKAGE = Path(__file__).resolve().parent
_NAME = _PACKAGE.name
_KEPT = 6  # folders of other versions of a module that are left alone


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
        usable = os.access(folder, os.W_OK | os.X_OK)
    except OSError:
        usable = False
    if not usable:
        import shutil
        import tempfile

        folder = Path(tempfile.mkdtemp(prefix="hev-can-emu-kernels-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@functools.cache
def _compiler_version() -> bytes:
    """Return what tells versions of Numba apart, without importing it."""
    found = importlib.util.find_spec("numba")
    if found is None or found.origin is None:
        return b""
    return Path(found.origin).with_name("_version.py").read_bytes()


@functools.cache
def _sources() -> tuple[Sources, dict[str, str]]:
    """Return the sources, and the hash for each module of all that its compiled code follows from."""
    sources = Sources(_PACKAGE, _compiler_version() + f" {BOUNDS_CHECKED}".encode())
    return sources, sources.digests(cache_home())


@functools.cache
def cache_folder(module: str) -> Path:
    """Return the folder for the compiled kernels of one module, named without the package."""
    sources, digests = _sources()
    folder = cache_home() / module / (digests.get(module) or sources.digest(module))
    with contextlib.suppress(OSError):  # Numba says so where it cannot write
        try:
            os.utime(folder)
        except FileNotFoundError:
            folder.mkdir(parents=True, exist_ok=True)
            _remove_old(folder)
    return folder


def _remove_old(folder: Path) -> None:
    """Remove the cache folders of versions not used for longest, beyond a few."""
    with contextlib.suppress(OSError):  # another process may be at it, too
        others = [each for each in folder.parent.iterdir() if each != folder]
        others.sort(key=lambda each: each.stat().st_mtime, reverse=True)
        for each in others[_KEPT:]:
            import shutil

            shutil.rmtree(each, ignore_errors=True)


def kernel(function: F) -> F:
    """Compile ``function`` with Numba on first call: no Python objects, strict floating point.

    Never ``fastmath`` and never parallel: the same inputs give the same bits.  No references are
    counted, so it cannot allocate.
    """
    return _compile(function)


def counting_kernel(function: F) -> F:
    """Compile as :func:`kernel` does, for one that allocates or opens a structure; off the hot path."""
    return _compile(function, _nrt=True)


def inlined_kernel(function: F) -> F:
    """Compile as :func:`kernel` does, and put the code where kernels call it.

    For a large kernel with many arrays and one caller on the hot path: handing those over costs.
    """
    return _compile(function, inline="always")


def small_kernel(function: F) -> F:
    """Compile as :func:`kernel` does, and let LLVM put the machine code where kernels call it.

    For what is called in one or two places: an array is handed over as seven words, and the code that
    does so, in every tick, would not fit a processor's instruction cache.
    """
    return _compile(function, forceinline=True)


def inner_kernel(function: F) -> F:
    """Compile as :func:`kernel` does, for a kernel that only kernels call.

    It has no entry from Python, which saves seconds of compilation where arguments are large tuples.
    """
    return _compile(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


class Kernel:
    """A kernel as long as Numba is not imported; the first call imports it.

    Attributes:
        py_func: the function as written.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        # As functools.update_wrapper does, in a fifth of the time.
        self.__module__, self.__doc__ = function.__module__, function.__doc__
        self.__name__, self.__qualname__ = function.__name__, function.__qualname__
        self.__wrapped__ = function
        self.py_func = function
        self._options = options
        self._dispatcher: Any = None

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled kernel, or the function as written inside :func:`uncompiled`."""
        if _uncompiled.depth:
            return self.py_func(*arguments)
        return self.dispatcher(*arguments)

    @property
    def dispatcher(self) -> Any:
        """Numba's dispatcher of the kernel."""
        ready_compiler()
        return self._dispatcher

    @property
    def overloads(self) -> Any:
        """What is compiled so far, as the dispatcher has it."""
        return self.dispatcher.overloads

    def turn(self) -> None:
        """Make the dispatcher."""
        self._dispatcher = _dispatcher(self.py_func, self._options)


class _Depth(threading.local):
    depth = 0


_uncompiled = _Depth()
_lock = threading.RLock()
_waiting: list[Kernel] = []
_preparations: list[Callable[[], object]] = []
_ready = not USUAL


@contextlib.contextmanager
def uncompiled() -> Iterator[None]:
    """Run kernels that are called inside as plain Python, unless Numba is there already.

    For what runs once and is small: the result is the same, and importing Numba takes half a second.
    """
    _uncompiled.depth += 1
    try:
        yield
    finally:
        _uncompiled.depth -= 1


def before_compiling(preparation: Callable[[], object]) -> None:
    """Call ``preparation`` once Numba is imported, before anything is compiled; at once if it is."""
    with _lock:
        if not _ready:
            _preparations.append(preparation)
            return
    preparation()


def ready_compiler() -> None:
    """Import Numba, and put its dispatchers in the place of all kernels."""
    global _ready
    with _lock:
        if _ready:
            return
        import hev_can_emu.numba_side  # noqa: F401

        _ready = True
        kernels, spaces = list(_waiting), {}
        _waiting.clear()
        for each in kernels:
            each.turn()
            spaces[id(each.py_func.__globals__)] = each.py_func.__globals__
        for name, module in list(sys.modules.items()):
            if name.partition(".")[0] == _NAME:
                spaces[id(vars(module))] = vars(module)
        for space in spaces.values():
            _put_in_place(space)
        for preparation in _preparations:
            preparation()
        _preparations.clear()


def _put_in_place(space: dict[str, Any]) -> None:
    for name, value in list(space.items()):
        if isinstance(value, Kernel):
            space[name] = value.dispatcher


def _dispatcher(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    from hev_can_emu import numba_side

    package, _, module = function.__module__.partition(".")
    # Not of functions elsewhere: nobody would notice that what they call here has changed.
    folder = cache_folder(module) if package == _NAME else None
    return numba_side.dispatcher(function, folder, options)


def _compile(function: F, **options: Any) -> F:
    if JIT_DISABLED:
        return function
    with _lock:
        if not _ready:
            waiting = Kernel(function, options)
            _waiting.append(waiting)
            return cast(F, waiting)
    _put_in_place(function.__globals__)
    return cast(F, _dispatcher(function, options))
