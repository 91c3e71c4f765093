"""What kernels with explicit vectors are built from: LLVM's instructions, eight lanes at a time.

Imported when kernels are compiled.  Arrays are handed to such code as addresses: an array is seven words.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

LANES = 8

DOUBLE, WORD, BIT, LANE = ir.DoubleType(), ir.IntType(64), ir.IntType(1), ir.IntType(32)
DOUBLES, WORDS, BITS, INDICES = (ir.VectorType(kind, LANES) for kind in (DOUBLE, WORD, BIT, LANE))


def _place(typing_context: Any, array: Any) -> Any:
    """Return where an array's first value is."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.ptrtoint(data, context.get_value_type(types.intp))

    return types.intp(array), emit


def _multiply_add(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """Return ``a * b + c`` with one rounding."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(*[types.float64] * 3), emit


address: Any = intrinsic(_place)
fused: Any = intrinsic(_multiply_add)


class Lanes:
    """Instructions on vectors of eight values, of which the first ``count`` (int64; None: all) matter."""

    def __init__(self, builder: Any, count: Any) -> None:
        self.builder = builder
        numbers = ir.Constant(WORDS, list(range(LANES)))
        self.mask = None if count is None else builder.icmp_signed("<", numbers, self.splat(count))

    def splat(self, value: Any) -> Any:
        """Return a vector of one value in all lanes."""
        builder = self.builder
        nothing = ir.Constant(ir.VectorType(value.type, LANES), ir.Undefined)
        one = builder.insert_element(nothing, value, ir.Constant(LANE, 0))
        return builder.shuffle_vector(one, nothing, ir.Constant(INDICES, [0] * LANES))

    def function(self, name: str, result: Any, *arguments: Any) -> Any:
        """Return the call of one of LLVM's intrinsic functions."""
        kind = ir.FunctionType(result, [each.type for each in arguments])
        module = self.builder.module
        known = module.globals.get(name)
        return self.builder.call(known or ir.Function(module, kind, name), arguments)

    def load(self, place: Any, kind: Any) -> Any:
        """Return what lies at an address (int64), zero in lanes that do not matter."""
        pointer = self.builder.inttoptr(place, kind.as_pointer())
        if self.mask is None:
            return self.builder.load(pointer, align=8)
        name = f"llvm.masked.load.v{LANES}{'f64' if kind == DOUBLES else 'i64'}.p0"
        align = ir.Constant(LANE, 8)
        return self.function(name, kind, pointer, align, self.mask, ir.Constant(kind, None))

    def store(self, value: Any, place: Any) -> None:
        """Write to an address (int64) the lanes that matter."""
        pointer = self.builder.inttoptr(place, value.type.as_pointer())
        if self.mask is None:
            self.builder.store(value, pointer, align=8)
            return
        name = f"llvm.masked.store.v{LANES}{'f64' if value.type == DOUBLES else 'i64'}.p0"
        self.function(name, ir.VoidType(), value, pointer, ir.Constant(LANE, 8), self.mask)

    def joined(self, value: Any) -> Any:
        """Return the bitwise or of all lanes of words."""
        return self.function(f"llvm.vector.reduce.or.v{LANES}i64", WORD, value)

    def counted(self, bits: Any) -> Any:
        """Return, as int64, in how many lanes a condition holds."""
        builder = self.builder
        if self.mask is not None:
            bits = builder.and_(bits, self.mask)
        byte = builder.bitcast(bits, ir.IntType(LANES))
        return builder.ctpop(builder.zext(byte, WORD))


def repeat(builder: Any, head: Any) -> None:
    """End a loop's body: go back to ``head``, and let LLVM leave the loop as it is.

    Unrolled, its code would be several times as long and no faster: what is too much for a processor's store
    of decoded instructions is decoded anew in every tick.
    """
    module = builder.module
    disable = module.add_metadata(["llvm.loop.unroll.disable"])
    # LLVM knows a loop's own node by its first operand, which is the node.
    loop = ir.values.MDValue(module, [disable], name=str(len(module.metadata)))
    loop.operands = (loop, disable)
    builder.branch(head).set_metadata("llvm.loop", loop)


def stretch(builder: Any, count: Any, body: Any) -> None:
    """Emit code for ``count`` (int64) values: ``body(lanes, done)``, whole vectors, then what is left."""
    step = ir.Constant(WORD, LANES)
    entry = builder.block
    head, inside, after = (builder.append_basic_block(name) for name in ("head", "whole", "after"))
    rest, end = (builder.append_basic_block(name) for name in ("rest", "end"))
    builder.branch(head)
    builder.position_at_end(head)
    done = builder.phi(WORD)
    done.add_incoming(ir.Constant(WORD, 0), entry)
    further = builder.add(done, step)
    builder.cbranch(builder.icmp_signed("<=", further, count), inside, after)
    builder.position_at_end(inside)
    body(Lanes(builder, None), done)
    done.add_incoming(further, builder.block)
    repeat(builder, head)
    builder.position_at_end(after)
    left = builder.sub(count, done)
    builder.cbranch(builder.icmp_signed(">", left, ir.Constant(WORD, 0)), rest, end)
    builder.position_at_end(rest)
    body(Lanes(builder, left), done)
    builder.branch(end)
    builder.position_at_end(end)


def blocks(builder: Any, count: Any, body: Any) -> None:
    """Emit a loop over blocks of eight: ``body(done, left)``, both int64, with ``left`` > 0."""
    zero, step = ir.Constant(WORD, 0), ir.Constant(WORD, LANES)
    entry = builder.block
    head, inside, after = (builder.append_basic_block(name) for name in ("head", "block", "after"))
    builder.branch(head)
    builder.position_at_end(head)
    done = builder.phi(WORD)
    done.add_incoming(zero, entry)
    builder.cbranch(builder.icmp_signed("<", done, count), inside, after)
    builder.position_at_end(inside)
    body(done, builder.sub(count, done))
    done.add_incoming(builder.add(done, step), builder.block)
    repeat(builder, head)
    builder.position_at_end(after)
