"""The loops of step detectors, compiled: rhythm, bands, peaks and scores."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .compiling import compiled, inlined
from .grid import neighbour_sums

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Places = NDArray[np.int64]

#: Points that are filtered together, by all bands that one of them needs. Chosen by judgement: most
#: of 0.8 s need the same two.
TOGETHER = 32


@inlined
def autocorrelation(x: Array, energy: Array, sums: Array) -> None:
    """Put the correlations of a window with itself, shifted by 0, 1, 2 ..., in ``sums``.

    Each is divided by the energies of the two parts that overlap, so that a perfect rhythm gives 1
    at all multiples of its period.

    Parameters
    ----------
    x
        Shape (n + len(sums) - 1,): the window, and nothing behind it.
    energy
        Shape (n + 1,), written over.
    sums
        Shape (lags,), lags <= n + 1.
    """
    n = len(energy) - 1
    energy[0] = 0.0
    for i in range(n):
        energy[i + 1] = energy[i] + x[i] * x[i]
    neighbour_sums(x, x[:n], sums)
    for lag in range(len(sums)):
        sums[lag] /= math.sqrt(energy[n - lag] * (energy[n] - energy[lag]) + 1e-9)


@inlined
def median_size(window: Array, x: Array) -> float:
    """Return the median of absolute values, by parting them about one again and again (Hoare).

    They are moved about in ``x``, shape (n,) or more.
    """
    n = len(window)
    for i in range(n):
        x[i] = abs(window[i])
    low, high, middle = 0, n - 1, n // 2
    while low < high:
        pivot, i, j = x[(low + high) // 2], low, high
        while i <= j:
            while x[i] < pivot:
                i += 1
            while x[j] > pivot:
                j -= 1
            if i <= j:
                x[i], x[j] = x[j], x[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    if n % 2:
        return float(x[middle])
    below = x[0]
    for k in range(1, middle):
        below = max(below, x[k])
    return float(0.5 * (below + x[middle]))


@inlined
def clip_window(window: Array, limit: float, x: Array) -> None:
    """Put a window, shape (n,), with its amplitudes clipped, less its mean, in ``x``."""
    total = 0.0
    for i in range(len(window)):
        x[i] = min(max(window[i], -limit), limit)
        total += x[i]
    for i in range(len(window)):
        x[i] -= total / len(window)


@inlined
def best_period(
    correlation: Array, repeats: int, shortest: int, longest: int, comb: Array
) -> tuple[int, float]:
    """Return the period that stands out, in points, and its strength; 0 and -1 for none.

    ``comb``, shape (longest - shortest + 1,), is written over.
    """
    for i in range(longest - shortest + 1):
        comb[i] = 0.0
        for k in range(1, repeats + 1):
            comb[i] += correlation[k * (shortest + i)]
        comb[i] /= repeats
    best, strength = 0, -np.inf
    for i in range(1, len(comb) - 1):
        if comb[i] > comb[i - 1] and comb[i] >= comb[i + 1] and comb[i] > strength:
            best, strength = shortest + i, comb[i]
    return best, strength if best else -1.0


@inlined
def between(values: Array, position: float) -> float:
    """Return the value at a place, on the straight line between its neighbours."""
    low = int(position)
    if low >= len(values) - 1:
        return float(values[len(values) - 1])
    return float((values[low + 1] - values[low]) * (position - low) + values[low])


@compiled("f8[:, ::1](f8[::1], i8, i8, i8, UniTuple(i8, 2), f8, f8, f8)")
def rhythms(
    signal: Array,
    hop: int,
    length: int,
    repeats: int,
    periods: tuple[int, int],
    fastest: float,
    clip: float,
    part: float,
) -> Array:
    """Return strength, step time in points and median amplitude of windows, shape (3, n).

    Parameters
    ----------
    signal
        Shape (m,): windows of ``length`` points begin at every ``hop``-th.
    repeats
        How many periods on the signal must repeat itself.
    periods
        Shortest and longest that are tried [points].
    fastest
        Shortest step time [points].
    clip
        Amplitudes are clipped at this multiple of their median.
    part
        What parts of a period must correlate by, as a part of what it does itself.
    """
    count = (len(signal) - length) // hop + 1
    shortest, longest = periods
    out, sums = np.empty((3, count)), np.empty(repeats * longest + 1)
    # nothing stands behind a window
    x, energy = np.zeros(length + len(sums) - 1), np.empty(length + 1)
    comb = np.empty(max(longest - shortest + 1, 1))
    for w in range(count):
        window = signal[w * hop : w * hop + length]
        out[0, w], out[1, w], out[2, w] = -1.0, 0.0, median_size(window, x)
        if longest < shortest + 2:
            continue
        clip_window(window, clip * out[2, w], x)
        autocorrelation(x, energy, sums)
        period, strength = best_period(sums, repeats, shortest, longest, comb)
        if not period:
            continue
        steps = 1
        if period >= 3 * fastest and between(sums, period / 3) > part * strength:
            steps = 3
        elif period >= 2 * fastest and between(sums, period / 2) > -part * strength:
            steps = 2
        out[0, w], out[1, w] = strength, period / steps
    return out


@compiled("f8[:, ::1](f8[:, ::1], i8, UniTuple(i8, 2), i8, i8)")
def strongest(windows: Array, first: int, hops: tuple[int, int], ahead: int, width: int) -> Array:
    """Return the best window of each hop ``[start, end)``, shape (3, n); -inf where there is none.

    Parameters
    ----------
    windows
        Of the windows from ``first`` on, the strength first, shape (3, m).
    ahead, width
        How far ahead of a hop a window may reach, and how long it is [hops].
    """
    start, end = hops
    out = np.full((3, end - start), -np.inf)
    for hop in range(start, end):
        last = min(hop, max(0, hop + ahead - width), first + windows.shape[1] - 1)
        for w in range(max(min(hop - 1 - width, last) - first, 0), last - first + 1):
            if windows[0, w] > out[0, hop - start]:
                for k in range(3):  # a whole column at once takes numba seconds to compile
                    out[k, hop - start] = windows[k, w]
    return out


@inlined
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


@compiled("f8[:, ::1](f8[::1], f8[:, ::1], i8[:, ::1], f8[::1], f8[:, ::1], i8, i8)")
def step_bands(
    up: Array, kernels: Array, spans: Places, nodes: Array, hops: Array, start: int, hop: int
) -> Array:
    """Filter points by their step time.

    Parameters
    ----------
    up
        Shape (n + taps - 1,): the signal from the oldest neighbour of the first point on.
    kernels, spans
        Weights of each node's band, and last those that rises are timed in, shape (nodes + 1,
        taps), and where those that count begin and end, (nodes + 1, 2).
    nodes
        Step times of the bands, shape (nodes,).
    hops
        Strength of the rhythm, step time and swing of the first point's hop and those after it,
        shape (3, m).
    start, hop
        Place of the first point in the run, and points from hop to hop.

    Returns
    -------
    Band, rise, rhythm, step time and usual swing of the points, shape (5, n).
    """
    n, last, lower = len(up) - kernels.shape[1] + 1, len(nodes), start // hop
    out, sums = np.empty((5, n)), np.empty((last + 1, TOGETHER))
    parts, below = np.empty(TOGETHER), np.empty(TOGETHER, np.int64)
    for at in range(0, n, TOGETHER):
        count, first, most = min(TOGETHER, n - at), last, 0
        for i in range(count):
            position = (start + at + i) / hop - lower
            for k in range(3):
                out[2 + k, at + i] = between(hops[k], position)
            node = place_among(nodes, out[3, at + i])
            below[i] = min(int(node), last - 2)
            parts[i] = node - below[i]
            first, most = min(first, below[i]), max(most, below[i])
        for node in range(first, last + 1):
            if node <= most + 1 or node == last:
                oldest, end = spans[node, 0], spans[node, 1]
                neighbour_sums(up[at + oldest :], kernels[node, oldest:end], sums[node, :count])
        for i in range(count):
            low, high = sums[below[i], i], sums[below[i] + 1, i]
            out[0, at + i] = low * (1 - parts[i]) + high * parts[i]
            out[1, at + i] = sums[last, i]
    return out


@inlined
def vertex(before: float, middle: float, after: float) -> float:
    """Return where the parabola through three values has its vertex, from the middle one."""
    return 0.5 * (before - after) / (before - 2.0 * middle + after)


@inlined
def risen(signal: Array, here: int, near: int, back: int, part: float) -> float:
    """Return where a signal reaches a part of its rise to the peak within ``near`` of a place."""
    top = max(0, here - near)
    for i in range(top, min(here + near + 1, len(signal))):
        if signal[i] > signal[top]:
            top = i
    low = max(0, top - back)
    for i in range(low, top + 1):
        if signal[i] < signal[low]:
            low = i
    level = signal[low] + part * (signal[top] - signal[low])
    if not level > signal[low]:
        return float(top)
    before = low
    for i in range(low, top):
        if signal[i] <= level:
            before = i
    if signal[before + 1] <= signal[before]:
        return float(top)
    return float(before + (level - signal[before]) / (signal[before + 1] - signal[before]))


@inlined
def higher(band: Array, here: int, reach: int) -> int:
    """Return how many points away the nearest higher value is; 0 where none is within ``reach``."""
    for away in range(1, reach + 1):
        before, after = here - away, here + away
        earlier = before >= 0 and band[before] >= band[here]
        if earlier or (after < len(band) and band[after] > band[here]):
            return away
    return 0


@compiled("f8[:, ::1](f8[:, ::1], i8, UniTuple(i8, 2), f8, f8, f8, f8, i8, UniTuple(f8, 3))")
def peaks(
    points: Array,
    first: int,
    span: tuple[int, int],
    last: float,
    floor: float,
    rise: float,
    grid_hz: float,
    near: int,
    reaches: tuple[float, float, float],
) -> Array:
    """Measure the local maxima of the band at places ``[start, end)``.

    Parameters
    ----------
    points
        Band, rise, rhythm, step time and usual swing of the points from ``first`` on, shape (5, n).
    last
        Place of the peak before.
    floor, rise
        Lowest peak, and part of the rise at which a step is timed; 0 times it at the peak.
    near
        How far from the peak of the band a rise ends at most [points].
    reaches
        How far valleys, the beginning of a rise and higher peaks are looked for [step times].

    Returns
    -------
    Place, height, swing, share, dominance, rhythm and step time, shape (n_peaks, 7).
    """
    band, timed, rhythm, step_s, typical = points
    table = np.empty((span[1] - span[0], 7))
    count = 0
    for at in range(span[0], span[1]):
        i = at - first
        if not (band[i] > band[i - 1] and band[i] >= band[i + 1] and band[i] > floor):
            continue
        step, low = step_s[i], band[i]
        for k in range(max(0, i - int(reaches[0] * step * grid_hz)), i):
            low = min(low, band[k])
        if rise == 0.0:
            offset = vertex(band[i - 1], band[i], band[i + 1])
        else:
            offset = risen(timed, i, near, round(reaches[1] * step * grid_hz), rise) - i
        last = max(last, at + offset)
        swing = band[i] - low
        row = table[count]
        row[0], row[1], row[2] = last, band[i], swing
        row[3] = swing / typical[i] if typical[i] > 0 else 0.0
        away = higher(band, i, int(reaches[2] * step * grid_hz))
        row[4] = min(reaches[2], away / grid_hz / step) if away else reaches[2]
        row[5], row[6] = rhythm[i], step
        count += 1
    return table[:count].copy()


@compiled(
    "Tuple((f8[:, ::1], f8[::1]))"
    "(f8[:, ::1], i8, UniTuple(i8, 2), f8[::1], i8, i8, f8[::1], f8[::1])"
)
def scaled_windows(
    points: Array,
    first: int,
    span: tuple[int, int],
    hops: Array,
    first_hop: int,
    hop: int,
    nodes: Array,
    taps: Array,
) -> tuple[Array, Array]:
    """Look about points at places ``[start, end)``, each in its own time scale.

    Parameters
    ----------
    points
        Two signals, smoothed for each node, from the place ``first`` on, shape (2 nodes, n); what
        lies before and after is as the first and the last.
    hops
        Logarithm of the time scale of the hops from ``first_hop`` on, shape (m,), each the middle
        of ``hop`` points.
    nodes
        Logarithms of the scales that the signals were smoothed for, shape (nodes,).
    taps
        Where is looked, at scale 1 [points], shape (taps,).

    Returns
    -------
    The two signals at the taps, shape (end - start, 2 taps), and the logarithm of the scale.
    """
    count, m, last = span[1] - span[0], len(taps), points.shape[1] - 1
    out, scale = np.empty((count, 2 * m)), np.empty(count)
    for i in range(count):
        position = (span[0] + i - 0.5 * (hop - 1)) / hop - first_hop
        scale[i] = between(hops, max(position, 0.0))
        node = place_among(nodes, scale[i])
        low = min(int(node), len(nodes) - 2)
        part, stretch = node - low, math.exp(scale[i])
        for k in range(m):
            at = min(max(span[0] + i + taps[k] * stretch - first, 0.0), float(last))
            a = int(at)
            b, past = min(a + 1, last), at - a
            for c in range(2):
                fine, coarse = points[2 * low + c], points[2 * low + 2 + c]
                x = fine[a] * (1 - past) + fine[b] * past
                y = coarse[a] * (1 - past) + coarse[b] * past
                out[i, c * m + k] = x * (1 - part) + y * part
    return out, scale


@inlined
def tanh(x: float) -> float:
    """Return the hyperbolic tangent by Lambert's continued fraction, within 0.0001 of it."""
    x = min(max(x, -4.97), 4.97)
    y = x * x
    over = x * (135135.0 + y * (17325.0 + y * (378.0 + y)))
    return over / (135135.0 + y * (62370.0 + y * (3150.0 + y * 28.0)))


