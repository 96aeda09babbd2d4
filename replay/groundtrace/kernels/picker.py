"""The loops of arrival pickers, compiled: filters, cells, frames, gates.

Samples lie side by side in lanes, :data:`~.lanes.LANES` channels to a row, so that one instruction
takes several channels; values in a lane without a channel are ignored. They are folded into a cell
each millisecond. Every sum runs in the order of time, whatever the blocks, so that parts give
exactly what the whole gives.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from .compiling import inlined as compiled
from .compiling import inlined as in_place
from .lanes import (
    LANES,
    LANES_32,
    absolute,
    cut_off,
    every,
    floating,
    greater,
    lesser,
    multiply_add,
    put_row,
    row,
    row_from,
    stored_row,
)
from .tiles import TILE, turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Places = NDArray[np.int64]
    Real = NDArray[np.floating[Any]]
    Indices = NDArray[np.intp]

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


#: Noise up to this is none: a filter's memory of what was before the silence.
SILENCE = 1e-140


@compiled
def _larger(one: Array, other: Array, found: Array) -> None:
    for i in range(len(found)):
        found[i] = one[i] if one[i] > other[i] else other[i]


@compiled
def _joined(tail: Array, values: Array) -> Array:
    rows, before = tail.shape
    line = np.empty((rows, before + values.shape[1]))
    for r in range(rows):
        line[r, :before] = tail[r]
        line[r, before:] = values[r]
    return line


@compiled
def window_maxima(tail: Array, values: Array) -> tuple[Array, Array]:
    """Return of shape (rows, n) the maximum of each value and those before it, and the next tail.

    ``tail`` are the values before, shape (rows, reach): each maximum is of 1 + reach values. The
    maximum of twice as many neighbours is that of two maxima, again and again; what overlaps counts
    twice without harm.
    """
    line, width = _joined(tail, values), tail.shape[1] + 1
    rows, n = line.shape
    found, last = np.empty(values.shape), line[:, values.shape[1] :].copy()
    more = np.empty(n)
    for r in range(rows):
        some, other = line[r], more
        reach = 1
        while 2 * reach < width:
            _larger(some, some[reach:], other[: n - 2 * reach + 1])
            some, other = other, some
            reach *= 2
        _larger(some, some[width - reach :], found[r])
    return found, last


@compiled
def ratio_to_noise(
    level: Array, tail: Array, noise: Array, known: int, warm_up: float
) -> tuple[Array, Array]:
    """Return levels over the noise some cells earlier, as far as it is trusted, and the next tail.

    Parameters
    ----------
    level, noise
        Shape (rows, n).
    tail
        Shape (rows, gap): the noise of the cells before; the ratio is to the noise a gap earlier.
    known
        For how many cells the noise of the first place was there; 0 or less: not at all.
    warm_up
        As :class:`~.dsp.noise.NoiseRatio` takes it.
    """
    rows, n = level.shape
    line = _joined(tail, noise)
    ratio, trust = np.empty((rows, n)), np.zeros(n)
    for i in range(max(0, 1 - known), n):
        trust[i] = (known + i) / (known + i + warm_up)
    for r in range(rows):
        one, other, found = level[r], line[r], ratio[r]
        for i in range(n):
            # over digital silence nothing has a ratio: a sensor coming alive is not an arrival
            found[i] = one[i] / other[i] * trust[i] if other[i] > SILENCE else 0.0
    return ratio, line[:, n:].copy()


@compiled
def _is_maximum(x: Array, place: int, reach: int) -> bool:
    value = x[place]
    for i in range(1, reach + 1):  # noqa: SIM110 - compiled as it stands
        if x[place - i] >= value or x[place + i] > value:
            return False
    return True


@compiled
def local_maxima(
    line: Array, start: int, stop: int, reach: int, floor: float, back: int
) -> tuple[NDArray[np.intp], Array]:
    """Find the columns in ``[start, stop)`` that are the largest within reach, first of equals.

    Parameters
    ----------
    line
        Shape (rows, n), with at least ``reach`` columns around each looked at, and ``back`` before.
    start, stop
        Columns looked at.
    reach, floor, back
        As :class:`~.dsp.noise.LocalMaxima` takes them.

    Returns
    -------
    Begin of the rise, maximum and row, shape (3, m), by column and row; values, shape (m,).
    """
    rows = len(line)
    most = rows * ((stop - start) // (reach + 1) + 1)
    place, value = np.empty((3, most), np.intp), np.empty(most)
    top = line[0, start:stop].copy()
    for r in range(1, rows):
        _larger(top, line[r, start:stop], top)
    count = 0
    for i in range(start, stop):
        for r in range(rows if top[i - start] > floor else 0):
            if line[r, i] > floor and _is_maximum(line[r], i, reach):
                begin = i
                while begin > i - back and line[r, begin - 1] > floor:
                    begin -= 1
                place[0, count], place[1, count], place[2, count] = begin, i, r
                value[count] = line[r, i]
                count += 1
    return place[:, :count], value[:count]


@compiled
def settled_maxima(
    tail: Array, values: Array, keep: int, rule: tuple[int, float, int], final: bool
) -> tuple[NDArray[np.intp], Array, Array]:
    """Find the maxima that no later column can change.

    Parameters
    ----------
    tail, values
        Shape (rows, n): columns from ``keep`` before the first that is not settled on, and new
        ones.
    keep
        Columns looked back at.
    rule
        Reach, floor and back, as :func:`local_maxima` takes them.
    final
        Whether nothing follows.

    Returns
    -------
    As :func:`local_maxima`, places counted from the first column that was not settled; next tail.
    """
    reach, floor, back = rule
    line = _joined(tail, values)
    if final:
        line = _joined(line, np.full((len(line), reach), -np.inf))
    count = max(0, line.shape[1] - keep - reach)
    place, value = local_maxima(line, keep, keep + count, reach, floor, back)
    place[:2] -= keep
    return place, value, line[:, count:].copy()


@compiled
def times_of(
    index: NDArray[np.intp], anchors: NDArray[np.int64], period_ns: float
) -> NDArray[np.int64]:
    """Return the times of samples [ns].

    Parameters
    ----------
    index
        Shape (n,): samples of the run.
    anchors
        Shape (k, 3): from which sample on an anchor holds, its time [ns], and which sample before
        the run's first it counts from.
    period_ns
        Time between two samples [ns].
    """
    found = np.empty(len(index), np.int64)
    for i in range(len(index)):
        own = len(anchors) - 1
        while own > 0 and anchors[own, 0] > index[i]:
            own -= 1
        place = np.rint((index[i] + anchors[own, 2]) * period_ns)
        found[i] = anchors[own, 1] + np.int64(place)
    return found


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


#: What an open frame holds of each channel: decision, peak, power, highest and lowest sample; how
#: often the signal stood still at the highest and the lowest; the column before, NaN if it moved.
FRAME = 8


@compiled
def open_frame(state: Array) -> None:
    """Begin a frame: shape (rows, FRAME)."""
    for r in range(len(state)):
        state[r, 0] = state[r, 1] = state[r, 3] = -np.inf
        state[r, 2] = state[r, 5] = state[r, 6] = 0.0
        state[r, 4] = np.inf
        state[r, 7] = np.nan


@compiled
def _extended(frame: Any, decision: float, peak: float, power: float, x: Any) -> Any:
    """Return a frame of one channel with a column more; ``x`` is its highest and lowest sample."""
    reached, top, total, highest, lowest, at_highest, at_lowest, before = frame
    high, low = x
    if high > highest:
        highest, at_highest = high, 0.0
    if low < lowest:
        lowest, at_lowest = low, 0.0
    still = high == low
    if still and before == high:  # as in the column before
        at_highest += 1.0 if high == highest else 0.0
        at_lowest += 1.0 if low == lowest else 0.0
    before = high if still else np.nan
    reached = decision if decision > reached else reached
    top = peak if peak > top else top
    return reached, top, total + power, highest, lowest, at_highest, at_lowest, before


@compiled
def _held(s: Array) -> Any:
    return s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7]


@compiled
def _keep(frame: Any, state: Array) -> None:
    for k in range(FRAME):
        state[k] = frame[k]


@compiled
def close_frame(s: Array, columns: int, found: Array) -> None:
    """Write decision, peak, effective value, swing and columns stood still of one channel."""
    found[0], found[1] = s[0], s[1]
    found[2] = np.sqrt(s[2] / columns)
    found[3] = (s[3] - s[4]) / 2.0
    found[4] = s[5] if s[3] == s[4] else s[5] + s[6]


@compiled
def fold_frames(
    decision: Array,
    peak: Array,
    power: Array,
    high: Array,
    low: Array,
    state: Array,
    filled: int,
    length: int,
) -> Array:
    """Take columns, each shape (rows, n), into frames of ``length`` columns.

    Returns
    -------
    What :func:`close_frame` writes of the frames that are complete, shape (frames, rows, 5).
    """
    rows, n = decision.shape
    found = np.empty(((filled + n) // length, rows, 5))
    for r in range(rows):
        own, columns, index = _held(state[r]), filled, 0
        for i in range(n):
            extremes = (high[r, i], low[r, i])
            own = _extended(own, decision[r, i], peak[r, i], power[r, i], extremes)
            columns += 1
            if columns == length:
                _keep(own, state[r])
                close_frame(state[r], length, found[index, r])
                open_frame(state[r : r + 1])
                own = _held(state[r])
                columns = 0
                index += 1
        _keep(own, state[r])
    return found


@compiled
def frame_values(folded: Array, past: Array, rate_hz: float) -> tuple[NDArray[np.float32], Array]:
    """Return frames with the quietest of the last ones beside each.

    Parameters
    ----------
    folded
        Shape (frames, rows, 5), as :func:`fold_frames` has them.
    past
        Shape (2 * rows, n): effective value and swing of frames before, as negative numbers; a dead
        stretch, which says nothing about the noise, has -inf.
    rate_hz
        Columns per second [Hz].

    Returns
    -------
    The quantities of :func:`~.detectors.trace.trace_of`, (frames, rows, 6); next past.
    """
    count, rows, _ = folded.shape
    level = np.full((2 * rows, count), -np.inf)
    for i in range(count):
        for r in range(rows):
            for k in range(2):
                if folded[i, r, 2 + k] > 0.0:
                    level[k * rows + r, i] = -folded[i, r, 2 + k]
    most, past = window_maxima(past, level)
    value = np.empty((count, rows, 6), np.float32)
    for i in range(count):
        for r in range(rows):
            noise, quiet = most[r, i], most[rows + r, i]
            value[i, r, 0], value[i, r, 1] = folded[i, r, 0], folded[i, r, 1]
            value[i, r, 2] = -noise if noise > -np.inf else 0.0
            value[i, r, 3] = folded[i, r, 3]
            value[i, r, 4] = -quiet if quiet > -np.inf else 0.0
            value[i, r, 5] = folded[i, r, 4] / rate_hz
    return value, past


#: Phases of the grid against the samples whose weights are kept.
_PHASES = 8
#: Sums that are made together, in registers.
TOGETHER = 4 * LANES


@compiled
def weights_at(past: float, reach: int, rate_hz: float, at_s: Array, table: Array) -> Array:
    """Return the low-pass's weights of the samples about a point ``past`` one of them, in samples.

    Parameters
    ----------
    past, reach
        How far the point lies after the middle sample, and how many samples count before and after
        that.
    rate_hz
        Sampling rate [Hz].
    at_s, table
        Times and weights between which straight lines are drawn, shape (m,).
    """
    out = np.empty(2 * reach + 1)
    last = len(at_s) - 1
    for k in range(2 * reach + 1):
        away_s = abs((k - reach) - past) / rate_hz
        j = int(away_s / at_s[last] * last)
        while j > 0 and at_s[j] > away_s:
            j -= 1
        while j < last and at_s[j + 1] <= away_s:
            j += 1
        if j >= last:
            out[k] = table[last]
        else:
            slope = (table[j + 1] - table[j]) / (at_s[j + 1] - at_s[j])
            out[k] = slope * (away_s - at_s[j]) + table[j]
    return out


@in_place
def summed(values: Array, start: int, stop: int) -> float:
    """Return the sum of values ``[start, stop)``, the first two added first."""
    total = 0.0
    for k in range(start, stop):
        total += values[k]
    return total


@in_place
def product_sum(x: Array, at: int, weights: Array, rows: int, sums: Array) -> float:
    """Return the sum of products of weights and what stands from ``at`` on, a few rows of each.

    Each lane is summed by itself, into ``sums``, shape (1, LANES).
    """
    total = every(0.0)
    for k in range(0, rows * LANES, LANES):
        total = total + row_from(weights, k) * row_from(x, at + k)
    put_row(sums, 0, total)
    s = sums[0]
    return float(((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])))


@compiled
def grid_points(
    values: Array,
    first: int,
    start: int,
    end: int,
    step: float,
    rate_hz: float,
    reach: int,
    at_s: Array,
    table: Array,
) -> tuple[Array, Array, Places, Array]:
    """Evaluate a low-passed signal at points ``[start, end)`` of the grid.

    Parameters
    ----------
    values
        Shape (n_channels, n), of the samples from ``first`` on.
    step
        Samples from point to point.
    rate_hz, reach, at_s, table
        As those of :func:`weights_at`.

    Returns
    -------
    Low-passed and straight between samples, shape (n_channels, m) each; the sample before each
    point, counted from ``first``, and how far after it the point lies [samples], shape (m,).
    """
    channels, n = values.shape
    low, recorded = np.empty((channels, end - start)), np.empty((channels, end - start))
    own, past = np.empty(end - start, np.int64), np.empty(end - start)
    rows = (2 * reach + LANES) // LANES
    known, kept, totals = (
        np.full(_PHASES, -1.0),
        np.zeros((_PHASES, rows * LANES)),
        np.zeros(_PHASES),
    )
    # nothing stands before the run and after its end
    lines, sums = np.zeros((channels, n + (rows + 1) * LANES + reach)), np.empty((1, LANES))
    for c in range(channels):
        lines[c, reach : reach + n] = values[c]
    for m in range(start, end):
        place, to = m * step, m - start
        base = math.floor(place + 1e-9)
        past[to] = place - base
        phase = m % _PHASES
        if known[phase] != past[to]:
            known[phase] = past[to]
            kept[phase, : 2 * reach + 1] = weights_at(past[to], reach, rate_hz, at_s, table)
            totals[phase] = summed(kept[phase], 0, 2 * reach + 1)
        weight, at, total = kept[phase], base - first, totals[phase]
        if at < reach or at >= n - reach:
            total = summed(weight, max(0, reach - at), min(2 * reach + 1, n + reach - at))
        own[to] = min(at, n - 1)
        after = min(own[to] + 1, n - 1)
        for c in range(channels):
            low[c, to] = product_sum(lines[c], at, weight, rows, sums) / total
            x, y = values[c, own[to]], values[c, after]
            recorded[c, to] = x * (1 - past[to]) + y * past[to]
    return low, recorded, own, past


@in_place
def sums_together(
    x: Array, at: int, weights: Array, span: tuple[int, int], out: Array, to: int
) -> None:
    """Put weighted sums of neighbours, of :data:`TOGETHER` points from ``at`` on, in four rows.

    Parameters
    ----------
    x
        Shape (n,), to at least TOGETHER behind the last neighbour.
    weights, span
        Weights from the oldest neighbour on, and those that count.
    out, to
        Rows of LANES, and the first of the four.
    """
    one, two, three, four = every(0.0), every(0.0), every(0.0), every(0.0)
    for k in range(span[0], span[1]):
        weight = every(weights[k])
        one = one + weight * row_from(x, at + k)
        two = two + weight * row_from(x, at + k + LANES)
        three = three + weight * row_from(x, at + k + 2 * LANES)
        four = four + weight * row_from(x, at + k + 3 * LANES)
    put_row(out, to, one)
    put_row(out, to + 1, two)
    put_row(out, to + 2, three)
    put_row(out, to + 3, four)


@compiled
def weighted_sums(x: Array, kernel: Array) -> Array:
    """Return sums of neighbours, shape (n_channels, n) to (n_channels, n - len(kernel) + 1).

    The oldest is added first: the same sums whatever the blocks.
    """
    channels, taps = len(x), len(kernel)
    count = x.shape[1] - taps + 1
    groups = -(-count // TOGETHER)
    out, line = np.empty((channels, groups * TOGETHER)), np.zeros(groups * TOGETHER + taps)
    weights = kernel[::-1].copy()
    for c in range(channels):
        line[: x.shape[1]] = x[c]
        rows = out[c].reshape(-1, LANES)
        for g in range(groups):
            sums_together(line, g * TOGETHER, weights, (0, taps), rows, 4 * g)
    return out[:, :count]


@in_place
def _put_side_by_side(samples: NDArray[Any], first: int, hop: int, turned: Real) -> None:
    """Put runs of samples, a hop apart, into columns.

    Parameters
    ----------
    samples
        Shape (n,).
    first, hop
        Where the first run begins, and from one to the next.
    turned
        Shape (length, runs), a length that is a multiple of TILE.
    """
    length, runs = turned.shape
    whole = runs - runs % TILE
    for run in range(0, whole, TILE):
        for j in range(0, length, TILE):
            turn(samples, first + run * hop + j, hop, turned, j * runs + run, runs)
    for run in range(whole, runs):
        for j in range(length):
            turned[j, run] = samples[first + run * hop + j]


@in_place
def _fold(turned: Real, places: Indices, weights: Real, mean: Real, folded: Real) -> None:
    """Fold the windows of all lanes about their middle, and about a quarter of the transform.

    Parameters
    ----------
    turned
        Shape (length, runs): where the first window's samples are, ``places`` say, counted through;
        those of the other windows lie behind them.
    places
        Shape (4, n): four samples that are folded upon each other.
    weights
        Shape (2, n): by what the first two, and the others, are multiplied.
    mean
        Shape (lanes,): twice the mean that is taken away of each window.
    folded
        Shape (4 * n, lanes): gets the terms of even and odd cosines, and of even and odd sines.
    """
    n, level = places.shape[1], row(mean, 0)
    for i in range(n):
        a, b = row_from(turned, places[0, i]), row_from(turned, places[1, i])
        c, d = row_from(turned, places[2, i]), row_from(turned, places[3, i])
        weight, other = every(weights[0, i]), every(weights[1, i])
        near, far = (a + b - level) * weight, (c + d - level) * other
        put_row(folded, i, near + far)
        put_row(folded, n + i, near - far)
        near, far = (a - b) * weight, (c - d) * other
        put_row(folded, 2 * n + i, near - far)
        put_row(folded, 3 * n + i, near + far)


@in_place
def _take_mean(turned: Real, every_place: Indices, share: Real, mean: Real) -> None:
    """Write twice the mean of each window, (lanes,); ``share`` is what a sample has in it, (1,)."""
    level = every(share[0]) * row_from(turned, every_place[0])
    for i in range(1, len(every_place)):
        level = multiply_add(every(share[0]), row_from(turned, every_place[i]), level)
    put_row(mean, 0, level)


@in_place
def _products(waves: Real, k: int, folded: Real, first: int) -> Any:
    """Return the sums of terms, from row ``first`` on, times four waves, every other one."""
    n, term = waves.shape[1], row(folded, first)
    one, two = every(waves[k, 0]) * term, every(waves[k + 2, 0]) * term
    three, four = every(waves[k + 4, 0]) * term, every(waves[k + 6, 0]) * term
    for i in range(1, n):
        term = row(folded, first + i)
        one = multiply_add(every(waves[k, i]), term, one)
        two = multiply_add(every(waves[k + 2, i]), term, two)
        three = multiply_add(every(waves[k + 4, i]), term, three)
        four = multiply_add(every(waves[k + 6, i]), term, four)
    return one, two, three, four


@in_place
def _multiply(folded: Real, cosines: Real, sines: Real, power: Real) -> None:
    """Write the power of the windows of all lanes, shape (frequencies, lanes).

    Parameters
    ----------
    folded
        Shape (4 * n, lanes).
    cosines, sines
        Shape (frequencies, n); frequencies are a multiple of TILE.
    """
    n = cosines.shape[1]
    for begin in range(0, len(cosines), TILE):
        for odd in range(2):
            k = begin + odd
            a, b, c, d = _products(cosines, k, folded, odd * n)
            e, f, g, h = _products(sines, k, folded, (2 + odd) * n)
            put_row(power, k, a * a + e * e)
            put_row(power, k + 2, b * b + f * f)
            put_row(power, k + 4, c * c + g * g)
            put_row(power, k + 6, d * d + h * h)


@in_place
def _join(before: NDArray[Any], after: NDArray[Any], start: int, joined: NDArray[Any]) -> None:
    """Write samples from ``start`` of the later ones on, 0 behind them; the others end there."""
    for i in range(len(joined)):
        at = start + i
        if at < 0:
            joined[i] = before[len(before) + at]
        else:
            joined[i] = after[at] if at < len(after) else 0


@compiled
def _places(pairs: Indices, window: int, hop: int, runs: int) -> tuple[Indices, Indices]:
    """Return where samples of a window are turned to, (window,), and those of pairs, (4, n)."""
    place = np.empty(window, np.intp)  # sample j is number j % hop of run j // hop
    for j in range(window):
        place[j] = j % hop * runs + j // hop
    folded = np.empty((4, pairs.shape[1]), np.intp)
    for i in range(pairs.shape[1]):
        one, other = pairs[0, i], pairs[1, i]
        folded[0, i], folded[1, i] = place[one], place[window - 1 - one]
        folded[2, i], folded[3, i] = place[other], place[window - 1 - other]
    return place, folded


@compiled
def put_power(
    before: NDArray[Any],
    samples: NDArray[Any],
    start: int,
    window: int,
    hop: int,
    pairs: Indices,
    weights: Real,
    share: Real,
    cosines: Real,
    sines: Real,
    power: Real,
) -> None:
    """Write the power of windows of each channel.

    Parameters
    ----------
    before, samples
        Shape (n_channels, n), one after the other.
    start, window, hop
        Where the first window begins, counted from the first of ``samples``, length of each, and
        from one to the next.
    pairs
        Shape (2, n): samples of a window's first half that are folded upon each other.
    weights, share, cosines, sines
        As the functions above take them; a share of nothing where no mean is taken away.
    power
        Shape (n_channels, windows, frequencies): multiples of the lanes and of TILE. Windows that
        end behind the samples are of no meaning.
    """
    frequencies, n = cosines.shape
    lanes = LANES if cosines.itemsize == 8 else LANES_32
    length, runs = -(-min(hop, window) // TILE) * TILE, lanes + (window - 1) // hop
    turned = np.empty((length, runs), cosines.dtype)
    mean, folded = np.zeros((1, lanes), cosines.dtype), np.empty((4 * n, lanes), cosines.dtype)
    found = np.empty((frequencies, lanes), cosines.dtype)
    rest = np.zeros((runs - 1) * hop + length, samples.dtype)
    every_place, places = _places(pairs, window, hop, runs)
    for channel in range(len(samples)):
        own = samples[channel]
        for first in range(0, power.shape[1], lanes):
            begin = start + first * hop
            if 0 <= begin <= len(own) - len(rest):
                _put_side_by_side(own, begin, hop, turned)
            else:
                _join(before[channel], own, begin, rest)
                _put_side_by_side(rest, 0, hop, turned)
            if share[0]:
                _take_mean(turned, every_place, share, mean)
            _fold(turned, places, weights, mean, folded)
            _multiply(folded, cosines, sines, found)
            for lane in range(0, lanes, TILE):
                for k in range(0, frequencies, TILE):
                    to = ((channel * power.shape[1]) + first + lane) * frequencies + k
                    turn(found, k * lanes + lane, lanes, power, to, frequencies)


#: Time of what did not happen [ns].
NEVER = np.iinfo(np.int64).min


@compiled
def time_since_passed(
    time_ns: NDArray[np.int64],
    channel: NDArray[np.int32],
    alive: NDArray[np.bool_],
    spacing_s: float,
    before: NDArray[np.int64],
    ns_per_s: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return for every candidate the time since the last of its channel that passed [s], (n,).

    Parameters
    ----------
    time_ns, channel, alive
        Shape (n,): candidates in their order; those not alive never pass.
    spacing_s
        A candidate passes where at least this time is over.
    before
        Shape (2 * k,): k channels of which one passed before, and when the last one did.
    ns_per_s
        Of all these times.

    Returns
    -------
    These times, infinite where there was none before; when the last one of each channel passed now,
    :data:`NEVER` where there is none.
    """
    known = len(before) // 2
    highest = 0
    for own in before[:known]:
        highest = max(highest, own)
    for own in channel:
        highest = max(highest, own)
    last_ns = np.full(highest + 1, NEVER)
    for i in range(known):
        last_ns[before[i]] = before[known + i]
    since_s = np.full(len(time_ns), np.inf)
    for i in range(len(time_ns)):
        own = channel[i]
        if last_ns[own] != NEVER:
            since_s[i] = (time_ns[i] - last_ns[own]) / ns_per_s
        if alive[i] and since_s[i] >= spacing_s:
            last_ns[own] = time_ns[i]
    return since_s, last_ns


@compiled
def judge(
    seen: NDArray[np.float64],
    threshold: float,
    at_least: bool,
    alive: NDArray[np.bool_],
    value: NDArray[np.float32],
    margin: NDArray[np.float32],
) -> NDArray[np.bool_]:
    """Write what a gate looked at, and margins; return which candidates passed it and all before.

    Parameters
    ----------
    seen, alive
        Shape (n,): what the gate looks at, and which candidates passed all gates before it.
    threshold, at_least
        Of the gate.
    value, margin
        Shape (n,): where to.
    """
    passed = np.empty(len(seen), np.bool_)
    for i in range(len(seen)):
        distance = seen[i] - threshold if at_least else threshold - seen[i]
        value[i], margin[i] = seen[i], distance
        passed[i] = alive[i] and distance >= 0.0
    return passed
