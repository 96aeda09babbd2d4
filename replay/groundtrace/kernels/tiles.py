"""Transposition of square tiles of numbers, in compiled functions.

Read along and written across one number at a time, each costs some cycles; a square of eight by
eight in registers takes three steps that exchange halves.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.extending import intrinsic

#: Rows and columns of a square.
TILE = 8

_INT = ir.IntType(32)


def _exchanged(builder: Any, one: Any, other: Any, step: int) -> tuple[Any, Any]:
    """Return two rows that have exchanged the numbers whose places differ by ``step``."""
    places = range(TILE)
    first = [TILE + (i ^ step) if i & step else i for i in places]
    second = [TILE + i if i & step else i | step for i in places]
    chosen = (ir.Constant(ir.VectorType(_INT, TILE), which) for which in (first, second))
    low, high = (builder.shuffle_vector(one, other, which) for which in chosen)
    return low, high


def _converted(builder: Any, numbers: Any, given: Any, wanted: Any) -> Any:
    """Return numbers of one type as those of the same or a floating one."""
    if given == wanted:
        return numbers
    kind = ir.VectorType(ir.DoubleType() if wanted == types.float64 else ir.FloatType(), TILE)
    signed = getattr(given, "signed", None)
    if signed is not None:
        return (builder.sitofp if signed else builder.uitofp)(numbers, kind)
    return (builder.fpext if given.bitwidth < wanted.bitwidth else builder.fptrunc)(numbers, kind)


def _address(builder: Any, data: Any, at: Any, stride: Any, index: int) -> Any:
    """Return where a run of TILE numbers begins, ``index`` strides behind ``at``."""
    far = builder.add(at, builder.mul(stride, ir.Constant(stride.type, index)))
    run = ir.VectorType(data.type.pointee, TILE)
    return builder.bitcast(builder.gep(data, [far]), run.as_pointer())


def _turn(
    typing: Any,  # noqa: ARG001
    source: Any,
    first: Any,  # noqa: ARG001
    apart: Any,  # noqa: ARG001
    target: Any,
    place: Any,  # noqa: ARG001
    wide: Any,  # noqa: ARG001
) -> Any:
    """Write TILE runs of TILE numbers as columns.

    Run ``i`` begins with element ``first + i * apart`` of the source; its number ``j`` becomes
    element ``place + j * wide + i`` of the target, of its type. Both are contiguous.
    """

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        sent, got = signature.args[0], signature.args[3]
        begin = context.make_array(sent)(context, builder, given[0]).data
        end = context.make_array(got)(context, builder, given[3]).data
        places = [_address(builder, begin, given[1], given[2], i) for i in range(TILE)]
        rows = [builder.load(place, align=1) for place in places]
        for step in (1, 2, 4):
            for i in (i for i in range(TILE) if not i & step):
                rows[i], rows[i | step] = _exchanged(builder, rows[i], rows[i | step], step)
        for i, numbers in enumerate(rows):
            written = _converted(builder, numbers, sent.dtype, got.dtype)
            place = _address(builder, end, given[4], given[5], i)
            builder.store(written, place, align=1)
        return context.get_dummy_value()

    index = types.intp
    return types.void(source, index, index, target, index, index), generate


#: ``turn(source, first, apart, target, place, wide)``: write TILE runs of numbers as columns.
turn: Any = intrinsic(_turn)
