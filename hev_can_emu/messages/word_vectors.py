"""What kernels run for :mod:`.quick`: eight signals of a message at a time, as LLVM's vector instructions.

Imported when kernels are compiled.  The operations on each signal, and so its bits, are those of the loops
in :mod:`.quick`, which stand in where bounds are checked or nothing is compiled.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils as untyped_cgutils
from numba.core import types
from numba.extending import intrinsic, overload

from hev_can_emu.messages import quick
from hev_can_emu.vector_code import BIT, DOUBLE, DOUBLES, WORD, WORDS, Lanes, address, blocks

cgutils: Any = untyped_cgutils
tuple_of: Any = types.Tuple


class _Tables:
    """The rows of ``ranges`` and ``places`` of eight signals."""

    def __init__(self, lanes: Lanes, ranges: Any, places: Any, stride: Any, done: Any) -> None:
        self.lanes, self._ranges, self._places = lanes, ranges, places
        self._stride, self._done = stride, done

    def _at(self, start: Any, row: int) -> Any:
        builder = self.lanes.builder
        value = builder.add(builder.mul(self._stride, ir.Constant(WORD, row)), self._done)
        return builder.add(start, builder.shl(value, ir.Constant(WORD, 3)))

    def number(self, row: int) -> Any:
        """Return a row of ``ranges``."""
        return self.lanes.load(self._at(self._ranges, row), DOUBLES)

    def pattern(self, row: int) -> Any:
        """Return a row of ``places``."""
        return self.lanes.load(self._at(self._places, row), WORDS)


def _all(value: float) -> Any:
    return ir.Constant(DOUBLES, [ir.Constant(DOUBLE, value)] * 8)


def _make_word(
    typing_context: Any, ranges: Any, places: Any, stride: Any, count: Any, values: Any
) -> Any:
    """Return word and number of unusual values; all but ``stride`` and ``count`` are addresses."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        ranges, places, stride, count, values = arguments
        sums = [cgutils.alloca_once_value(builder, ir.Constant(WORD, 0)) for _ in range(3)]

        def body(done: Any, left: Any) -> None:
            lanes = Lanes(builder, left)
            tables = _Tables(lanes, ranges, places, stride, done)
            value = lanes.load(
                builder.add(values, builder.shl(done, ir.Constant(WORD, 3))), DOUBLES
            )
            scaled = builder.fdiv(
                builder.fsub(value, tables.number(quick.Q_OFFSET)), tables.number(quick.Q_SCALE)
            )
            shifted = builder.fadd(scaled, _all(quick.ROUNDER))
            raw = builder.fsub(shifted, _all(quick.ROUNDER))
            pattern = builder.and_(builder.bitcast(shifted, WORDS), tables.pattern(quick.B_MASK))
            outside = builder.or_(
                builder.fcmp_ordered("<", raw, tables.number(quick.Q_LOW)),
                builder.fcmp_ordered(">", raw, tables.number(quick.Q_HIGH)),
            )
            taken = builder.icmp_unsigned("==", pattern, tables.pattern(quick.B_NA))
            missing = builder.fcmp_unordered("uno", value, value)
            usual = builder.select(missing, tables.pattern(quick.B_MISSING), pattern)
            placed = builder.shl(usual, tables.pattern(quick.B_SHIFT))
            placed = builder.select(lanes.mask, placed, ir.Constant(WORDS, None))
            big = tables.pattern(quick.B_BIG)
            found = (
                lanes.joined(builder.and_(placed, builder.not_(big))),
                lanes.joined(builder.and_(placed, big)),
                lanes.counted(builder.or_(outside, taken)),
            )
            for place, more, join in zip(
                sums, found, (builder.or_, builder.or_, builder.add), strict=True
            ):
                builder.store(join(builder.load(place), more), place)

        blocks(builder, count, body)
        little, big, unusual = (builder.load(place) for place in sums)
        word = builder.or_(little, builder.bswap(big))
        return context.make_tuple(builder, signature.return_type, (word, unusual))

    return tuple_of((types.uint64, types.int64))(*[types.intp] * 5), emit


