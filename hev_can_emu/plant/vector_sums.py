"""Sums over columns in explicit vectors, as LLVM's instructions; imported when kernels are compiled."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic


def vector_sums(width: int, vectors: int) -> Any:
    """Return an intrinsic that sums ``vectors`` neighbouring vectors of ``width`` results."""

    def sums(
        typing_context: Any, matrix: Any, start: Any, count: Any, x: Any, nz: Any, out: Any
    ) -> Any:
        """Write ``out[:width*vectors]``; ``start`` is the place of the first value in ``matrix``."""

        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            matrix_type, _, _, x_type, _, out_type = signature.args
            data = context.make_array(matrix_type)(context, builder, arguments[0]).data
            values = context.make_array(x_type)(context, builder, arguments[3]).data
            result = context.make_array(out_type)(context, builder, arguments[5]).data
            start, count, nz = arguments[1], arguments[2], arguments[4]
            integer = start.type
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

            def products(j: Any, step: int) -> list[Any]:
                """Return what ``step`` columns from ``j`` on add to each vector."""
                factors = [splat(builder.add(j, constant(k))) for k in range(step)]
                columns = [
                    builder.gep(data, [
                        builder.add(start, builder.mul(builder.add(j, constant(k)), count))
                    ])
                    for k in range(step)
                ]  # fmt: skip
                added = []
                for v in range(vectors):
                    terms = [
                        builder.fmul(builder.load(vector_at(column, v * width), align=8), factor)
                        for column, factor in zip(columns, factors, strict=True)
                    ]
                    while len(terms) > 1:
                        terms = [
                            builder.fadd(first, second)
                            for first, second in zip(terms[::2], terms[1::2], strict=True)
                        ]
                    added.append(terms[0])
                return added

            def loop(begin: Any, end: Any, step: int, sums: list[Any]) -> list[Any]:
                entry = builder.block
                head = builder.append_basic_block("columns")
                body = builder.append_basic_block("column")
                after = builder.append_basic_block("summed")
                builder.branch(head)
                builder.position_at_end(head)
                j = builder.phi(integer)
                kept = [builder.phi(vector) for _ in range(vectors)]
                builder.cbranch(builder.icmp_signed("<", j, end), body, after)
                builder.position_at_end(body)
                new = [
                    builder.fadd(old, more)
                    for old, more in zip(kept, products(j, step), strict=True)
                ]
                further = builder.add(j, constant(step))
                builder.branch(head)
                for phi, first, second in [(j, begin, further), *zip(kept, sums, new, strict=True)]:
                    phi.add_incoming(first, entry)
                    phi.add_incoming(second, body)
                builder.position_at_end(after)
                return kept

            zero = ir.Constant(vector, [0.0] * width)
            whole = builder.and_(nz, constant(-4))
            totals = loop(constant(0), whole, 4, [zero] * vectors)
            totals = loop(whole, nz, 1, totals)
            for v, total in enumerate(totals):
                builder.store(total, vector_at(result, v * width), align=8)
            return context.get_dummy_value()

        return types.void(matrix, types.intp, types.intp, x, types.intp, out), emit

    return intrinsic(sums)
