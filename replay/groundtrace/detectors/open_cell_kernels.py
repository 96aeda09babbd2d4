"""The loops of cells under way, compiled: samples in lanes, folded into a cell each millisecond.

Samples lie side by side in lanes, :data:`~groundtrace.lanes.LANES` channels to a row, so that one
instruction takes several channels; what a lane without a channel holds counts for nothing. Every
sum runs in the order of time, whatever the blocks, so that parts give exactly what the whole gives.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..compiled import compiled, in_place
from ..lanes import LANES, absolute, every, floating, greater, lesser, put_row, row, stored_row
from ..tiles import TILE, turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: What an open cell holds of each lane: level, peak, power, highest, lowest sample.
OPEN = 5


@in_place
def load(samples: NDArray[Any], first: int, start: int, rows: NDArray[Any]) -> None:
    """Put samples into rows, shape (n, LANES).

    Parameters
    ----------
    samples
        Shape (n_channels, n_samples), of any type.
    first, start
        Channel of the first lane, sample of the first row.
    rows
        Where to, of the same type; a lane without a channel gets the samples of the last one.
    """
    channels, n = samples.shape
    turned = len(rows) - len(rows) % TILE if first + LANES <= channels else 0
    for i in range(0, turned, TILE):
        turn(samples, first * n + start + i, n, rows, i * LANES, LANES)
    for lane in range(LANES):
        own = samples[min(first + lane, channels - 1)]
        for i in range(turned, len(rows)):
            rows[i, lane] = own[start + i]


@in_place
def empty_cell(cell: Array) -> None:
    """Begin an open cell, shape (OPEN, LANES)."""
    put_row(cell, 0, every(-np.inf))
    put_row(cell, 1, every(0.0))
    put_row(cell, 2, every(0.0))
    put_row(cell, 3, every(-np.inf))
    put_row(cell, 4, every(np.inf))


@in_place
def take_extremes(recorded: NDArray[Any], start: int, stop: int, scale: Any, cell: Array) -> None:
    """Take the extremes of rows; ``scale`` is a row that they are multiplied by."""
    most, least = row(cell, 3), row(cell, 4)
    high = low = stored_row(recorded, start)
    for i in range(start + 1, stop):
        x = stored_row(recorded, i)
        high = greater(x, high)
        low = lesser(x, low)
    one, other = floating(high) * scale, floating(low) * scale  # the scale may be negative
    put_row(cell, 3, greater(greater(one, other), most))
    put_row(cell, 4, lesser(lesser(one, other), least))


@in_place
def put_cells(closed: Array, first: int, cells: Array, index: int, count: int) -> None:
    """Put closed cells to those of their channels, from ``index`` on; ``first`` is a channel."""
    _, channels, n = cells.shape
    whole = count == TILE and first + LANES <= channels
    for k in range(OPEN):
        if whole:
            turn(closed, k * TILE * LANES, LANES, cells, (k * channels + first) * n + index, n)
            continue
        for lane in range(min(LANES, channels - first)):
            for i in range(count):
                cells[k, first + lane, index + i] = closed[k * TILE + i, lane]


@in_place
def close_cell(
    cell: Array, length: int, closed: Array, first: int, cells: Array, index: int
) -> int:
    """Put the open cell among the closed ones, shape (OPEN * TILE, LANES), and begin the next.

    ``index`` is its place; return that of the next. What is closed goes to ``cells`` by the tile.
    """
    put_row(cell, 2, row(cell, 2) / every(length * 1.0))
    for k in range(OPEN):
        put_row(closed, k * TILE + index % TILE, row(cell, k))
    empty_cell(cell)
    if (index + 1) % TILE == 0:
        put_cells(closed, first, cells, index + 1 - TILE, TILE)
    return index + 1


@in_place
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
    first: int,
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
    first, cell, filled, length, cells
        Channel of the first lane; the open cell, shape (OPEN, LANES), and how many samples it has;
        samples of a cell; shape (OPEN, n_channels, n_cells): gets the cells of these lanes.
    """
    index, start, closed = 0, 0, np.empty((OPEN * TILE, LANES))
    while start < len(recorded):
        stop = min(len(recorded), start + length - filled)
        take_extremes(recorded, start, stop, every(1.0), cell)
        _take_level(filtered, level, start, stop, cell)
        filled += stop - start
        start = stop
        if filled == length:
            index, filled = close_cell(cell, length, closed, first, cells, index), 0
    put_cells(closed, first, cells, index - index % TILE, index % TILE)
