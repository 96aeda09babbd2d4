"""The loops of :mod:`.adaptive_band`, compiled: at every point the band of its own step time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled, in_place
from ..lanes import LANES
from .grid_kernels import TOGETHER, sums_together

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Places = NDArray[np.int64]


@in_place
def between(values: Array, place: float) -> float:
    """Return the value at a place, on the straight line between its neighbours."""
    low = int(place)
    if low >= len(values) - 1:
        return float(values[len(values) - 1])
    return float((values[low + 1] - values[low]) * (place - low) + values[low])


@in_place
def place_among(nodes: Array, value: float) -> float:
    """Return the place of a value among nodes that rise, at most that of the first and last."""
    last = len(nodes) - 1
    if not value > nodes[0]:
        return 0.0
    if value >= nodes[last]:
        return float(last)
    low = 0
    while nodes[low + 1] <= value:
        low += 1
    return float(1.0 / (nodes[low + 1] - nodes[low]) * (value - nodes[low]) + low)


@compiled
def step_bands(
    up: Array,
    kernels: Array,
    spans: Places,
    nodes: Array,
    hops: Array,
    start: int,
    hop: int,
    out: Array,
) -> None:
    """Filter points by their step time; ``out``, shape (5, n), takes what is known of each.

    Parameters
    ----------
    up
        Shape (n + taps - 1,): the signal from the oldest neighbour of the first point on.
    kernels, spans
        Weights of each node's band, and last those that rises are timed in, shape (nodes + 1,
        taps), and first and last that counts, (nodes + 1, 2).
    nodes
        Step times of the bands, shape (nodes,).
    hops
        Strength of the rhythm, step time and swing of the first point's hop and those after it,
        shape (3, m).
    start, hop
        Place of the first point in the run, and points from hop to hop.
    out
        Rows: band, rise, rhythm, step time, usual swing.
    """
    n, last = out.shape[1], len(nodes)
    line = np.zeros(len(up) + TOGETHER)
    line[: len(up)] = up
    sums, parts, lower = np.empty((last + 1, TOGETHER)), np.empty(TOGETHER), start // hop
    rows, below = sums.reshape(-1, LANES), np.empty(TOGETHER, np.int64)
    for at in range(0, n, TOGETHER):
        count, first, most = min(TOGETHER, n - at), last, 0
        for i in range(count):
            place = (start + at + i) / hop - lower
            for k in range(3):
                out[2 + k, at + i] = between(hops[k], place)
            node = place_among(nodes, out[3, at + i])
            below[i] = min(int(node), last - 2)
            parts[i] = node - below[i]
            first, most = min(first, below[i]), max(most, below[i])
        for node in range(first, most + 2):
            sums_together(line, at, kernels[node], (spans[node, 0], spans[node, 1]), rows, 4 * node)
        sums_together(line, at, kernels[last], (spans[last, 0], spans[last, 1]), rows, 4 * last)
        for i in range(count):
            low, high = sums[below[i], i], sums[below[i] + 1, i]
            out[0, at + i] = low * (1 - parts[i]) + high * parts[i]
            out[1, at + i] = sums[last, i]
