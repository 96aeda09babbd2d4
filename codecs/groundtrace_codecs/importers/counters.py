"""Counters that begin again: of packets, of the ticks of a device's clock."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def unwrapped(
    counter: NDArray[np.int64], modulus: int, back: int | None = None
) -> NDArray[np.int64]:
    """Return a counter that begins again at ``modulus`` as one that goes on.

    Counts may come late or be missing: the shorter way round is taken, so that not more than
    half the modulus can be lost at once.

    Parameters
    ----------
    counter
        Shape (n,), each from 0 to ``modulus`` - 1.
    modulus
        Where the counter begins again.
    back
        How far back a count may lie at most, instead of half the modulus: the rest is forward.

    Examples
    --------
    >>> unwrapped(np.array([65534, 65535, 1, 0, 2]), 65536).tolist()
    [65534, 65535, 65537, 65536, 65538]
    """
    half = modulus // 2 if back is None else back
    steps = (np.diff(counter) + half) % modulus - half
    gone_on: NDArray[np.int64] = np.concatenate([counter[:1], counter[:1] + np.cumsum(steps)])
    return gone_on