@compiled("f8[:, ::1](f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], f8)")
def scores(
    seen: Array, hidden: Array, bias: Array, out: Array, typical: Array, offset: float
) -> Array:
    """Return what a network of one hidden layer says of windows.

    Parameters
    ----------
    seen
        Shape (n, 2 taps): one signal, then the other.
    hidden, bias, out, offset
        Weights of the hidden layer, shape (2 taps, units) and (units,), and of the output.
    typical
        A usual window, shape (2 taps,).

    Returns
    -------
    Logarithm of the odds, and how much of each signal's usual window there is, shape (3, n).
    """
    n, width, units = len(seen), seen.shape[1], len(bias)
    odds_and_shares, sums, m = np.empty((3, n)), np.empty(units), width // 2
    for i in range(n):
        for u in range(units):
            sums[u] = bias[u]
        for k in range(width):
            x, weights = seen[i, k], hidden[k]
            for u in range(units):
                sums[u] += x * weights[u]
        odds_and_shares[0, i] = offset
        for u in range(units):
            odds_and_shares[0, i] += out[u] * tanh(sums[u])
        for c in range(2):
            part, energy = 0.0, 1e-12
            for k in range(c * m, c * m + m):
                part += seen[i, k] * typical[k]
                energy += typical[k] * typical[k]
            odds_and_shares[1 + c, i] = part / energy
    return odds_and_shares


