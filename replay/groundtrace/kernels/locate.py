"""Loops that locate impacts: arrivals that pairs agree on, and their loss at nodes of a lattice."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .compiling import compiled, inlined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Index = NDArray[np.intp]
    Spectra = NDArray[np.complex128]

#: Nodes worked on together: what is summed for each of them stays in the nearest cache.
#: Chosen by judgement: 64 nodes of 5 sums are 2.5 KB.
BLOCK = 64
#: What is summed over arrivals at each node: 1, u, t, u u and t u, all by weight. Source:
#: definition.
SUMS = 5
#: The least sum of squares that divides, the least normal float64. Source: IEEE 754.
TINY = 2.2250738585072014e-308


@inlined
def _summed(
    u: Array, times: Array, line: Array, threshold: float, robust: bool, sums: Array
) -> None:
    """Sum over arrivals at the nodes of a block; ``robust``: by Huber's weights about ``line``."""
    sums[:] = 0.0
    for i in range(len(times)):
        t = times[i]
        for j in range(u.shape[1]):
            x, weight = u[i, j], 1.0
            if robust:
                size = abs(t - line[0, j] * x - line[1, j])
                weight = threshold / (size if size > threshold else threshold)
            weighted = weight * x
            sums[0, j] += weight
            sums[1, j] += weighted
            sums[2, j] += weight * t
            sums[3, j] += weighted * x
            sums[4, j] += weighted * t


@inlined
def _fitted(sums: Array, slope: float, line: Array) -> None:
    """Put the best slope, at least 0, and moment of each node in ``line``, of those sums."""
    for j in range(sums.shape[1]):
        weight = sums[0, j]
        u_mean, t_mean = sums[1, j] / weight, sums[2, j] / weight
        k = slope
        if np.isnan(slope):
            square = sums[3, j] - weight * (u_mean * u_mean)
            along = sums[4, j] - weight * u_mean * t_mean
            k = along / (square if square > TINY else TINY)
            k = k if k > 0.0 else 0.0
        line[0, j] = k
        line[1, j] = t_mean - k * u_mean


@inlined
def _lost(u: Array, times: Array, line: Array, threshold: float, loss: Array) -> None:
    """Put the mean of twice Huber's loss at each node of a block in ``loss``."""
    loss[:] = 0.0
    for i in range(len(times)):
        t = times[i]
        for j in range(u.shape[1]):
            size = abs(t - line[0, j] * u[i, j] - line[1, j])
            inner = size if size < threshold else threshold
            loss[j] += inner * (2.0 * size - inner)
    for j in range(u.shape[1]):
        loss[j] /= len(times)


@compiled("void(f8[:, :, ::1], f8[:, ::1], f8, f8, i8, f8[:, ::1])")
def robust_losses(
    u: Array, times_s: Array, slope: float, threshold_s: float, passes: int, losses: Array
) -> None:
    """Fit t = t0 + k u at every node by Huber's loss, reweighting, and put the mean loss there.

    Parameters
    ----------
    u
        Shape (m, n, q), or (1, n, q) where all impacts have the same nodes.
    times_s
        Shape (m, n) [s].
    slope
        k, or NaN where it is fitted, as at least 0.
    threshold_s
        Residuals beyond it count linearly [s].
    passes
        Reweightings; none for an infinite threshold.
    losses
        Shape (m, q) [s^2], overwritten.
    """
    whole_sums, whole_line = np.empty((SUMS, BLOCK)), np.empty((2, BLOCK))
    for row in range(len(times_s)):
        nodes = u[row if len(u) > 1 else 0]
        for start in range(0, nodes.shape[1], BLOCK):
            stop = min(start + BLOCK, nodes.shape[1])
            part, loss = nodes[:, start:stop], losses[row, start:stop]
            sums, line = whole_sums[:, : stop - start], whole_line[:, : stop - start]
            for index in range(passes + 1):
                _summed(part, times_s[row], line, threshold_s, index > 0, sums)
                _fitted(sums, slope, line)
            _lost(part, times_s[row], line, threshold_s, loss)


@inlined
def _levelled(
    left: Array, spread: Array, bound: Flags, level: Array, weights: Array, moved: Array
) -> None:
    """Move the level of each node of a block once, by the weights of Student's law about it."""
    weights[:] = 0.0
    moved[:] = 0.0
    for i in range(len(left)):
        mute = 0.0 if bound[i] else 1.0
        for j in range(BLOCK):
            off = left[i, j] - level[j]
            weight = (1.0 if off >= 0.0 else mute) / (spread[i, j] + off * off)
            weights[j] += weight
            moved[j] += weight * off
    for j in range(BLOCK):
        weights[j] = max(weights[j], 1e-12)
        level[j] += moved[j] / weights[j]


