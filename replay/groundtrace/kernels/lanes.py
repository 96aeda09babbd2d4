"""A row of numbers as one value in compiled functions: one instruction for several channels.

A compiler finds by itself that a loop over channels can be done at once, but not that what the loop
keeps from one sample to the next may stay in registers. A :class:`Lanes` value is such a row: it is
read from an array of shape (n, LANES), or (n, LANES_32) of float32, computed with by ``+``, ``-``,
``*``, ``/`` and the functions here, and written back. Each lane is rounded as its type is; products
and sums are not fused, except by ``multiply_add``.
"""

from __future__ import annotations

import operator
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.extending import intrinsic, lower_builtin, register_model
from numba.core.typing.templates import ConcreteTemplate, infer_global

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Numbers in a row, of float64 and of float32: as many bytes.
LANES, LANES_32 = 8, 16

_INT = ir.IntType(32)
_ROW = ir.VectorType(ir.DoubleType(), LANES)


def zero_rows(*shape: int) -> NDArray[np.float64]:
    """Return zeros of shape (..., LANES), no row of which lies in two lines of the cache."""
    size = prod(shape) * LANES
    whole = np.zeros(size + LANES)
    begin = -whole.__array_interface__["data"][0] // whole.itemsize % LANES
    return whole[begin : begin + size].reshape(*shape, LANES)