@compiled("f8[:, ::1](f8[:, ::1], i8, UniTuple(i8, 2), f8, f8, f8, UniTuple(f8, 2))")
def score_peaks(
    points: Array,
    first: int,
    span: tuple[int, int],
    least: float,
    reach: float,
    grid_hz: float,
    widths: tuple[float, float],
) -> Array:
    """Measure the local maxima of a score at places ``[start, end)``.

    Parameters
    ----------
    points
        Logarithm of the odds, two shares of the usual step, and step time [s] of the points from
        ``first`` on, shape (4, n).
    least
        Lowest score.
    reach
        How far a higher score is looked for [step times].
    widths
        Standard deviation of a score's peak about a time that is certain, and of that time [s].

    Returns
    -------
    Place, score, time to a higher one, the shares, standard deviation of the time, and step time,
    shape (n_peaks, 7).
    """
    odds, vertical, forward, step_s = points
    table = np.empty((span[1] - span[0], 7))
    lowest, count = math.log(least / (1.0 - least)), 0
    for at in range(span[0], span[1]):
        i = at - first
        if not (odds[i] > odds[i - 1] and odds[i] >= odds[i + 1] and odds[i] > lowest):
            continue
        near = int(reach * step_s[i] * grid_hz)
        offset = vertex(odds[i - 1], odds[i], odds[i + 1])
        away = higher(odds, i, near)
        weight, square = 0.0, 0.0
        for k in range(max(0, i - near), min(i + near + 1, len(odds))):
            if not away or abs(k - i) < away:
                part = 1.0 / (1.0 + math.exp(-odds[k]))
                weight += part
                square += part * ((k - i - offset) / grid_hz) ** 2
        row = table[count]
        row[0], row[1] = at + offset, 1.0 / (1.0 + math.exp(-odds[i]))
        row[2] = min(reach, away / grid_hz / step_s[i]) if away else reach
        row[3], row[4] = vertical[i], forward[i]
        wider = max(square / weight - widths[0] ** 2, 0.0)
        row[5], row[6] = math.sqrt(wider + widths[1] ** 2), step_s[i]
        count += 1
    return table[:count].copy()
