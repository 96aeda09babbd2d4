"""Integers as planes of bytes: what compresses best of samples, and fastest.

A sample is ``sum(digit[k] * 256**k)``, modulo its range, with signed digits of one byte. The lowest
digits of all samples come first, then the next ones: a quiet signal's upper planes are zeros, where
two's complement has 0x00 and 0xff in turn between bytes of noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def to_planes(values: NDArray[np.signedinteger[Any]]) -> bytes:
    """Return integers as planes, their first axis first, in ``values.nbytes`` bytes."""
    left, planes = values, []
    for _ in range(values.dtype.itemsize):
        digits = left.astype(np.int8)
        planes.append(digits.tobytes())
        left = (left - digits) >> 8
    return b"".join(planes)


def from_planes(data: bytes | bytearray | memoryview, out: NDArray[np.signedinteger[Any]]) -> None:
    """Put the integers of ``out.nbytes`` bytes of planes into ``out``."""
    lowest, *upper = np.frombuffer(data, np.int8).reshape(out.dtype.itemsize, *out.shape)
    # the upper digits of quiet samples are all zeros; numpy is fastest in arrays of one type
    parts = [
        np.multiply(d.astype(out.dtype), out.dtype.type(1 << 8 * k))
        for k, d in enumerate(upper, start=1)
        if np.count_nonzero(d)
    ]
    if not parts:
        out[...] = lowest
        return
    np.add(sum(parts[1:], parts[0]), lowest.astype(out.dtype), out=out)
