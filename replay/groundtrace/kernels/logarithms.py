"""Natural logarithms of rows of numbers, in compiled functions."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core.extending import intrinsic

from .lanes import LANES, ROWS

_INT, _ROW = ir.IntType(32), ROWS.vector

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
#: How far a rough logarithm lies below the true one at most.
ROUGHNESS = 0.0597


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

    return ROWS(ROWS), generate


def _rough_logarithm(typing: Any, value: Any) -> Any:  # noqa: ARG001
    """Return what lies below the natural logarithm by no more than ROUGHNESS, of the same numbers.

    The exponent of a number with its fraction behind it, as they are stored, lies by 0 to 0.0861
    below its logarithm to the base 2.
    """

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:  # noqa: ARG001
        whole, half = ir.VectorType(ir.IntType(64), LANES), ir.VectorType(_INT, LANES)
        stored = builder.lshr(builder.bitcast(given[0], whole), ir.Constant(whole, [32] * LANES))
        power = builder.sitofp(builder.trunc(stored, half), _ROW)
        unit, offset = sum(_LOG_2) / (1 << 20), 1023 * sum(_LOG_2) + 1e-6
        scaled = builder.fmul(power, ir.Constant(_ROW, [unit] * LANES))
        return builder.fsub(scaled, ir.Constant(_ROW, [offset] * LANES))

    return ROWS(ROWS), generate


logarithm: Any = intrinsic(_logarithm)
rough_logarithm: Any = intrinsic(_rough_logarithm)
