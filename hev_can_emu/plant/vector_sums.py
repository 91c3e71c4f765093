"""What kernels run for :mod:`.columns`: explicit vectors, as LLVM's instructions.

Imported when kernels are compiled.  Sums are called with addresses: an array is handed over as
seven words or more, and each of them costs as much as some of the sums.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, overload

from hev_can_emu.jit import kernel
from hev_can_emu.plant.columns import WIDTH, columns_times, few_columns_times
from hev_can_emu.vector_code import DOUBLE, DOUBLES, WORD, Lanes, address, repeat


def vector_sums(width: int, vectors: int) -> Any:
    """Return an intrinsic that sums ``vectors`` neighbouring vectors of ``width`` results."""

    def sums(typing_context: Any, matrix: Any, count: Any, x: Any, nz: Any, out: Any) -> Any:
        """Write ``width*vectors`` values; ``matrix``, ``x`` and ``out`` are addresses."""

        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = ir.DoubleType().as_pointer()
            data, values, result = (builder.inttoptr(arguments[i], pointer) for i in (0, 2, 4))
            count, nz = arguments[1], arguments[3]
            integer = count.type
            vector = ir.VectorType(ir.DoubleType(), width)

            def constant(value: int) -> Any:
                return ir.Constant(integer, value)

            def vector_at(pointer: Any, offset: int) -> Any:
                place = builder.gep(pointer, [constant(offset)])
                return builder.bitcast(place, vector.as_pointer())

            def splat(index: Any) -> Any:
                value = builder.load(builder.gep(values, [index]))
                lane = ir.Constant(ir.IntType(32), 0)
                one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, lane)
                mask = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
                return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), mask)

            def fused(first: Any, second: Any, third: Any) -> Any:
                name = f"llvm.fma.v{width}f64"
                kind = ir.FunctionType(vector, [vector] * 3)
                known = builder.module.globals.get(name)
                function = known or ir.Function(builder.module, kind, name)
                return builder.call(function, [first, second, third])

            def added(j: Any, step: int, before: list[Any]) -> list[Any]:
                """Return the sums with ``step`` more columns, in turn to the first and second half."""
                totals = list(before)
                for k in range(step):
                    place = builder.add(j, constant(k))
                    factor, column = splat(place), builder.gep(data, [builder.mul(place, count)])
                    for v in range(vectors):
                        value = builder.load(vector_at(column, v * width), align=8)
                        to = v + (k % 2) * vectors
                        totals[to] = fused(value, factor, totals[to])
                return totals

            def loop(begin: Any, end: Any, step: int, sums: list[Any]) -> list[Any]:
                entry = builder.block
                head = builder.append_basic_block("columns")
                body = builder.append_basic_block("column")
                after = builder.append_basic_block("summed")
                builder.branch(head)
                builder.position_at_end(head)
                j = builder.phi(integer)
                kept = [builder.phi(vector) for _ in sums]
                builder.cbranch(builder.icmp_signed("<", j, end), body, after)
                builder.position_at_end(body)
                new = added(j, step, kept)
                further = builder.add(j, constant(step))
                repeat(builder, head)
                for phi, first, second in [(j, begin, further), *zip(kept, sums, new, strict=True)]:
                    phi.add_incoming(first, entry)
                    phi.add_incoming(second, body)
                builder.position_at_end(after)
                return kept

            zero = ir.Constant(vector, [0.0] * width)
            whole = builder.and_(nz, constant(-4))
            totals = loop(constant(0), whole, 4, [zero] * (2 * vectors))
            totals = loop(whole, nz, 1, totals)
            for v in range(vectors):
                total = builder.fadd(totals[v], totals[v + vectors])
                builder.store(total, vector_at(result, v * width), align=8)
            return context.get_dummy_value()

        return types.void(*[types.intp] * 5), emit

    return intrinsic(sums)


_sums_40, _sums_32, _sums_16, _sums_8 = (vector_sums(WIDTH, n) for n in (5, 4, 2, 1))
_sums_4 = vector_sums(4, 1)


def _make_few(typing_context: Any, matrix: Any, places: Any, n: Any, x: Any, out: Any) -> Any:
    """Sum a few columns of one vector each; all but ``n``, which is even, are addresses."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        matrix, places, n, x, out = arguments
        words, doubles = WORD.as_pointer(), DOUBLE.as_pointer()
        places, values = builder.inttoptr(places, words), builder.inttoptr(x, doubles)
        entry = builder.block
        head, body, after = (builder.append_basic_block(name) for name in ("few", "pair", "done"))
        builder.branch(head)
        builder.position_at_end(head)
        j = builder.phi(WORD)
        sums = [builder.phi(DOUBLES) for _ in range(2)]
        builder.cbranch(builder.icmp_signed("<", j, n), body, after)
        builder.position_at_end(body)
        lanes = Lanes(builder, None)
        new = []
        for k, total in enumerate(sums):
            place = builder.add(j, ir.Constant(WORD, k))
            taken = builder.load(builder.gep(places, [place]))
            factor = lanes.splat(builder.load(builder.gep(values, [taken])))
            at = builder.add(matrix, builder.mul(place, ir.Constant(WORD, 8 * WIDTH)))
            terms = (lanes.load(at, DOUBLES), factor, total)
            new.append(lanes.function(f"llvm.fma.v{WIDTH}f64", DOUBLES, *terms))
        further = builder.add(j, ir.Constant(WORD, 2))
        repeat(builder, head)
        zero = ir.Constant(DOUBLES, [0.0] * WIDTH)
        for phi, first, second in zip(
            [j, *sums], [ir.Constant(WORD, 0), zero, zero], [further, *new], strict=True
        ):
            phi.add_incoming(first, entry)
            phi.add_incoming(second, body)
        builder.position_at_end(after)
        Lanes(builder, None).store(builder.fadd(*sums), out)
        return context.get_dummy_value()

    return types.void(*[types.intp] * 5), emit


_few: Any = intrinsic(_make_few)


@kernel
def _sums(matrix: int, count: int, x: int, nz: int, out: int) -> None:
    i = 0
    if count == 40:  # the 16-DOF driveline's motion over a period
        _sums_40(matrix, count, x, nz, out)
        return
    while i + 32 <= count:
        _sums_32(matrix + 8 * i, count, x, nz, out + 8 * i)
        i += 32
    if i + 16 <= count:
        _sums_16(matrix + 8 * i, count, x, nz, out + 8 * i)
        i += 16
    if i + 8 <= count:
        _sums_8(matrix + 8 * i, count, x, nz, out + 8 * i)
        i += 8
    if i + 4 <= count:
        _sums_4(matrix + 8 * i, count, x, nz, out + 8 * i)


@overload(few_columns_times, inline="always")
def _few_columns_times(
    matrix: Any, start: Any, places: Any, at: Any, n: Any, x: Any, out: Any
) -> Any:
    def times(matrix: Any, start: Any, places: Any, at: Any, n: Any, x: Any, out: Any) -> None:
        _few(address(matrix) + 8 * start, address(places) + 8 * at, n, address(x), address(out))

    return times


@overload(columns_times, inline="always")
def _columns_times(matrix: Any, start: Any, count: Any, x: Any, nz: Any, out: Any) -> Any:
    def times(matrix: Any, start: Any, count: Any, x: Any, nz: Any, out: Any) -> None:
        _sums(address(matrix) + 8 * start, count, address(x), nz, address(out))

    return times
