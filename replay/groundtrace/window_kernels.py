"""The loops of powers of windows, compiled: as many windows at once as a row has lanes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .compiled import compiled, in_place
from .lanes import LANES, LANES_32, every, multiply_add, put_row, row, row_from
from .tiles import TILE, turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Real = NDArray[np.floating[Any]]
    Indices = NDArray[np.intp]


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