@compiled("void(f8[::1], b1[::1], f8[:, ::1], f8[:, ::1], f8, i8, f8[:, ::1])")
def student_logs(
    values: Array, bound: Flags, laws: Array, field: Array, freedom: float, passes: int, logs: Array
) -> None:
    """Put the log likelihood of values = level + slope field, by Student's law, in ``logs``.

    The level is the best one, which reweighting finds.

    Parameters
    ----------
    values, bound
        Shape (n,), and which of them are lower bounds: these tell nothing where they hold.
    laws
        Shape (h, 3): slope, constant error, and the part of slope times field that values err by
        besides.
    field
        Shape (n, q).
    freedom, passes
        Degrees of freedom, and how often the level is moved: once or more.
    logs
        Shape (h, q), overwritten.
    """
    left, spread = np.zeros((len(values), BLOCK)), np.ones((len(values), BLOCK))
    level, weights = np.empty(BLOCK), np.empty(BLOCK)
    moved, tails = np.empty(BLOCK), np.empty(BLOCK)
    for law in range(len(laws)):
        slope, constant, part = laws[law]
        for start in range(0, field.shape[1], BLOCK):
            count = min(BLOCK, field.shape[1] - start)  # what is behind is that of the block before
            level[:] = 0.0
            for i in range(len(values)):
                for j in range(count):
                    taken = slope * field[i, start + j]
                    left[i, j] = values[i] - taken
                    spread[i, j] = freedom * (constant * constant + (part * taken) ** 2)
                for j in range(BLOCK):
                    level[j] += left[i, j]
            level /= len(values)
            for _ in range(passes):
                _levelled(left, spread, bound, level, weights, moved)
            tails[:] = 1.0
            for i in range(len(values)):
                mute = 0.0 if bound[i] else 1.0
                for j in range(BLOCK):
                    off = left[i, j] - level[j]
                    off = off if off >= 0.0 else mute * off
                    tails[j] *= 1.0 + off * off / spread[i, j]
                    weights[j] *= spread[i, j] / freedom
            for j in range(count):
                deviance = (freedom + 1.0) * np.log(tails[j]) + np.log(weights[j])
                logs[law, start + j] = -deviance / 2.0


@compiled("void(c16[:, ::1], f8[:, :, ::1], i8[::1], f8[:, ::1])")
def steered(cross: Spectra, phasors: Array, delay: Index, around: Array) -> None:
    """Sum cross spectra in phase at the delays about one of each pair.

    Parameters
    ----------
    cross
        Shape (n_pairs, n_frequencies).
    phasors
        Shape (k, 2, n_frequencies): cosine and sine of the phases at delays of 0 steps, 1 and on.
    delay
        Shape (n_pairs,), in steps: at most k - 2, and from its negative on.
    around
        Shape (3, n_pairs): one step less, that delay, one step more; overwritten.
    """
    for pair in range(len(cross)):
        for part in range(3):
            at = delay[pair] + part - 1
            cosine, sine = phasors[abs(at), 0], phasors[abs(at), 1]
            same, opposite = 0.0, 0.0
            for i in range(cross.shape[1]):
                same += cross[pair, i].real * cosine[i]
                opposite += cross[pair, i].imag * sine[i]
            around[part, pair] = same - opposite if at >= 0 else same + opposite


@inlined
def _solved(normal: Array, right: Array) -> None:
    """Put x of normal x = right in ``right``; of normal, symmetric and positive, half is used."""
    n = len(right)
    for k in range(n):
        for i in range(k + 1, n):
            factor = normal[k, i] / normal[k, k]
            for j in range(i, n):
                normal[i, j] -= factor * normal[k, j]
            right[i] -= factor * right[k]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            right[i] -= normal[i, j] * right[j]
        right[i] /= normal[i, i]


@compiled("void(f8[:, ::1], f8[:, ::1], f8, i8, f8[::1])")
def agreed(weight: Array, late: Array, misfit_s: float, passes: int, arrivals: Array) -> None:
    """Fit arrivals of mean 0 to the delays of all pairs, reweighting by Cauchy's loss.

    Parameters
    ----------
    weight
        Shape (n, n), symmetric: what each pair counts; 0 on the diagonal.
    late
        Shape (n, n): how much later i hears it than j [s].
    misfit_s
        That halves a pair's weight [s].
    passes
        How often the equations are solved.
    arrivals
        Shape (n,) [s], overwritten.
    """
    n = len(weight)
    share, normal = weight.copy(), np.empty((n, n))
    for _ in range(passes):
        # the normal equations of all pairs; their one freedom is taken by a mean of 0
        even = share.sum() / (n * (n - 1))
        for i in range(n):
            total, right = 0.0, 0.0
            for j in range(n):
                normal[i, j] = even - share[i, j]
                total += share[i, j]
                right += share[i, j] * late[i, j]
            normal[i, i] += total
            arrivals[i] = right
        _solved(normal, arrivals)
        for i in range(n):
            for j in range(n):
                off = (arrivals[i] - arrivals[j] - late[i, j]) / misfit_s
                share[i, j] = weight[i, j] / (1.0 + off * off)