def in_lanes(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return numbers, shape (n,), as rows of shape (-(-n // LANES), 1, LANES), filled up by 0."""
    rows = zero_rows(-(-len(values) // LANES), 1)
    rows.ravel()[: len(values)] = values
    return rows


class Lanes(types.Type):
    """The type of a row of numbers: of float64, of float32, or as samples are stored."""

    def __init__(self, number: Any, width: int) -> None:
        super().__init__(name=f"Lanes({number}, {width})")
        self.number = number
        self.vector = ir.VectorType(_NUMBERS.get(number) or ir.IntType(number.bitwidth), width)


_NUMBERS = {types.float64: ir.DoubleType(), types.float32: ir.FloatType()}
#: The type of a row of float64.
ROWS = _lanes = Lanes(types.float64, LANES)
_lanes_32 = Lanes(types.float32, LANES_32)


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


def _kind(number: Any) -> Lanes:
    """Return the type of rows of such numbers."""
    return _lanes if number == types.float64 else _lanes_32


def _address(context: Any, builder: Any, array_type: Any, array: Any, first: Any) -> Any:
    """Return the address of the row that begins with an element of an array that is contiguous."""
    data = context.make_array(array_type)(context, builder, array).data
    vector = _kind(array_type.dtype).vector
    return builder.bitcast(builder.gep(data, [first]), vector.as_pointer())


def _begin(builder: Any, array_type: Any, index: Any) -> Any:
    """Return the first element of row ``index``."""
    return builder.mul(index, ir.Constant(index.type, _kind(array_type.dtype).vector.count))


def _row(typing: Any, array: Any, index: Any) -> Any:  # noqa: ARG001
    """Return row ``index`` of an array of shape (n, LANES)."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        first = _begin(builder, signature.args[0], given[1])
        return builder.load(_address(context, builder, signature.args[0], given[0], first), align=4)

    return _kind(array.dtype)(array, types.intp), generate


def _row_from(typing: Any, array: Any, first: Any) -> Any:  # noqa: ARG001
    """Return the row that begins with element ``first`` of an array, rows counted through."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.load(_address(context, builder, signature.args[0], *given), align=4)

    return _kind(array.dtype)(array, types.intp), generate


def _stored_row(typing: Any, array: Any, index: Any) -> Any:  # noqa: ARG001
    """Return row ``index`` of an array of shape (n, LANES), of any type of numbers."""
    kind = Lanes(array.dtype, LANES)

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, given[0]).data
        first = builder.mul(given[1], ir.Constant(given[1].type, LANES))
        address = builder.bitcast(builder.gep(data, [first]), kind.vector.as_pointer())
        return builder.load(address, align=1)

    return kind(array, types.intp), generate


def _floating(typing: Any, value: Any) -> Any:  # noqa: ARG001
    """Return a row of any type of LANES numbers as one of float64."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        signed = getattr(value.number, "signed", None)
        if signed is not None:
            return (builder.sitofp if signed else builder.uitofp)(given[0], _ROW)
        return given[0] if value == _lanes else builder.fpext(given[0], _ROW)

    return _lanes(value), generate


def _put_row(typing: Any, array: Any, index: Any, value: Any) -> Any:  # noqa: ARG001
    """Write a row of an array of shape (n, LANES)."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        first = _begin(builder, signature.args[0], given[1])
        address = _address(context, builder, signature.args[0], given[0], first)
        builder.store(given[2], address, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, _kind(array.dtype)), generate


def _every(typing: Any, value: Any) -> Any:  # noqa: ARG001
    """Return a row that has one number in every lane."""
    number = types.float32 if value == types.float32 else types.float64
    kind = _kind(number)

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        nothing = ir.Constant(kind.vector, ir.Undefined)
        one = builder.insert_element(nothing, given[0], ir.Constant(_INT, 0))
        width = kind.vector.count
        first = ir.Constant(ir.VectorType(_INT, width), [0] * width)
        return builder.shuffle_vector(one, nothing, first)

    return kind(number), generate


def _size(builder: Any, value: Any) -> Any:
    whole = ir.VectorType(ir.IntType(64), LANES)
    unsigned = ir.Constant(whole, [(1 << 63) - 1] * LANES)
    return builder.bitcast(builder.and_(builder.bitcast(value, whole), unsigned), _ROW)


def _absolute(typing: Any, value: Any) -> Any:  # noqa: ARG001
    """Return the absolute values of a row."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        return _size(builder, given[0])

    return _lanes(_lanes), generate


def _chosen(ordering: str) -> Any:
    """Return a function of two rows that takes the first where it compares so with the second."""

    def function(typing: Any, one: Any, other: Any) -> Any:  # noqa: ARG001
        signed = getattr(one.number, "signed", None)

        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
            compare = {None: "fcmp_ordered", True: "icmp_signed", False: "icmp_unsigned"}[signed]
            return builder.select(getattr(builder, compare)(ordering, *given), *given)

        return one(one, one), generate

    return intrinsic(function)


def _multiply_add(typing: Any, one: Any, other: Any, more: Any) -> Any:  # noqa: ARG001
    """Return the product of two rows and a third, fused where the machine can."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        vector = more.vector
        name = f"llvm.fmuladd.v{vector.count}f{more.number.bitwidth}"
        kind = ir.FunctionType(vector, [vector] * 3)
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), given)

    return more(one, other, more), generate


def _cut_off(typing: Any, one: Any, other: Any) -> Any:  # noqa: ARG001
    """Return the first of two rows, but nothing where it is of less size than the second."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        small = builder.fcmp_ordered("<", _size(builder, given[0]), given[1])
        return builder.select(small, ir.Constant(_ROW, [0.0] * LANES), given[0])

    return _lanes(_lanes, _lanes), generate


#: Row of an array of shape (n, LANES), or from any element on; one of any type of numbers; write a
#: row; one number in every lane; a row as float64; absolute values, of float64.
row: Any = intrinsic(_row)
row_from: Any = intrinsic(_row_from)
stored_row: Any = intrinsic(_stored_row)
put_row: Any = intrinsic(_put_row)
every: Any = intrinsic(_every)
floating: Any = intrinsic(_floating)
absolute: Any = intrinsic(_absolute)
#: The product of two rows, and a third; fused where the machine can.
multiply_add: Any = intrinsic(_multiply_add)
#: The greater, the lesser of two rows, lane by lane; of numbers that cannot be compared the second.
greater, lesser = _chosen(">"), _chosen("<")
#: The first of two rows, but nothing where it is of less size than the second.
cut_off: Any = intrinsic(_cut_off)


def _operate(operation: Any, instruction: str) -> None:
    """Let compiled functions write an operation on two rows as Python does."""
    cases = tuple(kind(kind, kind) for kind in (_lanes, _lanes_32))
    template: Any = type("Rows", (ConcreteTemplate,), {"cases": cases})

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        return getattr(builder, instruction)(*given)

    infer_global(operation)(template)
    lower_builtin(operation, Lanes, Lanes)(generate)


_operate(operator.add, "fadd")
_operate(operator.sub, "fsub")
_operate(operator.mul, "fmul")
_operate(operator.truediv, "fdiv")
