"""Rows of LANES numbers as vectors that remain in the processor's registers during sums.

For rows by index the compiler cannot exclude overlap. It checks each row and writes a sum back after each
product. In LLVM's intermediate language, as in :mod:`atomic`, contractions are twice as fast.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils

from protochain.energies.native.atomic import intrinsic

LANES = 16
"""Numbers in a row, one per far node. With twice as many, rows of order 6 would need twice the first cache
and be full less often."""
_ROW = ir.VectorType(ir.DoubleType(), LANES)
_FAST = ("contract",)


def _row(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    start = builder.mul(index, ir.Constant(ir.IntType(64), LANES))
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [start]), _ROW.as_pointer())


@intrinsic
def put_product(
    typing: Any, rows: Any, to: Any, one: Any, axes: Any, axis: Any, factor: Any, two: Any
) -> Any:
    """Set rows[to] to axes[axis] * rows[one] + factor * rows[two], of arrays (n, LANES)."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def row(place: int, index: int) -> Any:
            return _row(context, builder, signature.args[place], args[place], args[index])

        along, first, second = (builder.load(row(*operand), align=8) for operand in ((3, 4), (0, 2), (0, 6)))
        zero = ir.Constant(ir.IntType(32), 0)
        lone = builder.insert_element(ir.Constant(_ROW, ir.Undefined), args[5], zero)
        same = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        factors = builder.shuffle_vector(lone, ir.Constant(_ROW, ir.Undefined), same)
        total = builder.fadd(
            builder.fmul(along, first, flags=_FAST), builder.fmul(factors, second, flags=_FAST), flags=_FAST
        )
        builder.store(total, row(0, 1), align=8)
        return context.get_dummy_value()

    n = types.int64
    return types.void(rows, n, n, axes, n, types.float64, n), code


@intrinsic
def add_products(
    typing: Any, sums: Any, to: Any, first: Any, second: Any, selection: Any, begin: Any, n: Any
) -> Any:
    """Add first[k] * second[selection[begin + k]], k < n, to sums[to], of arrays (., LANES) and (.,) int."""

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def row(place: int, index: Any) -> Any:
            return _row(context, builder, signature.args[place], args[place], index)

        to = row(0, args[1])
        total = cgutils.alloca_once(builder, _ROW)
        builder.store(builder.load(to, align=8), total)
        indices = context.make_array(signature.args[4])(context, builder, args[4]).data
        with cgutils.for_range(builder, args[6]) as loop:
            selected_row = builder.load(builder.gep(indices, [builder.add(args[5], loop.index)]))
            a, b = (builder.load(row(*operand), align=8) for operand in ((2, loop.index), (3, selected_row)))
            product = builder.fmul(a, b, flags=_FAST)
            builder.store(builder.fadd(builder.load(total), product, flags=_FAST), total)
        builder.store(builder.load(total), to, align=8)
        return context.get_dummy_value()

    count = types.int64
    return types.void(sums, count, first, second, selection, count, count), code
