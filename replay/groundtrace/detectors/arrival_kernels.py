"""The loop of the picker by variance, compiled: what is done with every sample.

Samples lie in lanes as in :mod:`~groundtrace.detectors.open_cell_kernels`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..compiled import compiled, in_place
from ..lanes import (
    LANES,
    absolute,
    cut_off,
    every,
    floating,
    greater,
    put_row,
    row,
    stored_row,
)
from ..tiles import TILE
from .open_cell_kernels import OPEN, close_cell, load, put_cells, take_extremes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Second-order sections of the band-pass; a filter with fewer is filled up by unit sections.
SECTIONS = 2
#: Coefficients of that many sections, those that are 1 left out.
COEFFICIENTS = 5 * SECTIONS
#: Rows of samples that are put into lanes at once, and filtered while they are near in the caches.
PART = 128 * TILE
#: A filter's memory below this, at the end of a cell, is nothing: it would go on through numbers
#: that are slow to count.
NOTHING = 1e-140


@in_place
def spread(sos: Array, coefficients: Array) -> None:
    """Write the coefficients of two sections into rows, in the order in which they are needed."""
    order = ((0, 0), (0, 1), (0, 4), (0, 2), (0, 5), (1, 0), (1, 1), (1, 4), (1, 2), (1, 5))
    for k in range(len(order)):
        put_row(coefficients, k, every(sos[order[k]]))


@in_place
def _remembered(c: Array, k: int, x: Any, y: Any, later: Any) -> Any:
    """Return a section's memory after a sample that came in and went out; ``k`` is its first."""
    return row(c, k + 1) * x - row(c, k + 2) * y + later, row(c, k + 3) * x - row(c, k + 4) * y


@in_place
def _filter(
    recorded: NDArray[Any],
    scale: Any,
    rows: Array,
    start: int,
    stop: int,
    c: Array,
    memory: Array,
    least: float,
) -> None:
    """Scale and filter rows: two sections, transposed direct form II, as scipy's ``sosfilt``.

    The second section is a row behind the first: neither waits for the other. ``c`` are the
    coefficients as :func:`spread` has them, read again for each row: those that were kept would
    push the filter's memory out of the registers, and each row waits for that. ``memory`` has
    shape (2 * SECTIONS, LANES); what is below ``least`` then is nothing.
    """
    p, q, r, s = row(memory, 0), row(memory, 1), row(memory, 2), row(memory, 3)
    x = floating(stored_row(recorded, start)) * scale
    y = row(c, 0) * x + p
    for i in range(start + 1, stop):
        p, q = _remembered(c, 0, x, y, q)
        x = floating(stored_row(recorded, i)) * scale
        z = row(c, 5) * y + r
        r, s = _remembered(c, 5, y, z, s)
        put_row(rows, i - 1, z)
        y = row(c, 0) * x + p
    p, q = _remembered(c, 0, x, y, q)
    z = row(c, 5) * y + r
    r, s = _remembered(c, 5, y, z, s)
    put_row(rows, stop - 1, z)
    put_row(memory, 0, cut_off(p, every(least)))
    put_row(memory, 1, cut_off(q, every(least)))
    put_row(memory, 2, cut_off(r, every(least)))
    put_row(memory, 3, cut_off(s, every(least)))


@in_place
def _take_variance(
    rows: Array, start: int, stop: int, alpha: float, mean: Array, least: float, cell: Array
) -> None:
    new, keep = every(alpha), every(1.0 - alpha)
    level, most, peak, total = row(mean, 0), row(cell, 0), row(cell, 1), row(cell, 2)
    for i in range(start, stop):
        x = row(rows, i)
        power = x * x
        level = new * power + keep * level
        most = greater(level, most)
        peak = greater(absolute(x), peak)
        total = total + power
    put_row(mean, 0, cut_off(level, every(least)))
    put_row(cell, 0, most)
    put_row(cell, 1, peak)
    put_row(cell, 2, total)


@in_place
def _cells_of_lanes(
    samples: NDArray[Any],
    scales: Array,
    first: int,
    rows: Array,
    coefficients: Array,
    memory: Array,
    alpha: float,
    mean: Array,
    at_cell: Array,
    cell: Array,
    filled: int,
    length: int,
    cells: Array,
    recorded: NDArray[Any],
    closed: Array,
) -> None:
    """Do the work of :func:`variance_cells` for one group, ``first`` its first channel."""
    index, scale = 0, row(scales, 0)
    for begin in range(0, len(rows), PART):
        part = rows[begin : begin + PART]
        load(samples, first, begin, recorded[: len(part)])
        start = 0
        while start < len(part):
            stop = min(len(part), start + length - filled)
            filled += stop - start
            least = NOTHING if filled == length else 0.0
            take_extremes(recorded, start, stop, scale, cell)
            _filter(recorded, scale, part, start, stop, coefficients, memory, least)
            _take_variance(part, start, stop, alpha, mean, least, cell)
            start = stop
            if filled == length:
                index, filled = close_cell(cell, length, closed, first, cells, index), 0
                put_row(at_cell, 0, row(mean, 0))
    put_cells(closed, first, cells, index - index % TILE, index % TILE)


@compiled
def variance_cells(
    samples: NDArray[Any],
    scales: Array,
    rows: Array,
    coefficients: Array,
    memory: Array,
    alpha: float,
    mean: Array,
    at_cell: Array,
    cell: Array,
    filled: int,
    length: int,
    cells: Array,
) -> None:
    """Filter samples, average their square, reduce them to cells.

    Parameters
    ----------
    samples, scales
        Shape (n_channels, n), of any type, and (groups, 1, LANES): 0 for a lane without a channel.
    rows
        Shape (groups, n, LANES): gets the filtered samples.
    coefficients, memory
        As :func:`spread` has them, and of shape (groups, 2 * SECTIONS, LANES): the filter.
    alpha, mean
        Coefficient and state, shape (groups, 1, LANES), of the moving average.
    at_cell
        Shape (groups, 1, LANES): gets the moving average at the end of the last complete cell.
    cell, filled
        The open cells, shape (groups, OPEN, LANES), and how many samples they have.
    length
        Samples of a cell.
    cells
        Shape (OPEN, n_channels, n_cells): gets the cells.
    """
    recorded, closed = np.empty((PART, LANES), samples.dtype), np.empty((OPEN * TILE, LANES))
    for group in range(len(rows)):
        _cells_of_lanes(
            samples,
            scales[group],
            group * LANES,
            rows[group],
            coefficients,
            memory[group],
            alpha,
            mean[group],
            at_cell[group],
            cell[group],
            filled,
            length,
            cells,
            recorded,
            closed,
        )


@in_place
def variance_levels(rows: Array, alpha: float, before: Array, levels: Array) -> None:
    """Put the moving average of the square in ``levels``, as :func:`variance_cells` averages.

    Parameters
    ----------
    rows
        Shape (groups, n, LANES): filtered samples.
    alpha, before
        Coefficient, and the average before them, shape (groups, 1, LANES).
    levels
        Shape (n * groups, LANES): those of a sample together.
    """
    new, keep, groups = every(alpha), every(1.0 - alpha), len(rows)
    for group in range(groups):
        level = row(before[group], 0)
        for i in range(rows.shape[1]):
            x = row(rows[group], i)
            level = new * (x * x) + keep * level
            put_row(levels, i * groups + group, level)
