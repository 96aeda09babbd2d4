"""A row of numbers as one value in compiled functions: one instruction for several channels.

A compiler finds by itself that a loop over channels can be done at once, but not that what the loop
keeps from one sample to the next may stay in registers. A :class:`Lanes` value is such a row: it is
read from an array of shape (n, LANES), counted with by ``+``, ``-``, ``*``, ``/`` and the
functions here, and written back. Each lane is rounded as float64 is; products and sums are not
fused.
"""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.extending import intrinsic, lower_builtin, register_model
from numba.core.typing.templates import ConcreteTemplate, infer_global

if TYPE_CHECKING:
    from collections.abc import Callable

#: Numbers in a row.
LANES = 8

_INT = ir.IntType(32)
_ROW = ir.VectorType(ir.DoubleType(), LANES)


class Lanes(types.Type):
    """The type of a row of numbers."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


_lanes = Lanes()


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _ROW)


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Return the address of a row of an array that is contiguous."""
    data = context.make_array(array_type)(context, builder, array).data
    start = builder.mul(index, ir.Constant(index.type, LANES))
    return builder.bitcast(builder.gep(data, [start]), _ROW.as_pointer())


def _row(typing: Any, array: Any, index: Any) -> Any:  # noqa: ARG001
    """Return row ``index`` of an array of shape (n, LANES)."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        address = _address(context, builder, signature.args[0], *given)
        return builder.load(address, align=8)

    return _lanes(array, types.intp), generate


def _column(typing: Any, array: Any, first: Any, index: Any) -> Any:  # noqa: ARG001
    """Return element ``index`` of LANES successive rows of an array of shape (rows, n).

    Of an array with fewer rows the last one stands for those that are not there. Integers become
    floating point all at once.
    """

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        kind = signature.args[0]
        view = context.make_array(kind)(context, builder, given[0])
        rows, columns = cgutils.unpack_tuple(builder, view.shape, 2)
        last = builder.sub(rows, ir.Constant(rows.type, 1))
        found = ir.Constant(ir.VectorType(view.data.type.pointee, LANES), ir.Undefined)
        for lane in range(LANES):
            wanted = builder.add(given[1], ir.Constant(rows.type, lane))
            there = builder.icmp_signed("<", wanted, last)
            place = builder.mul(builder.select(there, wanted, last), columns)
            sample = builder.load(builder.gep(view.data, [builder.add(place, given[2])]))
            found = builder.insert_element(found, sample, ir.Constant(_INT, lane))
        signed = getattr(kind.dtype, "signed", None)
        if signed is not None:
            return (builder.sitofp if signed else builder.uitofp)(found, _ROW)
        return found if kind.dtype == types.float64 else builder.fpext(found, _ROW)

    return _lanes(array, types.intp, types.intp), generate


def _put_row(typing: Any, array: Any, index: Any, value: Any) -> Any:  # noqa: ARG001
    """Write a row of an array of shape (n, LANES)."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        address = _address(context, builder, signature.args[0], *given[:2])
        builder.store(given[2], address, align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, _lanes), generate


def _every(typing: Any, value: Any) -> Any:  # noqa: ARG001
    """Return a row that has one number in every lane."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        nothing = ir.Constant(_ROW, ir.Undefined)
        one = builder.insert_element(nothing, given[0], ir.Constant(_INT, 0))
        first = ir.Constant(ir.VectorType(_INT, LANES), [0] * LANES)
        return builder.shuffle_vector(one, nothing, first)

    return _lanes(types.float64), generate


def _of_two(emit: Callable[[Any, Any, Any], Any]) -> Any:
    """Return a function of two rows that emits one instruction."""

    def function(typing: Any, one: Any, other: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
            return emit(builder, *given)

        return _lanes(_lanes, _lanes), generate

    return intrinsic(function)


def _greater(builder: Any, one: Any, other: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", one, other), one, other)


def _lesser(builder: Any, one: Any, other: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", one, other), one, other)


#: Row of an array of shape (n, LANES); write one; an element of successive rows; one number in
#: every lane; the natural logarithm.
row: Any = intrinsic(_row)
put_row: Any = intrinsic(_put_row)
column: Any = intrinsic(_column)
every: Any = intrinsic(_every)
#: The greater, the lesser of two rows, lane by lane; of numbers that cannot be compared the second.
greater, lesser = _of_two(_greater), _of_two(_lesser)

#: Coefficients of the series of log((1 + s) / (1 - s)) in s squared, and log 2 in two parts.
_SERIES = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
    1.818357216161805012e-01,
    1.531383769920937332e-01,
    1.479819860511658591e-01,
)
_LOG_2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)


def _logarithm(typing: Any, value: Any) -> Any:  # noqa: ARG001
    """Return the natural logarithm of a row of numbers of at least 1e-300, to the last digit or so.

    Source: the method and coefficients of ``log`` in FDLIBM (Sun Microsystems 1993).
    """

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        b, whole = builder, ir.VectorType(ir.IntType(64), LANES)

        def number(x: float) -> Any:
            return ir.Constant(_ROW, [x] * LANES)

        def bits(x: int) -> Any:
            return ir.Constant(whole, [x] * LANES)

        stored = b.bitcast(given[0], whole)
        power = b.sub(b.lshr(stored, bits(52)), bits(1023))
        fraction = b.or_(b.and_(stored, bits((1 << 52) - 1)), bits(1023 << 52))
        mantissa = b.bitcast(fraction, _ROW)
        large = b.fcmp_ordered(">", mantissa, number(2.0**0.5))
        mantissa = b.select(large, b.fmul(mantissa, number(0.5)), mantissa)
        power = b.select(large, b.add(power, bits(1)), power)
        exponent = b.sitofp(b.trunc(power, ir.VectorType(_INT, LANES)), _ROW)
        f = b.fsub(mantissa, number(1.0))
        s = b.fdiv(f, b.fadd(f, number(2.0)))
        z = b.fmul(s, s)
        series = number(_SERIES[-1])
        for coefficient in reversed(_SERIES[:-1]):
            series = b.fadd(b.fmul(series, z), number(coefficient))
        half = b.fmul(b.fmul(f, f), number(0.5))
        rest = b.fmul(s, b.fadd(half, b.fmul(z, series)))
        small = b.fadd(rest, b.fmul(exponent, number(_LOG_2[1])))
        return b.fsub(b.fmul(exponent, number(_LOG_2[0])), b.fsub(b.fsub(half, small), f))

    return _lanes(_lanes), generate


logarithm: Any = intrinsic(_logarithm)


def _operate(operation: Any, instruction: str) -> None:
    """Let compiled functions write an operation on two rows as Python does."""
    template: Any = type("Rows", (ConcreteTemplate,), {"cases": (_lanes(_lanes, _lanes),)})

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        return getattr(builder, instruction)(*given)

    infer_global(operation)(template)
    lower_builtin(operation, Lanes, Lanes)(generate)


_operate(operator.add, "fadd")
_operate(operator.sub, "fsub")
_operate(operator.mul, "fmul")
_operate(operator.truediv, "fdiv")
