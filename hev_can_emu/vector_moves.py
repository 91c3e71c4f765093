"""What kernels run for :mod:`.moves`: eight values at a time, as LLVM's vector instructions.

Imported when kernels are compiled.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils as untyped_cgutils
from numba.core import types
from numba.core.errors import TypingError
from numba.extending import intrinsic, overload

from hev_can_emu.vector_code import DOUBLES, WORD, address, stretch

cgutils: Any = untyped_cgutils


def _make_moved(typing_context: Any, source: Any, target: Any, count: Any) -> Any:
    """Copy from one address to another."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, target, count = arguments

        def body(lanes: Any, done: Any) -> None:
            at = builder.shl(done, ir.Constant(WORD, 3))
            lanes.store(lanes.load(builder.add(source, at), DOUBLES), builder.add(target, at))

        stretch(builder, count, body)
        return context.get_dummy_value()

    return types.void(*[types.intp] * 3), emit


def _make_differing(typing_context: Any, first: Any, second: Any, count: Any) -> Any:
    """Return how many values at two addresses differ."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, second, count = arguments
        total = cgutils.alloca_once_value(builder, ir.Constant(WORD, 0))

        def body(lanes: Any, done: Any) -> None:
            at = builder.shl(done, ir.Constant(WORD, 3))
            one, other = (lanes.load(builder.add(each, at), DOUBLES) for each in (first, second))
            found = lanes.counted(builder.fcmp_unordered("!=", one, other))
            builder.store(builder.add(builder.load(total), found), total)

        stretch(builder, count, body)
        return builder.load(total)

    return types.int64(*[types.intp] * 3), emit


def _filled(value_type: Any) -> Any:
    """Return an intrinsic that writes one value into ``count`` places from an address on."""

    def make(typing_context: Any, target: Any, count: Any, value: Any) -> Any:
        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            target, count, value = arguments

            def body(lanes: Any, done: Any) -> None:
                at = builder.shl(done, ir.Constant(WORD, 3))
                lanes.store(lanes.splat(value), builder.add(target, at))

            stretch(builder, count, body)
            return context.get_dummy_value()

        return types.void(types.intp, types.intp, value_type), emit

    return intrinsic(make)


_moved: Any = intrinsic(_make_moved)
_differing: Any = intrinsic(_make_differing)
_filled_doubles: Any = _filled(types.float64)
_filled_words: Any = _filled(types.int64)


def _fits(array: Any, *dtypes: Any) -> None:
    """Refuse, where a kernel is compiled, an array that is not contiguous or of other values."""
    if not isinstance(array, types.Array) or array.layout != "C" or array.dtype not in dtypes:
        raise TypingError(f"expected a contiguous array of {dtypes[0]}, got {array}")


def stand_in(move: Any, same: Any, fill: Any, fill_integers: Any) -> None:
    """Have compiled kernels call the vectors for the functions of :mod:`.moves`."""

    @overload(move, inline="always")
    def _move(source: Any, at: Any, target: Any, to: Any, count: Any) -> Any:
        _fits(source, types.float64)
        _fits(target, types.float64)

        def moved(source: Any, at: Any, target: Any, to: Any, count: Any) -> Any:
            _moved(address(source) + 8 * at, address(target) + 8 * to, count)

        return moved

    @overload(same, inline="always")
    def _same(first: Any, at: Any, second: Any, to: Any, count: Any) -> Any:
        _fits(first, types.float64)
        _fits(second, types.float64)

        def compared(first: Any, at: Any, second: Any, to: Any, count: Any) -> Any:
            return _differing(address(first) + 8 * at, address(second) + 8 * to, count) == 0

        return compared

    @overload(fill, inline="always")
    def _fill(target: Any, to: Any, count: Any, value: Any) -> Any:
        _fits(target, types.float64)

        def filled(target: Any, to: Any, count: Any, value: Any) -> Any:
            _filled_doubles(address(target) + 8 * to, count, value)

        return filled

    @overload(fill_integers, inline="always")
    def _fill_integers(target: Any, to: Any, count: Any, value: Any) -> Any:
        _fits(target, types.int64, types.uint64)

        def filled(target: Any, to: Any, count: Any, value: Any) -> Any:
            _filled_words(address(target) + 8 * to, count, value)

        return filled
