"""The loops of cells, compiled: maxima of noise, ratios to it, local maxima, times."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

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
    for row in range(rows):
        line[row, :before] = tail[row]
        line[row, before:] = values[row]
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
    for row in range(rows):
        some, other = line[row], more
        reach = 1
        while 2 * reach < width:
            _larger(some, some[reach:], other[: n - 2 * reach + 1])
            some, other = other, some
            reach *= 2
        _larger(some, some[width - reach :], found[row])
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
        As :class:`~groundtrace.detectors.cells.NoiseRatio` takes it.
    """
    rows, n = level.shape
    line = _joined(tail, noise)
    ratio, trust = np.empty((rows, n)), np.zeros(n)
    for i in range(max(0, 1 - known), n):
        trust[i] = (known + i) / (known + i + warm_up)
    for row in range(rows):
        one, other, found = level[row], line[row], ratio[row]
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
        As :class:`~groundtrace.detectors.cells.LocalMaxima` takes them.

    Returns
    -------
    Begin of the rise, maximum and row, shape (3, m), by column and row; values, shape (m,).
    """
    rows = len(line)
    most = rows * ((stop - start) // (reach + 1) + 1)
    place, value = np.empty((3, most), np.intp), np.empty(most)
    top = line[0, start:stop].copy()
    for row in range(1, rows):
        _larger(top, line[row, start:stop], top)
    count = 0
    for i in range(start, stop):
        for row in range(rows if top[i - start] > floor else 0):
            if line[row, i] > floor and _is_maximum(line[row], i, reach):
                begin = i
                while begin > i - back and line[row, begin - 1] > floor:
                    begin -= 1
                place[0, count], place[1, count], place[2, count] = begin, i, row
                value[count] = line[row, i]
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
