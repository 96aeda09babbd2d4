"""The loops of arrival pickers, compiled: what is done with every sample and every cell.

Samples lie side by side in lanes, :data:`LANES` channels to a row, so that one instruction takes
several channels; what a lane without a channel holds counts for nothing. Every sum runs in the
order of time, whatever the blocks, so that parts give exactly what the whole gives.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..compiled import compiled
from ..lanes import LANES, absolute, column, cut_off, every, greater, lesser, put_row, row
from ..tiles import TILE, turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Second-order sections of the band-pass; a filter with fewer is filled up by unit sections.
SECTIONS = 2
#: Coefficients of that many sections, those that are 1 left out.
COEFFICIENTS = 5 * SECTIONS
#: Rows of scaled samples that are filtered while they are in the nearest cache.
PART = 16 * TILE
#: What an open cell holds of each lane: level, peak, power, highest, lowest sample.
OPEN = 5
#: A filter's memory below this, at the end of a cell, is nothing: it would go on through numbers
#: that are slow to count.
NOTHING = 1e-140


@compiled
def load(samples: NDArray[Any], first: int, start: int, rows: Array) -> None:
    """Put samples into rows, shape (n, LANES).

    Parameters
    ----------
    samples
        Shape (n_channels, n_samples), of any type.
    first, start
        Channel of the first lane, sample of the first row.
    rows
        Where to; a lane without a channel gets the samples of the last one.
    """
    channels, n = samples.shape
    turned = len(rows) - len(rows) % TILE if first + LANES <= channels else 0
    for i in range(0, turned, TILE):
        turn(samples, first * n + start + i, n, rows, i * LANES, LANES)
    for i in range(turned, len(rows)):
        put_row(rows, i, column(samples, first, start + i))


@compiled
def empty_cell(cell: Array) -> None:
    """Begin an open cell, shape (OPEN, LANES)."""
    put_row(cell, 0, every(-np.inf))
    put_row(cell, 1, every(0.0))
    put_row(cell, 2, every(0.0))
    put_row(cell, 3, every(-np.inf))
    put_row(cell, 4, every(np.inf))


@compiled
def _take_extremes(rows: Array, start: int, stop: int, cell: Array) -> None:
    high, low = row(cell, 3), row(cell, 4)
    for i in range(start, stop):
        x = row(rows, i)
        high = greater(x, high)
        low = lesser(x, low)
    put_row(cell, 3, high)
    put_row(cell, 4, low)


@compiled
def spread(sos: Array, coefficients: Array) -> None:
    """Write the coefficients of two sections into rows, in the order in which they are needed."""
    order = ((0, 0), (0, 1), (0, 4), (0, 2), (0, 5), (1, 0), (1, 1), (1, 4), (1, 2), (1, 5))
    for k in range(len(order)):
        put_row(coefficients, k, every(sos[order[k]]))


@compiled
def _filter(
    recorded: Array,
    scales: Array,
    rows: Array,
    start: int,
    stop: int,
    c: Array,
    memory: Array,
    least: float,
    cell: Array,
) -> None:
    """Scale and filter rows: two sections, transposed direct form II, as scipy's ``sosfilt``.

    ``c`` are the coefficients as :func:`spread` has them, read again for each row: those that were
    kept would push the filter's memory out of the registers, and each row waits for that.
    ``memory`` has shape (2 * SECTIONS, LANES); what is below ``least`` then is nothing.
    """
    p, q, r, s = row(memory, 0), row(memory, 1), row(memory, 2), row(memory, 3)
    high, low = row(cell, 3), row(cell, 4)
    for i in range(start, stop):
        x = row(recorded, i) * row(scales, 0)
        high = greater(x, high)
        low = lesser(x, low)
        y = row(c, 0) * x + p
        p = row(c, 1) * x - row(c, 2) * y + q
        q = row(c, 3) * x - row(c, 4) * y
        z = row(c, 5) * y + r
        r = row(c, 6) * y - row(c, 7) * z + s
        s = row(c, 8) * y - row(c, 9) * z
        put_row(rows, i, z)
    put_row(cell, 3, high)
    put_row(cell, 4, low)
    put_row(memory, 0, cut_off(p, every(least)))
    put_row(memory, 1, cut_off(q, every(least)))
    put_row(memory, 2, cut_off(r, every(least)))
    put_row(memory, 3, cut_off(s, every(least)))


@compiled
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


@compiled
def _close_cell(cell: Array, length: int, cells: Array, index: int) -> None:
    put_row(cell, 2, row(cell, 2) / every(length * 1.0))
    for k in range(OPEN):
        for lane in range(cells.shape[1]):
            cells[k, lane, index] = cell[k, lane]
    empty_cell(cell)


@compiled
def variance_cells(
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
) -> None:
    """Filter samples, average their square, reduce them to cells.

    Parameters
    ----------
    samples, scales
        Shape (n_channels, n), of any type, and (1, LANES): 0 for a lane without a channel.
    first
        Channel of the first lane.
    rows
        Shape (n, LANES): gets the filtered samples.
    coefficients, memory
        As :func:`spread` has them, and of shape (2 * SECTIONS, LANES): the filter.
    alpha, mean
        Coefficient and state, shape (1, LANES), of the moving average.
    at_cell
        Shape (1, LANES): gets the moving average at the end of the last complete cell.
    cell, filled
        The open cell, shape (OPEN, LANES), and how many samples it has.
    length
        Samples of a cell.
    cells
        Shape (OPEN, lanes in use, n_cells): gets the cells.
    """
    index, recorded = 0, np.empty((PART, LANES))
    for begin in range(0, len(rows), PART):
        part = rows[begin : begin + PART]
        load(samples, first, begin, recorded[: len(part)])
        start = 0
        while start < len(part):
            stop = min(len(part), start + length - filled)
            filled += stop - start
            least = NOTHING if filled == length else 0.0
            _filter(recorded, scales, part, start, stop, coefficients, memory, least, cell)
            _take_variance(part, start, stop, alpha, mean, least, cell)
            start = stop
            if filled == length:
                _close_cell(cell, length, cells, index)
                put_row(at_cell, 0, row(mean, 0))
                index += 1
                filled = 0


@compiled
def _take_level(filtered: Array, level: Array, start: int, stop: int, cell: Array) -> None:
    most, peak, total = row(cell, 0), row(cell, 1), row(cell, 2)
    for i in range(start, stop):
        x = row(filtered, i)
        most = greater(row(level, i), most)
        peak = greater(absolute(x), peak)
        total = total + x * x
    put_row(cell, 0, most)
    put_row(cell, 1, peak)
    put_row(cell, 2, total)


@compiled
def reduce_cells(
    recorded: Array,
    filtered: Array,
    level: Array,
    cell: Array,
    filled: int,
    length: int,
    cells: Array,
) -> None:
    """Reduce samples to cells where the level of the decision function is known already.

    Parameters
    ----------
    recorded, filtered, level
        Shape (n, LANES).
    cell, filled, length, cells
        As :func:`variance_cells` takes them.
    """
    index, start = 0, 0
    while start < len(recorded):
        stop = min(len(recorded), start + length - filled)
        _take_extremes(recorded, start, stop, cell)
        _take_level(filtered, level, start, stop, cell)
        filled += stop - start
        start = stop
        if filled == length:
            _close_cell(cell, length, cells, index)
            index += 1
            filled = 0
