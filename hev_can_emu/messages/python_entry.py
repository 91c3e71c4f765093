"""Kernels called from Python so often, and for so little, that looking at their arguments counts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


def entry(function: F, *example: Any) -> F:
    """Return a kernel as callable from Python with arguments of the types of ``example`` only.

    Calls it once.  It spares the look at each argument's type, half of what a short call costs.
    """
    function(*example)
    compiled = list(getattr(function, "overloads", {}).values())
    if len(compiled) != 1:  # without compiler, or compiled for other types, too
        return function
    return cast(F, getattr(compiled[0], "entry_point", function))
