"""The loops of arrival pickers, compiled: what is done with every sample and every cell.

Samples lie side by side in lanes, :data:`LANES` channels to a row, so that one instruction takes
several channels; a channel without samples is a lane of zeros. Every sum runs in the order of time,
whatever the blocks, so that parts give exactly what the whole gives.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..compiled import compiled
from ..lanes import LANES, column, every, greater, lesser, put_row, row

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Second-order sections of the band-pass; a filter with fewer is filled up by unit sections.
SECTIONS = 2
#: What an open cell holds of each lane: level, peak, power, highest, lowest sample.
OPEN = 5
#: A filter's memory below this is nothing: it would go on through numbers that are slow to count.
NOTHING = 1e-140


@compiled
def load(samples: NDArray[Any], scales: Array, first: int, start: int, rows: Array) -> None:
    """Put samples into rows, shape (n, LANES), scaled.

    Parameters
    ----------
    samples, scales
        Shape (n_channels, n_samples), of any type, and (n_channels,).
    first, start
        Channel of the first lane, sample of the first row.
    rows
        Where to.
    """
    for lane in range(min(LANES, len(samples) - first)):
        scale = scales[first + lane]
        for i in range(len(rows)):
            rows[i, lane] = samples[first + lane, start + i] * scale


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
def _gather(
    samples: NDArray[Any],
    scales: Array,
    first: int,
    rows: Array,
    start: int,
    stop: int,
    cell: Array,
) -> None:
    scale, high, low = row(scales, 0), row(cell, 3), row(cell, 4)
    for i in range(start, stop):
        x = column(samples, first, i) * scale
        high = greater(x, high)
        low = lesser(x, low)
        put_row(rows, i, x)
    put_row(cell, 3, high)
    put_row(cell, 4, low)


@compiled
def _filter(rows: Array, start: int, stop: int, sos: Array, memory: Array) -> None:
    """Filter rows in place: two sections, transposed direct form II, as scipy's ``sosfilt``.

    ``memory`` has shape (2 * SECTIONS, LANES).
    """
    b0, b1, b2 = every(sos[0, 0]), every(sos[0, 1]), every(sos[0, 2])
    d0, d1, d2 = every(sos[1, 0]), every(sos[1, 1]), every(sos[1, 2])
    a1, a2, e1, e2 = every(sos[0, 4]), every(sos[0, 5]), every(sos[1, 4]), every(sos[1, 5])
    p, q, r, s = row(memory, 0), row(memory, 1), row(memory, 2), row(memory, 3)
    for i in range(start, stop):
        x = row(rows, i)
        y = b0 * x + p
        p = b1 * x - a1 * y + q
        q = b2 * x - a2 * y
        z = d0 * y + r
        r = d1 * y - e1 * z + s
        s = d2 * y - e2 * z
        put_row(rows, i, z)
    put_row(memory, 0, p)
    put_row(memory, 1, q)
    put_row(memory, 2, r)
    put_row(memory, 3, s)


@compiled
def _take_variance(
    rows: Array, start: int, stop: int, alpha: float, mean: Array, cell: Array
) -> None:
    new, keep, nothing = every(alpha), every(1.0 - alpha), every(0.0)
    level, most, peak, total = row(mean, 0), row(cell, 0), row(cell, 1), row(cell, 2)
    for i in range(start, stop):
        x = row(rows, i)
        power = x * x
        level = new * power + keep * level
        most = greater(level, most)
        peak = greater(greater(x, nothing - x), peak)
        total = total + power
    put_row(mean, 0, level)
    put_row(cell, 0, most)
    put_row(cell, 1, peak)
    put_row(cell, 2, total)


@compiled
def _flush(values: Array) -> None:
    for k in range(len(values)):
        for lane in range(LANES):
            if abs(values[k, lane]) < NOTHING:
                values[k, lane] = 0.0


@compiled
def _close_cell(cell: Array, length: int, cells: Array, index: int) -> None:
    for lane in range(cells.shape[1]):
        for k in range(OPEN):
            cells[k, lane, index] = cell[k, lane]
        cells[2, lane, index] /= length
    empty_cell(cell)


@compiled
def variance_cells(
    samples: NDArray[Any],
    scales: Array,
    first: int,
    rows: Array,
    sos: Array,
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
    sos, memory
        Shape (SECTIONS, 6) and (2 * SECTIONS, LANES): the filter.
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
    index, start = 0, 0
    while start < len(rows):
        stop = min(len(rows), start + length - filled)
        _gather(samples, scales, first, rows, start, stop, cell)
        _filter(rows, start, stop, sos, memory)
        _take_variance(rows, start, stop, alpha, mean, cell)
        filled += stop - start
        start = stop
        if filled == length:
            _close_cell(cell, length, cells, index)
            _flush(memory)
            _flush(mean)
            put_row(at_cell, 0, row(mean, 0))
            index += 1
            filled = 0


@compiled
def _take_level(filtered: Array, level: Array, start: int, stop: int, cell: Array) -> None:
    nothing = every(0.0)
    most, peak, total = row(cell, 0), row(cell, 1), row(cell, 2)
    for i in range(start, stop):
        x = row(filtered, i)
        most = greater(row(level, i), most)
        peak = greater(greater(x, nothing - x), peak)
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
