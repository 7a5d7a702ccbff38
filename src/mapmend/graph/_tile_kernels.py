"""The innermost product of the factorization, in vector registers.

For a sum of products, Numba relies on LLVM's vectorizers, which load and store every sum once for six products: 10 G
multiply-adds a second. Here the sums of a tile, some rows by three columns, stay in registers: 20 G on the same core.
The code uses LLVM's vector instructions, which LLVM translates to those of any machine.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

COLUMNS, VECTORS = 3, 3
TALL, SHORT = 24, 12
"""The rows of the tiles: three vectors of eight or of four."""


def subtract_tall(target, to, pitch, panel, p, q, step, columns):
    """``target[to + c * pitch + r] -= sum_k panel[p + k * step + r] * panel[q + k * step + c]`` for 24 r and 3 c."""
    _subtract(TALL, target, to, pitch, panel, p, q, step, columns)


def subtract_short(target, to, pitch, panel, p, q, step, columns):
    """The same for 12 rows."""
    _subtract(SHORT, target, to, pitch, panel, p, q, step, columns)


def _subtract(rows, target, to, pitch, panel, p, q, step, columns):
    """Stands for the two if nothing is compiled."""
    for c in range(COLUMNS):
        for r in range(rows):
            total = 0.0
            for k in range(int(columns)):
                total += panel[int(p + k * step) + r] * panel[int(q + k * step) + c]
            target[int(to + c * pitch) + r] -= total


def _tile(width: int) -> Any:
    """The same for vectors of that many numbers."""

    @intrinsic
    def tile(typing_context, target, to, pitch, panel, p, q, step, columns):
        signature = types.void(target, to, pitch, panel, p, q, step, columns)

        def generate(context, builder, signature, arguments):
            number, index = ir.DoubleType(), ir.IntType(64)
            vector, lanes = ir.VectorType(number, width), ir.VectorType(ir.IntType(32), width)
            multiply_add = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(vector, [vector] * 3), f"llvm.fmuladd.v{width}f64"
            )
            nothing = ir.Constant(vector, ir.Undefined)
            target, panel = (context.make_array(signature.args[k])(context, builder, arguments[k]).data for k in (0, 3))
            to, pitch, p, q, step, columns = (arguments[k] for k in (1, 2, 4, 5, 6, 7))

            def at(base, start, offset):
                pointer = builder.gep(base, [builder.add(start, ir.Constant(index, offset))])
                return builder.bitcast(pointer, vector.as_pointer())

            def load(pointer):
                loaded = builder.load(pointer)
                loaded.align = 8
                return loaded

            sums = [
                [cgutils.alloca_once_value(builder, ir.Constant(vector, [0.0] * width)) for _ in range(VECTORS)]
                for _ in range(COLUMNS)
            ]
            row, factor = cgutils.alloca_once_value(builder, p), cgutils.alloca_once_value(builder, q)
            with cgutils.for_range(builder, columns):
                a, b = builder.load(row), builder.load(factor)
                rows = [load(at(panel, a, v * width)) for v in range(VECTORS)]
                for c in range(COLUMNS):
                    single = builder.load(builder.gep(panel, [builder.add(b, ir.Constant(index, c))]))
                    single = builder.insert_element(nothing, single, ir.Constant(ir.IntType(32), 0))
                    repeated = builder.shuffle_vector(single, nothing, ir.Constant(lanes, [0] * width))
                    for v in range(VECTORS):
                        total = builder.call(multiply_add, [rows[v], repeated, builder.load(sums[c][v])])
                        builder.store(total, sums[c][v])
                builder.store(builder.add(a, step), row)
                builder.store(builder.add(b, step), factor)
            for c in range(COLUMNS):
                column = builder.add(to, builder.mul(pitch, ir.Constant(index, c)))
                for v in range(VECTORS):
                    pointer = at(target, column, v * width)
                    stored = builder.store(builder.fsub(load(pointer), builder.load(sums[c][v])), pointer)
                    stored.align = 8
            return context.get_dummy_value()

        return signature, generate

    return tile


_tall, _short = _tile(TALL // VECTORS), _tile(SHORT // VECTORS)


@overload(subtract_tall)
def _compiled_tall(target, to, pitch, panel, p, q, step, columns):
    def compiled(target, to, pitch, panel, p, q, step, columns):
        _tall(target, to, pitch, panel, p, q, step, columns)

    return compiled


@overload(subtract_short)
def _compiled_short(target, to, pitch, panel, p, q, step, columns):
    def compiled(target, to, pitch, panel, p, q, step, columns):
        _short(target, to, pitch, panel, p, q, step, columns)

    return compiled
