"""How compiled kernels keep what they write.

Where an overload was inlined into a function, Numba removes what it takes for dead code, stores included:
those into arrays which it does not know to be an argument's.  An array that is a field of a tuple, as most
of a tick's are, is such a one, or not, by the order in which the inlined blocks happen to lie.  So functions
of this package skip that removal, which LLVM does better; all other functions of a process stay as Numba has
them.

This is not Numba's public function: where a version has another, its own way stays, and tests of scenarios
tell if that drops a store.
"""

from __future__ import annotations

from typing import Any

from numba.core import typed_passes as untyped_passes

typed_passes: Any = untyped_passes

_PACKAGE = __name__.partition(".")[0]

_remove: Any = getattr(typed_passes, "dead_code_elimination", None)


def _eliminate(function: Any, *rest: Any, **options: Any) -> Any:
    """Stand in for ``typed_passes.dead_code_elimination``."""
    if str(function.func_id.modname).partition(".")[0] == _PACKAGE:
        return None
    return _remove(function, *rest, **options)


def install() -> None:
    """Have Numba compile this package's functions so; before it compiles any."""
    if _remove is not None:
        typed_passes.dead_code_elimination = _eliminate
