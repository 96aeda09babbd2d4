"""Integers as planes of bytes: what compresses best of samples, and fastest.

A sample is ``sum(digit[k] * 256**k)``, modulo its range, with signed digits of one byte. The lowest
digits of all samples come first, then the next ones, as far as there are any: a quiet signal takes
one byte a sample, where two's complement has 0x00 and 0xff in turn between bytes of noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def to_planes(values: NDArray[np.signedinteger[Any]]) -> bytes:
    """Return integers as planes, at least one, their first axis first."""
    left, planes = values, []
    for _ in range(values.dtype.itemsize):
        digits = left.astype(np.int8)
        planes.append(digits.tobytes())
        left = (left - digits) >> 8
        if not left.any():
            break
    return b"".join(planes)


def from_planes(data: bytes | bytearray | memoryview, out: NDArray[np.signedinteger[Any]]) -> None:
    """Put integers into ``out``, of at most as many planes as one of them has bytes."""
    planes = np.frombuffer(data, np.int8).reshape(-1, *out.shape)
    out[...] = planes[0]
    for k in range(1, len(planes)):
        out += planes[k].astype(out.dtype) * out.dtype.type(1 << 8 * k)