def _make_values(
    typing_context: Any, ranges: Any, places: Any, stride: Any, count: Any, word: Any, values: Any
) -> Any:
    """Write a word's values; return how many lie outside their range."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        ranges, places, stride, count, word, values = arguments
        beyond = cgutils.alloca_once_value(builder, ir.Constant(WORD, 0))
        swapped = builder.bswap(word)

        def body(done: Any, left: Any) -> None:
            lanes = Lanes(builder, left)
            tables = _Tables(lanes, ranges, places, stride, done)
            big = tables.pattern(quick.B_BIG)
            source = builder.or_(
                builder.and_(lanes.splat(swapped), big),
                builder.and_(lanes.splat(word), builder.not_(big)),
            )
            pattern = builder.and_(
                builder.lshr(source, tables.pattern(quick.B_SHIFT)), tables.pattern(quick.B_MASK)
            )
            high = ir.Constant(WORDS, [quick.HIGH_BITS] * 8)
            lifted = builder.or_(builder.xor(pattern, tables.pattern(quick.B_SIGN)), high)
            raw = builder.fsub(builder.bitcast(lifted, DOUBLES), tables.number(quick.Q_ZERO))
            value = builder.fadd(
                builder.fmul(raw, tables.number(quick.Q_SCALE)), tables.number(quick.Q_OFFSET)
            )
            missing = builder.icmp_unsigned("==", pattern, tables.pattern(quick.B_NA))
            value = builder.select(missing, _all(float("nan")), value)
            lanes.store(value, builder.add(values, builder.shl(done, ir.Constant(WORD, 3))))
            outside = builder.or_(
                builder.fcmp_ordered("<", raw, tables.number(quick.Q_LOW)),
                builder.fcmp_ordered(">", raw, tables.number(quick.Q_HIGH)),
            )
            found = lanes.counted(builder.and_(outside, builder.not_(missing)))
            builder.store(builder.add(builder.load(beyond), found), beyond)

        blocks(builder, count, body)
        return builder.load(beyond)

    arguments = (*[types.intp] * 4, types.uint64, types.intp)
    return types.int64(*arguments), emit


def _make_shown(
    typing_context: Any, source: Any, target: Any, seen_ns: Any, count: Any, t_ns: Any
) -> Any:
    """Copy values and set times; all but ``count`` and ``t_ns`` are addresses."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, target, seen_ns, count, t_ns = arguments

        def body(done: Any, left: Any) -> None:
            lanes = Lanes(builder, left)
            at = builder.shl(done, ir.Constant(WORD, 3))
            lanes.store(lanes.load(builder.add(source, at), DOUBLES), builder.add(target, at))
            lanes.store(lanes.splat(t_ns), builder.add(seen_ns, at))

        blocks(builder, count, body)
        return context.get_dummy_value()

    return types.void(*[types.intp] * 5), emit


def _make_reached(typing_context: Any, times: Any, t_ns: Any) -> Any:
    """Return the bits of the times at an address that are not after ``t_ns``."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lanes = Lanes(builder, ir.Constant(WORD, 8))
        there = builder.load(builder.inttoptr(arguments[0], WORDS.as_pointer()), align=8)
        bits = builder.icmp_signed("<=", there, lanes.splat(arguments[1]))
        return builder.zext(builder.bitcast(bits, ir.IntType(8)), WORD)

    return types.int64(types.intp, types.int64), emit


def _make_lowest(typing_context: Any, bits: Any) -> Any:
    """Return the number of trailing zeros."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(BIT, 1))

    return types.int64(types.int64), emit


_word: Any = intrinsic(_make_word)
_values: Any = intrinsic(_make_values)
_shown: Any = intrinsic(_make_shown)
_reached: Any = intrinsic(_make_reached)
_lowest: Any = intrinsic(_make_lowest)


@overload(quick.lowest, inline="always")
def _quick_lowest(bits: Any) -> Any:
    def lowest(bits: Any) -> Any:
        return _lowest(bits)

    return lowest


@overload(quick.reached, inline="always")
def _quick_reached(times: Any, start: Any, t_ns: Any) -> Any:
    def reached(times: Any, start: Any, t_ns: Any) -> Any:
        return _reached(address(times) + 8 * start, t_ns)

    return reached


@overload(quick.show_signals, inline="always")
def _quick_show(source: Any, target: Any, seen_ns: Any, first: Any, count: Any, t_ns: Any) -> Any:
    def show(source: Any, target: Any, seen_ns: Any, first: Any, count: Any, t_ns: Any) -> Any:
        at = 8 * first
        _shown(address(source) + at, address(target) + at, address(seen_ns) + at, count, t_ns)

    return show


@overload(quick.quick_word, inline="always")
def _quick_word(ranges: Any, places: Any, stride: Any, first: Any, count: Any, values: Any) -> Any:
    def word(ranges: Any, places: Any, stride: Any, first: Any, count: Any, values: Any) -> Any:
        at = 8 * first
        return _word(
            address(ranges) + at, address(places) + at, stride, count, address(values) + at
        )

    return word


@overload(quick.quick_values, inline="always")
def _quick_values(
    ranges: Any, at_ranges: Any, places: Any, at_places: Any, stride: Any, first: Any, count: Any,
    word: Any, values: Any, at_values: Any,
) -> Any:  # fmt: skip
    def write(
        ranges: Any, at_ranges: Any, places: Any, at_places: Any, stride: Any, first: Any, count: Any,
        word: Any, values: Any, at_values: Any,
    ) -> Any:  # fmt: skip
        return _values(
            address(ranges) + 8 * (at_ranges + first), address(places) + 8 * (at_places + first),
            stride, count, word, address(values) + 8 * (at_values + first),
        )  # fmt: skip

    return write
