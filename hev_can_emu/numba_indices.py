"""How compiled kernels index: from zero, and slices inside the array.

Numba, as Python, counts a negative index from the end and cuts a slice to the array.  No kernel of this
package needs either, and testing for it at each access was a third of a tick.  So what is generated in
functions of this package leaves it out; all other functions of a process stay as Numba has them.  With
``NUMBA_BOUNDSCHECK`` each index and slice is tested, and one outside raises IndexError: so the rule holds.

These are not Numba's public functions: where a version has others, its own way stays, slower and no more.
"""

from __future__ import annotations

import threading
from typing import Any

import numba.core.config
from numba.core import cgutils as untyped_cgutils
from numba.cpython import slicing as untyped_slicing
from numba.np import arrayobj as untyped_arrayobj

cgutils: Any = untyped_cgutils
slicing: Any = untyped_slicing
arrayobj: Any = untyped_arrayobj
config: Any = numba.core.config

_PACKAGE = __name__.partition(".")[0]
#: How the names of this package's compiled functions begin.
_OURS = f"_ZN{len(_PACKAGE)}{_PACKAGE}"
_LEFT_OUT = (1 << 63) - 1  # what Numba has for a slice's end that is not given
_compiling = threading.local()


def _is_ours(builder: Any) -> bool:
    return str(builder.function.name).startswith(_OURS)


def _index(builder: Any, index: Any, size: Any) -> Any:
    """Stand in for ``slicing.fix_index``."""
    return index if _is_ours(builder) else _counted_index(builder, index, size)


def _slice(builder: Any, slice: Any, size: Any) -> None:
    """Stand in for ``slicing.fix_slice``."""
    if not _is_ours(builder):
        _cut_slice(builder, slice, size)
        return
    left_out = builder.icmp_signed("==", slice.stop, slice.stop.type(_LEFT_OUT))
    slice.stop = builder.select(left_out, size, slice.stop)
    if config.BOUNDSCHECK:
        context = _compiling.context
        zero = size.type(0)
        for below, above in ((slice.start, zero), (size, slice.start), (size, slice.stop)):
            with builder.if_then(builder.icmp_signed("<", below, above), likely=False):
                message = ("a slice reaches beyond its array",)
                context.call_conv.return_user_exc(builder, IndexError, message)


def _indexing(context: Any, *rest: Any, **options: Any) -> Any:
    """Stand in for ``arrayobj.basic_indexing``, which does not hand its context to the two above."""
    _compiling.context = context
    return _basic_indexing(context, *rest, **options)


_counted_index: Any = getattr(slicing, "fix_index", None)
_cut_slice: Any = getattr(slicing, "fix_slice", None)
_basic_indexing: Any = getattr(arrayobj, "basic_indexing", None)


def install() -> None:
    """Have Numba compile this package's functions so; before it compiles any."""
    if _counted_index is not None and _cut_slice is not None and _basic_indexing is not None:
        slicing.fix_index, slicing.fix_slice = _index, _slice
        if config.BOUNDSCHECK:
            arrayobj.basic_indexing = _indexing
